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
"""Seconds without a sample, of a rig that samples by the clock, that are a fault."""

DROP, HOLD, RESTART = -3, -2, -1
"""What to do about a sample: nothing; answer with zero; restart with this sample."""


def _words(state: int) -> str:
    return State(state).words if state in State._value2member_map_ else f"in state {state}"


class Answering:
    """The samples that a node answers, and what it may send.

    Attributes
    ----------
    safety
        Of what the node sends. It outlives every configuration.
    watch
        Of the samples.
    held
        Why the rig lets nothing act; empty: it does, or nothing is known of it.
    cause
        Of the rig's fault or stop; empty: none.
    """

    def __init__(self) -> None:
        self.safety = RigSafety()
        self.held = self.cause = ""
        self._heard: float | None = None
        self._last = -math.inf

    def configure(
        self,
        outputs: Sequence[Output],
        sample_period: float,
        longest_gap: int = LONGEST_GAP,
        moving: Callable[[], bool] | None = None,
    ) -> None:
        """Be ready to answer.

        Parameters
        ----------
        outputs
            What is sent.
        sample_period
            [s].
        longest_gap
            More lost samples in a row than these are a fault, while something is sent that is not zero.
        moving
            Whether something is; None: as the outputs have it.
        """
        self.safety.configure(outputs, sample_period)
        self._moving = moving or (lambda: any(any(output.value) for output in outputs))
        self.watch = SampleWatch(sample_period, longest_gap)

    def activate(self) -> None:
        """Begin with the next sample; an AbraceError says why that is refused."""
        self.safety.activate()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Take the next sample as the first one."""
        self.watch.restart()
        self.held = ""
        self._heard = None

    def receive(self, stamp: int, head: Head, cause: str, now: float) -> int:
        """What to do about a sample.

        Parameters
        ----------
        stamp
            Its sampling instant [ns].
        head
            The rig's state and flags in it.
        cause
            Of the rig's fault or stop.
        now
            On the monotonic clock [s].

        Returns
        -------
        int
            DROP, HOLD or RESTART, or the number of samples lost just before it: then answer it.
        """
        lost = self.watch.update(head.run, head.sequence, stamp)
        if lost == OLD:
            return DROP
        self._last = now
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
        """Whether no sample has come for RESPONSE_TIMEOUT, `now` being as for `receive`."""
        return now - self._last > RESPONSE_TIMEOUT

    def look_for_silence(self, now: float) -> None:
        """It is a fault if a rig that sampled in real time has stopped publishing; `now` as for `receive`."""
        if self._heard is not None and now - self._heard > RESPONSE_TIMEOUT:
            self._heard = None
            self.safety.fault(f"no response for more than {RESPONSE_TIMEOUT:g} s")
            self.safety.rest()
