"""The rig by the clock: stamps, the controller in the loop, braces and table left alone by those who drove them.

Commands may stay away for 0.5 s here, not 0.02 s: nodes join a rig whose force is on, which may hold up a publisher for
333 ms (docs/real_time.md), and the machine may be busy with other tests.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import AccelStamped

from abrace_core.controller_file import Controller, save_controller
from abrace_core.linear_model import LinearModel
from abrace_interfaces.msg import BraceCommand, Response
from abrace_lqg.control_law import ControlLaw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

PERIOD = 2_000_000
TIMEOUT = 0.5
RAMP_SAMPLES = 250
RATE_STEP = 5.0e6 / 500
DRIVEN = {"rms": 5000.0, "duration": 60.0}


def stamp(message: Any) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.fixture(scope="module")
def rig(new_graph: Callable) -> Iterator[Any]:
    """One plant in real time for all of these tests."""
    with new_graph() as graph:
        graph.start("plant", command_timeout=TIMEOUT)
        yield graph


@pytest.fixture
def graph(rig: Any) -> Iterator[Any]:
    """The rig's graph; `responses` are the samples from now on. Nobody but the plant is in it before and after."""
    rig.responses = rig.listen(Response, "response")
    rig.commands = rig.listen(BraceCommand, "brace_command")
    rig.until(lambda: rig.responses, "the first sample")
    yield rig
    for name in [name for name in rig.started if name != "plant"]:
        rig.stop(name)
        del rig.started[name]
    since = len(rig.responses) + 60
    rig.until(lambda: rig.responses[since:] and not rig.responses[-1].command[0], "the braces to be let go")
    rig.clear_fault("plant")
    for subscription in list(rig.node.subscriptions):
        if subscription.topic_name != "/diagnostics":
            rig.node.destroy_subscription(subscription)


def commands(graph: Any) -> np.ndarray:
    """(samples,) [N], in force until each sample."""
    sequences = np.array([response.sequence for response in graph.responses], dtype=np.int64)
    assert (np.diff(sequences) == 1).all(), "no sample is missing"
    return np.array([response.command[0] for response in graph.responses])


def until_samples(graph: Any, count: int) -> None:
    """Wait for so many more samples."""
    last = len(graph.responses) + count
    graph.until(lambda: len(graph.responses) >= last, f"{count} samples")


def until_driven(graph: Any, force: float = 2000.0) -> None:
    """Wait until the braces push by commands that we see, no longer the late ones of a node that has just joined."""
    graph.until(
        lambda: (
            graph.commands
            and abs(graph.responses[-1].command[0]) > force
            and abs(graph.responses[-1].sequence - graph.commands[-1].sequence) < 5
        ),
        "the braces to push",
    )


def expect_smooth_end(command: np.ndarray) -> None:
    """The command has to go smoothly to zero within the ramp, and stay there."""
    assert command[0] != 0
    assert not command[RAMP_SAMPLES + 2 :].any(), "zero within 0.5 s"
    assert np.abs(np.diff(command)).max() <= RATE_STEP, "no step above the rate limit"
    assert (np.diff(np.abs(command)) <= 0).all(), "it only falls"


def test_stamps_are_2_ms_apart_and_the_building_is_at_rest(graph):
    until_samples(graph, 750)
    responses = graph.responses
    sequences = [response.sequence for response in responses]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert set(np.diff([stamp(response) for response in responses])) == {PERIOD}
    assert abs(stamp(responses[-1]) - time.time_ns()) < 5e9, "stamps are wall-clock time"
    displacement = np.array([response.displacement for response in responses])
    assert np.abs(displacement).max() < 6 * 5.6e-5 + 0.1 / 2**15, "sensor noise alone"
    assert np.abs(displacement.mean(axis=0)).max() < 6 * 5.6e-5 / np.sqrt(len(responses))
    assert not commands(graph).any()


def test_a_killed_commander_is_a_fault_and_the_force_goes_smoothly_to_zero(graph):
    graph.start("excitation", **DRIVEN)
    until_driven(graph)
    graph.kill("excitation")
    graph.until_fault("plant", "no brace_command for")
    graph.until(lambda: not graph.responses[-1].command[0], "the force to go to zero")
    until_samples(graph, 50)
    command = commands(graph)
    last = np.flatnonzero(command)[-1]
    released = last - RAMP_SAMPLES + 1
    held = np.flatnonzero(command[:released] != command[released])[-1] + 1
    assert command[released] in [message.force[0] for message in graph.commands[-5:]], "the last command holds"
    assert 0.8 * TIMEOUT * 500 < released - held < TIMEOUT * 500 + 2, "for the time-out"
    expect_smooth_end(command[released:])
    graph.stop("excitation")

    graph.start("excitation", **DRIVEN)
    answered = len(graph.commands)
    graph.until(lambda: len(graph.commands) > answered + 500, "new commands")
    assert not graph.responses[-1].command[0], "the fault is latched"
    assert graph.clear_fault("plant").success
    until_driven(graph)


def test_two_commanders_at_once_are_a_fault(graph):
    graph.start("excitation", **DRIVEN)
    until_driven(graph)
    graph.start("excitation", name="second", seed=9, **DRIVEN)
    graph.until_fault("plant", "two messages on brace_command")
    graph.until(lambda: not graph.responses[-1].command[0], "the force to go to zero")
    command = commands(graph)
    last = np.flatnonzero(command)[-1]
    expect_smooth_end(command[last - RAMP_SAMPLES + 1 :])


# a small law of the last three samples alone, so that it is known bit for bit from any sample on
LAW = LinearModel(
    np.array([[0.0, 0.0], [0.5, 0.0]]),
    np.array([[40.0, 0.0], [0.0, 40.0]]),
    np.array([[-5.0, -2.0]]),
    np.array([[-10.0, 0.0]]),
    ("a1", "a3"),
    ("U",),
    0.002,
)
SMALL = Controller(
    "small", LAW, np.zeros((2, 1)), np.zeros((2, 3)), np.array([20e3]), model="none", weights="none", margins="none"
)


@pytest.fixture(scope="module")
def controller_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The law as a controller's parameter file."""
    path = tmp_path_factory.mktemp("controller") / "small.yaml"
    save_controller(SMALL, path)
    return path


def test_the_controller_answers_every_sample_with_its_law(graph, controller_file):
    graph.start("controller", "--params-file", controller_file, ramp_time=0.0)
    graph.until(lambda: len(graph.commands) > 500, "the controller's answers")
    until_samples(graph, 10)
    answers = list(graph.commands)
    first = answers[0].sequence
    assert [answer.sequence for answer in answers] == list(range(first, first + len(answers)))
    answered = {response.sequence: response for response in graph.responses}
    assert [stamp(answer) for answer in answers] == [stamp(answered[answer.sequence]) for answer in answers]
    law, expected = ControlLaw(SMALL, LAW.inputs), []
    for answer in answers:
        expected.append(law.update(answered[answer.sequence].acceleration[::2])[0])
        law.advance(answer.force.tolist())
    assert [answer.force[0] for answer in answers][3:] == expected[3:]
    assert np.abs(expected).max() > 0
    graph.until_well("controller")
    graph.until_well("plant")


@pytest.mark.parametrize("name", ["excitation", "controller"])
def test_a_deactivated_commander_lets_go_smoothly_and_falls_silent(graph, controller_file, name):
    if name == "controller":
        graph.start(name, "--params-file", controller_file)
        until_driven(graph, 0.0)
    else:
        graph.start(name, **DRIVEN)
        until_driven(graph)
    before = len(graph.commands)
    assert graph.change_state(name, "deactivate")
    graph.until(lambda: not graph.commands[-1].force[0], "the force to go to zero")
    until_samples(graph, 100)
    force = np.array([command.force[0] for command in graph.commands])
    last = graph.commands[-1]
    assert graph.responses[-1].sequence - last.sequence > 80, "no more commands"
    assert last.force[0] == 0.0
    assert np.count_nonzero(force == 0.0) <= 2, "silent once it is zero"
    assert len(force) - before >= RAMP_SAMPLES - 5
    expect_smooth_end(force[-RAMP_SAMPLES:])
    graph.until_well("plant")

    assert graph.change_state(name, "activate")
    graph.until(lambda: len(graph.commands) > len(force) + 10, "commands after activation")


def test_the_emergency_stop_holds_until_rig_and_commander_are_cleared(graph):
    graph.start("excitation", **DRIVEN)
    until_driven(graph)
    press = graph.emergency_stop()
    press(True)
    for name in ("plant", "excitation"):
        graph.until_fault(name, "emergency stop")
    assert not graph.clear_fault("excitation").success, "the button is still pressed"
    press(False)
    graph.until(
        lambda: not graph.responses[-1].command[0] and not graph.commands[-1].force[0], "both ramps to reach zero"
    )
    graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
    until_samples(graph, 100)
    assert not commands(graph)[-100:].any(), "the commander is latched by itself"
    graph.until(lambda: graph.clear_fault("excitation").success, "the commander to be cleared")
    until_driven(graph)


def test_a_deactivated_table_comes_smoothly_to_rest(graph):
    motion = graph.listen(AccelStamped, "ground_motion")
    graph.start("ground_motion", record="white_noise", duration=60.0, rms=0.5)
    graph.until(lambda: motion and abs(motion[-1].accel.linear.x) > 0.2, "the table to move")
    assert graph.change_state("ground_motion", "deactivate")
    graph.until(lambda: not motion[-1].accel.linear.x, "the table to come to rest")
    until_samples(graph, 100)
    acceleration = np.array([message.accel.linear.x for message in motion])
    assert stamp(graph.responses[-1]) - stamp(motion[-1]) > 80 * PERIOD, "no more accelerations"
    ramp = np.abs(acceleration[-RAMP_SAMPLES:])
    assert ramp[-1] == 0.0
    assert ramp[0] > 0
    assert (np.diff(ramp) < 0).all(), "it only falls, for 0.5 s"
    assert np.abs(np.diff(acceleration)).max() < 0.1, "smoothly throughout"
    graph.until_well("plant")
