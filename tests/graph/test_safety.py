# SPDX-License-Identifier: Apache-2.0
"""What the plant makes of commands that are wrong: a latched fault, and a force that goes smoothly to zero."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PUSH = 20e3
RATE_STEP = 2.5e6 / 500
RAMP_SAMPLES = 250
SLOWEST = 430
"""Samples of the building's slowest period, in which rest is measured."""
NOISE = 16.0


class Bench:
    """A rig in lockstep with the hand of the test at its braces."""

    def __init__(self, graph: Any, commander: Any) -> None:
        self.graph = graph
        self.hand = commander

    def push(self) -> int:
        """Bring the braces to PUSH; returns the number of samples taken so far."""
        self.hand.hold(PUSH, 20)
        assert self.hand.commands[-1] == PUSH
        return len(self.hand.responses)

    def expect_smooth_end(self, first: int) -> None:
        """Go on pushing; from sample `first` on the force has to go smoothly to zero and stay there."""
        self.hand.hold(PUSH, first + RAMP_SAMPLES + 50 - len(self.hand.responses))
        command, force = self.hand.commands[first - 1 :], self.hand.forces[first - 1 :]
        assert command[0] == PUSH
        assert np.diff(command).max() <= 0, "the command only falls"
        assert -np.diff(command).min() < PUSH * math.pi / 2 / RAMP_SAMPLES * 1.01, "along a half cosine"
        assert not command[RAMP_SAMPLES + 2 :].any(), "zero within 0.5 s, whatever is commanded"
        assert np.abs(np.diff(force)).max() < RATE_STEP + 10 * NOISE, "no step above the rate limit"
        assert np.abs(force[-20:]).max() < 0.1 * PUSH, "what is left is the building moving the actuator"

    def expect_latched_until_cleared(self, reason: str) -> None:
        """The fault is reported and told by every sample, stays, and is cleared while nothing is commanded alone."""
        self.graph.until_fault("plant", reason)
        self.hand.hold(PUSH, 20)
        assert not self.hand.commands[-20:].any()
        assert self.hand.responses[-1].state == Response.LATCHED
        assert reason in self.hand.responses[-1].cause
        refused = self.graph.clear_fault("plant")
        assert not refused.success
        assert refused.message == "brace_command still requests 20000, expected every input at rest first"
        self.hand.hold(0.0, SLOWEST)
        answer = self.graph.clear_fault("plant")
        assert answer.success, answer.message
        assert reason in answer.message
        self.hand.hold(0.0, 3)  # the target is armed meanwhile
        self.hand.hold(3000.0, RAMP_SAMPLES + 5)
        assert self.hand.responses[-1].state == Response.RUNNING
        assert not self.hand.responses[-1].cause
        assert self.hand.commands[-1] == 3000.0
        faded = self.hand.commands[-RAMP_SAMPLES - 5 :]
        assert np.abs(np.diff(faded)).max() < 3000.0 * math.pi / 2 / RAMP_SAMPLES * 1.01, "it fades in"


@pytest.fixture(scope="module")
def rig(new_graph: Callable, new_commander: Callable) -> Iterator[Bench]:
    """One plant in lockstep for all of these tests."""
    with new_graph() as graph:
        graph.start("plant", lockstep=True)
        yield Bench(graph, new_commander(graph))


@pytest.fixture
def bench(rig: Bench) -> Bench:
    """The plant without a fault and without force."""
    rig.hand.hold(0.0, RAMP_SAMPLES + SLOWEST)
    rig.graph.clear_fault("plant")
    rig.hand.hold(0.0, RAMP_SAMPLES + 10)
    assert not rig.hand.commands[-10:].any()
    return rig


def test_a_command_of_the_wrong_length_takes_the_force_smoothly_to_zero(bench):
    first = bench.push()
    bench.hand.answer([PUSH, PUSH])
    bench.expect_smooth_end(first + 1)
    bench.expect_latched_until_cleared("expected (1,)")


BUTTONS = {
    "the default of rclpy and ros2 topic pub": ("emergency_stop", QoSProfile(depth=10)),
    "latched": ("/emergency_stop", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)),
    "best effort": ("emergency_stop", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)),
}


@pytest.mark.parametrize(("topic", "qos"), BUTTONS.values(), ids=BUTTONS)
def test_a_stop_is_heard_on_both_names_with_any_qos_and_held_until_its_sender_releases_it(bench, topic, qos):
    bench.push()
    button = bench.graph.publisher(Bool, topic, qos)
    other = bench.graph.publisher(Bool, topic, qos)
    # the best effort of a button that says it once may be none
    again = qos.reliability is ReliabilityPolicy.BEST_EFFORT

    def say(pressed: bool) -> None:
        if again:
            button.publish(Bool(data=pressed))
        bench.hand.hold(PUSH, 1)

    button.publish(Bool(data=True))
    bench.graph.until(lambda: say(True) or bench.hand.commands[-1] < PUSH, "the force to fall")
    bench.expect_smooth_end(len(bench.hand.responses) - 1)
    other.publish(Bool(data=False))
    bench.hand.hold(0.0, 50)
    pressed = bench.hand.responses[-1]
    assert pressed.state == Response.PROTECTIVE_STOP
    assert pressed.flags & Response.STOP_PRESSED
    assert pressed.cause == f"protective stop: pressed by {bench.graph.namespace}/test"
    answer = bench.graph.clear_fault("plant")
    assert not answer.success
    assert answer.message.startswith("a stop is still pressed")
    button.publish(Bool(data=False))
    bench.graph.until(lambda: say(False) or bench.hand.states[-1] == Response.LATCHED, "its release")
    bench.expect_latched_until_cleared("protective stop: pressed by")
    for publisher in (button, other):
        bench.graph.node.destroy_publisher(publisher)


def test_a_stop_whose_sender_has_left_counts_until_a_person_clears_it(bench):
    bench.hand.hold(0.0, 2)
    button = bench.graph.publisher(Bool, "emergency_stop")
    button.publish(Bool(data=True))
    bench.graph.until(lambda: bench.hand.hold(0.0, 1) or bench.hand.states[-1] == Response.PROTECTIVE_STOP, "the stop")
    bench.graph.node.destroy_publisher(button)
    bench.hand.hold(0.0, SLOWEST)
    assert bench.hand.states[-1] == Response.PROTECTIVE_STOP
    bench.graph.until(lambda: bench.graph.clear_fault("plant").success, "it to be cleared")
