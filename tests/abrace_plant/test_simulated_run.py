# SPDX-License-Identifier: Apache-2.0
"""A test of the simulated rig without ROS; that it is the nodes' own is in tests/graph/test_replay.py."""

from pathlib import Path

import numpy as np
import pytest

from abrace_plant.live.simulated_run import simulated_run
from abrace_plant.rig.file import load_rig

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"


@pytest.fixture(scope="module")
def rig():
    return load_rig(CONFIG / "five_storey.yaml")


def test_each_group_gives_its_stroke_and_the_mean_of_its_braces(rig):
    seen = []

    def force(number, z, applied):
        seen.append((number, z, applied))
        return [1000.0, -500.0]

    run = simulated_run(rig, np.zeros(500), force)
    assert run.names[-2:] == ("f1", "f2")
    assert run.braces == (2, 1)
    np.testing.assert_array_equal(run.command[2:], [[1000.0, -500.0]] * 498)
    assert run.channels(["f1", "f2"])[-1] == pytest.approx([1000.0, -500.0], rel=0.2)
    numbers, measured, applied = zip(*seen, strict=True)
    assert list(numbers) == list(range(500))
    np.testing.assert_array_equal(measured, run.outputs)
    np.testing.assert_array_equal(applied, run.command)
    assert not run.clipped.any()


def test_a_table_beyond_its_sensor_stops_the_rig_and_the_run_says_so(rig):
    pulse = np.concatenate([np.zeros(100), np.full(100, 30.0), np.zeros(200)])
    run = simulated_run(rig, pulse, lambda *_: [0.0, 0.0], source="pulse")
    assert run.stopped == "w: at the end of its range, at 2 for 20 ms (interlocks.clipped)"
    assert run.clipped_samples["w"] >= 10, "20 ms"
    assert abs(run.ground_acceleration[-1]) < 0.1
