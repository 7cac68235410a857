"""The viewer beside a real-time loop at 500 Hz: what a client of Foxglove's protocol, at 500 Hz, costs the loop.

In turns, a rig and its controller run alone, and with a viewer whose client subscribes to all samples and commands and
to what is drawn of them. For `make soak`.

lost             samples of the rig that its controller or the logger missed in turns with the viewer; and without
p999_us, alone_p999_us, p999_ratio  99.9 % of the times from a sample to its command, by the middleware's time stamps:
                 median over the turns of each kind, and their ratio
shown, not_shown  samples that the client received, and that it did not

python benchmarks/viewer.py SECONDS TURNS    # seconds of one turn, and how many pairs of turns
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
from foxglove_client import FoxgloveClient
from isolation import isolated
from running_graph import graph_of_its_own

from abrace_bags import read_topics
from abrace_core.controller_file import save_controller
from abrace_core.wire import read_header

if TYPE_CHECKING:
    from running_graph import Graph

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
        while not set(WATCHED) <= set(client.channels):
            time.sleep(0.05)
        client.subscribe(*WATCHED)
        numbers: list[int] = []
        while not done.exists():
            time.sleep(0.2)
            for topic in WATCHED[1:]:
                client.messages[topic].clear()
            samples, client.messages[RESPONSE] = client.messages[RESPONSE], []
            numbers += [sequence_of(payload) for _, payload in samples]
    found = np.array(numbers)
    print(json.dumps({"shown": found.size, "not_shown": int(np.sum(np.diff(found) - 1))}), flush=True)


def turn(graph: Graph, number: int, seconds: float, viewed: bool) -> dict[str, Any]:
    """Record the loop for so many seconds; latencies, losses, and what the client has received."""
    bag, done, client = graph.folder / f"turn_{number}", graph.folder / f"done_{number}", f"client_{number}"
    lost_before = int(graph.values("controller").get("lost", 0))
    if viewed:
        graph.start("viewer", port=0, page_port=0)
        (line,) = graph.until(lambda: [text for text in graph.output_of("viewer") if "ws://" in text], "the viewer")
        port = re.sub(r".*:", "", line)
        command = [sys.executable, __file__, "watch", port, str(done)]
        graph.started[client] = graph.processes.start(client, command, graph.folder / f"{client}.log")
        graph.until(lambda: int(graph.values("viewer").get("samples", 0)), "the viewer to show samples")
    graph.start("logger", output=str(bag), topics=[RESPONSE, COMMAND])
    graph.until_matched("logger", **{RESPONSE: 1, COMMAND: 1})
    end = time.monotonic() + seconds
    graph.until(lambda: time.monotonic() > end, "the end of the turn", seconds + 60.0)
    graph.stop("logger")
    seen = {}
    if viewed:
        done.touch()
        graph.ended(client)
        seen = json.loads(graph.output_of(client)[-1])
        graph.stop("viewer")
    found = read_topics(bag)
    samples, commands = found[RESPONSE], found[COMMAND]
    sampled = samples.fields["sequence"].astype(np.int64)
    _, first, second = np.intersect1d(sampled, commands.fields["sequence"].astype(np.int64), return_indices=True)
    latency = commands.publish_time[second].astype(np.int64) - samples.publish_time[first].astype(np.int64)
    lost = int(np.sum(np.diff(sampled) - 1)) + int(graph.values("controller").get("lost", 0)) - lost_before
    return {"p999": float(np.percentile(latency, P999)) / 1e3, "samples": sampled.size, "lost": lost, **seen}


def viewer_cost(seconds: float = SECONDS, turns: int = TURNS) -> dict[str, Any]:
    """So many pairs of turns; call it in a folder and on a domain of one's own."""
    save_controller(lqg3(), "lqg3.yaml")
    with graph_of_its_own(NAMESPACE) as graph:
        graph.by_the_clock = True
        graph.start("plant")
        graph.start(
            "ground_motion", record="white_noise", rms=0.1, band=[0.2, 30.0], duration=2 * turns * (seconds + 60)
        )
        graph.start("controller", "--params-file", Path("lqg3.yaml").resolve())
        graph.until_matched("controller", response=1, brace_command=1)
        alone, viewed = [], []
        for number in range(turns):
            alone.append(turn(graph, 2 * number, seconds, viewed=False))
            viewed.append(turn(graph, 2 * number + 1, seconds, viewed=True))
            print(f"turn {number + 1} of {turns}: {alone[-1]}, {viewed[-1]}", file=sys.stderr)
    with_viewer, without = (float(np.median([one["p999"] for one in kind])) for kind in (viewed, alone))
    return {
        "samples": sum(one["samples"] for one in viewed),
        "lost": sum(one["lost"] for one in viewed),
        "alone_lost": sum(one["lost"] for one in alone),
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
