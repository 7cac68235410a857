# SPDX-License-Identifier: Apache-2.0
"""What may act, tried on running nodes in lockstep: what is wrong with a command, a stop or a sensor, and clearing it.

Each case is a function that fails with an AssertionError. They share a plant that the case commands, or a controller to
which the case plays the rig. For `make verify`, with those of `safety_by_the_clock`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from controller_speed import SOURCE
from geometry_msgs.msg import AccelStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from running_graph import LATCHED, Commander
from state_table import EXPECTED, StateWalk, cells
from std_msgs.msg import Bool

from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.live.loop import rig_outputs
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.publisher import Publisher
    from running_graph import Graph

    from abrace_plant.rig.model import Rig

PUSH = 20e3
"""Force of the braces before something goes wrong [N]."""
RATE, RATE_LIMIT = 500.0, 2.5e6
RAMP = round(RAMP_TIME * RATE)
SLOWEST = 430
"""Samples of the building's slowest period, in which rest is measured."""
HEARTBEAT = 1.0
"""Time within which the repeating stop button has to be heard [s]."""
TABLE = load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml").table
TABLE_NOISE = 8.4e-4
"""Of the table's accelerometer [m/s^2]."""
QOS = {
    "volatile": QoSProfile(depth=10),
    "latched": LATCHED,
    "best_effort": QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
}
TOPICS = ("emergency_stop", "/emergency_stop")


def worst_step(responses: Sequence[Response]) -> float:
    """The greatest change of a command from one sample of a run to the next, over what the rate limit allows.

    Without what a difference of two numbers loses to rounding.
    """
    commands = np.array([response.command[0] for response in responses])
    runs = np.array([response.run for response in responses], dtype=np.uint64)
    steps = np.abs(np.diff(commands))[runs[1:] == runs[:-1]]
    return round(float(steps.max(initial=0.0)) * RATE / RATE_LIMIT, 9)


def walk_pairs(rig: Rig) -> tuple[int, int]:
    """Pairs of a state and an event, and those of them that lead where a person has written it down."""
    walk = StateWalk(lambda: rig_outputs(rig), 1 / rig.sample_rate)
    return len(cells(EXPECTED)), len(cells(EXPECTED)) - len(list(walk.differences()))


class Hands(Commander):
    """At the braces and at the table of a rig in lockstep."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.shaking = -1
        """Samples for which the table has been shaken; -1: it is not."""
        self._table = graph.publisher(AccelStamped, "ground_motion")
        # the rig begins when it has as many subscribers as inputs
        graph.node.create_subscription(Response, "response", lambda _: None, 1, raw=True)
        super().__init__(graph)

    def send(self, force: Sequence[float], fault: str = "") -> None:
        """Answer the present sample."""
        self.send_table()
        super().send(force, fault)

    def send_table(self, acceleration: float | None = None) -> None:
        """Answer the present sample with an `acceleration` of the table [m/s^2]; None: with that of its shaking."""
        if acceleration is None:
            self.shaking += self.shaking >= 0
            acceleration = 0.05 * math.cos(0.02 * math.pi * self.shaking) if self.shaking >= 0 else 0.0
        message = AccelStamped(header=self.responses[-1].header)
        message.accel.linear.x = acceleration
        self._table.publish(message)

    @property
    def last(self) -> Response:
        """The last sample."""
        return self.responses[-1]

    def begin(self) -> None:
        """Be at rest, without a fault; forget the samples before."""
        self.shaking = -1
        self.hold(0.0, 2)
        if self.last.state != Response.RUNNING:
            self.until(lambda: self.last.state in (Response.LATCHED, Response.RUNNING), 0.0)
            if self.last.state == Response.LATCHED:
                self.hold(0.0, SLOWEST)
                answer = self.graph.clear_fault("plant")
                assert answer.success, answer.message
            self.until(lambda: self.last.state == Response.RUNNING, 0.0)
        del self.responses[:-1]

    def begin_new_run(self) -> None:
        """Let building and table be at rest and in the middle, in a new run."""
        graph, run = self.graph, self.last.run
        assert graph.change_state("plant", "deactivate")
        if self.last.cause:
            assert graph.clear_fault("plant").success
        for transition in ("cleanup", "configure", "activate"):
            assert graph.change_state("plant", transition), f"{transition} was refused"
        graph.until(lambda: self.last.run != run, "a new run")

    def push(self) -> int:
        """Push and shake; returns the number of samples so far."""
        self.shaking = 0
        self.hold(PUSH, 10)
        assert self.commands[-1] == PUSH, f"{self.commands[-1]} N, expected {PUSH}"
        return len(self.responses)

    def until(self, holds: Callable[[], bool], force: float = PUSH, samples: int = 2000) -> None:
        """Go on with a `force` until something holds."""
        for _ in range(samples):
            if holds():
                return
            self.hold(force, 1)
        raise AssertionError(f"still not after {samples} samples; {self.graph.reported()}")

    def expect_rest(self, first: int, state: int, cause: str) -> None:
        """Go on: from sample `first` on braces and table have to come smoothly to rest, and stay there."""
        self.hold(PUSH, max(0, first + 2 * RAMP - len(self.responses)))
        command = self.commands[first - 1 :]
        assert np.diff(command).max() <= 0, "the command only falls"
        assert -np.diff(command).min() < 1.01 * PUSH * math.pi / 2 / RAMP, "along a half cosine"
        assert not command[RAMP + 3 :].any(), "zero within the ramp, whatever is commanded"
        ground = [response.ground_acceleration for response in self.responses[-100:]]
        assert np.abs(ground).max() < 7 * TABLE_NOISE, "the table is at rest"
        assert self.last.state == state, self.last.cause
        assert cause in self.last.cause, self.last.cause

    def expect_clearing(self) -> None:
        """Only when nothing is asked for any more can the fault be cleared; then the force fades in."""
        refused = self.graph.clear_fault("plant")
        assert not refused.success, "cleared while a force is commanded"
        assert "expected every input at rest first" in refused.message, refused.message
        self.shaking = -1
        self.hold(0.0, SLOWEST)
        answer = self.graph.clear_fault("plant")
        assert answer.success, answer.message
        self.until(lambda: self.last.state == Response.FADING_IN, 0.0)
        self.hold(PUSH, RAMP + 5)
        faded = self.commands[-RAMP - 5 :]
        assert faded[-1] == PUSH, "the force is in"
        assert np.abs(np.diff(faded)).max() < 1.01 * PUSH * math.pi / 2 / RAMP, "it fades in"


class RepeatingButton(Hands):
    """The same with a stop button that repeats its message, as long as `repeats` says so."""

    def __init__(self, graph: Graph) -> None:
        self.repeats = True
        button = graph.publisher(Bool, "emergency_stop")

        def repeat() -> None:
            if self.repeats:
                button.publish(Bool(data=False))

        graph.node.create_timer(HEARTBEAT / 10, repeat)
        super().__init__(graph)


def stop_of(kind: str) -> Callable[[Hands], None]:
    """A stop button of one kind of QoS, on the laboratory's and on the rig's own name."""

    def case(hands: Hands) -> None:
        for topic in TOPICS:
            hands.begin()
            hands.push()
            button = hands.graph.publisher(Bool, topic, QOS[kind])
            button.publish(Bool(data=True))

            def obeyed(button: Publisher = button) -> bool:
                if kind == "best_effort":
                    # what best effort has lost is lost: such a button repeats itself
                    button.publish(Bool(data=True))
                return bool(hands.last.command[0] < PUSH)

            hands.until(obeyed)
            hands.expect_rest(len(hands.responses) - 1, Response.PROTECTIVE_STOP, "protective stop: pressed by")
            assert not hands.graph.clear_fault("plant").success, "cleared while a stop is pressed"
            button.publish(Bool(data=False))
            hands.until(lambda: hands.last.state == Response.LATCHED)
            hands.graph.node.destroy_publisher(button)

    return case


def two_buttons(hands: Hands) -> None:
    """One pressed, the other one says that it is not."""
    first = hands.push()
    one, other = (hands.graph.publisher(Bool, "emergency_stop") for _ in range(2))
    one.publish(Bool(data=True))
    hands.until(lambda: hands.last.command[0] < PUSH)
    first = len(hands.responses) - 1
    other.publish(Bool(data=False))
    hands.expect_rest(first, Response.PROTECTIVE_STOP, "protective stop: pressed by")
    hands.hold(0.0, 50)
    assert "a stop is still pressed" in hands.graph.clear_fault("plant").message
    one.publish(Bool(data=False))
    hands.until(lambda: hands.last.state == Response.LATCHED)
    hands.expect_clearing()
    for button in (one, other):
        hands.graph.node.destroy_publisher(button)


def sender_gone(hands: Hands) -> None:
    """Pressed, its sender gone, and the rig taken through its life cycle: nothing but a person lets it act."""
    hands.push()
    button = hands.graph.publisher(Bool, "emergency_stop")
    button.publish(Bool(data=True))
    hands.until(lambda: hands.last.state == Response.PROTECTIVE_STOP)
    hands.graph.node.destroy_publisher(button)
    graph = hands.graph
    for transition in ("deactivate", "cleanup", "configure"):
        assert graph.change_state("plant", transition), f"{transition} was refused"
    assert not graph.change_state("plant", "activate"), "activated while a stop is pressed"
    graph.until(lambda: graph.clear_fault("plant").success, "it to be cleared")
    run, hands.shaking = hands.last.run, -1
    assert graph.change_state("plant", "activate")
    graph.until(lambda: hands.last.run != run, "a new run")
    hands.until(lambda: hands.last.state == Response.RUNNING, 0.0)
    hands.hold(PUSH, 10)
    assert hands.commands[-1] == PUSH


def clear_while_commanded(hands: Hands) -> None:
    """A commander that goes on commanding keeps a fault from being cleared."""
    first = hands.push()
    hands.answer([math.nan])
    hands.expect_rest(first + 1, Response.LATCHED, "expected finite numbers")
    hands.expect_clearing()


def clear_during_the_ramp(hands: Hands) -> None:
    """Refused until the ramp is over, which goes on."""
    first = hands.push()
    hands.answer([math.nan])
    for _ in range(5):
        hands.hold(PUSH, RAMP // 6)
        answer = hands.graph.clear_fault("plant")
        assert not answer.success, "cleared on the way to rest"
        assert "still ramping down" in answer.message, answer.message
    hands.expect_rest(first + 1, Response.LATCHED, "expected finite numbers")


def wrong_command(force: list[float], cause: str) -> Callable[[Hands], None]:
    """A command that cannot act stops braces and table together."""

    def case(hands: Hands) -> None:
        first = hands.push()
        hands.answer(force)
        hands.expect_rest(first + 1, Response.LATCHED, cause)

    return case


def two_senders(hands: Hands) -> None:
    """Two answers to one sample."""
    first = hands.push()
    for force in (PUSH, -PUSH):
        answer = BraceCommand(run=hands.last.run, sequence=hands.last.sequence, force=[force])
        hands._publisher.publish(answer)
    hands.send_table()
    hands.graph.until(lambda: len(hands.responses) > first, "the next sample")
    hands.expect_rest(first + 2, Response.LATCHED, "two messages on brace_command")


def sender_reports_a_fault(hands: Hands) -> None:
    """A sender that reports a fault of its own: the rig's as well, until that one is cleared."""
    first = hands.push()
    hands.send([PUSH], "planted")
    hands.graph.until(lambda: len(hands.responses) > first, "the next sample")
    hands.expect_rest(first + 1, Response.LATCHED, "its sender reports: planted")
    more = hands._more()
    hands.send([0.0], "planted")
    hands.graph.until(more, "the next sample")
    refused = hands.graph.clear_fault("plant")
    assert not refused.success, "cleared though its sender reports a fault"
    assert "its sender reports a fault: planted" in refused.message, refused.message
    hands.expect_clearing()


def sensor_at_its_end(hands: Hands) -> None:
    """The table accelerates beyond its accelerometer's range: every such sample says so, and it is an interlock."""
    hands.hold(0.0, 2)
    clipped = 0
    for _ in range(40):
        hands.send_table(1.8 if hands.last.state == Response.RUNNING else 0.0)
        Commander.send(hands, [0.0])
        hands.graph.until(hands._more(), "the next sample")
        clipped += bool(hands.last.clipped >> 9 & 1)
    assert clipped >= 5, f"{clipped} samples say so"
    assert "interlocks.clipped" in hands.last.cause, hands.last.cause
    hands.hold(0.0, RAMP + 50)
    assert hands.last.state == Response.LATCHED
    hands.begin_new_run()


def motion_cut(hands: Hands) -> None:
    """A motion beyond the table's limits, that nobody refused: cut, and every such sample says so."""
    hands.begin_new_run()
    hands.until(lambda: hands.last.state == Response.RUNNING, 0.0)
    graph, peak = hands.graph, TABLE.peak_acceleration
    graph.until_well("plant")
    before, first = int(graph.values("plant")["table_limits"]), len(hands.responses)
    for k in range(80):
        # to and fro: the table is slow and near the middle afterwards
        hands.send_table(3 * peak * (1 if k // 20 in (0, 3) else -1))
        Commander.send(hands, [0.0])
        graph.until(hands._more(), "the next sample")
    hands.hold(0.0, 100)
    flagged = [bool(one.flags & Response.TABLE_LIMITED) for one in hands.responses[first:]]
    assert all(flagged[:80]), f"{sum(flagged[:80])} of 80 samples say so"
    graph.until_well("plant")
    assert int(graph.values("plant")["table_limits"]) - before == sum(flagged), "not counted"
    ground = np.array([one.ground_acceleration for one in hands.responses[first:]])
    assert 0.9 * peak < np.abs(ground).max() < peak + 7 * TABLE_NOISE, f"{np.abs(ground).max():.3g} m/s^2"
    most = TABLE.peak_jerk / RATE + 14 * TABLE_NOISE
    assert np.abs(np.diff(ground)).max() < most, "a step beyond the table's jerk"
    assert hands.last.state == Response.RUNNING, hands.last.cause


def heartbeat_silent(hands: RepeatingButton) -> None:
    """A stop button that has to repeat falls silent: a stop, until it is heard again and a person clears it."""
    hands.push()
    hands.repeats = False
    hands.until(lambda: bool(hands.last.command[0] < PUSH), samples=20_000)
    hands.expect_rest(len(hands.responses) - 1, Response.PROTECTIVE_STOP, "protective stop: no heartbeat of")
    assert not hands.graph.clear_fault("plant").success, "cleared without a heartbeat"
    hands.repeats = True
    hands.until(lambda: hands.last.state == Response.LATCHED)
    hands.expect_clearing()


LOCKSTEP: dict[str, Callable[[Hands], None]] = {
    "stop_volatile": stop_of("volatile"),
    "stop_latched": stop_of("latched"),
    "stop_best_effort": stop_of("best_effort"),
    "two_buttons": two_buttons,
    "sender_gone_life_cycle_walked": sender_gone,
    "clear_while_commanded": clear_while_commanded,
    "clear_during_the_ramp": clear_during_the_ramp,
    "command_nan": wrong_command([math.nan], "expected finite numbers"),
    "command_of_wrong_length": wrong_command([PUSH, PUSH], "expected (1,)"),
    "two_senders": two_senders,
    "sender_reports_a_fault": sender_reports_a_fault,
    "sensor_at_the_end_of_its_range": sensor_at_its_end,
}


def start_plant_in_hand(graph: Graph, **parameters: Any) -> None:
    """Start a plant in lockstep whose braces and table are ours, with further `parameters`."""
    inputs = ["brace_command", "ground_motion"]
    graph.start("plant", lockstep=True, wait_for=inputs, **parameters)


def plant_in_hand(graph: Graph) -> Hands:
    """A plant in lockstep whose braces and table are ours."""
    start_plant_in_hand(graph)
    return Hands(graph)


def repeating_button(graph: Graph) -> RepeatingButton:
    """The same with a stop button that has to repeat its message."""
    start_plant_in_hand(graph, stop_heartbeat=HEARTBEAT)
    return RepeatingButton(graph)
