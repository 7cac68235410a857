# SPDX-License-Identifier: Apache-2.0
"""The viewer beside a real-time loop at 500 Hz: what a client of Foxglove's protocol, at 500 Hz, costs the loop.

In turns, a rig and its controller run alone, and with a viewer whose client subscribes to all samples and commands and
to what is drawn of them. For `make soak`.

lost, alone_lost     samples of the rig that its controller or the logger missed, with the viewer and without
faults, alone_faults turns that ended with a fault of the rig, which a machine that is busy otherwise makes by itself
stall_ms, alone_stall_ms  the longest stall of the machine itself in the turns of each kind (machine_stalls.py)
p999_us, alone_p999_us, p999_ratio  99.9 % of the times from a sample to its command, by the middleware's time stamps:
                 median over the turns of each kind, and their ratio
shown, not_shown     samples that the client received, and that it did not

Or one loop that is not interrupted: half of the seconds alone, all of them with the viewer, half alone again, so that a
machine that changes slowly changes both alike. The same values of the whole windows, and lost_joining: samples lost in
the seconds in which viewer and client start and end.

python benchmarks/viewer.py SECONDS TURNS         # seconds of one turn, and how many pairs of turns
python benchmarks/viewer.py continuous [SECONDS]  # with the viewer: 600
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from controller_speed import lqg3
from diagnostic_msgs.msg import DiagnosticStatus
from foxglove_client import FoxgloveClient
from isolation import isolated
from machine_stalls import MachineStalls
from running_graph import graph_of_its_own

from abrace_bags import read_topics
from abrace_core.controller_file import save_controller
from abrace_core.wire import read_header

if TYPE_CHECKING:
    from collections.abc import Sequence

    from running_graph import Graph

SECONDS, TURNS = 60.0, 10
CONTINUOUS = 600.0
"""Seconds with a viewer in one loop."""
SETTLED = 10.0
"""Seconds after a node has joined or left, which are in no window."""
RATIO_LIMIT = 1.1
"""Of the loop's 99.9 % with a viewer over that without."""
NAMESPACE = "/watched"
RESPONSE, COMMAND = f"{NAMESPACE}/response", f"{NAMESPACE}/brace_command"
WATCHED = (RESPONSE, COMMAND, "/view/channels", "/view/frames", "/view/scene")
P999 = 99.9
CLIENT, DONE = "client", "client_done"
"""The client's process, and the file at which it ends."""
ALWAYS = (0, 2**62)


def sequence_of(payload: bytes) -> int:
    """The number of a sample, which follows the header."""
    begin = read_header(payload).offset
    return int.from_bytes(payload[begin : begin + 8], "little")


def watch(port: int, done: Path) -> None:
    """Be the client until the file `done` appears; print how many samples came, and how many were missing."""
    with FoxgloveClient(port) as client:
        numbers: list[int] = []
        subscribed: set[str] = set()
        while not done.exists():
            time.sleep(0.2)
            new = (set(WATCHED) & set(client.channels)) - subscribed
            client.subscribe(*new)
            subscribed |= new
            for topic in WATCHED[1:]:
                client.messages[topic].clear()
            samples, client.messages[RESPONSE] = client.messages[RESPONSE], []
            numbers += [sequence_of(payload) for _, payload in samples]
    found = np.array(numbers)
    print(json.dumps({"shown": found.size, "not_shown": int(np.sum(np.diff(found) - 1))}), flush=True)


def start_loop(graph: Graph, bag: Path, seconds: float) -> None:
    """The table, the controller and the logger of a rig that runs, for so many seconds at most."""
    graph.start("ground_motion", record="white_noise", rms=0.1, band=[0.2, 30.0], duration=seconds + 120.0)
    graph.start("controller", "--params-file", Path("lqg3.yaml").resolve())
    graph.until_matched("controller", response=1, brace_command=1)
    graph.start("logger", output=str(bag), topics=[RESPONSE, COMMAND])
    graph.until_matched("logger", **{RESPONSE: 1, COMMAND: 1})


def start_viewer(graph: Graph) -> None:
    """A viewer and its client, which takes all samples from here on."""
    (graph.folder / DONE).unlink(missing_ok=True)  # of an earlier turn
    graph.start("viewer", port=0, page_port=0)
    (line,) = graph.until(lambda: [text for text in graph.output_of("viewer") if "ws://" in text], "the viewer")
    command = [sys.executable, __file__, "watch", re.sub(r".*:", "", line), str(graph.folder / DONE)]
    graph.started[CLIENT] = graph.processes.start(CLIENT, command, graph.folder / f"{CLIENT}.log")
    graph.until(lambda: int(graph.values("viewer").get("samples", 0)), "the viewer to show samples")


def end_client(graph: Graph) -> dict[str, Any]:
    """What the client has received."""
    (graph.folder / DONE).touch()
    graph.ended(CLIENT)
    found: dict[str, Any] = json.loads(graph.output_of(CLIENT)[-1])
    return found


def let_run(graph: Graph, seconds: float) -> tuple[tuple[int, int], int]:
    """Wait so long; returns begin and end [ns since 1970], and how many samples the controller has missed then."""
    lost_before, begin, end = int(graph.values("controller")["lost"]), time.time_ns(), time.monotonic() + seconds
    while time.monotonic() < end:
        graph.executor.spin_once(timeout_sec=0.1)
    return (begin, time.time_ns()), int(graph.values("controller")["lost"]) - lost_before


def turn(number: int, seconds: float, viewed: bool) -> dict[str, Any]:
    """A loop of its own for so many seconds; its latencies, losses and fault, and what the client has received."""
    with graph_of_its_own(NAMESPACE) as graph:
        graph.by_the_clock = True
        bag = graph.folder / f"turn_{number}"
        graph.start("plant")
        if viewed:
            start_viewer(graph)
        start_loop(graph, bag, seconds)
        _, lost = let_run(graph, seconds)
        graph.stop("logger")
        seen = end_client(graph) if viewed else {}
        fault = graph.statuses["plant"].level == DiagnosticStatus.ERROR
    return {**latencies(bag, [ALWAYS]), "controller_lost": lost, "fault": int(fault), **seen}


def latencies(bag: Path, windows: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """99.9 % of the times from sample to command in windows [ns] of a bag [us], samples, and those that are missing."""
    found = read_topics(bag)
    samples, commands = found[RESPONSE], found[COMMAND]
    sampled, answered = (topic.fields["sequence"].astype(np.int64) for topic in (samples, commands))
    published = samples.publish_time.astype(np.int64)
    inside = np.any([(published >= begin) & (published < end) for begin, end in windows], axis=0)
    _, first, second = np.intersect1d(sampled, answered, return_indices=True)
    taken = (commands.publish_time[second].astype(np.int64) - published[first])[inside[first]]
    # a sample that is missing between two of a window
    missing = int(np.sum((np.diff(sampled) - 1)[inside[1:] & inside[:-1]]))
    return {"p999": float(np.percentile(taken, P999)) / 1e3, "samples": int(inside.sum()), "missing": missing}


def continuous(seconds: float = CONTINUOUS) -> dict[str, Any]:
    """One loop, alone and with a viewer for so many seconds each; call it in a folder and on a domain of one's own."""
    save_controller(lqg3(), "lqg3.yaml")
    with graph_of_its_own(NAMESPACE) as graph:
        graph.by_the_clock = True
        bag = graph.folder / "continuous"
        graph.start("plant")
        start_loop(graph, bag, 2 * seconds)
        let_run(graph, SETTLED)
        before, lost_before = let_run(graph, seconds / 2)
        lost_at_first = int(graph.values("controller")["lost"])
        start_viewer(graph)
        let_run(graph, SETTLED)
        viewed, lost = let_run(graph, seconds)
        fault = graph.statuses["plant"].level == DiagnosticStatus.ERROR
        seen = end_client(graph)
        graph.stop("viewer")
        let_run(graph, SETTLED)
        lost_joining = int(graph.values("controller")["lost"]) - lost_at_first - lost
        after, lost_after = let_run(graph, seconds / 2)
        graph.stop("logger")
    alone, with_viewer = latencies(bag, [before, after]), latencies(bag, [viewed])
    return {
        "seconds": seconds,
        "samples": with_viewer["samples"],
        "lost": with_viewer["missing"] + lost,
        "alone_lost": alone["missing"] + lost_before + lost_after,
        "lost_joining": lost_joining,
        "faults": int(fault),
        "p999_us": with_viewer["p999"],
        "alone_p999_us": alone["p999"],
        "p999_ratio": with_viewer["p999"] / alone["p999"],
        **seen,
    }


def viewer_cost(seconds: float = SECONDS, turns: int = TURNS) -> dict[str, Any]:
    """So many pairs of turns; call it in a folder and on a domain of one's own."""
    save_controller(lqg3(), "lqg3.yaml")
    alone: list[dict[str, Any]] = []
    viewed: list[dict[str, Any]] = []
    with MachineStalls() as stalls:
        for number in range(2 * turns):
            began, second = time.monotonic(), number % 2 == 1
            measured = turn(number, seconds, viewed=second)
            found = {**measured, "stall_ms": 1e3 * max(stalls.since(began), default=0.0)}
            (viewed if second else alone).append(found)
            print(f"turn {number + 1} of {2 * turns}: {found}", file=sys.stderr, flush=True)
    with_viewer, without = (float(np.median([one["p999"] for one in kind])) for kind in (viewed, alone))
    return {
        "samples": sum(one["samples"] for one in viewed),
        "lost": sum(one["missing"] + one["controller_lost"] for one in viewed),
        "alone_lost": sum(one["missing"] + one["controller_lost"] for one in alone),
        "faults": sum(one["fault"] for one in viewed),
        "alone_faults": sum(one["fault"] for one in alone),
        "stall_ms": max(one["stall_ms"] for one in viewed),
        "alone_stall_ms": max(one["stall_ms"] for one in alone),
        "p999_us": with_viewer,
        "alone_p999_us": without,
        "p999_ratio": with_viewer / without,
        "shown": sum(one["shown"] for one in viewed),
        "not_shown": sum(one["not_shown"] for one in viewed),
    }


def main() -> None:
    """Measure and print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        match sys.argv[1:]:
            case ["continuous", *given]:
                found = continuous(float(given[0]) if given else CONTINUOUS)
            case given:
                found = viewer_cost(*(kind(text) for kind, text in zip((float, int), given, strict=False)))
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["watch"]:
        watch(int(sys.argv[2]), Path(sys.argv[3]))
    else:
        main()
