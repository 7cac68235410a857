# SPDX-License-Identifier: Apache-2.0
"""Sliding-mode control on the simulated rig, without ROS."""

from pathlib import Path

import numpy as np
import pytest
from sliding_mode.sliding_mode import SlidingMode

from abrace.campaign.file import load_campaign
from abrace_core.node import find_file
from abrace_core.own_law import GuardedLaw
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.motion import RigMotion

FORCE = 15.0e3


def shaken(force: float) -> tuple[np.ndarray, np.ndarray]:
    """(samples, 8) [x1, x2, x3, xf, a1, a2, a3, f] and (samples,) command of 20 s of El Centro at 0.1 g."""
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    motion, law = RigMotion(rig), GuardedLaw(SlidingMode(force), 1 / rig.sample_rate, 0.5)
    ground = prepare(read_record("el_centro"), rig.sample_rate)[:10_000]
    law.begin(rig.floors, rig.groups)
    wanted, responses, commands = np.zeros(rig.groups), [], []
    for number, acceleration in enumerate(0.980665 * ground / np.abs(ground).max()):
        *z, first, second = motion.outputs(acceleration, wanted)[rig.measured_outputs]
        responses.append([*z, (first + second) / 2])
        wanted = np.array(law.force(number, responses[-1], 0))
        commands.append(wanted[0])
    return np.array(responses), np.array(commands)


def test_it_damps_every_floor_more_than_the_skyhook_and_never_asks_for_more_than_its_force() -> None:
    free, _ = shaken(1e-9)
    damped, commands = shaken(FORCE)
    left = damped.std(axis=0) / free.std(axis=0)
    assert left[2] < 0.22, "displacement of the third floor; the skyhook leaves 0.27"
    assert left[6] < 0.22, "its acceleration; the skyhook leaves 0.26"
    assert (left[:3] < 0.27).all()
    assert (left[4:7] < 0.40).all()
    assert 0.9 * FORCE < np.abs(commands).max() <= FORCE


def test_what_does_not_fit_the_rig_is_said() -> None:
    with pytest.raises(ValueError, match=r"boundary 0, corner 0\.6, expected more than 0"):
        SlidingMode(boundary=0.0)
    with pytest.raises(ValueError, match=r"weights \[0.3, 0.4, 0.3\], expected 2 times 5, one for each floor"):
        SlidingMode().begin(5, 2, 0.002)


def test_the_campaign_runs_it_beside_the_skyhook() -> None:
    campaign = load_campaign(Path(__file__).parents[1] / "campaign.yaml")
    assert [step.name for step in campaign.steps][1::2] == ["with_sliding_mode", "with_skyhook"]
