# SPDX-License-Identifier: Apache-2.0
"""Checks of the stream of samples that a node answers: old and lost samples, a new run of the rig, a wrong rate."""

from __future__ import annotations

from collections import deque

LONGEST_GAP = 5
"""Lost samples in a row that a node bridges by default; more are a fault."""

NEW_RUN, OLD = -1, -2
"""What `SampleWatch.update` returns instead of a number of lost samples."""

_RATE_SAMPLES, _RATE_TOLERANCE = 50, 0.3
"""Number of samples over which the rate is checked, since single stamps vary; and the greatest error of the rate."""
_FINE_SAMPLES, _FINE_TOLERANCE = 500, 0.02
"""The same for small errors, a fault only twice in a row: one late stamp changes two rates, in opposite directions."""
_KEPT_RUNS = 1000
"""Number of earlier runs that are remembered."""


class SampleWatch:
    """Checks each sample's run, number and stamp.

    Parameters
    ----------
    sample_period
        Expected sample period [s].
    longest_gap
        Greatest number of lost samples in a row that is no fault.

    Attributes
    ----------
    run, sequence
        Run and number of the last sample that was not old; -1: none yet.
    missing
        Number of lost samples, in all runs.
    old
        Number of dropped samples: repeated, out of order, or of an earlier run.
    problem
        Why the last sample is a fault; None: it is not.
    """

    def __init__(self, sample_period: float, longest_gap: int = LONGEST_GAP) -> None:
        self._longest_gap = longest_gap
        self._period = sample_period * 1e9
        self._earlier: deque[int] = deque(maxlen=_KEPT_RUNS)
        self._rate_from: tuple[int, int] | None = None
        self._fine_from: tuple[int, int] | None = None
        self._fine_error = 0.0
        self.run = self.sequence = -1
        self.missing = self.old = 0
        self.problem: str | None = None

    def update(self, run: int, sequence: int, stamp: int, goes_on: bool = False) -> int:
        """Check the next sample.

        Parameters
        ----------
        run
            Number of the rig's run.
        sequence
            Its number in this run.
        stamp
            Its sampling instant [ns].
        goes_on
            Whether the run of the sample before has not ended: one of another run does not make it an earlier one.

        Returns
        -------
        int
            Samples lost just before it; NEW_RUN if it is the first one of a run; OLD if it is to be dropped.
        """
        if run != self.run:
            if run in self._earlier:
                self.old += 1
                return OLD
            if self.run >= 0 and not goes_on:
                self._earlier.append(self.run)
            self.run, self.sequence, self.problem = run, sequence, None
            self._rate_from = self._fine_from = None
            self._fine_error = 0.0
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
            self._rate_from = sequence, stamp
            problem = self._wrong_rate(first, since, sequence, stamp)
            self.problem = self.problem or problem
        return lost

    def _wrong_rate(self, first: int, since: int, sequence: int, stamp: int) -> str | None:
        """Why the rate is wrong, either since the last check, or slightly in the last two long intervals."""
        period = (stamp - since) / (sequence - first)
        wrong = abs(period - self._period) > _RATE_TOLERANCE * self._period
        fine_first, fine_since = self._fine_from = self._fine_from or (first, since)
        if not wrong and sequence - fine_first >= _FINE_SAMPLES:
            self._fine_from = sequence, stamp
            first, period = fine_first, (stamp - fine_since) / (sequence - fine_first)
            before, self._fine_error = self._fine_error, period / self._period - 1
            wrong = min(abs(before), abs(self._fine_error)) > _FINE_TOLERANCE and before * self._fine_error > 0
        if not wrong:
            return None
        return (
            f"samples {first} to {sequence} come {period * 1e-6:g} ms apart, "
            f"expected {self._period * 1e-6:g} ms (sample rate)"
        )

    def restart(self) -> None:
        """Treat the next sample as the first one of its run."""
        self.run = self.sequence = -1
