# SPDX-License-Identifier: Apache-2.0
"""What may act, tried on running nodes by the clock: who joins, is deactivated, interrupted, stopped, killed or floods.

Each case is a function of a graph that fails with an AssertionError, as in `safety_cases`. The nodes that stream have a
real-time priority where that is allowed.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from controller_speed import lqg3
from diagnostic_msgs.msg import DiagnosticStatus
from emulated_target import TICKING, EmulatedTarget
from joins import visit
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from safety_cases import RAMP, RATE, worst_step
from std_srvs.srv import Trigger
from udp_target import device_file

from abrace_core.model.controller_file import save_controller
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Callable

    from running_graph import Graph

TIMEOUT = round(0.02 * RATE)
"""Samples of the rig's command_timeout."""
MARGIN = 5
"""Samples beyond time-out and ramp within which the force has to be zero: the last answer may act two samples later."""
REST_MARGIN = round(0.1 * RATE)
"""Samples beyond the ramp within which a rig that is deactivated or interrupted has taken its last one."""
STALL = 3.0
TARGET_PRIORITY = 70
"""Of the emulator, above the nodes' 50."""
TRIES = 3
"""Attempts to have the rig running before a case begins: a machine that is blocked for 20 ms also causes a fault."""
TABLE_FAR = 50.0
"""Percent of the limit of the table's displacement; beyond it the next stop might not have the room that it needs."""
FLOOD, FLOOD_RATE = 2000, 10_000
"""Messages, and a second."""
DRIVEN: dict[str, Any] = {"rms": 4000.0, "duration": 60.0}
SHAKEN: dict[str, Any] = {"record": "white_noise", "duration": 240.0, "rms": 0.3, "band": [0.3, 10.0]}


def stamp_of(response: Response) -> int:
    """Sampling instant [ns] of the wall clock."""
    return int(10**9 * response.header.stamp.sec + response.header.stamp.nanosec)


class Rig:
    """A rig by the clock, whom somebody commands.

    Parameters
    ----------
    graph
        Where its nodes are.
    commander
        `excitation`, or `controller` with a shaken table.
    name
        `plant`, or `sensor_bridge` with the emulator as its device.

    Attributes
    ----------
    faults_before
        Faults before the present case could begin; it began when they were cleared, as a person would.
    worst_step_at_device
        Greatest change of a command from one tick of the emulated target to the next over what the rate limit allows.
    """

    def __init__(self, graph: Graph, commander: str, name: str = "plant") -> None:
        self.graph, self.commander, self.name = graph, commander, name
        self.faults_before = 0
        self.worst_step_at_device = 0.0
        graph.by_the_clock = True
        self.responses: list[Response] = graph.listen(Response, "response")
        self.commands: list[BraceCommand] = graph.listen(BraceCommand, "brace_command")
        self.start_rig()
        if commander == "controller":
            save_controller(lqg3(), graph.folder / "lqg3.yaml")
            graph.start("ground_motion", autostart=False, **SHAKEN)
            assert graph.change_state("ground_motion", "configure")
        self.start_commander()
        graph.until_matched(name, brace_command=1)
        self.flood = graph.publisher(BraceCommand, "brace_command")
        if commander == "controller":
            graph.until_matched("ground_motion", response=1, ground_motion=1)
            assert graph.change_state("ground_motion", "activate")
        self.played = "ground_motion" if commander == "controller" else commander
        """The node whose signal plays."""

    def start_rig(self) -> None:
        """Start the node that takes the samples, and its device."""
        if self.name == "plant":
            self.graph.start("plant")
            return
        self.device = device_file(self.graph.folder, timeout=0.02)
        self.start_target()
        self.graph.start("sensor_bridge", device=str(self.device))

    def start_target(self) -> None:
        """Start the emulator; a real target has a processor of its own, which its priority stands for."""
        self.target = EmulatedTarget(self.device, priority=TARGET_PRIORITY)
        process = self.graph.processes.start("emulator", self.target.command, self.graph.folder / "emulator.log")
        self.graph.until(lambda: TICKING in process.last_lines(), "the emulator")

    def note_device(self) -> None:
        """Note the greatest change of a command from one tick of the target to the next, over what is allowed."""
        if self.name == "sensor_bridge":
            step = self.target.report()["worst_step_over_rate_limit"]
            self.worst_step_at_device = max(self.worst_step_at_device, step)

    def start_commander(self) -> None:
        """Start the node that commands."""
        self.commands.clear()
        if self.commander == "controller":
            self.graph.start("controller", "--params-file", self.graph.folder / "lqg3.yaml")
        else:
            self.graph.start("excitation", **DRIVEN)

    @property
    def last(self) -> Response:
        """The last sample."""
        return self.responses[-1]

    def begin(self) -> None:
        """Let the rig run, and somebody command it; forget the samples before."""
        graph, self.faults_before = self.graph, 0
        if self.commander not in graph.started:
            self.start_commander()
        if self.name not in graph.started:
            self.start_rig()
        if graph.state(self.name) == "inactive":
            assert graph.change_state(self.name, "activate")
        count = len(self.responses)
        graph.until(lambda: len(self.responses) > count + 5, "samples")
        # a node that joins is late at first, and holds others up: nothing may act meanwhile
        graph.until(self.keeps_up, f"{self.commander} to keep up")
        for _ in range(TRIES):
            if self.last.state not in (Response.ARMING, Response.RUNNING, Response.FADING_IN):
                self.clear()
            graph.until(lambda: self.last.state in (Response.RUNNING, Response.LATCHED), "the rig to run")
        assert self.last.state == Response.RUNNING, graph.reported()
        self.play()
        del self.responses[:-1], self.commands[:-1]

    def play(self) -> None:
        """Let the signal play, unless it does."""
        answer = self.graph.call(Trigger, f"{self.played}/play", Trigger.Request())
        assert answer.success or answer.message.endswith("a signal is playing"), answer.message

    def clear(self) -> None:
        """Clear all faults."""
        graph = self.graph
        graph.until(lambda: self.last.state == Response.LATCHED, "all to be at rest")
        # after many stops the table is far from the middle, or at its limit: a person moves it, docs/rig.md
        share = graph.values(self.name).get("interlock table_displacement", "0 % of its limit").partition(" %")[0]
        far = float(share) > TABLE_FAR or "interlocks.table_displacement" in self.last.cause
        if far:
            self.take(self.name, "deactivate", "cleanup")
            if self.name == "sensor_bridge":
                self.note_device()
                graph.processes.stop("emulator")
                self.start_target()
            self.take(self.name, "configure")
        graph.until(self.cleared, "the rig to be cleared")
        if far:
            self.take(self.name, "activate")
        if self.commander == "controller":
            # where the stop left the table there may be no room for the record: a person moves it to the middle
            self.take("ground_motion", "deactivate", "cleanup", "configure", "activate")
        graph.until(lambda: self.last.state != Response.LATCHED, "the rig to act again")

    def take(self, name: str, *transitions: str) -> None:
        """Take a node through transitions of its life cycle."""
        for transition in transitions:
            assert self.graph.change_state(name, transition), f"{name}: {transition} refused; {self.graph.reported()}"

    def keeps_up(self) -> bool:
        """Whether the commander has answered for a while, and does so in time."""
        commands = self.commands
        return len(commands) > 100 and 0 <= self.last.sequence - commands[-1].sequence < 5

    def cleared(self) -> bool:
        """Clear the rig's fault, and before it those that its commander and its table have of their own."""
        for name in (self.commander, "ground_motion"):
            status = self.graph.statuses.get(name)
            if status is not None and status.level == DiagnosticStatus.ERROR:
                self.graph.clear_fault(name)
        answer = self.graph.clear_fault(self.name)
        return bool(answer.success) or "no fault" in answer.message

    def until_undisturbed(self) -> None:
        """Let the controller answer until its last 100 answers were in time; forget the samples before."""
        self.until_driven(100.0)
        self.graph.until(
            lambda: len(self.commands) > 200 and not self.late_answers(100), "a node that has joined to keep up"
        )
        del self.responses[:-1], self.commands[:-1]

    def expect_no_delay(self) -> None:
        """50 more samples, and none since `until_undisturbed` was late, unanswered, or its answer late."""
        count = len(self.responses) + 50
        self.graph.until(lambda: len(self.responses) > count, "samples")
        assert self.last.state == Response.RUNNING, self.last.cause
        answered = [one.sequence for one in self.commands if one.sequence > self.responses[0].sequence]
        assert (np.diff(answered) == 1).all(), "an answer is missing"
        late = sum(bool(one.flags & Response.LATE) for one in self.responses)
        assert not late, f"{late} samples were late"
        waited = self.late_answers(len(self.commands))
        assert not waited, f"{len(waited)} answers acted late, the first to sample {waited[0]}"

    def late_answers(self, count: int) -> list[int]:
        """Samples of the last `count` answers that were not in force two samples later."""
        in_force = {one.sequence: one.command[0] for one in self.responses[-count - 20 :]}
        answers = self.commands[-count:]
        return [one.sequence for one in answers if in_force.get(one.sequence + 2, one.force[0]) != one.force[0]]

    def until_driven(self, force: float) -> None:
        """Wait until the braces push with more than a `force` [N], by commands in time: a new node's are late.

        A fault before that is counted and cleared, and the wait begins anew.
        """

        def driven() -> bool:
            late = self.last.sequence - self.commands[-1].sequence if self.commands else 10
            return bool(abs(self.last.command[0]) > force and abs(late) < 5)

        for _ in range(TRIES):
            self.graph.until(lambda: driven() or self.last.state == Response.LATCHED, f"{force:g} N")
            if self.last.state != Response.LATCHED:
                return
            self.faults_before += 1
            print(f"a fault before the case: {self.last.cause}", file=sys.stderr, flush=True)
            self.clear()
        raise AssertionError(f"{TRIES} faults before {force:g} N: {self.last.cause}")

    def sample_at(self, moment: int) -> int:
        """Number of the last sample before a moment of the wall clock [ns]."""
        stamps = list(map(stamp_of, self.responses))
        return int(self.responses[max(0, int(np.searchsorted(stamps, moment)) - 1)].sequence)

    def expect_zero(self, since: int, within: int) -> None:
        """The force has to be zero by sample `since` + `within`, for good, and on no way with a step."""
        deadline = since + within + 20
        self.graph.until(lambda: self.last.sequence >= deadline, "the force to be zero")
        late = [one for one in self.responses if one.sequence > since + within]
        assert not any(one.command[0] for one in late), (
            f"force on {within} samples after sample {since}; {self.last.cause}"
        )
        self.note_device()
        assert self.worst_step_at_device <= 1 + 1e-9, "a step beyond the rate limit at the device"
        assert worst_step(self.responses) <= 1.0, "a step beyond the rate limit"


def rig_deactivated(rig: Rig) -> None:
    """At 6 kN: the ramp first, then it is inactive."""
    rig.until_driven(6e3)
    run, moment, began = rig.last.run, time.time_ns(), time.monotonic()
    assert rig.graph.change_state("plant", "deactivate")
    took = time.monotonic() - began
    rig.graph.until(lambda: rig.last.flags & Response.LAST, "the last sample")
    _expect_last(rig, moment, run)
    assert took < (RAMP + REST_MARGIN) / RATE, f"{took:.2f} s"


def rig_interrupted(rig: Rig) -> None:
    """Ctrl-C at 6 kN: the ramp first."""
    rig.until_driven(6e3)
    run, moment = rig.last.run, time.time_ns()
    assert rig.graph.stop("plant") == 0
    del rig.graph.started["plant"]
    rig.graph.until(lambda: rig.last.flags & Response.LAST, "the last sample")
    _expect_last(rig, moment, run)


def _expect_last(rig: Rig, moment: int, run: int) -> None:
    first = rig.sample_at(moment)
    assert rig.last.run == run
    # a sample says what was in force until it was taken: the end of the ramp
    assert abs(rig.last.command[0]) < 1.0, f"{rig.last.command[0]} N"
    assert rig.last.state == Response.STANDBY
    assert rig.last.sequence - first < RAMP + REST_MARGIN, f"{rig.last.sequence - first} samples"
    assert worst_step(rig.responses) <= 1.0, "a step beyond the rate limit"


def commander_interrupted(rig: Rig) -> None:
    """Ctrl-C at 6 kN: its force goes to zero, and that is no fault."""
    rig.until_driven(6e3)
    moment = time.time_ns()
    assert rig.graph.stop(rig.commander) == 0
    del rig.graph.started[rig.commander]
    # all that was sent before the node ended
    count = len(rig.responses)
    rig.graph.until(lambda: len(rig.responses) > count + RAMP, "samples")
    rig.expect_zero(rig.sample_at(moment), RAMP + REST_MARGIN)
    assert rig.last.state == Response.RUNNING, rig.last.cause


def commander_deactivated(rig: Rig) -> None:
    """At 6 kN: its force goes to zero, then it is silent, and that is no fault."""
    rig.until_driven(6e3)
    moment = time.time_ns()
    assert rig.graph.change_state(rig.commander, "deactivate")
    count = len(rig.responses)
    rig.graph.until(lambda: len(rig.responses) > count + RAMP, "samples")
    rig.expect_zero(rig.sample_at(moment), RAMP + REST_MARGIN)
    assert rig.last.state == Response.RUNNING, rig.last.cause
    assert rig.last.sequence - rig.commands[-1].sequence > RAMP // 2, "it still commands"
    assert rig.graph.change_state(rig.commander, "activate")


def node_joins(rig: Rig) -> None:
    """A node joins, receives every stream and leaves, at the default time-outs: the force goes on."""
    rig.until_driven(2e3)
    del rig.responses[:-1]
    visit(rig.graph)
    rig.until_driven(2e3)
    assert {one.state for one in rig.responses} == {Response.RUNNING}, rig.graph.reported()


def two_rigs(rig: Rig) -> None:
    """A second rig in the namespace: the commander tells both of them, and the first goes on once it is alone."""
    rig.until_driven(2e3)
    graph, runs = rig.graph, {rig.last.run}
    del rig.responses[:-1]
    graph.by_the_clock = False  # what becomes of the second one is not timed
    graph.start("plant", name="second")
    graph.by_the_clock = True
    graph.until(lambda: bool(rig.responses[-1].run not in runs), "the second rig")
    graph.until_fault(rig.commander, "two rigs publish response, expected one")
    graph.until(lambda: [one for one in rig.responses if one.run in runs][-1].state == Response.LATCHED, "rest")
    assert graph.stop("second") == 0
    del graph.started["second"]
    graph.statuses.pop("second", None)
    count = len(rig.responses)
    graph.until(lambda: len(rig.responses) > count + 20, "the first rig alone")
    rig.responses[:] = [one for one in rig.responses if one.run in runs]
    first = next(one.sequence for one in rig.responses if one.state == Response.RAMPING_DOWN)
    rig.expect_zero(first, RAMP + MARGIN)
    assert "its sender reports: a run began during another one: two rigs" in rig.last.cause, rig.last.cause
    rig.clear()
    graph.until(lambda: rig.last.state == Response.RUNNING, "the first rig to run")
    rig.play()  # what the second one has cut short is over
    rig.until_driven(2e3)


def rig_stalled(rig: Rig) -> None:
    """Delayed for 3 s: a fault of the rig and of the node that commands it; the missed samples have no message."""
    rig.until_driven(2e3)
    plant = rig.graph.started["plant"].group
    os.kill(plant, signal.SIGSTOP)
    stalled = time.monotonic()
    rig.graph.until_fault(rig.commander, "no response for more than 0.1 s")
    rig.graph.until(lambda: time.monotonic() > stalled + STALL, "the end of the stall")
    os.kill(plant, signal.SIGCONT)
    rig.graph.until(lambda: rig.last.state == Response.LATCHED, "all to be at rest")
    # whichever of the two the rig hears first
    assert re.search("samples missed before sample|sender reports: no response", rig.last.cause), rig.last.cause
    stamps = np.array([one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in rig.responses])
    sequences = np.array([one.sequence for one in rig.responses], dtype=np.int64)
    held = int(np.argmax(np.diff(stamps)))
    assert np.diff(stamps)[held] > STALL - 0.1
    assert abs(np.diff(sequences)[held] / RATE - np.diff(stamps)[held]) < 0.05, "none is hidden"
    rig.graph.until(lambda: abs(rig.last.sequence - rig.commands[-1].sequence) < 5, "answers in time")
    refused = rig.graph.clear_fault("plant")
    assert not refused.success, "cleared though its sender reports a fault"
    assert "its sender reports a fault: no response" in refused.message, refused.message
    assert worst_step(rig.responses) <= 1.0, "a step beyond the rate limit"


def services_called(rig: Rig) -> None:
    """Parameters and life cycle services of a controller in use: every sample is answered before the next one."""
    rig.until_undisturbed()
    values = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(rig.graph.folder / "lqg3.yaml"))
    request = SetParameters.Request(parameters=[Parameter(name="next", value=values)])
    asked = time.monotonic()
    rig.graph.call(SetParameters, "controller/set_parameters", request)
    took = time.monotonic() - asked
    assert took > 0.002, "a service of more than a sample"
    assert not rig.graph.change_state("controller", "configure"), "configured while it is active"
    rig.graph.call(GetState, "controller/get_state", GetState.Request())
    rig.expect_no_delay()


def nothing_called(rig: Rig) -> None:
    """The same without a service, for comparison: what the machine itself delays."""
    rig.until_undisturbed()
    rig.expect_no_delay()


def killed(rig: Rig) -> None:
    """The controller is killed: the last command holds for the time-out, then the ramp."""
    rig.until_driven(1e3)
    rig.graph.kill(rig.commander)
    rig.graph.stop(rig.commander)
    del rig.graph.started[rig.commander]
    rig.graph.until(lambda: rig.last.state == Response.RAMPING_DOWN, "the ramp")
    rig.expect_zero(rig.commands[-1].sequence, TIMEOUT + RAMP + MARGIN)
    assert "no brace_command for" in rig.last.cause, rig.last.cause
    rig.start_commander()


def stopped(rig: Rig) -> None:
    """The controller is stopped, and goes on later."""
    rig.until_driven(1e3)
    controller = rig.graph.started[rig.commander].group
    os.kill(controller, signal.SIGSTOP)
    rig.graph.until(lambda: rig.last.state == Response.RAMPING_DOWN, "the ramp")
    last = rig.commands[-1].sequence
    rig.expect_zero(last, TIMEOUT + RAMP + MARGIN)
    assert "no brace_command for" in rig.last.cause, rig.last.cause
    os.kill(controller, signal.SIGCONT)


def flooding(rig: Rig) -> None:
    """Every sample is answered many times, with other forces: by a sender who knows the present one by the clock."""
    rig.until_driven(1e3)
    known, taken = rig.last, stamp_of(rig.last)

    def present() -> int:
        """Number of the present sample, which has not reached us."""
        return int(known.sequence + 1e-9 * RATE * (time.time_ns() - taken))

    message = BraceCommand(run=known.run)
    first, begin = present(), time.monotonic()
    for number in range(FLOOD):
        # from two samples before the present one to the one that follows
        message.sequence, message.force = present() - 2 + number // 2 % 4, [20e3 if number % 2 else -20e3]
        rig.flood.publish(message)
        time.sleep(max(0.0, begin + number / FLOOD_RATE - time.monotonic()))
    rig.expect_zero(first, TIMEOUT + RAMP + MARGIN)
    assert "two messages on brace_command" in rig.last.cause, rig.last.cause


EXCITED: dict[str, Callable[[Rig], None]] = {
    "rig_deactivated": rig_deactivated,
    "rig_interrupted": rig_interrupted,
    "commander_interrupted": commander_interrupted,
    "commander_deactivated": commander_deactivated,
    "node_joins": node_joins,
    "two_rigs": two_rigs,
    "rig_stalled": rig_stalled,
}
NOTHING_CALLED = "without_services"
CONTROLLED: dict[str, Callable[[Rig], None]] = {
    "nothing_but_the_loop_in_its_thread": services_called,
    NOTHING_CALLED: nothing_called,
}
FAILURES: dict[str, Callable[[Rig], None]] = {"killed": killed, "stopped": stopped, "flooding": flooding}
