# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that command braces: each sample is answered with a checked and limited force.

A subclass computes the force; this class and `Commander` do the rest.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from abrace_core.latency import Latency
from abrace_core.node import Parameter, published_stream_qos
from abrace_core.node.commander import Commander
from abrace_core.safety.answering import HOLD, RESTART
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_core.safety.sample_watch import LONGEST_GAP
from abrace_core.wire import BraceCommands
from abrace_interfaces.msg import BraceCommand

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace_core.wire import Head

RATE_LIMIT = Parameter("rate_limit", 5.0e6, "N/s, greatest rate of the force of one brace", minimum=1.0)


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
        self.answering.configure([self.guard], sample_period, longest_gap)
        self.commands = BraceCommands()
        self.latency = Latency(sample_period)
        self.publisher = self.publish_on(BraceCommand, "brace_command", published_stream_qos())
        self.listen()

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Reset to this sample: the first of a run, or after a fault or stop; subclasses reset their state here."""
        raise NotImplementedError

    def interrupt(self, cause: str) -> None:
        """Override to react to a fault or stop, of the rig or the node, with this `cause`: commands do not act."""

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
        if cause := safety.cause or self.answering.cause:
            self.interrupt(cause)
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
        self.publisher.publish(self.commands.pack(stamp, head.run, head.sequence, force, safety.cause))
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
