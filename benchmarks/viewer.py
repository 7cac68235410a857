# SPDX-License-Identifier: Apache-2.0
"""The viewer beside a real-time loop at 500 Hz: what a client of Foxglove's protocol, at 500 Hz, costs the loop.

In turns, a rig and its controller run alone, and with a viewer whose client subscribes to all samples and commands and
to what is drawn of them. For `make soak`.

lost, alone_lost     samples of the rig that its controller or the logger missed, with the viewer and without
faults, alone_faults turns that ended with a fault of the rig, which a machine that is busy otherwise makes by itself
p999_us, alone_p999_us, p999_ratio  99.9 % of the times from a sample to its command, by the middleware's time stamps:
                 median over the turns of each kind, and their ratio
shown, not_shown     samples that the client received, and that it did not

python benchmarks/viewer.py SECONDS TURNS    # seconds of one turn, and how many pairs of turns
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from controller_speed import lqg3
from diagnostic_msgs.msg import DiagnosticStatus
from foxglove_client import FoxgloveClient
from isolation import isolated
from running_graph import graph_of_its_own

from abrace_bags import read_topics
from abrace_core.controller_file import save_controller
from abrace_core.wire import read_header

SECONDS, TURNS = 60.0, 10
RATIO_LIMIT = 1.1
"""Of the loop's 99.9 % with a viewer over that without."""
NAMESPACE = "/watched"
RESPONSE, COMMAND = f"{NAMESPACE}/response", f"{NAMESPACE}/brace_command"
WATCHED = (RESPONSE, COMMAND, "/view/channels", "/view/frames", "/view/scene")
P999 = 99.9


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


def turn(number: int, seconds: float, viewed: bool) -> dict[str, Any]:
    """A loop of its own for so many seconds; its latencies, losses and fault, and what the client has received."""
    with graph_of_its_own(NAMESPACE) as graph:
        graph.by_the_clock = True
        bag, done, client = graph.folder / f"turn_{number}", graph.folder / f"done_{number}", f"client_{number}"
        graph.start("plant")
        if viewed:
            graph.start("viewer", port=0, page_port=0)
            (line,) = graph.until(lambda: [text for text in graph.output_of("viewer") if "ws://" in text], "the viewer")
            command = [sys.executable, __file__, "watch", re.sub(r".*:", "", line), str(done)]
            graph.started[client] = graph.processes.start(client, command, graph.folder / f"{client}.log")
            graph.until(lambda: int(graph.values("viewer").get("samples", 0)), "the viewer to show samples")
        graph.start("ground_motion", record="white_noise", rms=0.1, band=[0.2, 30.0], duration=seconds + 120.0)
        graph.start("controller", "--params-file", Path("lqg3.yaml").resolve())
        graph.until_matched("controller", response=1, brace_command=1)
        graph.start("logger", output=str(bag), topics=[RESPONSE, COMMAND])
        graph.until_matched("logger", **{RESPONSE: 1, COMMAND: 1})
        lost_before, end = int(graph.values("controller")["lost"]), time.monotonic() + seconds
        while time.monotonic() < end:
            graph.executor.spin_once(timeout_sec=0.1)
        graph.stop("logger")
        seen = {}
        if viewed:
            done.touch()
            graph.ended(client)
            seen = json.loads(graph.output_of(client)[-1])
        lost = int(graph.values("controller")["lost"]) - lost_before
        fault = graph.statuses["plant"].level == DiagnosticStatus.ERROR
    return {**latencies(bag), "controller_lost": lost, "fault": int(fault), **seen}


def latencies(bag: Path) -> dict[str, Any]:
    """99.9 % of the times from sample to command in a bag [us], its samples, and those that are missing among them."""
    found = read_topics(bag)
    samples, commands = found[RESPONSE], found[COMMAND]
    sampled, answered = (topic.fields["sequence"].astype(np.int64) for topic in (samples, commands))
    _, first, second = np.intersect1d(sampled, answered, return_indices=True)
    taken = commands.publish_time[second].astype(np.int64) - samples.publish_time[first].astype(np.int64)
    missing = int(np.sum(np.diff(sampled) - 1))
    return {"p999": float(np.percentile(taken, P999)) / 1e3, "samples": sampled.size, "missing": missing}


def viewer_cost(seconds: float = SECONDS, turns: int = TURNS) -> dict[str, Any]:
    """So many pairs of turns; call it in a folder and on a domain of one's own."""
    save_controller(lqg3(), "lqg3.yaml")
    alone, viewed = [], []
    for number in range(turns):
        alone.append(turn(2 * number, seconds, viewed=False))
        viewed.append(turn(2 * number + 1, seconds, viewed=True))
        print(f"turn {number + 1} of {turns}: {alone[-1]}, {viewed[-1]}", file=sys.stderr)
    with_viewer, without = (float(np.median([one["p999"] for one in kind])) for kind in (viewed, alone))
    return {
        "samples": sum(one["samples"] for one in viewed),
        "lost": sum(one["missing"] + one["controller_lost"] for one in viewed),
        "alone_lost": sum(one["missing"] + one["controller_lost"] for one in alone),
        "faults": sum(one["fault"] for one in viewed),
        "alone_faults": sum(one["fault"] for one in alone),
        "p999_us": with_viewer,
        "alone_p999_us": without,
        "p999_ratio": with_viewer / without,
        "shown": sum(one["shown"] for one in viewed),
        "not_shown": sum(one["not_shown"] for one in viewed),
    }


def main() -> None:
    """Measure and print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    seconds = float(sys.argv[1]) if sys.argv[1:] else SECONDS
    turns = int(sys.argv[2]) if sys.argv[2:] else TURNS
    with isolated():
        print(json.dumps(viewer_cost(seconds, turns), indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["watch"]:
        watch(int(sys.argv[2]), Path(sys.argv[3]))
    else:
        main()
