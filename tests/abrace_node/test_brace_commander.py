# SPDX-License-Identifier: Apache-2.0
"""What a node that commands braces refuses when it is configured, and how its force fades in."""

from __future__ import annotations

import math
import time
from itertools import count
from types import SimpleNamespace
from typing import TYPE_CHECKING

import domain_coordinator
import numpy as np
import pytest
import rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import String
from std_srvs.srv import Trigger

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import State
from abrace_core.safety.wire import LAST, LOCKSTEP, Head, Responses
from abrace_interfaces.msg import Response
from abrace_node.commander import PLAYING, READY, BraceCommander
from abrace_node.law_node import LawNode

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def domain() -> Iterator[int]:
    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield domain
        rclpy.try_shutdown()


@pytest.fixture
def commander(domain) -> Iterator[BraceCommander]:
    rclpy.init(args=["--ros-args", "-p", "rate_limit:=250000.0"], domain_id=domain)
    node = BraceCommander("pusher", [])
    yield node
    node.destroy_node()


def test_a_rate_limit_too_low_for_the_ramp_is_refused_by_its_parameter(commander):
    with pytest.raises(AbraceError) as refused:
        commander.create_topics(0.002, [1e3, 1e5, 2e3])
    assert str(refused.value) == (
        "parameter rate_limit: 250000 N/s, expected at least 314200 N/s to bring 100000 N to zero in 0.5 s"
    )
    commander.create_topics(0.002, [1e3, 7e4, 2e3])
    assert commander.guard.at_rest


class Push:
    def begin(self, floors, groups, sample_period):
        pass

    def force(self, _):
        return 1000.0


class PushNode(LawNode):
    law = Push


def test_a_force_fades_in_once_after_a_fault_has_been_cleared(domain):
    """By its law's half cosine, not by that times the one of the state machine."""
    rclpy.init(args=[], domain_id=domain)
    node, responses, sequence = PushNode(), Responses(), count()
    node.trigger_configure()
    node.trigger_activate()

    def answer(samples: int) -> list[float]:
        forces = []
        for _ in range(samples):
            head = Head(next(sequence), 1, 0, LOCKSTEP, State.RUNNING)
            node.on_response(
                responses.pack(2_000_000 * head.sequence, head, "", [1], [0.0], [0.0], [0.0], [0.0], [0.0], 0.0, 0.0)
            )
            forces += node.guard.value
        return forces

    first = answer(300)
    node.safety.fault("planted")
    answer(300)
    assert node.on_clear_fault(Trigger.Request(), Trigger.Response()).success
    again = answer(300)
    node.destroy_node()
    half_cosine = [1000 * (1 - math.cos(math.pi * j / 250)) / 2 for j in range(1, 250)] + [1000.0] * 51
    assert first == pytest.approx(half_cosine)
    assert again == pytest.approx(half_cosine)


def test_an_acceleration_that_is_not_finite_is_a_fault_that_names_it(domain):
    """Of a law of one's own; the force comes to rest and is zero from then on."""
    rclpy.init(args=[], domain_id=domain)
    node = PushNode()
    node.trigger_configure()
    node.trigger_activate()
    responses, forces = Responses(), []
    for number in range(1400):
        head = Head(number, 1, 0, LOCKSTEP, State.RUNNING)
        acceleration = math.nan if number == 1000 else 1.0
        node.on_response(
            responses.pack(2_000_000 * number, head, "", [1], [0.0], [acceleration], [0.0], [0.0], [0.0], 0.0, 0.0)
        )
        forces += node.guard.value
    fault = node.fault
    node.destroy_node()
    assert fault == "acceleration[0] of sample 1000 is nan, expected a finite number"
    assert forces[999] == pytest.approx(1000.0)
    assert np.isfinite(forces).all()
    assert forces[1399] == 0.0


class Signal(BraceCommander):
    """Commands 100 N while it plays."""

    signal = READY
    awaits_goal = True

    def __init__(self) -> None:
        super().__init__("signal", [])

    def configure(self) -> None:
        self.create_topics(0.002, [1000.0])
        self.answers: list[float] = []
        self.publisher = SimpleNamespace(publish=lambda _: self.answers.append(self.guard.value[0]))

    def play(self) -> None:
        self.begin_goal()

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        pass

    def force(self, *_) -> np.ndarray:
        return np.array([100.0 if self.signal == PLAYING else 0.0])


@pytest.fixture
def signal(domain) -> Iterator[Signal]:
    rclpy.init(args=[], domain_id=domain)
    node = Signal()
    node.trigger_configure()
    node.trigger_activate()
    yield node
    node.destroy_node()


def sample(node: Signal, run: int, sequence: int, state: State = State.RUNNING, flags: int = LOCKSTEP) -> None:
    head = Head(sequence, run, 0, flags, state)
    payload = Responses().pack(2_000_000 * sequence, head, "", [1], [0.0], [0.0], [0.0], [0.0], [0.0], 0.0, 0.0)
    node.on_response(payload)


def ask_to_play(node: Signal) -> str:
    return node.on_play(Trigger.Request(), Trigger.Response()).message


def test_a_rig_in_lockstep_waits_at_its_first_running_sample_of_each_run_for_the_goal(signal):
    for run in (1, 2):
        signal.answers.clear()
        sample(signal, run, 0, State.FADING_IN)
        assert signal.answers == [0.0]
        assert ask_to_play(signal) == "not played: rig fading in"
        sample(signal, run, 1)
        assert signal.answers == [0.0], "it waits"
        assert ask_to_play(signal) == "playing"
        assert signal.answers == [0.0, 100.0]
        sample(signal, run, 2)
        assert signal.answers == [0.0, 100.0, 100.0]
        sample(signal, run, 3, State.RAMPING_DOWN)
        sample(signal, run, 4, State.RUNNING)
        assert signal.answers[3:] == [0.0, 0.0], "a signal that was cancelled is over, and nobody waits again"
        assert signal.signal == "cancelled"


def test_a_sample_of_a_rig_in_lockstep_that_comes_again_is_answered_again_with_the_same_and_computed_once(signal):
    asked = []
    signal.force = lambda sequence, *_: asked.append(sequence) or np.array([10.0 * len(asked)])
    signal.awaits_goal = False
    sent = []
    signal.publisher = SimpleNamespace(publish=sent.append)
    for sequence in (0, 0, 1, 1, 1, 2, 1):
        sample(signal, 1, sequence)
    assert asked == [0, 1, 2]
    assert sent == [sent[0], sent[0], sent[2], sent[2], sent[2], sent[5]]
    assert len(set(sent)) == 3
    assert (signal.gate.watch.old, signal.gate.watch.missing) == (1, 0), "but one that is older"
    sample(signal, 2, 2)
    assert len(sent) == 7, "another run's sample is a new one"


def test_by_the_clock_a_sample_that_comes_again_is_old(signal):
    signal.awaits_goal = False
    for sequence in (0, 1, 1):
        sample(signal, 1, sequence, flags=0)
    assert len(signal.answers) == 2
    assert signal.gate.watch.old == 1


def test_a_sample_that_waits_for_a_goal_is_answered_once_though_it_comes_again(signal):
    sample(signal, 1, 0, State.FADING_IN)
    for _ in range(3):
        sample(signal, 1, 1)
    assert signal.answers == [0.0]
    assert ask_to_play(signal) == "playing"
    assert signal.answers == [0.0, 100.0]


def test_a_sample_that_waits_for_a_goal_is_answered_when_the_node_is_deactivated(signal):
    sample(signal, 1, 0)
    assert signal.answers == []
    signal.trigger_deactivate()
    assert signal.answers == [0.0]
    signal.play = None  # not called: what it needs may not be there
    assert ask_to_play(signal) == "not played: not active"


def test_the_end_of_a_run_ends_a_goal_and_the_next_run_does_not_begin_it(signal):
    sample(signal, 1, 0, flags=0)
    assert ask_to_play(signal) == "playing"
    assert ask_to_play(signal) == "not played: a signal is playing"
    sample(signal, 1, 1, flags=LAST)
    sample(signal, 2, 0, flags=0)
    assert signal.answers == [0.0, 100.0, 0.0]
    assert signal.status == "cancelled: the run of the rig has ended; ~/play plays it again"
    assert ask_to_play(signal) == "playing"
    sample(signal, 2, 1, flags=0)
    assert signal.answers[-1] == 100.0


@pytest.mark.parametrize(
    ("message_type", "qos", "said"),
    [
        (Response, qos_profile_sensor_data, "QoS (best effort publisher and reliable subscription)"),
        (String, 10, "type std_msgs/msg/String, expected abrace_interfaces/msg/Response"),
        (Response, 10, ""),
    ],
)
def test_the_state_names_a_publisher_of_the_rig_that_does_not_fit(domain, signal, monkeypatch, message_type, qos, said):
    """Otherwise the node waits for a rig that is there."""
    reports = []
    monkeypatch.setattr(signal, "_diagnostics", SimpleNamespace(publish=reports.append))
    context = rclpy.Context()  # one participant has one type for a topic
    context.init(domain_id=domain)
    rig = rclpy.create_node("own_rig", context=context)
    publisher = rig.create_publisher(message_type, "response", qos)
    waiting = "no sample of a rig has come yet"
    expected = f"{waiting}; publisher /own_rig of /response does not fit: {said}" if said else waiting
    end, found = time.monotonic() + 20.0, ""
    while found != expected or not (said or publisher.get_subscription_count()):
        assert time.monotonic() < end, found
        time.sleep(0.01)  # the name of its node comes a moment after the publisher
        signal.publish_diagnostics()
        found = reports[-1].status[0].message
    rig.destroy_node()
    context.try_shutdown()
