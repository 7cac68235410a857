# SPDX-License-Identifier: Apache-2.0
"""The rig by the clock: stamps, braces and table left alone by those who drove them.

With SLOW samples a second and a time-out of 0.2 s: what a shared computer does to 500 is no subject of these tests.
"""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import AccelStamped
from running_graph import SLOW, stamp
from std_srvs.srv import Trigger

from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.alone
PERIOD = round(1e9 / SLOW)
TIMEOUT = 0.2
RAMP_SAMPLES = round(0.5 * SLOW)
INPUTS = {"excitation": "brace_command", "ground_motion": "ground_motion"}
DRIVEN = {"rms": 2500.0, "duration": 60.0, "band": [0.5, 5.0], "sample_rate": SLOW}
SHAKEN = {"record": "white_noise", "duration": 60.0, "rms": 0.5}


def start_rig(graph: Any) -> None:
    """A plant by the clock in the graph, for which a moment of a machine that stands still is no fault."""
    graph.by_the_clock = True
    graph.start("plant", rig=graph.slow_rig(), command_timeout=TIMEOUT, late_limit=round(TIMEOUT * SLOW))


@pytest.fixture(scope="module")
def rig(new_graph: Callable) -> Iterator[Any]:
    """One plant in real time for all of these tests."""
    with new_graph() as graph:
        start_rig(graph)
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
    since = len(rig.responses) + RAMP_SAMPLES
    rig.until(lambda: rig.responses[since:] and not rig.responses[-1].command[0], "the braces to be let go")
    rig.clear_any_fault("plant")
    for subscription in list(rig.node.subscriptions):
        if subscription.topic_name != "/diagnostics":
            rig.node.destroy_subscription(subscription)


def commands(graph: Any) -> np.ndarray:
    """(samples,) [N], in force until each sample."""
    return np.array([response.command[0] for response in graph.responses])


def until_samples(graph: Any, count: int) -> None:
    """Wait for so many more samples."""
    last = len(graph.responses) + count
    graph.until(lambda: len(graph.responses) >= last, f"{count} samples")


def until_driven(graph: Any) -> None:
    """Wait until the braces push by commands that we see, no longer the late ones of a node that has just joined."""
    graph.until(
        lambda: (
            graph.commands
            and abs(graph.responses[-1].command[0]) > 1000.0
            and abs(graph.responses[-1].sequence - graph.commands[-1].sequence) < 5
        ),
        "the braces to push",
    )


def find(graph: Any, executable: str, name: str = "", **parameters: Any) -> None:
    """Start a node, and wait until all have found it: one that joins may hold up those who publish."""
    name = name or executable
    graph.start(executable, name=name, autostart=False, **parameters)
    graph.until_well(name)
    assert graph.change_state(name, "configure")
    graph.until_matched(name, response=1)
    graph.until(lambda: int(graph.values("plant").get(f"publishers of {INPUTS[executable]}", 0)), "the rig to find it")
    until_samples(graph, 20)


def join(graph: Any, executable: str, name: str = "", **parameters: Any) -> None:
    """Start a node, and have its signal play once all have found it."""
    find(graph, executable, name=name, **parameters)
    assert graph.change_state(name or executable, "activate")
    graph.play(name or executable)


def largest_step(force: float) -> float:
    """Of a ramp from that force [N], which falls by up to a half more than evenly, also over a missed sample."""
    return 1.5 * 2 * abs(force) / RAMP_SAMPLES


def expect_smooth_end(command: np.ndarray) -> None:
    """The command has to go smoothly to zero within the ramp, and stay there."""
    assert command[0] != 0
    assert not command[RAMP_SAMPLES + 2 :].any(), "zero within 0.5 s"
    assert np.abs(np.diff(command)).max() <= largest_step(command[0]), "smoothly"
    assert (np.diff(np.abs(command)) <= 0).all(), "it only falls"


def test_stamps_are_the_real_instants_and_the_building_is_at_rest(graph):
    until_samples(graph, 300)
    responses = graph.responses
    sequences = np.array([response.sequence for response in responses], dtype=np.int64)
    assert (np.diff(sequences) > 0).all()
    stamps = np.array([stamp(response) for response in responses])
    lateness = (stamps - sequences * PERIOD)[1:]
    assert len(set(np.diff(stamps))) > 10, "no clockwork is as even as what is computed"
    assert np.median(lateness - lateness.min()) < PERIOD, "the clock of the samples is the wall clock"
    assert abs(stamps[-1] - time.time_ns()) < 5e9
    assert {response.run for response in responses} == {responses[0].run}
    assert {response.state for response in responses[120:]} == {Response.RUNNING}
    displacement = np.array([response.displacement for response in responses])
    assert np.abs(displacement).max() < 6 * 5.6e-5 + 0.1 / 2**15, "sensor noise alone"
    assert np.abs(displacement.mean(axis=0)).max() < 6 * 5.6e-5 / np.sqrt(len(responses))
    assert not commands(graph).any()


def test_two_commanders_at_once_are_a_fault(graph):
    find(graph, "excitation", name="second", seed=9, **DRIVEN)
    join(graph, "excitation", **DRIVEN)
    until_driven(graph)
    assert graph.change_state("second", "activate")
    graph.until_fault("plant", "two messages on brace_command")
    graph.until(lambda: graph.values("excitation").get("signal") == "cancelled", "the first to be told")
    graph.until(lambda: not graph.responses[-1].command[0], "the force to go to zero")
    falling = next(k for k, one in enumerate(graph.responses) if one.state == Response.RAMPING_DOWN)
    # what was in force until that sample was still a commander's
    expect_smooth_end(commands(graph)[falling + 1 :])


def test_a_deactivated_commander_lets_go_smoothly_and_falls_silent(graph):
    join(graph, "excitation", **DRIVEN)
    until_driven(graph)
    before = len(graph.commands)
    assert graph.change_state("excitation", "deactivate")
    graph.until(lambda: not graph.commands[-1].force[0], "its last force")
    until_samples(graph, RAMP_SAMPLES)
    force = np.array([command.force[0] for command in graph.commands])
    last = graph.commands[-1]
    assert graph.responses[-1].sequence - last.sequence > 0.8 * RAMP_SAMPLES, "no more commands"
    assert last.force[0] == 0.0
    # a busy machine misses samples
    assert last.sequence - graph.commands[before].sequence >= RAMP_SAMPLES - 5
    expect_smooth_end(force[[one.sequence > last.sequence - RAMP_SAMPLES for one in graph.commands]])
    graph.until_well("plant")

    assert graph.change_state("excitation", "activate")
    graph.until(lambda: len(graph.commands) > len(force) + 10, "commands after activation")
    assert not any(answer.force[0] for answer in graph.commands[len(force) :])


def test_after_a_signal_the_force_goes_to_zero_before_the_rig_ends(new_graph):
    with new_graph() as graph:
        graph.responses = graph.listen(Response, "response")
        graph.commands = graph.listen(BraceCommand, "brace_command")
        start_rig(graph)
        join(graph, "excitation", **DRIVEN)
        until_driven(graph)
        begin = len(graph.responses)
        assert graph.stop("plant") == 0
        graph.until(lambda: not graph.responses[-1].command[0], "the force to go to zero")
        command = np.array([response.command[0] for response in graph.responses[begin:]])
        assert command[-1] == 0.0
        last = np.flatnonzero(command)[-1]
        ramp = command[last - RAMP_SAMPLES + 2 : last + 1]
        assert (np.diff(np.abs(ramp)) <= 0).all(), "along the ramp"
        assert np.abs(np.diff(ramp)).max() <= largest_step(ramp[0]), "smoothly"
        assert graph.responses[-1].flags & Response.LAST
        assert graph.responses[-1].state == Response.STANDBY


def test_a_stop_is_obeyed_by_all_and_the_signal_does_not_begin_again_by_itself(graph):
    motion = graph.listen(AccelStamped, "ground_motion")
    press = graph.emergency_stop()
    find(graph, "ground_motion", rig=graph.slow_rig(), **SHAKEN)
    find(graph, "excitation", **DRIVEN)
    for name in ("ground_motion", "excitation"):
        assert graph.change_state(name, "activate")
        graph.play(name)
    until_driven(graph)
    graph.until(lambda: motion and abs(motion[-1].accel.linear.x) > 0.2, "the table to move")
    press(True)
    graph.until_fault("plant", "protective stop: pressed by")
    graph.until(lambda: graph.responses[-1].state == Response.PROTECTIVE_STOP, "all to be at rest")
    assert not graph.clear_fault("plant").success, "the button is still pressed"
    until_samples(graph, 2)
    assert not graph.responses[-1].command[0]
    press(False)
    graph.until(lambda: graph.responses[-1].state == Response.LATCHED, "the release")
    graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
    graph.until(lambda: graph.responses[-1].state == Response.RUNNING, "the fade to end")
    until_samples(graph, RAMP_SAMPLES)
    assert not commands(graph)[-RAMP_SAMPLES:].any()
    assert not any(message.accel.linear.x for message in motion[-RAMP_SAMPLES:])
    for name in ("excitation", "ground_motion"):
        graph.until_well(name)
        assert "cancelled: protective stop: pressed by" in graph.statuses[name].message
    graph.play("excitation")
    until_driven(graph)


def test_a_rig_that_stands_still_is_a_fault_for_all_who_command_it(graph):
    join(graph, "excitation", **DRIVEN)
    until_driven(graph)
    plant, begin = graph.started["plant"].group, time.monotonic()
    os.kill(plant, signal.SIGSTOP)
    graph.until_fault("excitation", "no response for more than 0.1 s")
    # for longer than the rig lets pass
    graph.until(lambda: time.monotonic() > begin + 2 * TIMEOUT, "twice its limit")
    os.kill(plant, signal.SIGCONT)
    graph.until_fault("plant", "samples missed before sample")
    graph.until(lambda: graph.responses[-1].state == Response.LATCHED, "all to be at rest")
    stamps = np.array([stamp(response) for response in graph.responses])
    sequences = np.array([response.sequence for response in graph.responses], dtype=np.int64)
    held = int(np.argmax(np.diff(stamps)))
    assert np.diff(stamps)[held] > 0.1e9
    assert abs((sequences[held + 1] - sequences[held]) * PERIOD - np.diff(stamps)[held]) < 0.05e9, "none is hidden"
    falling = next(k for k, one in enumerate(graph.responses) if one.state == Response.RAMPING_DOWN)
    assert falling > held
    # what was in force until that sample was still the commander's
    fallen = commands(graph)[falling + 1 :]
    assert np.abs(np.diff(fallen)).max() <= largest_step(fallen[0])
    refused = graph.clear_fault("plant")
    assert not refused.success
    assert "its sender reports a fault: no response" in refused.message
    assert graph.clear_fault("excitation").success
    graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")


def test_a_deactivated_table_comes_smoothly_to_rest(graph):
    motion = graph.listen(AccelStamped, "ground_motion")
    join(graph, "ground_motion", rig=graph.slow_rig(), **SHAKEN)
    graph.until(lambda: motion and abs(motion[-1].accel.linear.x) > 0.2, "the table to move")
    assert graph.change_state("ground_motion", "deactivate")
    graph.until(lambda: motion[-1].accel.linear.x == 0.0, "its last acceleration")
    until_samples(graph, RAMP_SAMPLES)
    acceleration = np.array([message.accel.linear.x for message in motion])
    assert stamp(graph.responses[-1]) - stamp(motion[-1]) > 0.8 * RAMP_SAMPLES * PERIOD, "no more accelerations"
    velocity = (acceleration.sum() - acceleration[0] / 2) * PERIOD * 1e-9
    assert abs(velocity) < 1e-3, "the table does not coast"
    assert np.abs(np.diff(acceleration)).max() < 0.5, "smoothly throughout"
    graph.until_well("plant")


# the last: when the middleware gives a killed node up, 20 s later, the rig's samples stand still for some 15 ms
def test_a_killed_commander_is_a_fault_and_the_force_goes_smoothly_to_zero(graph):
    join(graph, "excitation", **DRIVEN)
    until_driven(graph)
    graph.kill("excitation")
    graph.until_fault("plant", "no brace_command for")
    graph.until(lambda: not graph.responses[-1].command[0], "the force to go to zero")
    until_samples(graph, 20)
    command = commands(graph)
    last = np.flatnonzero(command)[-1]
    released = last - RAMP_SAMPLES + 1
    assert command[released] in [message.force[0] for message in graph.commands[-5:]], "the last command holds"
    # from the sample that it answers: it acts later on a busy machine, whose missed samples are part of the time-out
    periods = graph.responses[released].sequence - graph.commands[-1].sequence
    assert 0.8 * TIMEOUT * SLOW < periods < TIMEOUT * SLOW + 3, "for the time-out"
    expect_smooth_end(command[released:])
    graph.stop("excitation")

    graph.start("excitation", **DRIVEN)
    answered = len(graph.commands)
    graph.until(lambda: len(graph.commands) > answered + SLOW, "new commands")
    assert not graph.responses[-1].command[0], "the fault is latched"
    assert not any(answer.force[0] for answer in graph.commands[answered:]), "and nothing is asked for"
    refused = graph.call(Trigger, "excitation/play", Trigger.Request())
    assert not refused.success
    assert refused.message.startswith("not played: rig latched (no brace_command for ")
    graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
    graph.play("excitation")
    until_driven(graph)
