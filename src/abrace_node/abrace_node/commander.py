# SPDX-License-Identifier: Apache-2.0
"""The base classes of nodes that answer the rig's samples: with accelerations of the table, or with brace forces.

They drop old samples, answer one that a rig in lockstep says again as before, command zero while the rig is stopped,
report a fault if the rig stops publishing, and latch the node's own faults until a person clears them. A subclass of
`BraceCommander` computes the force; it is then checked and limited. A signal is played when a person asks for it
(`~/play`), in the run that is running then, and never again by itself.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from abrace_core import AbraceError
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import ACTING, RAMP_TIME
from abrace_core.safety.sample_gate import DROP, HOLD, RESTART, SampleGate
from abrace_core.safety.sample_watch import LONGEST_GAP
from abrace_core.safety.wire import LOCKSTEP, BraceCommands, Responses
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.latency import Latency
from abrace_node.lifecycle import AbraceLifecycleNode
from abrace_node.node import clearing
from abrace_node.parameters import Parameter
from abrace_node.transport import KEPT_STREAM_QOS, published_stream_qos

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray
    from rclpy.publisher import Publisher

    from abrace_core.safety.wire import Head

WATCH_PERIOD = 0.02
"""Seconds between checks whether the rig has stopped publishing."""

READY, PLAYING, OVER, CANCELLED = "ready", "playing", "over", "cancelled"
"""States of a signal, as reported."""

RATE_LIMIT = Parameter("rate_limit", 2.5e6, "N/s, greatest rate of the force of one brace", minimum=1.0)


class Commander(AbraceLifecycleNode):
    """Answers each Response while active, and after that until its commands are at rest."""

    signal = ""
    """State of the signal that a person starts; empty: the node plays none."""
    cancelled = ""
    """Why the signal was cancelled."""
    awaits_goal = False
    """Whether the node lets a rig in lockstep wait for the first goal of a run: so each run is the same."""
    publisher: Publisher
    """Of the answers; the subclass's `configure` creates it."""
    held_back: tuple[int, Head, tuple[float, ...], int] | None = None
    """The sample that is answered once there is a goal: arguments of `answer`."""
    answered = b""
    """The last answer."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, table)
        self.remedy = clearing(self)
        self.gate = SampleGate()
        self.safety = self.gate.safety
        self.responses = Responses()
        self.create_service(Trigger, "~/clear_fault", self.on_clear_fault)
        self.create_timer(WATCH_PERIOD, self._look_for_silence, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.keep_endpoints()

    def listen(self) -> None:
        """Subscribe to the rig; the subclass's `configure` calls it last."""
        self.responses = Responses()
        self.subscribe_to(Response, "response", self.on_response, KEPT_STREAM_QOS, raw=True)

    def answer(self, stamp: int, head: Head, z: tuple[float, ...], lost: int) -> None:
        """Publish the answer to a sample; implemented by subclasses.

        `stamp` [ns]; `z` is [displacements, strokes, accelerations, forces], as measured; `lost` is the value of
        `SampleGate.receive`, never DROP.
        """
        raise NotImplementedError

    def publish_answer(self, payload: bytes) -> None:
        """Publish the answer to a sample; `answer` calls it once."""
        self.answered = payload
        self.publisher.publish(payload)

    def play(self) -> None:
        """Begin the node's signal with the next sample, after `begin_goal`; implemented by subclasses that have one."""
        raise NotImplementedError

    def begin_goal(self) -> None:
        """Accept a person's goal: it begins in the run that is running now, and the end of that run ends it.

        Raises
        ------
        AbraceError
            If no command can act now, or a signal is playing.
        """
        if not self.active:
            raise AbraceError("not active")
        if self.signal == PLAYING:
            raise AbraceError("a signal is playing")
        self.gate.begin_goal(time.monotonic())
        self.signal, self.cancelled = PLAYING, ""

    def end_goal(self, cause: str) -> None:
        """Cancel the signal, if one plays."""
        if self.signal == PLAYING:
            self.signal, self.cancelled = CANCELLED, cause

    def activate(self) -> None:
        """Answer from the next sample on; a signal waits for a goal."""
        self.gate.activate()
        self.held_back = None
        if self.signal:
            self.signal, self.cancelled = READY, ""

    def protect(self, cause: str) -> None:
        """Latch a fault."""
        self.safety.fault(cause)
        self.reported_fault = self.fault

    def come_to_rest(self) -> None:
        """Bring the commands to rest; after that no sample is answered."""
        self.end_goal("the node was deactivated")
        self.safety.deactivate()
        self.answer_held_back()
        if self.gate.silent(time.monotonic()):
            self.let_go()
        elif not any(output.moving for output in self.safety.outputs):
            self.safety.rest()

    def let_go(self) -> None:
        """Take the commands as at rest: the rig, which has not been heard for a while, comes to rest by itself."""
        self.safety.rest()

    @property
    def at_rest(self) -> bool:
        """Whether all commands are zero and no ramp is in progress."""
        return self.safety.at_rest

    def until_at_rest(self) -> bool:
        """Wait for it: in lockstep, where the ramp takes as long as its samples do, while samples come."""
        while not super().until_at_rest():
            with self.lock:
                if self.gate.silent(time.monotonic()):
                    self.let_go()
            if not self.gate.lockstep or self.gate.silent(time.monotonic()):
                return self.at_rest
        return True

    def cleanup(self) -> None:
        """Give up the outputs; commands that still act are set to zero."""
        if not self.safety.at_rest:
            self.safety.deactivate()
            self.safety.rest()
        self.safety.clean_up()

    def on_response(self, payload: bytes) -> None:
        """Answer a sample."""
        if not self.active:
            return
        try:
            stamp, head, z = self.responses.unpack(payload)
            cause = "" if head.state in ACTING else self.responses.cause(payload)
        except AbraceError as error:
            self.safety.fault(str(error))
            return
        watch = self.gate.watch
        if head.flags & LOCKSTEP and (head.run, head.sequence) == (watch.run, watch.sequence):
            if self.held_back is None and self.answered:  # it may have been lost
                self.publish_answer(self.answered)
            return
        lost = self.gate.receive(stamp, head, cause, time.monotonic())
        if lost in (HOLD, RESTART) or self.safety.cause:
            self.end_goal(self.safety.cause or cause or self.gate.held or "the run of the rig has ended")
        if lost != DROP:
            self.held_back = stamp, head, z, lost
            if not (self.awaits_goal and self.gate.awaits_goal):
                self.answer_held_back()
        self.report_fault(self.fault)

    def answer_held_back(self) -> None:
        """Answer the sample that has not been answered, if there is one."""
        sample, self.held_back = self.held_back, None
        if sample is not None:
            self.answer(*sample)

    def _look_for_silence(self) -> None:
        if self.active:
            with self.lock:
                self.gate.look_for_silence(time.monotonic())
                if self.safety.cause:
                    self.end_goal(self.safety.cause)
            self.report_fault(self.fault)

    def on_play(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Play the node's signal once."""
        with self.lock:
            try:
                if not self.active:
                    raise AbraceError("not active")
                self.play()
                response.success, response.message = True, "playing"
                self.answer_held_back()
            except AbraceError as error:
                response.message = f"not played: {error}"
        return response

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the latched fault; the next sample is treated as the first one."""
        with self.lock:
            try:
                response.message = f"cleared: {self.safety.clear()}"
                response.success = True
                self.gate.begin_anew()
            except AbraceError as error:
                response.message = str(error)
        self.report_fault(self.fault)
        return response

    @property
    def fault(self) -> str | None:
        """The latched fault, if any."""
        return self.safety.cause or None

    @property
    def status(self) -> str:
        """The node's state, for its diagnostics."""
        if self.signal == CANCELLED:
            return f"cancelled: {self.cancelled}; ~/play plays it again"
        if not self.active:
            return "not active"
        if self.gate.watch.run < 0:
            return "no sample of a rig has come yet"
        return f"commands do not act: {self.gate.held}" if self.gate.held else self.safety.state.words

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        if not self.configured:
            return self.fault, "not configured", {}
        watch = self.gate.watch
        values: dict[str, object] = {
            "sequence": watch.sequence,
            "lost": watch.missing,
            "old": watch.old,
            "state": self.safety.state.words,
        }
        if self.signal:
            values["signal"] = self.signal
        return self.fault, self.status, values


class BraceCommander(Commander):
    """Answers each Response with a BraceCommand while active."""

    guard: CommandGuard
    size = 0, 0
    """Floors and brace groups of the rig at the last restart."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, [*table, RATE_LIMIT])

    def create_topics(self, sample_period: float, force_limit: Sequence[float], longest_gap: int = LONGEST_GAP) -> None:
        """Create the topics and their command guard; the subclass's `configure` calls it.

        `sample_period` [s]; `force_limit` [N] of each group; more than `longest_gap` samples lost in a row are a fault.
        """
        rates = [self.parameters.rate_limit] * len(force_limit)
        self.guard = CommandGuard(force_limit, rates, sample_period, RAMP_TIME, "parameter rate_limit")
        self.gate.configure([self.guard], sample_period, longest_gap)
        self.commands = BraceCommands()
        self.latency = Latency(sample_period)
        self.publisher = self.publish_on(BraceCommand, "brace_command", published_stream_qos())
        self.listen()

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Reset to this sample: the first of a run, or after a fault or stop; subclasses reset their state here."""
        raise NotImplementedError

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> NDArray[np.float64]:
        """The force to command (groups,) [N] in answer to sample `sequence`; subclasses compute it.

        `z` is [displacements, strokes, accelerations, forces], as measured; `lost` samples were lost just before.
        """
        raise NotImplementedError

    def acted(self, force: list[float]) -> None:
        """Override to use the `force` (groups,) [N] that was published, after the limits."""

    def answer(self, stamp: int, head: Head, z: tuple[float, ...], lost: int) -> None:
        """Answer a sample."""
        begin = time.perf_counter_ns()
        safety, wanted = self.safety, None
        size = self.responses.floors, self.responses.groups
        if lost == RESTART:
            self.size = size
            self.restart(head.sequence, *size)
        elif lost != HOLD and size != self.size:
            safety.fault(f"sample {head.sequence}: floors and brace groups {size}, expected {self.size} as before")
        if safety.acting and lost != HOLD:
            wanted = self.force(head.sequence, z, max(lost, 0)).tolist()
        safety.act([wanted])
        force = self.guard.value
        self.publish_answer(self.commands.pack(stamp, head.run, head.sequence, force, safety.cause))
        self.latency.add(time.perf_counter_ns() - begin, time.time_ns() - stamp)
        if wanted is not None:
            self.acted(force)

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        fault, message, values = super().diagnose()
        if self.configured:
            values.update(
                saturations=self.guard.saturations, rate_limits=self.guard.rate_limits, **self.latency.report()
            )
        return fault, message, values
