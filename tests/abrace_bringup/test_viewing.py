# SPDX-License-Identifier: Apache-2.0
"""What viewers are shown of a rig: names for all numbers, layouts that fit."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import write_nodes
import yaml
from bag_of_run import write_bag

from abrace import simulate
from abrace_bags import Bag
from abrace_bringup.page import view
from abrace_bringup.page.samples import ResponseReader, names_of
from abrace_bringup.viewing.layout import foxglove_layout
from abrace_core import AbraceError
from abrace_core.model.table_signals import table_noise
from abrace_interfaces.msg import Response
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.robot_description import joint_names

ROOT = Path(__file__).parents[2]
RIG = load_rig(ROOT / "src/abrace_plant/config/ncree_three_storey.yaml")
FIVE = load_rig(ROOT / "src/abrace_plant/config/five_storey.yaml")
VIEWER = ROOT / "src/abrace_bringup/viewer"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two seconds of a rig under noise, and its bag."""
    done = simulate(RIG, table_noise(1000, 500.0, (0.5, 10.0), 0.3, 1))
    path = tmp_path_factory.mktemp("bag") / "noise"
    write_bag(done, path)
    return done, path


def test_every_number_of_a_sample_has_the_name_that_the_paper_gives_it(run):
    done, bag = run
    samples = ResponseReader().read([one.payload for one in Bag(bag).raw()])
    columns = dict(zip(samples.names, samples.values.T, strict=True))
    for name, values in zip(done.names, done.outputs.T, strict=True):
        np.testing.assert_allclose(columns[name], values, rtol=1e-15, err_msg=name)
    np.testing.assert_array_equal(columns["w"], done.ground_acceleration)
    np.testing.assert_array_equal(columns["U"], done.command[:, 0])
    assert (samples.floors, samples.groups) == (3, 1)
    np.testing.assert_array_equal(samples.stamps, 2_000_000 * np.arange(1000))
    assert set(samples.runs.tolist()) == {samples.runs[0]}


def test_of_a_rig_whose_size_changes_the_last_samples_are_read(tmp_path):
    payloads = []
    for rig in (RIG, FIVE):
        write_bag(simulate(rig, np.zeros(2)), tmp_path / rig.name)
        payloads += [one.payload for one in Bag(tmp_path / rig.name).raw()]
    reader = ResponseReader()
    assert reader.read(payloads).names == names_of(FIVE.floors, FIVE.groups)
    with pytest.raises(AbraceError, match="message 0: has too few bytes"):
        reader.read([b"\x00\x01\x00\x00\x00\x00\x00\x00"])


def test_what_is_not_measured_is_on_no_page_and_in_no_viewer(tmp_path):
    rig = load_rig(ROOT / "src/abrace_plant/config/six_storey.yaml")
    run = simulate(rig, np.zeros(5))
    write_bag(run, tmp_path / "bag")
    samples = ResponseReader().read([one.payload for one in Bag(tmp_path / "bag").raw()])
    shown = view.on_screen(samples, rig)
    names = view.rig_view(rig)["channels"]
    assert names == ["a2", "a4", "a6", "f1", "f2", "w", "U1", "U2"]
    np.testing.assert_allclose(shown[:, names.index("a4")], run["a4"], rtol=1e-14)
    np.testing.assert_allclose(shown[:, names.index("f2")], run["f2"] / 1000, rtol=1e-14)
    assert not joint_names(rig)
    layout = foxglove_layout(6, (2, 1), "/rig/response", "/rig/robot_description", rig.not_measured).decode()
    assert set(re.findall(r"acceleration\[(\d)\]", layout)) == {"1", "3", "5"}
    assert "displacement[" not in layout
    assert "force[2]" in layout


@pytest.mark.parametrize("rig", [RIG, FIVE], ids=["three", "five"])
def test_the_layout_for_foxglove_shows_numbers_of_a_response_by_their_names(rig):
    content = json.loads(foxglove_layout(rig.floors, rig.braces_in_group, "/rig/response", "/rig/robot_description"))
    panels = content["configById"]
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(content["layout"]))) == set(panels)
    assert panels["3D!building"]["layers"]["rig"]["topic"] == "/rig/robot_description"
    source = {path["label"]: path["value"] for panel in panels.values() for path in panel.get("paths", ())}
    own = {"x5": "displacement[4]", "f1b": "force[1]", "f2": "force[2]", "U2": "command[1]"}
    own = own if rig is FIVE else {"x3": "displacement[2]", "fb": "force[1]", "U": "command[0]"}
    for name, field in {"a1": "acceleration[0]", "w": "ground_acceleration", "state": "state", **own}.items():
        assert source[name] == f"/rig/response.{field}"
        assert hasattr(Response(), field.partition("[")[0])


def test_the_configuration_for_rviz_shows_the_robot_description():
    content = yaml.safe_load((VIEWER / "rig.rviz").read_text())["Visualization Manager"]
    (building,) = [one for one in content["Displays"] if one["Class"].endswith("RobotModel")]
    assert building["Description Topic"]["Value"] == "/rig/robot_description"
    assert content["Global Options"]["Fixed Frame"] == "table", "the root of the description"


def test_every_running_node_is_in_one_group_of_the_diagnostic_aggregator():
    parameters = yaml.safe_load((VIEWER / "diagnostic_aggregator.yaml").read_text())["/**"]["ros__parameters"]
    groups = [one for one in parameters.values() if isinstance(one, dict)]
    assert {group["type"] for group in groups} == {"diagnostic_aggregator/GenericAnalyzer"}
    for group in groups:
        assert 1.0 < group["timeout"] < 5.0, "nodes report once a second"
    about = {name: text for inside in write_nodes.NODES.values() for name, text in inside.items()}
    running = [name for name, text in about.items() if not text.startswith("Offline")]
    assert {"plant", "controller", "logger", "viewer"} <= set(running)
    for name in running:
        status = f"rig/{name}: state"
        assert sum(any(part in status for part in group["contains"]) for group in groups) == 1, name
