# SPDX-License-Identifier: Apache-2.0
"""Anybody's rig in the whole graph: every vector of every message takes its length from the rig file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import get_parameter_value

from abrace_bags import Bag, read_run
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import Controller, save_controller
from abrace_interfaces.msg import Response
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_plant.rig.model import Rig

SECONDS = 3.0
TOPICS = ("response", "brace_command", "ground_motion")
RIGS = {"ten_storey": (10, (2, 2, 2, 1)), "single_storey": (1, (1,))}
"""Floors, and braces in each group, of rigs in the configuration beside the paper's."""


def rig_named(name: str) -> Rig:
    return load_rig(find_file(name, "abrace_plant", "config", ".yaml", "rig"))


def record(graph: Any, rig: str, commander: str, *arguments: Path, **parameters: object) -> Path:
    """A lockstep run of a rig with a motion of its table and a commander at its braces."""
    bag, rate = graph.folder / "bag", rig_named(rig).sample_rate
    graph.start("logger", output=str(bag), topics=list(TOPICS), facts=[f"sample_period={1 / rate:g}"])
    graph.start("plant", autostart=False, rig=rig, lockstep=True, wait_for=list(TOPICS[1:]), duration=SECONDS, seed=1)
    graph.start("ground_motion", record="white_noise", duration=SECONDS, rig=rig)
    graph.start(commander, *arguments, **parameters)
    graph.run_to_the_end()
    return bag


def expect_lengths(bag: Path, floors: int, braces: tuple[int, ...]) -> None:
    response = Bag(bag).arrays()
    (recorded,) = (topic.fields for name, topic in response.items() if name.endswith("/response"))
    for name in ("displacement", "acceleration"):
        assert recorded[name].shape[1] == floors, name
    groups = len(braces)
    for name in ("stroke", "command"):
        assert recorded[name].shape[1] == groups, name
    assert recorded["force"].shape[1] == sum(braces)
    (commands,) = (topic.fields for name, topic in response.items() if name.endswith("/brace_command"))
    assert commands["force"].shape[1] == groups
    run = read_run(bag)
    assert (run.floors, run.groups, run.braces) == (floors, groups, braces)
    assert not run.facts.get("warnings")


def test_white_noise_shakes_and_drives_any_rig(graph):
    name = "ten_storey"
    capacity = rig_named(name).capacity
    rms = 0.05 * float(capacity.min())
    bag = record(graph, name, "excitation", duration=SECONDS, rms=rms, force_limit=capacity.tolist())
    expect_lengths(bag, *RIGS[name])
    run = read_run(bag)
    assert (np.abs(run.command).max(axis=0) > rms).all(), "each group was driven"
    assert (np.abs(run.outputs).max(axis=0) > 0).all()


def test_a_controller_of_its_own_controls_any_rig(graph, tmp_path):
    name = "single_storey"
    rig = rig_named(name)
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    measured = [f"a{floor + 1}" for floor in range(rig.floors)]
    made = design(rig.model, weights.model_copy(update={"measured": measured, "relative": {}}), 1 / rig.sample_rate)
    parts = made.controller, made.correction, made.prediction
    file = tmp_path / "controller.yaml"
    save_controller(Controller(name, *parts, rig.capacity, "the rig's own", "lqg3", "not needed here"), file)
    bag = record(graph, name, "controller", "--params-file", file)
    expect_lengths(bag, *RIGS[name])
    assert (np.abs(read_run(bag).command).max(axis=0) > 0).all(), "each group is at work"


def test_a_rig_with_its_braces_off_is_the_bare_frame(graph):
    graph.start("plant", disconnected_braces=[1], lockstep=True)
    graph.start("excitation", duration=60.0, rms=2000.0)
    responses = graph.listen(Response, "response")
    graph.play("excitation")
    graph.until(lambda: responses and abs(responses[-1].command[0]) > 1000, "commands")
    sensors = rig_named("ncree_three_storey").sensors
    assert max(abs(message.force[0]) for message in responses) < 6 * sensors.force.noise
    assert max(abs(message.stroke[0]) for message in responses) < 6 * sensors.stroke.noise


def set_faults(graph: Any, faults: str) -> Any:
    """As `ros2 param set` does; the answer."""
    value = get_parameter_value(faults)
    request = SetParameters.Request(parameters=[Parameter(name="sensor_faults", value=value)])
    return graph.call(SetParameters, "plant/set_parameters", request).results[0]


def test_a_channel_dies_on_demand_and_comes_back(graph):
    graph.start("plant")
    responses = graph.listen(Response, "response")

    def noise() -> float:
        """Of the last 50 samples that have come; those from before an answer may come after it."""
        return float(np.std([message.acceleration[1] for message in responses[-50:]]))

    graph.until(lambda: len(responses) >= 50 and noise() > 0, "sensor noise")
    assert set_faults(graph, "[a2=stuck, x1=zero]").successful
    graph.until(lambda: noise() == 0, "a2 to be stuck")
    assert not any(message.displacement[0] for message in responses[-49:]), "a2 is stuck at its last reading"
    assert responses[-1].displacement[1] != 0 or responses[-2].displacement[1] != 0
    answer = set_faults(graph, "[a9=stuck]")
    assert not answer.successful
    assert "expected CHANNEL=KIND" in answer.reason
    count = len(responses)
    graph.until(lambda: len(responses) >= count + 500, "another second")
    assert noise() == 0, "what was in force stays"
    assert set_faults(graph, "[]").successful
    graph.until(lambda: noise() > 0, "a2 to be back")


def with_three_accelerometers(folder: Path) -> Path:
    """The five storeys with accelerometers on floors 1, 3 and 5, load cells and the table's accelerometer alone."""
    file, text = folder / "three.yaml", find_file("five_storey", "abrace_plant", "config", ".yaml", "rig").read_text()
    text = re.sub(r"(?m)^  (displacement|stroke): \{range.*\n", "", text)
    file.write_text(text.replace("acceleration: {range", "acceleration: {channels: [a1, a3, a5], range", 1))
    return file


def test_a_rig_is_controlled_and_recorded_with_the_sensors_that_it_has(graph, tmp_path):
    rig = load_rig(with_three_accelerometers(tmp_path))
    weights = load_weights(find_file("half", "abrace_lqg", "config", ".yaml", "weights")).model_copy(
        update={"scale": None, "measured": ["a1", "a3", "a5"]}
    )
    made = design(rig.model, weights, 1 / rig.sample_rate)
    parts = made.controller, made.correction, made.prediction
    file = tmp_path / "controller.yaml"
    save_controller(Controller("three", *parts, rig.capacity, "the rig's own", "half", "not needed here"), file)
    bag = record(graph, str(tmp_path / "three.yaml"), "controller", "--params-file", file)
    expect_lengths(bag, 5, (2, 1))
    run = read_run(bag)
    assert run.names == ("a1", "a3", "a5", "f1", "f2")
    assert run.without == ("x1", "x2", "x3", "x4", "x5", "xf1", "xf2", "a2", "a4")
    assert np.isfinite(run.outputs).all()
    assert (np.abs(run.command).max(axis=0) > 0).all(), "each group is at work"
    assert (np.abs(run.outputs).max(axis=0) > 0).all()


def test_a_controller_that_measures_what_is_not_there_stops_at_the_first_sample(graph, tmp_path):
    whole, sparse = rig_named("five_storey"), with_three_accelerometers(tmp_path)
    weights = load_weights(find_file("half", "abrace_lqg", "config", ".yaml", "weights"))
    made = design(whole.model, weights.model_copy(update={"scale": None}), 1 / whole.sample_rate)
    parts = made.controller, made.correction, made.prediction
    file = tmp_path / "controller.yaml"
    save_controller(Controller("all", *parts, whole.capacity, "the rig's own", "half", "not needed here"), file)
    graph.start("plant", rig=str(sparse))
    graph.start("controller", "--params-file", file)
    responses = graph.listen(Response, "response")
    graph.until(lambda: responses and responses[-1].cause, "a fault")
    assert "acceleration[1] of sample " in responses[-1].cause
    assert "is nan, expected a finite number" in responses[-1].cause
    assert not any(any(one.command) for one in responses)
