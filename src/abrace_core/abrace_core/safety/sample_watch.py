# SPDX-License-Identifier: Apache-2.0
"""Checks of the stream of samples that a node answers: old and lost samples, a new run of the rig, a wrong rate."""

from __future__ import annotations

from collections import deque

LONGEST_GAP = 5
"""Lost samples in a row that a node bridges by default; more are a fault."""

NEW_RUN, OLD = -1, -2
"""What `SampleWatch.update` returns instead of a number of lost samples."""

RATE_CHECKS = (25, 0.3), (500, 0.02)
"""Numbers of samples over which the rate is measured, and the greatest error of each: a large error is found early."""
_KEPT_RUNS = 1000
"""Number of earlier runs that are remembered."""


class RateCheck:
    """Compares the mean sample period of the last samples with the expected one, at every sample.

    A sample that is late, a rig that was delayed, and a clock that was set change at most `samples` of these means in
    one direction. Only more of them in a row, all wrong in the same direction, are a wrong rate.

    Parameters
    ----------
    period
        Expected sample period [ns].
    samples
        Number of samples of each mean.
    tolerance
        Greatest relative error of a mean.

    Attributes
    ----------
    first
        Number of the first sample of the last mean.
    """

    def __init__(self, period: float, samples: int, tolerance: float) -> None:
        self._period, self._samples, self._tolerance = period, samples, tolerance
        self._received: deque[tuple[int, int]] = deque(maxlen=samples + 1)
        self._wrong_in_a_row = 0
        self.first = -1

    def update(self, sequence: int, stamp: int) -> float | None:
        """The mean period [ns] if that is a wrong rate, up to sample `sequence` with its `stamp` [ns]; None: it is not.

        After a wrong rate, the next sample is the first one.
        """
        received = self._received
        received.append((sequence, stamp))
        if len(received) <= self._samples:
            return None
        self.first, since = received[0]
        mean = (stamp - since) / (sequence - self.first)
        error = mean / self._period - 1
        if abs(error) <= self._tolerance:
            self._wrong_in_a_row = 0
        elif error > 0:
            self._wrong_in_a_row = max(self._wrong_in_a_row, 0) + 1
        else:
            self._wrong_in_a_row = min(self._wrong_in_a_row, 0) - 1
        if abs(self._wrong_in_a_row) <= self._samples:
            return None
        self.restart()
        return mean

    def restart(self) -> None:
        """Forget the samples so far."""
        self._received.clear()
        self._wrong_in_a_row = 0


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
        self._earlier: deque[int] = deque(maxlen=_KEPT_RUNS)
        self._period = sample_period * 1e9
        self._rate_checks = [RateCheck(self._period, *check) for check in RATE_CHECKS]
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
            for check in self._rate_checks:
                check.restart()
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
        # from the second sample on: the first one of a rig may be delayed
        for check in self._rate_checks:
            mean = check.update(sequence, stamp)
            if mean is not None and self.problem is None:
                self.problem = (
                    f"samples {check.first} to {sequence} come {mean * 1e-6:g} ms apart, "
                    f"expected {self._period * 1e-6:g} ms (sample rate)"
                )
        return lost

    def restart(self) -> None:
        """Treat the next sample as the first one of its run."""
        self.run = self.sequence = -1
