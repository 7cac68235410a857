# SPDX-License-Identifier: Apache-2.0
"""The skyhook on the simulated rig, without ROS."""

import numpy as np
from skyhook.skyhook import Skyhook

from abrace_core.node import find_file
from abrace_core.own_law import GuardedLaw
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.motion import RigMotion


def shaken(damping: float) -> np.ndarray:
    """(samples, 8) [x1, x2, x3, xf, a1, a2, a3, f] of 20 s of El Centro at 0.1 g."""
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    motion, law = RigMotion(rig), GuardedLaw(Skyhook(damping), 1 / rig.sample_rate, 0.5)
    ground = prepare(read_record("el_centro"), rig.sample_rate)[:10_000]
    law.begin(rig.floors, rig.groups)
    force, responses = np.zeros(rig.groups), []
    for number, acceleration in enumerate(0.980665 * ground / np.abs(ground).max()):
        *z, first, second = motion.outputs(acceleration, force)[rig.measured_outputs]
        responses.append([*z, (first + second) / 2])
        force = np.array(law.force(number, responses[-1], 0))
    return np.array(responses)


def test_it_damps_every_floor() -> None:
    free, damped = shaken(0.0).std(axis=0), shaken(120.0e3).std(axis=0)
    assert (damped[:3] < 0.35 * free[:3]).all(), "displacements"
    assert (damped[4:7] < 0.35 * free[4:7]).all(), "accelerations"
