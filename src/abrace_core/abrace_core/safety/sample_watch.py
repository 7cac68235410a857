# SPDX-License-Identifier: Apache-2.0
"""Checks of the stream of samples that a node answers: old and lost samples, a new run of the rig, a wrong rate."""

from __future__ import annotations

from collections import deque

LONGEST_GAP = 5
"""Lost samples in a row that a node bridges by default; more are a fault."""

NEW_RUN, OLD = -1, -2
"""What `SampleWatch.update` returns instead of a number of lost samples."""

_RATE_SAMPLES, _RATE_TOLERANCE = 50, 0.3
"""Samples over which the rate is checked, since a stamp is when the sample really was taken; and its greatest error."""
_KEPT_RUNS = 1000
"""Runs that are remembered as old."""


class SampleWatch:
    """Checks each sample's run, number and stamp.

    Parameters
    ----------
    sample_period
        Expected [s].
    longest_gap
        Lost samples in a row that the node bridges.

    Attributes
    ----------
    run, sequence
        Of the last sample that was not old; -1: none yet.
    missing
        Samples that were lost, in all runs.
    old
        Samples that were dropped: repeated, late, or of an earlier run.
    problem
        Why the last sample is a fault; None: it is not.
    """

    def __init__(self, sample_period: float, longest_gap: int = LONGEST_GAP) -> None:
        self._longest_gap = longest_gap
        self._period = sample_period * 1e9
        self._earlier: deque[int] = deque(maxlen=_KEPT_RUNS)
        self._rate_from: tuple[int, int] | None = None
        self.run = self.sequence = -1
        self.missing = self.old = 0
        self.problem: str | None = None

    def update(self, run: int, sequence: int, stamp: int) -> int:
        """Check the next sample.

        Parameters
        ----------
        run
            Number of the rig's run.
        sequence
            Its number in this run.
        stamp
            Its sampling instant [ns].

        Returns
        -------
        int
            Samples lost just before it; NEW_RUN if it is the first one of a run; OLD if it is to be dropped.
        """
        if run != self.run:
            if run in self._earlier:
                self.old += 1
                return OLD
            if self.run >= 0:
                self._earlier.append(self.run)
            self.run, self.sequence, self.problem = run, sequence, None
            self._rate_from = None
            return NEW_RUN
        if sequence <= self.sequence:
            self.old += 1
            return OLD
        lost = sequence - self.sequence - 1
        self.sequence = sequence
        self.missing += lost
        self.problem = None
        if lost > self._longest_gap:
            self.problem = f"{lost} samples lost before sample {sequence}, at most {self._longest_gap} can be bridged"
        # from the second sample on: the first ones of a rig may be delayed
        first, since = self._rate_from = self._rate_from or (sequence, stamp)
        if sequence - first >= _RATE_SAMPLES:
            period = (stamp - since) / (sequence - first)
            self._rate_from = sequence, stamp
            if abs(period - self._period) > _RATE_TOLERANCE * self._period and self.problem is None:
                self.problem = (
                    f"samples {first} to {sequence} come {period * 1e-6:g} ms apart, "
                    f"expected {self._period * 1e-6:g} ms (sample rate)"
                )
        return lost

    def restart(self) -> None:
        """Take the next sample as the first one of a run, whichever run that is."""
        self.run = self.sequence = -1
