"""When samples are due, and which sample a stamp belongs to."""

from __future__ import annotations

LONGEST_CATCH_UP = 0.01
"""Seconds that a rig which was held up makes up for. After more it goes on from now: no commander could keep up."""


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
        self.behind = 0
        """Samples that were taken a whole period late or more."""
        self.held_up = 0.0
        """Seconds that were not made up for: the stamps are so much behind the clock."""

    def stamp(self, sequence: int) -> int:
        """Instant of sample `sequence` [ns]."""
        return self._start + round(sequence * self._period)

    def sequence(self, stamp: int) -> int:
        """The sample nearest to a stamp [ns]."""
        return round((stamp - self._start) / self._period)

    def next_due(self, sequence: int, now: float) -> float:
        """When the sample after `sequence` is due [s, monotonic]: counted from the start, so that errors do not add up.

        `now` is the instant at which `sequence` was taken.
        """
        due = self._monotonic_start + (sequence + 1) * self._period * 1e-9
        late = now - due
        self.behind += late > 0
        if late <= LONGEST_CATCH_UP:
            return due
        self._monotonic_start += late
        self.held_up += late
        return now

    def is_last(self, sequence: int) -> bool:
        """Whether the run ends with sample `sequence`."""
        return sequence == self._last
