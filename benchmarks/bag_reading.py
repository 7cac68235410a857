# SPDX-License-Identifier: Apache-2.0
"""Speed of reading a bag: 1 000 000 responses to arrays, against `rosbags` and `mcap-ros2-support`, on one core.

read_1e6_seconds            `read_topics`, all fields of all messages
time_range_seconds          `read_topics` of one hundredth of the bag, in its middle
rosbags_seconds             `rosbags`, each message deserialised
mcap_ros2_support_seconds   `mcap-ros2-support`, each message deserialised

Each is the best of a few runs; peers run once over as many of the first messages as `peer_messages` says, and their
times are scaled to all.

python benchmarks/bag_reading.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from identification_speed import best_of, read_with_mcap_ros2, read_with_rosbags, write_bag
from simulation import ONE_THREAD

MESSAGES, PEER_MESSAGES = 1_000_000, 200_000
REPEATS = 5
RANGE = 100
"""The part of the bag in the range of time: one in so many."""


def bag_reading() -> dict[str, Any]:
    """`measure` in a process of its own, whose BLAS has one thread from the start."""
    script = Path(__file__).resolve()
    ran = subprocess.run([sys.executable, str(script)], env=os.environ | ONE_THREAD, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def measure(messages: int = MESSAGES, peer_messages: int = PEER_MESSAGES) -> dict[str, Any]:
    """Seconds of each, for bags of `messages` responses of the paper's rig, and how many times faster ours is."""
    from abrace_bags import read_topics

    with tempfile.TemporaryDirectory() as folder:
        bag, peer_bag = Path(folder) / "bag", Path(folder) / "peer"
        for path, count in ((bag, messages), (peer_bag, peer_messages)):
            write_bag(path, noise(count), "noise")
        read = read_topics(bag)["/response"].log_time
        assert read.size == messages, f"{read.size} responses, expected {messages}"
        begin, end = (int(read[read.size * (RANGE + side) // (2 * RANGE)]) for side in (-1, 1))
        seconds = best_of(REPEATS, lambda: read_topics(bag))
        range_seconds = best_of(REPEATS, lambda: read_topics(bag, begin=begin, end=end))
        readers = {"rosbags": read_with_rosbags, "mcap_ros2_support": read_with_mcap_ros2}
        peers = {
            name: best_of(1, partial(read, peer_bag), warm=False) * messages / peer_messages
            for name, read in readers.items()
        }
    found: dict[str, Any] = {
        "messages": messages,
        "peer_messages": peer_messages,
        f"read_{messages:.0e}_seconds".replace("+0", ""): seconds,
        "time_range_seconds": range_seconds,
    }
    for name, spent in peers.items():
        found[f"{name}_seconds"] = spent
        found[f"ratio_to_{name}"] = spent / seconds
    return found


def noise(samples: int) -> Any:
    """A test of `samples` samples of the paper's rig, in which everything is noise."""
    source = np.random.default_rng(6)
    return SimpleNamespace(
        floors=3,
        groups=1,
        sample_period=0.002,
        outputs=source.normal(size=(samples, 8)),
        command=source.normal(size=(samples, 1)),
        ground_acceleration=source.normal(size=samples),
    )


if __name__ == "__main__":
    print(json.dumps(measure(*map(int, sys.argv[1:]))))
