# SPDX-License-Identifier: Apache-2.0
"""Which samples a node answers with a command: old ones are dropped, and it commands zero while the rig is stopped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import STOPPED, RigSafety, State
from abrace_core.safety.sample_watch import LONGEST_GAP, NEW_RUN, OLD, SampleWatch
from abrace_core.safety.wire import LAST, LOCKSTEP

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace_core.safety.rig_safety import Output
    from abrace_core.safety.wire import Head

RESPONSE_TIMEOUT = 0.1
"""Seconds without a sample, of a rig that runs in real time, after which there is a fault."""

DROP, HOLD, RESTART = -3, -2, -1
"""Actions on a sample: ignore it; answer with zero; restart with this sample."""


def _stopped(state: int, cause: str) -> str:
    """Why a rig in a `state` lets no command act, as text: `rig in protective stop (pressed by panel)`."""
    words = State(state).words if state in State._value2member_map_ else f"state {state}"
    preposition = "in " if state in (State.STANDBY, State.PROTECTIVE_STOP) or words.startswith("state") else ""
    if state == State.PROTECTIVE_STOP:
        cause = cause.removeprefix(STOPPED)
    return f"rig {preposition}{words}" + (f" ({cause})" if cause else "")


class SampleGate:
    """Decides which samples a node answers, and with what.

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
    goal_run
        Run in which a person's goal was accepted last; -1: none.
    """

    goal_run = -1

    def __init__(self) -> None:
        self.safety = RigSafety()
        self.held = self.cause = ""
        self._heard: float | None = None
        self._last_received = -math.inf
        self._flags, self._state = LAST, State.UNCONFIGURED.value

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
        self.safety.configure(outputs, sample_period, fade_time=0.0)
        self._moving = moving or (lambda: any(output.moving for output in outputs))
        self.watch = SampleWatch(sample_period, longest_gap)

    def activate(self) -> None:
        """Answer from the next sample on; an AbraceError gives the reason for a refusal."""
        self.safety.activate()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Treat the next sample as the first one, after `activate` or `clear`: the rig has the target and the fade."""
        self.safety.begin()
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
        self._last_received, self._flags, self._state = now, head.flags, head.state
        self._heard = None if head.flags & (LOCKSTEP | LAST) else now
        if self.watch.problem and self._moving():
            self.safety.fault(self.watch.problem)
        self.cause = cause
        if head.state != State.RUNNING:
            self.held = _stopped(head.state, cause)
            self.safety.rest()
            return HOLD
        if lost == NEW_RUN:
            self.safety.rest()
        elif not self.held and (not self.watch.problem or self.safety.cause):
            return lost
        self.held = ""
        return RESTART

    def begin_goal(self, now: float) -> None:
        """Accept a person's goal in the run that is running now; `now` as for `receive`. HOLD or RESTART ends the goal.

        Raises
        ------
        AbraceError
            If no run is running, with the reason.
        """
        reason = self.safety.cause or self.held
        if not reason and (self.watch.run < 0 or (self.silent(now) and not self.lockstep)):
            reason = "no rig is running"
        elif not reason and self._state != State.RUNNING:
            reason = _stopped(self._state, "")
        elif not reason and not self.safety.acting:
            reason = f"the node's commands are {self.safety.state.words}"
        if reason:
            raise AbraceError(reason)
        self.goal_run = self.watch.run

    @property
    def awaits_goal(self) -> bool:
        """Whether the rig runs in lockstep, and no goal has been accepted in this run."""
        return self.lockstep and self._state == State.RUNNING and self.goal_run != self.watch.run

    @property
    def lockstep(self) -> bool:
        """Whether the last sample was one of a rig in lockstep."""
        return bool(self._flags & LOCKSTEP)

    def silent(self, now: float) -> bool:
        """Whether no sample has come for RESPONSE_TIMEOUT; `now` as for `receive`."""
        return now - self._last_received > RESPONSE_TIMEOUT

    def look_for_silence(self, now: float) -> None:
        """Report a fault if a rig that runs in real time has stopped publishing; `now` as for `receive`."""
        if self._heard is not None and now - self._heard > RESPONSE_TIMEOUT:
            self._heard = None
            self.safety.fault(f"no response for more than {RESPONSE_TIMEOUT:g} s")
            self.safety.rest()
