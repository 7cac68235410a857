# SPDX-License-Identifier: Apache-2.0
"""Speed of reading a bag: 1 000 000 responses to arrays, against `rosbags` and `mcap-ros2-support`, on one core.

seconds                     `Bag.arrays`, all fields of all messages
time_range_seconds          `Bag.arrays` of one hundredth of the bag, in its middle
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
from typing import Any

import numpy as np
from bag_of_run import write_bag
from identification_speed import best_of, read_with_mcap_ros2, read_with_rosbags
from simulation import ONE_THREAD

from abrace_core.model.run import Run

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
    from abrace_bags import Bag

    with tempfile.TemporaryDirectory() as folder:
        bag, peer_bag = Path(folder) / "bag", Path(folder) / "peer"
        for path, count in ((bag, messages), (peer_bag, peer_messages)):
            write_bag(noise(count), path)
        read = Bag(bag).arrays()["/response"].log_time
        assert read.size == messages, f"{read.size} responses, expected {messages}"
        begin, end = (int(read[read.size * (RANGE + side) // (2 * RANGE)]) for side in (-1, 1))
        seconds = best_of(REPEATS, lambda: Bag(bag).arrays())
        range_seconds = best_of(REPEATS, lambda: Bag(bag).arrays(begin=begin, end=end))
        readers = {"rosbags": read_with_rosbags, "mcap_ros2_support": read_with_mcap_ros2}
        peers = {
            name: best_of(1, partial(read, peer_bag), warm=False) * messages / peer_messages
            for name, read in readers.items()
        }
    found: dict[str, Any] = {
        "messages": messages,
        "peer_messages": peer_messages,
        "seconds": seconds,
        "time_range_seconds": range_seconds,
    }
    for name, spent in peers.items():
        found[f"{name}_seconds"] = spent
        found[f"ratio_to_{name}"] = spent / seconds
    return found


def noise(samples: int) -> Run:
    """A test of `samples` samples of the paper's rig, in which everything is noise."""
    outputs, ground, command = np.split(np.random.default_rng(6).normal(size=(samples, 10)), [8, 9], axis=1)
    return Run("noise", 0.002, np.arange(samples, dtype=np.uint64), 3, 1, outputs, ground[:, 0], command)


if __name__ == "__main__":
    print(json.dumps(measure(*map(int, sys.argv[1:]))))
