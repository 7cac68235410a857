# SPDX-License-Identifier: Apache-2.0
"""The life cycle of a rig that runs by the clock: it is at rest only when its run has closed the device."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import domain_coordinator
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.nodes.rig_node import RigNode, time_limits

if TYPE_CHECKING:
    from collections.abc import Iterator

REFUSAL = "the device of the former run has not answered yet, expected that run to be over"


class SlowDevice(SimulatedRig):
    """A device that takes 0.2 s to close, and that answers only while `answering` is set."""

    def __init__(self, node: SlowRig) -> None:
        super().__init__(node.rig, 1, by_the_clock=True)
        self.node = node
        self.answering = threading.Event()
        self.answering.set()
        self.safe = self.closed = False

    def exchange(self, command, table):
        self.answering.wait()
        return super().exchange(command, table)

    def make_safe(self) -> None:
        self.safe = True

    def close(self) -> None:
        self.node.tell_rest()  # as after each message that arrives meanwhile
        time.sleep(0.2)
        self.closed = True


class SlowRig(RigNode):
    """A rig by the clock with a `SlowDevice`."""

    def __init__(self) -> None:
        super().__init__("slow_rig", time_limits(10.0, 1000))
        self.devices: list[SlowDevice] = []

    def make_device(self) -> SlowDevice:
        self.devices.append(SlowDevice(self))
        return self.devices[-1]

    def deactivate(self) -> None:
        super().deactivate()
        self.closed_before = self.devices[-1].closed

    def go(self, label: str) -> bool:
        """Ask for a transition as its service does; whether it went."""
        request = ChangeState.Request(transition=Transition(label=label))
        return self._on_change_state(request, ChangeState.Response()).success


@pytest.fixture
def start(monkeypatch) -> Iterator:
    """Creates the node with the parameters given."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with domain_coordinator.domain_id() as domain:
        nodes = []

        def create(**parameters: object) -> SlowRig:
            given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
            rclpy.init(args=["--ros-args", *given] if given else [], domain_id=domain)
            nodes.append(SlowRig())
            assert all(map(nodes[0].go, ["configure", "activate"]))
            return nodes[0]

        yield create
        for node in nodes:
            for device in node.devices:
                device.answering.set()
            node.destroy_node()
        rclpy.try_shutdown()


def until(holds) -> None:
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_deactivate_answers_when_the_device_is_safe_and_closed_and_the_next_run_begins_at_once(start):
    rig = start()
    until(lambda: rig.loop.sequence > 20)
    assert rig.go("deactivate")
    assert rig.devices[0].safe
    assert rig.closed_before, "two runs would use one device"
    assert rig.go("activate")
    until(lambda: rig.loop.sequence > 20)
    assert rig.go("deactivate")


def test_a_process_ends_only_when_the_device_is_safe_and_closed(start):
    rig = start()
    until(lambda: rig.loop.sequence > 20)
    assert rig.leave() > 0.2
    until(lambda: rig.at_rest)
    assert rig.devices[0].safe
    assert rig.devices[0].closed


def test_a_run_that_ends_by_itself_finishes_the_node_after_its_device_is_closed(start):
    rig = start(duration=0.1)
    until(lambda: rig.exit_code is not None)
    assert rig.exit_code == 0
    assert rig.devices[0].closed
    until(lambda: rig.at_rest)


def test_while_the_device_of_the_former_run_does_not_answer_another_run_is_refused(start):
    rig = start()
    rig.ramp_time = 0.0  # so that it is not waited for any longer
    until(lambda: rig.loop.sequence > 20)
    device = rig.devices[0]
    device.answering.clear()
    time.sleep(0.01)
    assert rig.go("deactivate")
    assert not rig.go("activate")
    assert str(rig._refusal) == REFUSAL
    assert rig.go("cleanup")
    assert not rig.go("configure"), "two loops would use one safety"
    assert str(rig._refusal) == REFUSAL
    device.answering.set()
    until(lambda: rig.at_rest)
    assert device.safe
    assert device.closed
    assert rig.exit_code is None, "an answer after the clean-up is no error"
    assert all(map(rig.go, ["configure", "activate"]))
    until(lambda: rig.loop.sequence > 20)
    assert rig.go("deactivate")
