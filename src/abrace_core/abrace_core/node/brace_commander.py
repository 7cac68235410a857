"""The node behind every node that commands braces: it answers each sample with a force that has passed the checks.

Like `node`, it imports rclpy. A subclass says what force it wants; this class sees to the rest: lost samples, the
guard, the emergency stop, faults that a person clears, and a smooth end when the node is deactivated.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace_core.errors import AbraceError
from abrace_core.latency import Latency
from abrace_core.node import KEPT_STREAM_QOS, LATCHED_QOS, AbraceLifecycleNode, Parameter
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.sample_watch import LONGEST_GAP, SampleWatch
from abrace_core.wire import BraceCommands, Responses
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

RAMP_TIME = 0.5
"""Seconds within which a fault, or the node's end, brings the force to zero."""

RATE_LIMIT = Parameter("rate_limit", 5.0e6, "N/s, greatest rate of the force of one brace", minimum=1.0)
DEACTIVATED, EMERGENCY_STOP = "deactivated", "emergency stop"


class BraceCommander(AbraceLifecycleNode):
    """Answers each Response with a BraceCommand while active."""

    guard: CommandGuard

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, [*table, RATE_LIMIT])

    def open_loop(self, sample_period: float, force_limit: Sequence[float], longest_gap: int = LONGEST_GAP) -> None:
        """Make guard and topics; called by the subclass's `configure`.

        `force_limit` [N] of each group; `longest_gap` is how many samples in a row may be lost without a fault.
        """
        rates = [self.parameters.rate_limit] * len(force_limit)
        self.guard = CommandGuard(force_limit, rates, sample_period, RAMP_TIME)
        self.watch = SampleWatch(sample_period, longest_gap)
        self.responses, self.commands = Responses(), BraceCommands()
        self.latency = Latency(sample_period)
        self.quiet = True
        self.stopped = False
        self.pressed = False
        self.publisher = self.publish_on(BraceCommand, "brace_command", KEPT_STREAM_QOS)
        self.subscribe_to(Response, "response", self.on_response, KEPT_STREAM_QOS, raw=True)
        self.create_subscription(Bool, "emergency_stop", self.on_emergency_stop, LATCHED_QOS)
        self.create_service(Trigger, "~/clear_fault", self.on_clear_fault)

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Begin anew with this sample, the first of a rig's run or after a fault; subclasses forget the past here."""
        raise NotImplementedError

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> NDArray[np.float64]:
        """The force wanted (groups,) [N] in answer to sample `sequence`; subclasses give it.

        `z` is [displacements, strokes, accelerations, forces], as measured; `lost` samples were lost just before.
        """
        raise NotImplementedError

    def acted(self, force: list[float]) -> None:
        """What the guard has left of the force wanted acts in answer to the sample; for subclasses that use it."""

    def activate(self) -> None:
        """Answer from the next sample on."""
        if self.guard.fault_reason == DEACTIVATED:
            self.guard.clear()
        if self.stopped:
            self.guard.fault(EMERGENCY_STOP)
        self.watch.sequence = -1

    def deactivate(self) -> None:
        """The force goes to zero; answers end when it is there."""
        self.guard.fault(DEACTIVATED)

    def on_response(self, payload: bytes) -> None:
        """Answer a sample."""
        if not self.active and self.quiet:
            return
        begin = time.perf_counter_ns()
        try:
            stamp, sequence, z = self.responses.unpack(payload)
        except AbraceError as error:
            self.guard.fault(str(error))
            return
        seen = self.watch.sequence >= 0
        lost = self.watch.take(sequence, stamp)
        if self.watch.problem:
            self.guard.fault(self.watch.problem)
        if lost < 0:
            if seen:
                self.guard.rest()
            self.restart(sequence, self.responses.floors, self.responses.groups)
        wanted = self.force(sequence, z, lost) if self.guard.fault_reason is None else None
        force = self.guard.check(wanted).tolist()
        self.publisher.publish(self.commands.pack(stamp, sequence, force))
        self.quiet = not any(force)
        self.latency.take(time.perf_counter_ns() - begin, time.time_ns() - stamp)
        if wanted is not None:
            self.acted(force)

    def on_emergency_stop(self, message: Bool) -> None:
        """Someone pressed the button, or released it."""
        self.pressed = message.data
        if self.pressed:
            self.stopped = True
            self.guard.fault(EMERGENCY_STOP)

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A person clears the latched fault; the next sample begins anew."""
        reason = self.guard.fault_reason
        refusal = "not active" if not self.active else "no fault" if reason is None else ""
        if self.pressed and not refusal:
            refusal = f"{EMERGENCY_STOP} is still pressed"
        response.success = not refusal
        response.message = refusal or f"cleared: {reason}"
        if response.success:
            self.stopped = False
            self.guard.clear()
            self.watch.sequence = -1
        return response

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `diagnostics`."""
        if not self.configured:
            return None, "not configured", {}
        values: dict[str, object] = {
            "sequence": self.watch.sequence,
            "lost": self.watch.missing,
            "saturations": self.guard.saturations,
            "rate_limits": self.guard.rate_limits,
            **self.latency.report(),
        }
        fault = self.guard.fault_reason
        if fault == DEACTIVATED:
            return None, DEACTIVATED, values
        return fault, "running" if self.active else "not active", values
