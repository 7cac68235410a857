# SPDX-License-Identifier: Apache-2.0
"""What viewers are shown of a rig: every extreme, names for all numbers, a building that moves, layouts that fit."""

import json
import re
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_of_run import write_bag

from abrace import simulate
from abrace_bags.definitions import message_definition, parse_message_type
from abrace_bags.raw import read_raw
from abrace_bringup.viewing.bag_source import BagSource
from abrace_bringup.viewing.decimation import extremes
from abrace_bringup.viewing.layout import layout
from abrace_bringup.viewing.named_channels import RESPONSE_TYPE, ResponseReader, message, names_of, schema
from abrace_bringup.viewing.scene import Scene, colour
from abrace_bringup.viewing.server import CHANNELS, DESCRIPTION, SCENE
from abrace_core.errors import AbraceError
from abrace_core.table_signals import table_noise
from abrace_plant.rig.file import load_rig

ROOT = Path(__file__).parents[2]
RIG = load_rig(ROOT / "src/abrace_plant/config/ncree_three_storey.yaml")
FIVE = load_rig(ROOT / "src/abrace_plant/config/five_storey.yaml")
LAYOUTS = ROOT / "src/abrace_bringup/viewer"


def test_the_smallest_and_the_largest_value_of_every_channel_of_a_window_are_kept():
    chance = np.random.default_rng(1)
    for count in range(1, 60):
        values, step = chance.integers(-5, 5, (count, 7)).astype(float), int(chance.integers(1, 10**8))
        times = 10**18 + step * np.arange(count)
        shown, kept = extremes(times, values)
        assert len(shown) == len(kept) == min(count, 2)
        np.testing.assert_array_equal(kept.min(axis=0), values.min(axis=0))
        np.testing.assert_array_equal(kept.max(axis=0), values.max(axis=0))
        assert times[0] <= shown[0] <= shown[-1] <= times[-1] + step
        assert (np.diff(shown) > 0).all()


def test_one_sample_that_peaks_among_a_thousand_is_shown_in_its_place():
    values = np.zeros((1000, 2))
    values[700, 0], values[300, 1] = -5.0, 7.0
    windows = [extremes(np.arange(k, k + 20), values[k : k + 20]) for k in range(0, 1000, 20)]
    times, shown = (np.concatenate(part) for part in zip(*windows, strict=True))
    assert shown[:, 0].min() == -5.0
    assert shown[:, 1].max() == 7.0
    assert abs(times[shown[:, 0].argmin()] - 700) <= 15, "to three quarters of a window"
    np.testing.assert_array_equal(np.diff(times), 10)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two seconds of a rig under noise, and its bag."""
    done = simulate(RIG, table_noise(1000, 500.0, (0.5, 10.0), 0.3, 1))
    path = tmp_path_factory.mktemp("bag") / "noise"
    write_bag(done, path)
    return done, path


def test_every_number_of_a_sample_has_the_name_that_the_paper_gives_it(run):
    done, bag = run
    samples = ResponseReader(RIG.capacity.tolist()).read([one.payload for one in read_raw(bag).read()])
    assert samples.names == names_of(3, [2])
    columns = dict(zip(samples.names, samples.values.T, strict=True))
    for name, values in zip(done.names, done.outputs.T, strict=True):
        np.testing.assert_allclose(columns[name], values, rtol=1e-15, err_msg=name)
    np.testing.assert_array_equal(columns["w"], done.ground_acceleration)
    np.testing.assert_array_equal(columns["U"], done.command[:, 0])
    np.testing.assert_allclose(columns["fb_utilisation"], np.abs(columns["fb"]) / RIG.capacity[0])
    assert samples.sequence == 999
    shown = json.loads(json.dumps(message(samples, samples.values[-1]), allow_nan=False))
    assert set(shown) == set(schema(samples.names)["properties"])
    assert shown["x3"] == done.outputs[-1, 2]
    assert message(samples, samples.values[-1] * np.nan)["x3"] is None, "JSON has no NaN"


def test_of_a_rig_whose_size_changes_the_last_samples_are_read(tmp_path):
    payloads = []
    for rig in (RIG, FIVE):
        write_bag(simulate(rig, np.zeros(2)), tmp_path / rig.name)
        payloads += [one.payload for one in read_raw(tmp_path / rig.name).read()]
    reader = ResponseReader(FIVE.capacity.tolist())
    assert reader.read(payloads).names == names_of(FIVE.floors, FIVE.braces_in_group)
    with pytest.raises(AbraceError, match="message 0: has 8 bytes"):
        reader.read([b"\x00\x01\x00\x00\x00\x00\x00\x00"])


def test_floors_are_drawn_as_many_times_further_out_as_is_asked_for():
    scene = Scene(RIG)
    sample = dict.fromkeys(names_of(3, [2]), 0.0) | {"x2": 0.0123, "fa": -12258.3, "fa_utilisation": 0.5}
    frames = scene.frames(sample, 20.0, 1_500_000_000).encode()
    assert struct.pack("<d", 20.0 * 0.0123) in frames
    assert frames.count(b"floor_2_link") == 1
    drawn = scene.update(sample, 20.0, 0).encode()
    assert b"fa -12.26 kN, 50 %" in drawn
    assert b"fb 0.00 kN, 0 %" in drawn
    for share in colour(0.5):
        assert struct.pack("<d", share) in drawn
    assert scene.update(dict.fromkeys(sample, float("nan")), 20.0, 0).encode(), "a failed sensor is no reason to stop"
    assert Scene(FIVE).update({}, 1.0, 0).encode().count(b"kN") == sum(FIVE.braces_in_group)


def test_a_bag_is_played_by_the_clock_and_again_from_its_beginning(run):
    _, bag = run
    source, rounds = BagSource(str(bag), 1.0, loop=True), []
    assert len(list(source.messages(100.0, lambda: rounds.append(1)))) == 1
    assert len(list(source.messages(100.5, lambda: rounds.append(1)))) == 250
    assert not rounds
    later = [one.log_time for one in source.messages(102.5, lambda: rounds.append(1))]
    assert len(rounds) == 1
    assert len(later) == 1000
    assert later.count(0) == 1
    assert source.topics["/response"].type_name == RESPONSE_TYPE
    with pytest.raises(AbraceError, match="nowhere: no such bag"):
        BagSource("nowhere", 1.0, loop=True)


def test_the_layout_for_foxglove_shows_topics_and_channels_that_there_are():
    text = (LAYOUTS / "foxglove.json").read_text()
    channels = set(re.findall(rf"{CHANNELS}\.(\w+)", text))
    assert {"x1", "a3", "f", "fa_utilisation", "state"} <= channels <= set(schema(names_of(3, [2]))["properties"])
    assert set(re.findall(r'"(/[\w/]+)[".]', text)) == {CHANNELS, SCENE, DESCRIPTION, "/diagnostics"}
    installed = json.loads(text)
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(installed["layout"]))) == set(installed["configById"])
    assert layout(names_of(3, [2])) == installed, "of this rig it is the one for any"
    others = names_of(FIVE.floors, FIVE.braces_in_group)
    shown = re.findall(rf"{CHANNELS}\.(\w+)", json.dumps(layout(others)))
    assert {"x5", "a5", "f2", "U2", "f1b_utilisation"} <= set(shown) <= {*others, "state"}


def test_the_layout_for_plotjuggler_shows_fields_of_a_response():
    tree = ElementTree.parse(LAYOUTS / "plotjuggler.xml")
    curves = [curve.attrib["name"] for curve in tree.iter("curve")]
    parsed = parse_message_type(RESPONSE_TYPE, message_definition(RESPONSE_TYPE).text)
    fields = {field.name for field in parsed.fields[parsed.name]}
    assert len(curves) > 10
    assert {re.fullmatch(r"/rig/response/(\w+)(\[\d\])?", curve)[1] for curve in curves} <= fields


def test_the_configuration_for_rviz_shows_the_building_of_the_launch_files():
    content = yaml.safe_load((LAYOUTS / "rig.rviz").read_text())["Visualization Manager"]
    (model,) = [one for one in content["Displays"] if one["Class"].endswith("RobotModel")]
    assert model["Description Topic"]["Value"] == "/rig/robot_description"
    assert model["Description Topic"]["Durability Policy"] == "Transient Local"
    assert content["Global Options"]["Fixed Frame"] == "table", "the root of the robot description"


def test_every_running_node_is_in_one_group_of_the_diagnostic_aggregator():
    parameters = yaml.safe_load((LAYOUTS / "diagnostic_aggregator.yaml").read_text())["/**"]["ros__parameters"]
    groups = [one for one in parameters.values() if isinstance(one, dict)]
    assert {group["type"] for group in groups} == {"diagnostic_aggregator/GenericAnalyzer"}
    for group in groups:
        assert 1.0 < group["timeout"] < 5.0, "nodes report once a second"
    page = (ROOT / "docs/nodes.md").read_text()
    sections = re.findall(r"^## (\w+)\n\n(.*?)\n\n(.*?)\n", page, re.MULTILINE)
    running = [name for name, _, topics in sections if not topics.startswith("Offline")]
    assert {"plant", "controller", "logger", "viewer"} <= set(running)
    for name in running:
        status = f"rig/{name}: state"
        assert sum(any(part in status for part in group["contains"]) for group in groups) == 1, name
