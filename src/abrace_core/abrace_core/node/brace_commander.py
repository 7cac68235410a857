"""The base of every node that commands braces: it answers each sample with a force that has passed the checks.

A subclass computes the force; this class does the rest: lost samples, the command guard, the emergency stop, latched
faults that a person clears, and the ramp to zero when the node is deactivated.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace_core.errors import AbraceError
from abrace_core.latency import Latency
from abrace_core.node import KEPT_STREAM_QOS, TRANSIENT_LOCAL_QOS, AbraceLifecycleNode, Parameter
from abrace_core.node.conventions import clearing
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.sample_watch import LONGEST_GAP, SampleWatch
from abrace_core.wire import BraceCommands, Responses
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

RAMP_TIME = 0.5
"""Seconds within which a fault, or a deactivation, brings the force to zero."""

RATE_LIMIT = Parameter("rate_limit", 5.0e6, "N/s, greatest rate of the force of one brace", minimum=1.0)
DEACTIVATED, EMERGENCY_STOP = "deactivated", "emergency stop"


class BraceCommander(AbraceLifecycleNode):
    """Answers each Response with a BraceCommand while active."""

    guard: CommandGuard

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, [*table, RATE_LIMIT])
        self.remedy = clearing(self)

    def create_topics(self, sample_period: float, force_limit: Sequence[float], longest_gap: int = LONGEST_GAP) -> None:
        """Create the topics, the service and their command guard; the subclass's `configure` calls it.

        `sample_period` [s]; `force_limit` [N] of each group; more than `longest_gap` samples lost in a row are a fault.
        """
        rates = [self.parameters.rate_limit] * len(force_limit)
        self.guard = CommandGuard(force_limit, rates, sample_period, RAMP_TIME)
        self.watch = SampleWatch(sample_period, longest_gap)
        self.responses, self.commands = Responses(), BraceCommands()
        self.latency = Latency(sample_period)
        self.at_zero = True
        self.stop_latched = False
        self.stop_pressed = False
        self.publisher = self.publish_on(BraceCommand, "brace_command", KEPT_STREAM_QOS)
        self.subscribe_to(Response, "response", self.on_response, KEPT_STREAM_QOS, raw=True)
        self.create_subscription(Bool, "emergency_stop", self.on_emergency_stop, TRANSIENT_LOCAL_QOS)
        self.create_service(Trigger, "~/clear_fault", self.on_clear_fault)

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Reset to this sample, the first of a run of the rig or after a fault; subclasses reset their state here."""
        raise NotImplementedError

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> NDArray[np.float64]:
        """The force to command (groups,) [N] in answer to sample `sequence`; subclasses compute it.

        `z` is [displacements, strokes, accelerations, forces], as measured; `lost` samples were lost just before.
        """
        raise NotImplementedError

    def acted(self, force: list[float]) -> None:
        """Override to use the `force` (groups,) [N] that was published, after the limits."""

    def activate(self) -> None:
        """Answer from the next sample on."""
        if self.guard.fault_reason == DEACTIVATED:
            self.guard.clear()
        if self.stop_latched:
            self.guard.fault(EMERGENCY_STOP)
        self.watch.sequence = -1

    def deactivate(self) -> None:
        """Bring the force to zero; the answers end when it is zero."""
        self.guard.fault(DEACTIVATED)

    def on_response(self, payload: bytes) -> None:
        """Answer a sample."""
        if not self.active and self.at_zero:
            return
        begin = time.perf_counter_ns()
        try:
            stamp, sequence, z = self.responses.unpack(payload)
        except AbraceError as error:
            self.guard.fault(str(error))
            return
        running = self.watch.sequence >= 0
        lost = self.watch.update(sequence, stamp)
        if self.watch.problem:
            self.guard.fault(self.watch.problem)
        if lost < 0:
            if running:
                self.guard.reset_force()
            self.restart(sequence, self.responses.floors, self.responses.groups)
        wanted = self.force(sequence, z, lost) if self.guard.fault_reason is None else None
        force = self.guard.check(wanted).tolist()
        self.publisher.publish(self.commands.pack(stamp, sequence, force))
        self.at_zero = not any(force)
        self.latency.add(time.perf_counter_ns() - begin, time.time_ns() - stamp)
        if wanted is not None:
            self.acted(force)
        self.report_fault(self.fault)

    def on_emergency_stop(self, message: Bool) -> None:
        """The emergency stop is pressed or released."""
        self.stop_pressed = message.data
        if self.stop_pressed:
            self.stop_latched = True
            self.guard.fault(EMERGENCY_STOP)
            self.report_fault(self.fault)

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the latched fault; the next sample is a first one."""
        with self.lock:
            reason = self.guard.fault_reason
            refusal = "not active" if not self.active else "no fault" if reason is None else ""
            if self.stop_pressed and not refusal:
                refusal = f"{EMERGENCY_STOP} is still pressed"
            if not refusal:
                self.stop_latched = False
                self.guard.clear()
                self.watch.sequence = -1
        response.success = not refusal
        response.message = refusal or f"cleared: {reason}"
        self.report_fault(self.fault)
        return response

    @property
    def fault(self) -> str | None:
        """The latched fault, if any; to be deactivated is none."""
        reason = self.guard.fault_reason
        return None if reason == DEACTIVATED else reason

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        if not self.configured:
            return None, "not configured", {}
        values: dict[str, object] = {
            "sequence": self.watch.sequence,
            "lost": self.watch.missing,
            "saturations": self.guard.saturations,
            "rate_limits": self.guard.rate_limits,
            **self.latency.report(),
        }
        if self.guard.fault_reason == DEACTIVATED:
            return None, DEACTIVATED, values
        return self.fault, "running" if self.active else "not active", values
