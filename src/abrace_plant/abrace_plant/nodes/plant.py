"""The node `plant`: a simulated rig with exactly the topics of the real one."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from abrace_core.errors import AbraceError
from abrace_core.node import AbraceLifecycleNode, Parameter, find_file, run
from abrace_core.node.conventions import DISPLAY_PERIOD, KEPT_STREAM_QOS, STREAM_QOS, TRANSIENT_LOCAL_QOS, clearing
from abrace_core.wire import BraceCommands, Responses, unpack_acceleration
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.live.loop import COMMAND, GROUND, RigLoop
from abrace_plant.live.schedule import Schedule
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.robot_description import joint_names, urdf

PARAMETERS = [
    Parameter("rig", "ncree_three_storey", "rig: a name in the package's configuration or a file", required=True),
    Parameter("disconnected_braces", [], "disconnected brace groups (1 the first); all: bare frame", element=int),
    Parameter("seed", 0, "seed of the sensor noise", minimum=0),
    Parameter(
        "sensor_faults",
        [],
        "failed channels, as a2=stuck, x3=zero, f=noise@20.0 (from second 20 on)",
        element=str,
        live=True,
    ),
    Parameter("duration", 0.0, "seconds to run, then end; 0: until stopped", minimum=0.0),
    Parameter("command_timeout", 0.02, "seconds that an input may be missing while it is not zero", minimum=0.002),
    Parameter("lockstep", False, "sample as soon as every input of wait_for has answered, not by the clock"),
    Parameter(
        "wait_for",
        [COMMAND],
        "inputs whose answers lockstep waits for",
        choices=(COMMAND, GROUND),
        required=True,
    ),
    Parameter("lockstep_timeout", 10.0, "seconds without an answer that end a lockstep run", minimum=0.1),
]


class Plant(AbraceLifecycleNode):
    """Samples the simulated rig, by the clock or in lockstep with its inputs."""

    loop: RigLoop
    pressed = False

    def __init__(self) -> None:
        super().__init__("plant", PARAMETERS)
        self.remedy = clearing(self)

    def configure(self) -> None:
        """Load the rig and create the topics."""
        given = self.parameters
        rig = load_rig(find_file(given.rig, "abrace_plant", "config", ".yaml", "rig"))
        self.rig = rig.disconnect(given.disconnected_braces)
        self.floors, self.groups = self.rig.floors, self.rig.groups
        self.response = self.publish_on(Response, "response", KEPT_STREAM_QOS)
        self.joint_states = self.create_publisher(JointState, "joint_states", 10)
        self.description = self.create_publisher(String, "robot_description", TRANSIENT_LOCAL_QOS)
        self.description.publish(String(data=urdf(self.rig)))
        self.clock_publisher = self.create_publisher(Clock, "clock", 10) if given.lockstep else None
        self.inputs = {
            COMMAND: self.subscribe_to(BraceCommand, COMMAND, self.on_command, STREAM_QOS, raw=True),
            GROUND: self.subscribe_to(AccelStamped, GROUND, self.on_ground_motion, STREAM_QOS, raw=True),
        }
        self.create_subscription(Bool, "emergency_stop", self.on_emergency_stop, TRANSIENT_LOCAL_QOS)
        self.create_service(Trigger, "~/clear_fault", self.on_clear_fault)
        self.responses, self.commands = Responses(), BraceCommands()
        self.joints = JointState(name=list(joint_names(self.rig)))
        self.reset()

    def reset(self) -> None:
        """Reset the rig to rest, before sample 0."""
        given = self.parameters
        self.loop = RigLoop(self.rig, given.seed, given.command_timeout)
        self.loop.set_sensor_faults(self.loop.sensor_faults(given.sensor_faults))
        start = 0 if given.lockstep else self.get_clock().now().nanoseconds
        self.schedule = Schedule(self.rig.sample_rate, start, time.monotonic(), given.duration)
        self.next_display = 0.0

    def activate(self) -> None:
        """Start at sample 0; a fault stays latched."""
        fault = self.loop.fault_reason
        self.reset()
        if fault is not None:
            self.loop.fault(fault)
        self.due = time.monotonic()

    def deactivate(self) -> None:
        """Stop sampling."""
        self.due = None

    def tick(self) -> None:
        """Take the sample that is due; in lockstep the first one, or end because an answer is missing."""
        if not self.parameters.lockstep:
            self.take_sample()
        elif self.loop.sequence < 0:
            matched = all(self.inputs[name].get_publisher_count() for name in self.parameters.wait_for)
            if matched and self.response.get_subscription_count() >= len(self.parameters.wait_for):
                self.take_sample()
            else:
                self.due = time.monotonic() + DISPLAY_PERIOD
        else:
            missing = [name for name in self.parameters.wait_for if not self.loop.answered(name)]
            self.due = None
            self.finish(
                1,
                f"no answer to sample {self.loop.sequence} on {', '.join(missing)} within "
                f"{self.parameters.lockstep_timeout:g} s (lockstep_timeout)",
            )

    def prepare_change(self, name: str, value: list[str]) -> Callable[[], None]:
        """New sensor faults act from the next sample on; before the rig is configured they are kept for it."""
        if not self.configured:
            return super().prepare_change(name, value)
        return partial(self.loop.set_sensor_faults, self.loop.sensor_faults(value))

    def take_sample(self) -> None:
        """Step the rig, publish its response, report a fault that is new, set when the next sample is due."""
        sample = self.loop.sample()
        if sample.sequence == 0:
            self.began = time.monotonic()
        reading, floors, groups = sample.reading.tolist(), self.floors, self.groups
        stamp = self.schedule.stamp(sample.sequence)
        payload = self.responses.pack(
            stamp,
            sample.sequence,
            displacement=reading[:floors],
            acceleration=reading[floors + groups : 2 * floors + groups],
            stroke=reading[floors : floors + groups],
            force=reading[2 * floors + groups : -1],
            command=sample.command.tolist(),
            ground_acceleration=reading[-1],
        )
        self.response.publish(payload)
        self.report_fault(self.loop.fault_reason)
        now = time.monotonic()
        if now >= self.next_display:
            self.next_display = now + DISPLAY_PERIOD
            self.joints.header.stamp = Time(sec=stamp // 10**9, nanosec=stamp % 10**9)
            self.joints.position = reading[:floors]
            self.joint_states.publish(self.joints)
            if self.clock_publisher is not None:
                self.clock_publisher.publish(Clock(clock=self.joints.header.stamp))
        if self.parameters.lockstep:
            self.due = now + self.parameters.lockstep_timeout
        elif self.schedule.is_last(sample.sequence):
            self.end(now)
        else:
            self.due = self.schedule.next_due(sample.sequence, now)

    def end(self, now: float) -> None:
        """End the run after the last sample, in lockstep after its answers."""
        self.due = None
        self.finish(0, f"done: {self.loop.sequence + 1} samples in {now - self.began:.2f} s")

    def on_command(self, payload: bytes) -> None:
        """Accept a command."""
        if self.active:
            try:
                self.loop.receive_command(*self.commands.unpack(payload))
            except AbraceError as error:
                self.loop.fault(str(error))
            self.advance()

    def on_ground_motion(self, payload: bytes) -> None:
        """Accept a ground acceleration."""
        if self.active:
            try:
                stamp, acceleration = unpack_acceleration(payload)
                self.loop.receive_ground_acceleration(self.schedule.sequence(stamp), acceleration)
            except AbraceError as error:
                self.loop.fault(str(error))
            self.advance()

    def advance(self) -> None:
        """In lockstep, take the next sample once every input of `wait_for` has answered."""
        if self.parameters.lockstep and self.due is not None and self.exit_code is None:
            for name in self.parameters.wait_for:
                if not self.loop.answered(name):
                    return
            if self.schedule.is_last(self.loop.sequence):
                self.end(time.monotonic())
            else:
                self.take_sample()

    def on_emergency_stop(self, message: Bool) -> None:
        """The emergency stop is pressed or released."""
        self.pressed = message.data
        if self.pressed:
            self.loop.fault("emergency stop")
            self.report_fault(self.loop.fault_reason)

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the latched fault."""
        with self.lock:
            reason = self.loop.fault_reason
            response.success = reason is not None and not self.pressed
            if response.success:
                self.loop.clear_faults()
        if response.success:
            response.message = f"cleared: {reason}"
            self.report_fault(self.loop.fault_reason)
        else:
            response.message = "emergency stop is still pressed" if reason else "no fault"
        return response

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        if not self.configured:
            return None, "not configured", {}
        values: dict[str, object] = {
            "sequence": self.loop.sequence,
            "behind": self.schedule.overruns,
            "held_up": round(self.schedule.shift, 3),
            **self.loop.counters(),
        }
        return self.loop.fault_reason, "running" if self.active else "not active", values


def main() -> int:
    """Entry point."""
    return run(Plant)
