# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that answer the rig's samples: with brace forces, or with accelerations of the table.

It drops old samples, commands zero while the rig is stopped, reports a fault if the rig stops publishing, and latches
the node's own faults until a person clears them.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from abrace_core.errors import AbraceError
from abrace_core.node import KEPT_STREAM_QOS, AbraceLifecycleNode
from abrace_core.node.conventions import clearing
from abrace_core.safety.answering import DROP, Answering
from abrace_core.safety.rig_safety import ACTING
from abrace_core.wire import Responses
from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.node import Parameter
    from abrace_core.wire import Head

WATCH_PERIOD = 0.02
"""Seconds between checks whether the rig has stopped publishing."""


class Commander(AbraceLifecycleNode):
    """Answers each Response while active, and after that until its commands are at rest."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        super().__init__(name, table)
        self.remedy = clearing(self)
        self.answering = Answering()
        self.safety = self.answering.safety
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
        `Answering.receive`, never DROP.
        """
        raise NotImplementedError

    def activate(self) -> None:
        """Answer from the next sample on."""
        self.answering.activate()

    def come_to_rest(self) -> None:
        """Bring the commands to rest; after that no sample is answered."""
        self.safety.deactivate()
        silent = self.answering.silent(time.monotonic())
        if silent or not any(output.moving for output in self.safety.outputs):
            self.safety.rest()

    @property
    def at_rest(self) -> bool:
        """Whether all commands are zero and no ramp is in progress."""
        return self.safety.at_rest

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
        lost = self.answering.receive(stamp, head, cause, time.monotonic())
        if lost != DROP:
            self.answer(stamp, head, z, lost)
        self.report_fault(self.fault)

    def _look_for_silence(self) -> None:
        if self.active:
            with self.lock:
                self.answering.look_for_silence(time.monotonic())
            self.report_fault(self.fault)

    def on_clear_fault(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the latched fault; the next sample is treated as the first one."""
        with self.lock:
            try:
                response.message = f"cleared: {self.safety.clear()}"
                response.success = True
                self.answering.begin_anew()
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
        if not self.active:
            return "not active"
        return f"held: {self.answering.held}" if self.answering.held else self.safety.state.words

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        if not self.configured:
            return self.fault, "not configured", {}
        watch = self.answering.watch
        values: dict[str, object] = {
            "sequence": watch.sequence,
            "lost": watch.missing,
            "old": watch.old,
            "state": self.safety.state.words,
        }
        return self.fault, self.status, values
