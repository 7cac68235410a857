# SPDX-License-Identifier: Apache-2.0
"""How a node answers each sample: it drops old samples, and commands zero while the rig is stopped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from abrace_core.safety.rig_safety import ACTING, RigSafety, State
from abrace_core.safety.sample_watch import LONGEST_GAP, NEW_RUN, OLD, SampleWatch
from abrace_core.wire import LAST, LOCKSTEP

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace_core.safety.rig_safety import Output
    from abrace_core.wire import Head

RESPONSE_TIMEOUT = 0.1
"""Seconds without a sample, of a rig that runs in real time, after which there is a fault."""

DROP, HOLD, RESTART = -3, -2, -1
"""Actions on a sample: ignore it; answer with zero; restart with this sample."""


def _words(state: int) -> str:
    return State(state).words if state in State._value2member_map_ else f"in state {state}"


class Answering:
    """Decides how a node answers each sample.

    Attributes
    ----------
    safety
        The state machine of the node's commands. It is kept when the node is configured again.
    watch
        Checks of the samples.
    held
        Why the rig keeps commands from acting; empty: they act, or no sample has come yet.
    cause
        Cause of the rig's fault or stop; empty: none.
    """

    def __init__(self) -> None:
        self.safety = RigSafety()
        self.held = self.cause = ""
        self._heard: float | None = None
        self._last = -math.inf
        self._flags = LAST

    def configure(
        self,
        outputs: Sequence[Output],
        sample_period: float,
        longest_gap: int = LONGEST_GAP,
        moving: Callable[[], bool] | None = None,
    ) -> None:
        """Prepare to answer.

        Parameters
        ----------
        outputs
            The node's commands with their limits.
        sample_period
            Sample period of the rig [s].
        longest_gap
            More lost samples in a row are a fault, while a command is not zero.
        moving
            Whether a command is not zero; None: taken from the outputs.
        """
        self.safety.configure(outputs, sample_period)
        self._moving = moving or (lambda: any(output.moving for output in outputs))
        self.watch = SampleWatch(sample_period, longest_gap)

    def activate(self) -> None:
        """Answer from the next sample on; an AbraceError gives the reason for a refusal."""
        self.safety.activate()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Treat the next sample as the first one."""
        self.watch.restart()
        self.held = ""
        self._heard = None

    def receive(self, stamp: int, head: Head, cause: str, now: float) -> int:
        """Decide how to answer a sample.

        Parameters
        ----------
        stamp
            Its sampling instant [ns].
        head
            Its run, number, and the rig's state and flags.
        cause
            Cause of the rig's fault or stop.
        now
            Monotonic time [s].

        Returns
        -------
        int
            DROP, HOLD or RESTART; otherwise the number of samples lost just before it, and the node answers it.
        """
        # a rig in lockstep may end without a last sample
        goes_on = self.watch.run >= 0 and not self._flags & (LAST | head.flags & LOCKSTEP) and not self.silent(now)
        lost = self.watch.update(head.run, head.sequence, stamp, goes_on)
        if lost == OLD:
            return DROP
        if lost == NEW_RUN and goes_on:
            self.safety.fault("a run began during another one: two rigs publish response, expected one")
        self._last, self._flags = now, head.flags
        self._heard = None if head.flags & (LOCKSTEP | LAST) else now
        if self.watch.problem and self._moving():
            self.safety.fault(self.watch.problem)
        self.cause = cause
        if head.state not in ACTING:
            self.held = f"the rig is {_words(head.state)}" + (f": {cause}" if cause else "")
            self.safety.rest()
            return HOLD
        if lost == NEW_RUN:
            self.safety.rest()
        elif not self.held and (not self.watch.problem or self.safety.cause):
            return lost
        self.held = ""
        return RESTART

    def silent(self, now: float) -> bool:
        """Whether no sample has come for RESPONSE_TIMEOUT; `now` as for `receive`."""
        return now - self._last > RESPONSE_TIMEOUT

    def look_for_silence(self, now: float) -> None:
        """Report a fault if a rig that runs in real time has stopped publishing; `now` as for `receive`."""
        if self._heard is not None and now - self._heard > RESPONSE_TIMEOUT:
            self._heard = None
            self.safety.fault(f"no response for more than {RESPONSE_TIMEOUT:g} s")
            self.safety.rest()
