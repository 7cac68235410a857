"""The sampling schedule of a rig in real time: when samples are due, their stamps, overruns."""

from __future__ import annotations

LONGEST_CATCH_UP = 0.01
"""Seconds of an overrun that are caught up. After a longer one the schedule shifts: no commander could keep up."""


class Schedule:
    """The sampling instants of one activation of a rig.

    Parameters
    ----------
    sample_rate
        Hz.
    start
        Stamp of sample 0 [ns].
    monotonic_start
        The same instant on the monotonic clock [s].
    duration
        Seconds of samples, at least one sample; 0: no end.
    """

    def __init__(self, sample_rate: float, start: int, monotonic_start: float, duration: float) -> None:
        self._period = 1e9 / sample_rate
        self._start = start
        self._monotonic_start = monotonic_start
        self._last = max(1, round(duration * sample_rate)) - 1 if duration else -1
        self.overruns = 0
        """Samples that were taken a whole period late or more."""
        self.shift = 0.0
        """Seconds by which the schedule has shifted in long overruns: the stamps are behind the clock by as much."""

    def stamp(self, sequence: int) -> int:
        """Instant of sample `sequence` [ns]."""
        return self._start + round(sequence * self._period)

    def sequence(self, stamp: int) -> int:
        """The sample nearest to a stamp [ns]."""
        return round((stamp - self._start) / self._period)

    def next_due(self, sequence: int, now: float) -> float:
        """When the sample after `sequence` is due [s, monotonic], counted from the start: errors do not accumulate.

        `now` is the instant at which `sequence` was taken.
        """
        due = self._monotonic_start + (sequence + 1) * self._period * 1e-9
        late = now - due
        self.overruns += late > 0
        if late <= LONGEST_CATCH_UP:
            return due
        self._monotonic_start += late
        self.shift += late
        return now

    def is_last(self, sequence: int) -> bool:
        """Whether the run ends with sample `sequence`."""
        return sequence == self._last
