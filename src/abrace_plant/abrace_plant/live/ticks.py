# SPDX-License-Identifier: Apache-2.0
"""A device's own ticks: whether its stamps rise in steps of the sample period, and its samples come as the clock goes.

A wrong rate is a wrong model, and ramps that take another time. The rate is judged twice: by the stamps, which may be
right although the samples are not, and by this computer's clock.
"""

from __future__ import annotations

import math

from abrace_core.safety.sample_watch import RateCheck

RATE_ERROR = 0.01
"""Share by which the rate may be wrong: above what a device that makes up for a delay is allowed (`FASTEST`)."""
WINDOW = 0.5
"""Seconds over which it is measured: a hundred times the delays of a computer that is fit for it."""
EARLY = 25, 0.3
"""Samples over which a rate that is altogether wrong is found before commands act in full, and the error that is."""
DRIFT = 1e-3
"""Share by which the clocks of device and computer may differ: ten times what cheap quartzes do."""
LEAD = 0.02
"""Seconds by which samples may be ahead of what they were: twice what `RealTimeRun` lets them be ahead of the clock."""
UNITS = {-3: "us", -6: "ms", -9: "s"}
"""Unit of stamps whose steps are the expected nanoseconds times this power of ten."""


class Ticks:
    """Judges sample after sample of one run.

    Parameters
    ----------
    sample_rate
        Of the rig file [Hz].

    Attributes
    ----------
    problem
        What is wrong with the device's ticks; empty: nothing. It holds for two windows of right samples.
    begins
        Whether it is too early to say, by the clock: for the first window.
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate, self._period = sample_rate, 1e9 / sample_rate
        self._window = max(1, round(WINDOW * sample_rate))
        checks = (EARLY, (self._window, RATE_ERROR))
        self._by_stamps = [RateCheck(self._period, *check) for check in checks]
        self._by_clock = RateCheck(self._period, *checks[-1])
        self.problem = ""
        self.begins = False
        self._holds_until = -1
        self._now = 0
        self._drains = False
        self.restart()

    def restart(self) -> None:
        """Forget the samples so far: the device has failed meanwhile. What was wrong still holds."""
        self._seen = 0
        self._by_clock.restart()
        self._restart_stamps(-1)

    def _restart_stamps(self, sequence: int) -> None:
        self._stamp: int | None = None
        self._judged_from = sequence
        for check in self._by_stamps:
            check.restart()

    def take(self, sequence: int, stamp: int, clocks: tuple[int, int] | None, age: float = 0.0) -> None:
        """Judge a sample.

        Parameters
        ----------
        sequence
            Its number, with those that were missed.
        stamp
            Its stamp [ns].
        clocks
            This computer's monotonic and wall clock now [ns]; None: samples do not come by the clock.
        age
            Seconds since its tick, as the device says: a computer that falls behind is no slow device.
        """
        found = self._pace(sequence, *clocks, round(1e9 * max(0.0, age))) if clocks is not None else ""
        found = found or self._judge_stamp(sequence, stamp)
        if found:
            self.problem = self.problem or f"device: {found}"
            self._holds_until = sequence + 2 * self._window + 1  # after which a `RateCheck` would have found it again
        elif self.problem and sequence > self._holds_until:
            self.problem = ""

    def _judge_stamp(self, sequence: int, stamp: int) -> str:
        if sequence < self._judged_from:
            return ""
        last, self._stamp = self._stamp, stamp
        if last is not None and stamp <= last:
            self._restart_stamps(sequence)
            self._stamp = stamp
            if stamp == last:
                return f"stamp of sample {sequence} stands still at {stamp} ns"
            return f"stamp of sample {sequence} goes back by {1e-9 * (last - stamp):.3g} s"
        if self._drains:
            return ""
        for check in self._by_stamps:
            if (mean := check.update(sequence, stamp)) is not None:
                return self._wrong_steps(mean)
        return ""

    def _wrong_steps(self, mean: float) -> str:
        power = math.log10(mean / self._period)
        thousands = 3 * round(power / 3)
        if thousands and abs(power - thousands) < 0.1:
            asked = f"in {UNITS[thousands]}" if thousands in UNITS else "in ns"
            return f"steps of {self._period:g} ns expected, {mean:.3g} given: are the stamps {asked}?"
        return f"{1e9 / mean:.4g} samples/s by its stamps, expected {self._rate:g} (sample_rate of the rig file)"

    def _pace(self, sequence: int, now: int, wall: int, age: int) -> str:
        """Why samples come too quickly or too slowly by the clock.

        Samples that were delayed may come at once after that, but then be no further ahead than they were before, but
        for `DRIFT`. In the first half of the first window what has waited for the run comes at once, and may be stamped
        so. After this computer's clock was set, stamps are not judged for a window.
        """
        offset = wall - now
        now -= age
        lead = sequence * self._period - now
        before, self._now = self._now, now
        if self._seen < 2:  # the middleware is slow with the first sample
            self._seen += 1
            self._offset, self._begin, self._most = offset, now, lead
            self.begins = self._drains = True
            return ""
        self.begins = now < self._begin + WINDOW * 1e9
        if abs(offset - self._offset) > self._period / 4:
            self._restart_stamps(sequence + self._window)
        self._offset = offset
        self._drains = now < self._begin + WINDOW * 0.5e9
        if self._drains:
            self._most = max(self._most, lead)
        elif lead > self._most:
            self._most = min(lead, self._most + DRIFT * (now - before))
            if lead - self._most > LEAD * 1e9:
                return f"more than {self._rate:g} samples/s (sample_rate of the rig file) by this computer's clock"
        mean = self._by_clock.update(sequence, now)
        if mean is not None and mean > self._period:
            return (
                f"{1e9 / mean:.4g} samples/s by this computer's clock, expected {self._rate:g} (sample_rate of the rig "
                "file)"
            )
        return ""
