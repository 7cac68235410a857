# SPDX-License-Identifier: Apache-2.0
"""The base class of rig nodes: the simulated rig, and hardware behind the bridge."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from abrace_core import AbraceError, RunFailed
from abrace_core.files.installed import find_file
from abrace_core.safety.rig_safety import REST_TIME, RigSafety, State
from abrace_core.safety.stop_senders import UNNAMED
from abrace_core.safety.table_stop import LONGEST
from abrace_core.safety.wire import BraceCommands, Responses, unpack_acceleration
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node import real_time
from abrace_node.lifecycle import REST_MARGIN, AbraceLifecycleNode
from abrace_node.node import DISPLAY_PERIOD, clearing, what_and_where
from abrace_node.parameters import Parameter
from abrace_node.stop_listener import StopListener
from abrace_node.transport import LOCKSTEP_STREAM_QOS, STREAM_QOS, TRANSIENT_LOCAL_QOS, published_stream_qos
from abrace_plant.devices.device import open_device
from abrace_plant.live.loop import COMMAND, GROUND, RigLoop, rig_outputs
from abrace_plant.live.real_time import RealTimeRun
from abrace_plant.live.rest import slowest_period
from abrace_plant.rig.detectors import missing_sensors
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.robot_description import joint_names, urdf

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_plant.devices.device import Device
    from abrace_plant.live.loop import Sample
    from abrace_plant.rig.model import Rig

STOP_PERIOD = 0.01
"""Seconds between searches for stop buttons."""

PEAKS = ("drift", "displacement", "acceleration", "force", "table_displacement")
"""Interlocks whose greatest values so far are in the diagnostics, in SI units."""

RIG = "ncree_three_storey"
"""The rig that runs where no other is named."""

RIG_PARAMETERS = [
    Parameter("rig", RIG, "rig: a name in the package's configuration or a file", required=True),
    Parameter("duration", 0.0, "seconds to run, then end; 0: until stopped", minimum=0.0),
]


def time_limits(longest_timeout: float, most_late: int) -> list[Parameter]:
    """The parameters of a rig's time limits, with their greatest values: seconds and samples."""
    return [
        Parameter(
            "command_timeout",
            0.02,
            "seconds without an input while force or table act; longer is a fault",
            minimum=0.002,
            maximum=longest_timeout,
        ),
        Parameter(
            "late_limit",
            10,
            "samples in a row that may be late or missed; more are a fault",
            minimum=1,
            maximum=most_late,
        ),
    ]


class RigNode(AbraceLifecycleNode):
    """Publishes the samples of a rig, and lets commands act as far as its safety allows."""

    rig: Rig
    device: Device
    loop: RigLoop | None = None
    run: RealTimeRun | None = None
    """Run by the clock; None: its thread has made the device safe and closed it, or there was none."""
    lockstep = False

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, [*RIG_PARAMETERS, *table])
        self.remedy = clearing(self)
        self.safety = RigSafety()
        self.run_number = 0
        self.create_service(Trigger, "~/clear_fault", self.on_clear_fault)
        self.stops = StopListener(self, self.parameters.stop_heartbeat)
        self.create_timer(STOP_PERIOD, self.poll_stops, clock=RosClock(clock_type=ClockType.STEADY_TIME))
        self.keep_endpoints()

    def destroy_node(self) -> None:
        """Destroy the node, with its subscriptions to the stop buttons."""
        self.stops.close()
        super().destroy_node()

    def make_device(self) -> Device:
        """The device of this run; subclasses make it. An AbraceError refuses the activation."""
        raise NotImplementedError

    def load(self) -> Rig:
        """The rig of the parameters; an AbraceError refuses the configuration."""
        return load_rig(find_file(self.parameters.rig, "abrace_plant", "config", ".yaml", "rig"))

    def configure(self) -> None:
        """Load the rig and create the topics."""
        self.refuse_during_run()
        self.rig = self.load()
        if missing := missing_sensors(self.rig):
            self.get_logger().warning(f"rig {self.rig.name}: {missing}")
        self.ramp_time = LONGEST + REST_TIME + slowest_period(self.rig)  # after a fault rest is measured, too
        self.safety.configure(rig_outputs(self.rig), 1 / self.rig.sample_rate)
        self.response = self.publish_on(
            Response, "response", LOCKSTEP_STREAM_QOS if self.lockstep else published_stream_qos()
        )
        self.joint_states = self.create_publisher(JointState, "joint_states", published_stream_qos(depth=10))
        self.description = self.create_publisher(String, "robot_description", TRANSIENT_LOCAL_QOS)
        self.description.publish(String(data=urdf(self.rig)))
        self.clock_publisher = self.create_publisher(Clock, "clock", 10) if self.lockstep else None
        self.inputs = {
            COMMAND: self.subscribe_to(BraceCommand, COMMAND, self.on_command, STREAM_QOS, raw=True),
            GROUND: self.subscribe_to(AccelStamped, GROUND, self.on_ground_motion, STREAM_QOS, raw=True),
        }
        self.responses, self.commands = Responses(), BraceCommands()
        Interlocks(self.rig)  # loads compiled functions for half a second, before the activation
        self.joints = JointState(name=list(joint_names(self.rig)))
        self.shown = [i for i in range(self.rig.floors) if f"x{i + 1}" in self.rig.channel_names]

    def activate(self) -> None:
        """Begin a run at sample 0, from rest."""
        self.refuse_during_run()
        given, rig = self.parameters, self.rig
        self.device = self.make_device()
        self.safety.activate()
        if not self.lockstep:
            try:
                open_device(self.device)
            except BaseException:
                self.safety.deactivate()
                raise
        # later runs have greater numbers, also those of a restarted node
        self.run_number = max(self.run_number + 1, time.time_ns())
        self.loop = RigLoop(
            rig, self.device, self.safety, given.command_timeout, given.late_limit, self.run_number, self.lockstep
        )
        self.last_sequence = max(1, round(given.duration * rig.sample_rate)) - 1 if given.duration else -1
        self.next_display = 0.0
        self.done = False
        if not self.lockstep:
            self.run = RealTimeRun(
                self.loop,
                self.device,
                1 / rig.sample_rate,
                self.lock,
                self.catching(self.on_tick),
                self.run_over,
                self.catching(self.prepare),
            )
            self.run.start()

    def refuse_during_run(self) -> None:
        """Raise an AbraceError while the former run still uses its device and the safety."""
        if self.run is not None:
            raise AbraceError("the device of the former run has not answered yet, expected that run to be over")

    def prepare(self) -> None:
        """Called in the thread of a run by the clock before its first sample."""
        real_time.above_the_loops(self.parameters)

    def protect(self, cause: str) -> None:
        """Latch a fault."""
        self.safety.fault(cause)
        self.reported_fault = self.safety.cause or None

    def come_to_rest(self) -> None:
        """Bring braces and table to rest; the run ends with the first sample at which they are."""
        assert self.loop is not None
        if self.loop.ending:
            return
        self.safety.deactivate()
        self.loop.ending = True
        while self.lockstep and not self.loop.ended and self.safety.state is not State.NOT_AT_REST:
            self.catching(self.publish_sample)(self.loop.step())

    @property
    def at_rest(self) -> bool:
        """Whether the run is over; one by the clock is when its device has been made safe and closed."""
        if self.lockstep:
            return self.loop is None or self.loop.ended
        return self.run is None

    def stay_active(self) -> None:
        """The run goes on: the rig has not come to rest, or its device has not been made safe."""
        assert self.loop is not None
        self.loop.ending = False
        self.safety.stay_active(f"not at rest {self.ramp_time + REST_MARGIN:.1f} s after the deactivation")

    def ended_before_rest(self) -> None:
        """End with code 1: the device has not been made safe."""
        self.finish(1, f"not at rest after {self.ramp_time + REST_MARGIN:.1f} s: the device was not made safe")

    def deactivate(self) -> None:
        """The run is over."""
        self.due = None

    def cleanup(self) -> None:
        """Give up the outputs; where a run has not come to rest yet, when it has: nothing steps to zero."""
        if self.run is not None:
            assert self.loop is not None
            self.loop.ending = self.loop.give_up = True
            if self.safety.acting:
                self.safety.deactivate()
            return
        if self.safety.acting or self.safety.state is State.RAMPING_DOWN:  # in lockstep, where nothing real moves
            self.safety.deactivate()
            self.safety.rest()
        self.safety.clean_up()

    def run_over(self) -> None:
        """A run by the clock has ended, and its device is closed; called in its thread."""
        run, loop = self.run, self.loop
        assert run is not None
        assert loop is not None
        if run.errors:
            self.fail(RunFailed("; ".join(map(what_and_where, run.errors))))
        elif self.done:
            self.defer(lambda: self.finish_run(f"{loop.sequence + 1} samples, {loop.missed_deadlines} late answers"))
        with self.lock:
            self.run = None
            if not self.configured:
                self.cleanup()
        self.notify_rest()

    def finish_run(self, counts: str) -> None:
        """End after the last sample and report the counts; with code 1 while a fault is latched."""
        if self.safety.cause:
            self.finish(1, f"ended with a fault: {self.safety.cause}; {counts}")
        else:
            self.finish(0, f"done: {counts}")

    def on_tick(self, sample: Sample | None) -> None:
        """Publish a sample of a run by the clock, if the device has given one; end the run after its last tick."""
        if sample is not None:
            self.publish_sample(sample)
        assert self.loop is not None
        # the last sample itself may have been missed
        if self.configured and 0 <= self.last_sequence <= self.loop.sequence:
            self.done = self.loop.give_up = True
            self.come_to_rest()

    def publish_sample(self, sample: Sample) -> None:
        """Publish a sample, and report a fault that is new."""
        if not self.configured:
            return  # the device has answered after the clean-up, which has destroyed the topics
        rig, reading = self.rig, self.rig.as_in_message(sample.reading)
        floors, groups = rig.floors, rig.groups
        self.send(
            self.responses.pack(
                sample.stamp,
                sample.head,
                sample.cause,
                rig.braces_in_group,
                displacement=reading[:floors],
                acceleration=reading[floors + groups : 2 * floors + groups],
                stroke=reading[floors : floors + groups],
                force=reading[2 * floors + groups : -1],
                command=sample.command,
                ground_acceleration=reading[-1],
                table_displacement=sample.table,
            )
        )
        self.report_fault(sample.cause or None)
        now = time.monotonic()
        if now >= self.next_display:
            self.next_display = now + DISPLAY_PERIOD
            stamp = Time(sec=sample.stamp // 10**9, nanosec=sample.stamp % 10**9)
            self.defer(lambda: self.show(stamp, [reading[i] for i in self.shown]))

    def send(self, payload: bytes) -> None:
        """Publish a response."""
        self.response.publish(payload)

    def show(self, stamp: Time, displacement: list[float]) -> None:
        """Publish the joint states for viewers, and in lockstep the time."""
        if not self.configured:
            return  # the clean-up, which came meanwhile, has destroyed the topics
        self.joints.header.stamp = stamp
        self.joints.position = displacement
        self.joint_states.publish(self.joints)
        if self.clock_publisher is not None:
            self.clock_publisher.publish(Clock(clock=stamp))

    def on_command(self, payload: bytes) -> None:
        """Accept a command."""
        if self.active and self.loop is not None:
            try:
                self.loop.receive_command(*self.commands.unpack(payload))
            except AbraceError as error:
                self.safety.fault(str(error))
            self.on_input()

    def on_ground_motion(self, payload: bytes) -> None:
        """Accept a ground acceleration."""
        if self.active and self.loop is not None:
            try:
                self.loop.receive_ground_acceleration(*unpack_acceleration(payload))
            except AbraceError as error:
                self.safety.fault(str(error))
            self.on_input()

    def on_input(self) -> None:
        """An input has answered; called with the lock."""
        if self.run is not None:
            self.run.on_input()

    def poll_stops(self) -> None:
        """Take messages of the stop buttons."""
        who = self.stops.pressed_by()
        with self.lock:
            if self.loop is not None:
                self.loop.note_stops_polled()
            if who and who != self.safety.pressed:
                self.safety.press(who)
            elif not who and self.safety.pressed:
                self.safety.release()
        self.report_fault(self.safety.cause or None)

    def _log_fault(self, fault: str | None) -> None:
        """Log the fault, but not a stop once more whose sender's name has become known meanwhile."""
        if fault and self.reported_fault and UNNAMED in self.reported_fault:
            self.reported_fault = fault
        else:
            super()._log_fault(fault)

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the latched fault."""
        self.stops.forget_gone()
        self.poll_stops()
        with self.lock:
            try:
                moving = self.loop.moving() if self.active and self.loop is not None else ""
                response.message = f"cleared: {self.safety.clear(moving)}"
                response.success = True
            except AbraceError as error:
                response.message = str(error)
        self.report_fault(self.safety.cause or None)
        return response

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        fault = self.safety.cause or None
        if not self.configured:
            return fault, "not configured", {}
        values: dict[str, object] = {"state": self.safety.state.words}
        if self.safety.pressed:
            values["stop"] = self.safety.pressed
        if self.loop is not None:
            values |= {"sequence": self.loop.sequence, **self.loop.counters()}
            values |= {f"clipped {name}": count for name, count in self.loop.clipped.items() if count}
            utilisation, greatest = self.loop.interlocks.utilisation(), self.loop.interlocks.greatest()
            values |= {f"interlock {name}": f"{100 * share:.0f} % of its limit" for name, share in utilisation.items()}
            values |= {f"peak {name}": f"{greatest[name]:.4g}" for name in PEAKS if name in greatest}
            if warnings := [*filter(None, [self.loop.ticks.problem]), *map(str, self.loop.interlocks.warnings)]:
                values["warning"] = "; ".join(warnings)
        return fault, self.safety.state.words if self.active else "not active", values
