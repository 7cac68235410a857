# SPDX-License-Identifier: Apache-2.0
"""Endurance of the closed loop in lockstep: two runs on the same nodes, 10 hours of the rig or 20 minutes in all.

samples    of both runs
lost       samples that were not received; they are in no block
grown_mb   by node, greatest less smallest resident memory after the first minute
compared   samples of the second run whose bytes were compared with those of the first, but for the run's number
different  blocks of 10 000 samples that are not the same

python benchmarks/lockstep_endurance.py [SECONDS]
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from controller_speed import lqg3
from geometry_msgs.msg import AccelStamped
from isolation import isolated
from running_graph import Graph, graph_of_its_own

from abrace_core.controller_file import save_controller
from abrace_core.node.conventions import KEPT_STREAM_QOS, LOCKSTEP_STREAM_QOS
from abrace_core.wire import LAST, Responses, read_header
from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from collections.abc import Sequence

SECONDS = 1200.0
MOST_SAMPLES = 10 * 3600 * 500
MEMORY_LIMIT = 1.0
"""MB that a node may grow by after SETTLED."""
SETTLED = 60.0
LOOK_AFTER = 1000
"""Samples after which the memory is looked at."""
UNWATCHED = "ground_motion_unwatched"
"""Topic of the motion before it has gone through our hands."""
BLOCK = 10_000
SEQUENCE_SIZE = RUN_SIZE = 8
"""Bytes of the first two fields after the header; the second one differs between two runs."""


class Watch:
    """Digests of the samples of each run, block by block; the rig waits for it, so that no sample is lost."""

    def __init__(self, graph: Graph) -> None:
        self.runs: list[list[str]] = []
        self.samples = self.lost = self.ended = 0
        self._responses = Responses()
        self._digest = hashlib.blake2b()
        self._run = self._sequence = -1
        graph.node.create_subscription(Response, "response", self._on_response, LOCKSTEP_STREAM_QOS, raw=True)
        relay = graph.publisher(AccelStamped, "ground_motion")
        graph.node.create_subscription(AccelStamped, UNWATCHED, relay.publish, KEPT_STREAM_QOS, raw=True)

    def _on_response(self, payload: bytes) -> None:
        _, head, _ = self._responses.unpack(payload)
        if head.run != self._run:
            self._run, self._sequence, self._digest = head.run, -1, hashlib.blake2b()
            self.runs.append([])
        self.samples += 1
        self.lost += head.sequence - self._sequence - 1
        self._sequence = head.sequence
        self.ended += bool(head.flags & LAST)
        begin = read_header(payload).offset + SEQUENCE_SIZE
        self._digest.update(payload[:begin])
        self._digest.update(payload[begin + RUN_SIZE :])
        if (head.sequence + 1) % BLOCK == 0:
            self.runs[-1].append(self._digest.hexdigest())


def resident_mb(process: int) -> float:
    """Memory of a process, by its number, that is in RAM."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


class Look(NamedTuple):
    """Memory of the nodes at one moment.

    Parameters
    ----------
    run
        1 or 2.
    seconds
        Since the first run began.
    samples
        So far, of both runs.
    memory
        By node [MB].
    """

    run: int
    seconds: float
    samples: int
    memory: dict[str, float]


def grown_mb(looks: Sequence[Look]) -> dict[str, float]:
    """By node, greatest less smallest memory [MB]."""
    names = looks[0].memory if looks else ()
    return {name: float(np.ptp([look.memory[name] for look in looks])) for name in names}


def run_in_lockstep(graph: Graph, seconds: float, samples: int) -> tuple[list[Look], dict[str, Any]]:
    """Two runs, together of so many `seconds` or `samples`, whichever is less: memory, and what is listed above.

    The samples of a run are counted from its first look at the memory on: a node may go on for thousands before it
    hears that it is to stop. The motion goes through our hands, so that the rig is never ahead of us: the samples that
    it keeps for a slow subscriber take memory, too.
    """
    save_controller(lqg3(), graph.folder / "lqg3.yaml")
    inputs = ["brace_command", "ground_motion"]
    graph.start("plant", lockstep=True, wait_for=inputs, autostart=False)
    through_us = ("-r", f"ground_motion:={UNWATCHED}")
    graph.start("ground_motion", *through_us, record="white_noise", rms=0.1, duration=240.0, autostart=False)
    graph.start("controller", "--params-file", graph.folder / "lqg3.yaml")
    for name in ("plant", "ground_motion"):
        assert graph.change_state(name, "configure")
    watch = Watch(graph)
    graph.until_matched("plant", response=3, ground_motion=1, brace_command=1)
    graph.until_matched("ground_motion", response=1, ground_motion=1)
    assert graph.change_state("ground_motion", "activate")
    looks: list[Look] = []
    begun = time.monotonic()
    for run in (1, 2):
        assert graph.change_state("plant", "activate")
        end = math.inf
        while time.monotonic() < begun + run * seconds / 2 and watch.samples < end:
            count = watch.samples + LOOK_AFTER
            graph.until(lambda count=count: watch.samples >= count, "samples")  # type: ignore[misc]
            memory = {name: resident_mb(process.group) for name, process in graph.started.items()}
            looks.append(Look(run, time.monotonic() - begun, watch.samples, memory))
            end = min(end, watch.samples + samples / 2)
        assert graph.change_state("plant", "deactivate")
        graph.until(lambda run=run: watch.ended == run, "the last sample")  # type: ignore[misc]
    first, second = watch.runs
    return looks, {
        "samples": watch.samples,
        "lost": watch.lost,
        "seconds": time.monotonic() - begun,
        "compared": BLOCK * min(len(first), len(second)),
        "different": sum(one != other for one, other in zip(first, second, strict=False)),
    }


def lockstep_endurance(seconds: float = SECONDS) -> dict[str, Any]:
    """All of it; call it on a domain of one's own."""
    with graph_of_its_own("/lockstep") as graph:
        looks, found = run_in_lockstep(graph, seconds, MOST_SAMPLES)
    return {**found, "grown_mb": grown_mb([look for look in looks if look.seconds > SETTLED])}


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(lockstep_endurance(float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS), indent=1))
