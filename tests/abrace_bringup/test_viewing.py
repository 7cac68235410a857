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
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker

from abrace import simulate
from abrace_bags.raw import read_raw
from abrace_bringup.enlarged_description import enlarged
from abrace_bringup.nodes.markers import marker_array
from abrace_bringup.viewing.bag_source import BagSource
from abrace_bringup.viewing.decimation import extremes, greatest
from abrace_bringup.viewing.display import Display
from abrace_bringup.viewing.layout import layout, plotjuggler_layout
from abrace_bringup.viewing.named_channels import RESPONSE_TYPE, ResponseReader, message, names_of, schema
from abrace_bringup.viewing.scene import Scene, colour, scene_update
from abrace_bringup.viewing.server import CHANNELS, DESCRIPTION, FRAMES, SCENE
from abrace_core.errors import AbraceError
from abrace_core.table_signals import table_noise
from abrace_interfaces.msg import Response
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.robot_description import PLATE, joint_names, urdf

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


def test_the_value_of_the_greatest_magnitude_keeps_its_sign_and_a_failed_sensor_shows():
    values = np.array([[1.0, -2.0, 0.0, 1.0], [-3.0, 1.0, 0.0, np.nan], [2.5, 1.9, 0.0, 9.0]])
    np.testing.assert_array_equal(greatest(values), [-3.0, -2.0, 0.0, np.nan])
    np.testing.assert_array_equal(greatest(values[:1]), values[0])


class Sent:
    """In place of a server that everybody has subscribed to: keeps what is sent."""

    def __init__(self) -> None:
        self.messages: dict[str, list[tuple[int, bytes]]] = {}

    def wanted(self, _: str) -> bool:
        return True

    def send(self, topic: str, payload: bytes, time: int, latched: bool = False) -> None:  # noqa: ARG002
        self.messages.setdefault(topic, []).append((time, payload))

    def send_json(self, topic: str, content: dict, time: int) -> None:
        self.send(topic, json.dumps(content).encode(), time)

    def offer(self, *_: object) -> None:
        pass

    open_channels = offer


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


def test_a_sample_whose_arrays_do_not_belong_together_is_not_read():
    arrays = {"displacement": [1.0] * 3, "acceleration": [1.0] * 3}
    for braces, force, groups in (
        ([2], [1.0], 1),
        ([0], [], 1),
        ([9, 0], [1.0] * 9, 2),
        ([], [1.0], 0),
        ([1], [1.0], 2),
    ):
        message = Response(braces=braces, force=force, stroke=[1.0] * groups, command=[1.0] * groups, **arrays)
        with pytest.raises(AbraceError, match="expected floors, floors, groups"):
            ResponseReader(RIG.capacity.tolist()).read([serialize_message(message)])


def test_floors_are_drawn_as_many_times_further_out_as_is_asked_for():
    scene = Scene(RIG)
    sample = dict.fromkeys(names_of(3, [2]), 0.0) | {"x2": 0.0123, "fa": -12258.3, "fa_utilisation": 0.5}
    frames = scene.frames(sample, 20.0, 1_500_000_000).encode()
    assert struct.pack("<d", 20.0 * 0.0123) in frames
    assert frames.count(b"floor_2_link") == 1
    drawn = scene_update(scene.picture(sample, 20.0), 0).encode()
    assert b"fa -12.26 kN, 50 %" in drawn
    assert b"fb 0.00 kN, 0 %" in drawn
    for share in colour(0.5):
        assert struct.pack("<d", share) in drawn
    for failed in (dict.fromkeys(sample, float("nan")), {}):
        assert len(scene.picture(failed, 20.0).braces) == 2, "a failed sensor is no reason to stop"
        assert scene_update(scene.picture(failed, 20.0), 0).encode()
    assert len(Scene(FIVE).picture({}, 1.0).braces) == sum(FIVE.braces_in_group)


def test_the_markers_for_rviz_have_every_brace_in_its_colour_with_force_and_utilisation():
    sample = dict.fromkeys(names_of(3, [2]), 0.0) | {"x1": 0.01, "fa": -12258.3, "fa_utilisation": 0.5}
    markers = marker_array(Scene(RIG).picture(sample, 20.0), 1_500_000_000).markers
    assert {(one.header.frame_id, one.header.stamp.sec, one.header.stamp.nanosec) for one in markers} == {
        ("table", 1, 500_000_000)
    }
    by_name = {(one.ns, one.id): one for one in markers}
    assert len(by_name) == len(markers) == 1 + 2 * 3
    assert by_name["numbers", 0].text == "fa -12.26 kN, 50 %"
    line, force = by_name["braces", 0], by_name["forces", 0]
    assert [line.color.r, line.color.g, line.color.b] == pytest.approx(colour(0.5))
    assert line.points[1].x - line.points[0].x > 0
    start, tip = force.points
    assert start.x == pytest.approx((line.points[0].x + line.points[1].x) / 2)
    assert np.hypot(tip.x - start.x, tip.z - start.z) == pytest.approx(1.0), "half of the length for the capacity"
    assert tip.z < start.z, "compression pushes down"
    assert (force.action, by_name["forces", 1].action) == (Marker.ADD, Marker.DELETE)
    (columns,) = [one for one in markers if one.ns == "columns"]
    assert len(columns.points) % 2 == 0
    assert max(point.x for point in columns.points) == pytest.approx(0.2 + PLATE[0] / 2)


class Pictures:
    """Those who draw pictures."""

    def __init__(self, wanted: bool) -> None:
        self.wanted, self.taken = wanted, []

    def take(self, picture, time):
        self.taken.append((time, picture))


def test_the_scene_has_the_greatest_force_of_its_interval_and_the_floors_of_its_last_sample(run):
    done, bag = run
    server, messages, pictures = Sent(), list(read_raw(bag).read()), Pictures(wanted=True)
    display = Display(server, RIG, pictures)
    for number, one in enumerate(messages, 1):
        display.add(one.payload, one.log_time)
        if number % 10 == 0:
            display.show(20.0)
    scenes, frames = server.messages[SCENE], server.messages[FRAMES]
    assert len(scenes) == len(frames) == 100, "fifty in each second of the samples"
    np.testing.assert_array_equal(np.diff([time for time, _ in scenes]), 20_000_000)
    assert [time for time, _ in pictures.taken] == [time for time, _ in scenes]
    samples = ResponseReader(RIG.capacity.tolist()).read([one.payload for one in messages])
    force = samples.values[:, samples.names.index("fa")].reshape(100, 10)
    inside = np.abs(force).argmax(axis=1)
    assert np.sum(inside < 9) > 10, "of many intervals the last sample is not the greatest"
    for (_, scene), (_, frame), own, at, x3 in zip(
        scenes, frames, force, inside, done.outputs[9::10, done.names.index("x3")], strict=True
    ):
        share = 100 * abs(own[at]) / RIG.capacity[0]
        assert f"fa {own[at] / 1000:.2f} kN, {share:.0f} %".encode() in scene
        assert struct.pack("<d", 20.0 * x3) in frame
        assert struct.pack("<d", 20.0 * x3 + PLATE[0] / 2) in scene, "columns end where the floor is"


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


def test_the_layout_for_plotjuggler_shows_numbers_of_a_response_by_their_names():
    tree = ElementTree.parse(LAYOUTS / "plotjuggler.xml")
    curves = [curve.attrib["name"] for curve in tree.iter("curve")]
    source = {one.attrib["name"]: one.findtext("linked_source") for one in tree.iterfind("customMathEquations/snippet")}
    assert {one.findtext("function") for one in tree.iter("snippet")} == {"return value"}
    plain = {curve for curve in curves if curve not in source}
    assert plain == {f"/rig/response/{name}" for name in ("state", "flags", "clipped")}, "no number without its name"
    assert {"x1", "x3", "a1", "a3", "w", "fa", "fb", "U", "xf"} <= set(source) <= set(curves)

    response = Response(displacement=[1.0, 2.0, 3.0], acceleration=[4.0, 5.0, 6.0], stroke=[7.0], force=[8.0, 9.0])
    response.braces, response.command, response.ground_acceleration = [2], [10.0], 11.0
    samples = ResponseReader(RIG.capacity.tolist()).read([serialize_message(response)])
    for name, path in source.items():
        field, number = re.fullmatch(r"/rig/response/(\w+)(?:\[(\d)\])?", path).groups()
        value = getattr(response, field)
        assert samples.last[name] == (value if number is None else value[int(number)]), name
    for curve in plain:
        assert hasattr(response, curve.rpartition("/")[2])
    made = ElementTree.fromstring(plotjuggler_layout(3, [2], "/rig/response"))
    assert contents(made) == contents(tree.getroot()), "of this rig it is the one for any"


def contents(root):
    """Plots with their curves, and custom series with their sources, of a layout for PlotJuggler."""
    plots = {
        area.attrib["name"]: {curve.attrib["name"] for curve in area.iter("curve")} for area in root.iter("DockArea")
    }
    return plots, {one.attrib["name"]: one.findtext("linked_source") for one in root.iter("snippet")}


def test_the_layout_for_plotjuggler_of_several_groups_names_each_brace():
    plots, sources = contents(
        ElementTree.fromstring(plotjuggler_layout(FIVE.floors, FIVE.braces_in_group, "/lab/response"))
    )
    assert sources["x5"] == "/lab/response/displacement[4]"
    assert (sources["f1b"], sources["f2"]) == ("/lab/response/force[1]", "/lab/response/force[2]")
    assert (sources["U2"], sources["w"]) == ("/lab/response/command[1]", "/lab/response/ground_acceleration")
    assert {"f1a", "f2", "U1", "U2"} <= plots["force and command of a brace [N]"]
    assert plots["stroke [m]"] == {"xf1", "xf2"}
    assert plots["flags, clipped"] == {"/lab/response/flags", "/lab/response/clipped"}


def test_the_configuration_for_rviz_shows_the_building_of_the_launch_files():
    content = yaml.safe_load((LAYOUTS / "rig.rviz").read_text())["Visualization Manager"]
    (model,) = [one for one in content["Displays"] if one["Class"].endswith("RobotModel")]
    assert model["Description Topic"]["Value"] == "/rig/robot_description"
    assert model["Description Topic"]["Durability Policy"] == "Transient Local"
    assert content["Global Options"]["Fixed Frame"] == "table", "the root of the robot description"


def test_rviz_draws_floors_enlarged_and_joint_states_stay_as_measured():
    plain = urdf(RIG)
    assert enlarged(plain, 1.0) == plain
    before, robot = (ElementTree.fromstring(text) for text in (plain, enlarged(plain, 20.0)))
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    assert list(joints) == [*joint_names(RIG), *(f"{name}_drawn" for name in joint_names(RIG))]
    for joint in before.findall("joint"):
        name = joint.get("name")
        drawn, measured = joints[f"{name}_drawn"], joints[name]
        assert drawn.find("mimic").attrib == {"joint": name, "multiplier": "20"}
        assert drawn.find("child").get("link") == joint.find("child").get("link") == f"{name}_link", "what RViz draws"
        assert measured.find("child").get("link") == f"{name}_measured"
        assert measured.find("mimic") is None
        for each in (drawn, measured):
            assert each.get("type") == "prismatic"
            assert [each.find(tag).attrib for tag in ("origin", "axis", "parent")] == [
                joint.find(tag).attrib for tag in ("origin", "axis", "parent")
            ]
        assert measured.find("limit").attrib == joint.find("limit").attrib
        assert float(drawn.find("limit").get("upper")) == 20.0 * float(joint.find("limit").get("upper"))
    children = [joint.find("child").get("link") for joint in joints.values()]
    links = [link.get("name") for link in robot.findall("link")]
    assert sorted(["table", *children]) == sorted(links), "a tree: every link but the root is the child of one joint"
    assert [link.find("visual") is not None for link in robot.findall("link")] == [True] * 4 + [False] * 3


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
