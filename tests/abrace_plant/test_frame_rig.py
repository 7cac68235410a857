# SPDX-License-Identifier: Apache-2.0
"""A rig whose building is a frame file's: what its levels keep of the frame, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from abrace_core.errors import AbraceError
from abrace_plant.frames.file import load_frame
from abrace_plant.frames.model import building_model, modal_building
from abrace_plant.rig.file import load_rig, recorded_rig
from abrace_plant.rig.model import Rig

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
RIG = "sac_la_20"


def content(**building: Any) -> dict[str, Any]:
    written = yaml.safe_load((CONFIG / f"{RIG}.yaml").read_text())
    return written | {"building": {"frame": RIG} | building}


def loaded(written: dict[str, Any], folder: Path) -> Rig:
    (folder / "rig.yaml").write_text(yaml.safe_dump(written))
    return load_rig(folder / "rig.yaml")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIG / f"{RIG}.yaml")


@pytest.fixture(scope="module")
def frame():
    return load_frame(CONFIG / f"frames/{RIG}.yaml")


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


def test_its_frequencies_and_damping_are_the_frames_as_nearly_as_it_states(rig, frame):
    modes, (frequencies, _) = modal_building(frame), rig.building.modes()
    stated = np.array(rig.building.frequency_errors)
    assert frequencies[:5] == pytest.approx(modes.frequencies[:5] * (1 + stated[:5]), rel=1e-9)
    assert 0 < np.abs(stated[:5]).max() < 0.003
    assert np.abs(stated).max() < 0.015
    assert rig.building.damping_ratios[:5] == pytest.approx(modes.damping_ratios[:5], rel=0.002)


def test_a_frame_of_three_storeys_loses_next_to_nothing(tmp_path):
    written = content(frame="sac_la_3")
    written["braces"] = written["braces"][:3]
    small = loaded(written, tmp_path)
    frequencies, _ = small.building.modes()
    assert frequencies / (2 * np.pi) == pytest.approx([0.990, 3.056, 5.827], rel=4e-4)
    assert np.abs(small.building.frequency_errors).max() < 4e-5


def test_a_bags_facts_describe_the_rig_where_the_frame_file_is_no_more(tmp_path):
    written = content(frame=str(tmp_path / "gone.yaml"))
    written["braces"] = written["braces"][:3]
    facts = {"rig_file": yaml.safe_dump(written), "frame_file": (CONFIG / "frames/sac_la_3.yaml").read_text()}
    assert recorded_rig({"rig": "real"}) is None
    found = recorded_rig(facts)
    assert found is not None
    assert found.building.masses.sum() == pytest.approx(2948980.0)
    assert found.storey_heights == pytest.approx([3.9624] * 3)
    with pytest.raises(AbraceError, match=r"rig\.yaml: frame file .*gone\.yaml: no such file"):
        recorded_rig({"rig_file": facts["rig_file"]})
    older = recorded_rig({"rig_file": (CONFIG / f"{RIG}.yaml").read_text()})
    assert older is not None
    assert older.floors == 20, "an installed frame is found without the fact"


def test_the_devices_push_what_they_are_told_however_the_building_moves(rig):
    omega = 2 * np.pi * np.array([0.3, 1.0, 3.0, 10.0])
    response = rig.model.select(["f1", "f20"], ["U1", "U20"]).frequency_response(omega)
    late = np.exp(-1j * omega * 0.001)[:, None, None]
    assert response == pytest.approx(late * np.eye(2), abs=0.003)


def test_the_weight_takes_from_its_stiffness(rig, tmp_path):
    leaning = loaded(content(p_delta=True), tmp_path)
    share = leaning.building.modes()[0][0] / rig.building.modes()[0][0]
    assert 0.9 < share < 0.99


@pytest.mark.parametrize(
    ("building", "message"),
    [
        ({"frame": "sac_la_21"}, "frame 'sac_la_21': unknown, expected a file ending in .yaml or one of sac_la_20, "),
        ({"masses": [1e5] * 20}, "building.masses: given, expected none: building.frame has it"),
        ({"damping_ratios": [0.02] * 20}, "building.damping_ratios: given, expected none: building.frame has it"),
        ({"frame": None}, "building.storey_height: key is missing"),
        ({"frame": None, "storey_height": 4.0}, "building.masses: key is missing"),
        ({"friction": [100.0]}, "building.friction: 1 numbers, expected one for each of 20 storeys"),
    ],
)
def test_what_does_not_fit_a_frame_is_refused_in_one_line(building, message, tmp_path):
    with pytest.raises(AbraceError) as refused:
        loaded(content(**building), tmp_path)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
