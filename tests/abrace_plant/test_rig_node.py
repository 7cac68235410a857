# SPDX-License-Identifier: Apache-2.0
"""The life cycle of a rig that runs by the clock: it is at rest only when its run has closed the device."""

from __future__ import annotations

import re
import threading
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING

import domain_coordinator
import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import TransitionCallbackReturn

from abrace_core.files.installed import find_file
from abrace_core.safety.rig_safety import State
from abrace_core.safety.stop_senders import UNNAMED
from abrace_plant.devices import device as device_module
from abrace_plant.devices.device import DeviceError, open_device
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import COMMAND
from abrace_plant.nodes.plant import PARAMETERS
from abrace_plant.nodes.rig_node import RIG, RigNode
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Iterator

FORCE = 5e3
"""Of a step [N]: a greater one trips the interlock for jumps where this computer misses samples."""
REFUSAL = "the device of the former run has not answered yet, expected that run to be over"


class SlowDevice(SimulatedRig):
    """A device that takes 0.2 s to close, and that answers only while `answering` is set."""

    def __init__(self, node: SlowRig) -> None:
        super().__init__(node.rig, 1, by_the_clock=True)
        self.node = node
        self.answering = threading.Event()
        self.answering.set()
        self.safe = self.closed = False
        self.sent: list[float] = []
        self.missed = 0
        """Most samples in a row that were missed."""

    def exchange(self, command, table, *target):
        self.sent.append(command[0])
        self.answering.wait()
        reading = super().exchange(command, table, *target)
        self.missed = max(self.missed, reading.missed)
        return reading

    def make_safe(self) -> None:
        self.safe = True

    def close(self) -> None:
        self.node.notify_rest()  # as after each message that arrives meanwhile
        time.sleep(0.2)
        self.closed = True


class SlowRig(RigNode):
    """A rig by the clock with a `SlowDevice`."""

    def __init__(self) -> None:
        super().__init__("slow_rig", PARAMETERS)
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


@pytest.fixture(scope="module")
def rig_file():
    return load_rig(find_file(RIG, "abrace_plant", "config", ".yaml", "rig"))


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
            with node.lock:
                if node.run is not None:
                    node.cleanup()
        until(lambda: all(node.run is None for node in nodes))  # a thread would go on with a node that is destroyed
        for node in nodes:
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


def test_a_stop_is_logged_once_though_its_senders_name_becomes_known_later(start, monkeypatch):
    rig, lines = start(), []
    monkeypatch.setattr(rig, "get_logger", lambda: SimpleNamespace(error=lines.append, info=lines.append))
    for pressed in (f"pressed by {UNNAMED}", "pressed by /panel"):
        rig.safety.press(pressed)
        rig.publish_diagnostics()
    assert rig.reported_fault == "protective stop: pressed by /panel"
    (line,) = lines
    assert line.startswith(f"fault: protective stop: pressed by {UNNAMED}; ")


def test_a_process_ends_only_when_the_device_is_safe_and_closed(start):
    rig = start()
    until(lambda: rig.loop.sequence > 20)
    assert rig.begin_shutdown() > 0.2
    until(lambda: rig.at_rest)
    assert rig.devices[0].safe
    assert rig.devices[0].closed


def test_a_run_that_ends_by_itself_finishes_the_node_after_its_device_is_closed(start):
    rig = start(duration=0.1)
    until(lambda: rig.exit_code is not None)
    assert rig.exit_code == 0
    assert rig.devices[0].closed
    until(lambda: rig.at_rest)


def test_a_run_of_a_device_that_fails_at_every_tick_ends_in_time_with_its_fault(start, monkeypatch):
    def fail(*_) -> None:
        raise DeviceError("the card does not answer")

    monkeypatch.setattr(SlowDevice, "exchange", fail)
    begun = time.monotonic()
    rig, ended, finish = start(duration=0.5), [], RigNode.finish
    monkeypatch.setattr(rig, "finish", lambda *given: (ended.append(given), finish(rig, *given)))
    until(lambda: rig.exit_code is not None)
    assert time.monotonic() - begun > 0.5
    ((code, message),) = ended
    assert code == 1
    assert message.startswith("ended with a fault: the card does not answer; ")
    assert rig.devices[0].safe
    assert rig.devices[0].closed


@pytest.mark.parametrize("period", [0.004, 0.001])
def test_a_device_of_another_rate_is_a_fault_whatever_its_stamps_say(start, monkeypatch, period):
    """It says steps of 2 ms, and keeps the samples that are not used yet; a busy computer uses fewer than it could."""

    def exchange(device, *given):
        device._by_the_clock = False
        if device.next_stamp == 0:
            device.begun = time.monotonic()
        time.sleep(max(0.0, device.begun + device.next_stamp / 2e6 * period - time.monotonic()))
        return SimulatedRig.exchange(device, *given)

    monkeypatch.setattr(SlowDevice, "exchange", exchange)
    rig = start(command_timeout=2.0)
    rig.loop._unwatched_limit = np.inf  # nobody spins the node
    until(lambda: rig.safety.cause)
    assert re.match(r"device: (more than 500|\d.*) samples/s .*by this computer's clock", rig.safety.cause)
    until(lambda: rig.safety.state is State.LATCHED)
    _, _, values = rig.diagnose()
    assert values["warning"] == rig.safety.cause
    assert rig.loop.moving() == rig.safety.cause, "nothing is armed"


def test_a_rig_whose_device_does_not_answer_stays_active_and_is_latched_until_a_person_clears_it(start):
    rig = start()
    rig.ramp_time = 0.0  # so that it is not waited for any longer
    until(lambda: rig.loop.began >= 0)
    device = rig.devices[0]
    device.answering.clear()
    time.sleep(0.01)
    assert not rig.go("deactivate")
    assert rig.active
    assert not rig.go("activate")
    device.answering.set()
    until(lambda: rig.safety.state is State.LATCHED)
    assert rig.safety.cause == "not at rest 0.1 s after the deactivation"
    assert rig.run is not None
    until(lambda: not rig.loop.moving())
    rig.safety.clear()
    until(lambda: rig.safety.state is State.RUNNING)
    rig.ramp_time = 3.0
    assert rig.go("deactivate")
    assert device.safe
    assert device.closed


def test_a_node_that_is_reset_while_its_device_does_not_answer_sends_no_step_to_zero(start):
    rig = start(late_limit=1000, command_timeout=2.0)
    until(lambda: rig.loop.began >= 0)
    device = rig.devices[0]

    rig.loop._unwatched_limit = np.inf  # nobody spins the node

    def push() -> bool:
        with rig.lock:
            if not rig.loop.has_answer(COMMAND):
                rig.loop.receive_command(rig.run_number, rig.loop.sequence, [FORCE], "")
        return device.sent[-1] == FORCE

    until(push)
    device.answering.clear()
    time.sleep(0.01)
    rig.on_error(None)
    assert rig.on_configure(None) == TransitionCallbackReturn.FAILURE, "two loops would use one safety"
    assert str(rig._refusal) == REFUSAL
    device.answering.set()
    until(lambda: rig.at_rest)
    steps = np.diff(device.sent[device.sent.index(FORCE) :])
    assert device.sent[-1] == 0.0
    assert np.abs(steps).max() < FORCE * np.pi / 2 / 250 * 1.01 * (1 + device.missed), "the ramp"
    assert device.safe
    assert device.closed
    assert rig.exit_code is None, "an answer after the reset is no error"
    assert rig.safety.state is State.UNCONFIGURED, rig.safety.cause


def test_a_device_that_does_not_open_is_given_up_and_one_that_opens_later_is_closed(rig_file, monkeypatch):
    monkeypatch.setattr(device_module, "OPEN_TIME", 0.05)
    opens, done = threading.Event(), []

    class Hanging(SimulatedRig):
        def open(self):
            opens.wait(20)

        def make_safe(self):
            done.append("safe")

        def close(self):
            done.append("closed")

    with pytest.raises(DeviceError, match=r"the device has not opened within 0\.05 s"):
        open_device(Hanging(rig_file, 1, by_the_clock=True))
    assert not done
    opens.set()
    until(lambda: done == ["safe", "closed"])


def test_a_device_that_raises_what_nobody_foresaw_while_it_opens_is_made_safe_and_closed(rig_file):
    done = []

    class Broken(SimulatedRig):
        def open(self):
            raise RuntimeError("no driver")

        def make_safe(self):
            done.append("safe")

        def close(self):
            done.append("closed")

    with pytest.raises(RuntimeError, match="no driver"):
        open_device(Broken(rig_file, 1, by_the_clock=True))
    assert done == ["safe", "closed"]
