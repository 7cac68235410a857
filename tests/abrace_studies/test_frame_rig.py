# SPDX-License-Identifier: Apache-2.0
"""A rig whose building is a frame condensed to its levels: what it keeps of the frame."""

from pathlib import Path

import numpy as np
import pytest

from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import Rig
from abrace_studies.frames.file import load_frame
from abrace_studies.frames.model import building_model, modal_building

ROOT = Path(__file__).parents[2]
RIG = "sac_la_20"


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / f"src/abrace_plant/config/{RIG}.yaml")


@pytest.fixture(scope="module")
def frame():
    return load_frame(ROOT / f"src/abrace_studies/frames/{RIG}.yaml")


def test_its_masses_heights_and_devices_are_the_buildings(rig, frame):
    assert rig.building.masses == pytest.approx(frame.masses)
    assert rig.storey_heights == pytest.approx([5.4864, *[3.9624] * 19])
    assert rig.storey_height == pytest.approx(frame.heights.mean())
    assert [group.floor for group in rig.braces] == list(range(1, 21))
    assert sum(rig.braces_in_group) == 25
    assert len(rig.channel_names) == 86


def test_forces_on_levels_that_rest_displace_them_as_in_the_whole_frame(rig, frame):
    devices = rig.braces_in_group
    whole = building_model(frame, devices).select([f"x{i}" for i in range(1, 21)], [f"U{j}" for j in range(1, 21)])
    exact = -whole.c @ np.linalg.solve(whole.a, whole.b)
    pushes = np.column_stack([group.count * group.direction(20) for group in rig.braces])
    assert np.linalg.solve(rig.building.stiffness, pushes) == pytest.approx(exact, rel=1e-9, abs=1e-6 * np.ptp(exact))


def test_its_frequencies_and_damping_are_nearly_the_frames(rig, frame):
    modes, (frequencies, _) = modal_building(frame), rig.building.modes()
    assert frequencies[:5] == pytest.approx(modes.frequencies[:5], rel=0.003)
    assert rig.building.damping_ratios[:5] == pytest.approx(modes.damping_ratios[:5], rel=0.002)


def test_the_devices_push_what_they_are_told_however_the_building_moves(rig):
    omega = 2 * np.pi * np.array([0.3, 1.0, 3.0, 10.0])
    response = rig.model.select(["f1", "f20"], ["U1", "U20"]).frequency_response(omega)
    late = np.exp(-1j * omega * 0.001)[:, None, None]
    assert response == pytest.approx(late * np.eye(2), abs=0.003)
