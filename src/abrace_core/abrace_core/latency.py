"""How long a node takes to answer its samples, over the last of them."""

from __future__ import annotations

from collections import deque

import numpy as np

REMEMBERED = 5000
"""Samples over which times are reported."""

SAME_CLOCK = 1_000_000_000
"""Nanoseconds that a stamp and its answer may be apart by one clock; the stamps of a lockstep run begin at 0."""


class Latency:
    """Times from a sample to its answer.

    Parameters
    ----------
    sample_period
        [s]; an answer that falls behind the one before it by more than that is late.
    """

    def __init__(self, sample_period: float) -> None:
        self._period = sample_period * 1e9
        self._from_receipt: deque[int] = deque(maxlen=REMEMBERED)
        self._from_stamp: deque[int] = deque(maxlen=REMEMBERED)
        self.late = 0
        """Answers so far that came more than a sample period later after their stamps than the one before, where clocks
        tell. The stamps of a rig that was held up stay behind the clock: their age alone says nothing."""

    def take(self, from_receipt: int, from_stamp: int) -> None:
        """An answer was sent `from_receipt` ns after its sample was received and `from_stamp` ns after its stamp."""
        self._from_receipt.append(from_receipt)
        if 0 <= from_stamp < SAME_CLOCK:
            if self._from_stamp:
                self.late += from_stamp - self._from_stamp[-1] > self._period
            self._from_stamp.append(from_stamp)

    def report(self) -> dict[str, object]:
        """Median, 99 % and worst over the last samples [us] of both; nothing of what is not known."""
        found: dict[str, object] = {"late": self.late}
        for name, times in (("answer", self._from_receipt), ("stamp_to_command", self._from_stamp)):
            if times:
                middle, most, worst = np.percentile(times, [50, 99, 100]) / 1e3
                found.update(
                    {
                        f"{name}_median_us": round(middle),
                        f"{name}_99_percent_us": round(most),
                        f"{name}_worst_us": round(worst),
                    }
                )
        return found
