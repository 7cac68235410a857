# SPDX-License-Identifier: Apache-2.0
"""Latency of a node's answers: statistics over the last samples."""

from __future__ import annotations

from array import array
from collections import deque

import numpy as np

WINDOW = 5000
"""Samples over which latency is reported."""

SAME_CLOCK = 1_000_000_000
"""Nanoseconds between stamp and answer beyond which they are of different clocks: lockstep stamps begin at 0."""


class Latency:
    """Times from a sample to its answer.

    Parameters
    ----------
    sample_period
        [s]; an answer is late if its delay grows by more than that from one sample to the next.
    """

    def __init__(self, sample_period: float) -> None:
        self._period = sample_period * 1e9
        self._from_receipt: deque[int] = deque(maxlen=WINDOW)
        self._from_stamp: deque[int] = deque(maxlen=WINDOW)
        self.late = 0
        """Answers so far whose delay after the stamp is more than a sample period longer than that of the answer
        before, where stamps are of this clock. After an overrun all stamps stay behind the clock."""

    def add(self, from_receipt: int, from_stamp: int) -> None:
        """Add an answer sent `from_receipt` ns after its sample was received and `from_stamp` ns after its stamp."""
        self._from_receipt.append(from_receipt)
        if 0 <= from_stamp < SAME_CLOCK:
            if self._from_stamp:
                self.late += from_stamp - self._from_stamp[-1] > self._period
            self._from_stamp.append(from_stamp)

    def report(self) -> dict[str, object]:
        """Median, 99 % and worst of both delays over the last samples [us], where they were measured.

        Of n delays in order the 99 % is the one of number 0.99 n, rounded up; so is the median.
        """
        found: dict[str, object] = {"late": self.late}
        for name, times in (("answer", self._from_receipt), ("stamp_to_command", self._from_stamp)):
            # a copy, in one step: another thread may add meanwhile
            last = array("q", list(times))
            if n := len(last):
                places = (n + 1) // 2 - 1, -(-99 * n // 100) - 1, n - 1
                # np.percentile would import numpy.ma, and hold the interpreter for some 40 ms
                ordered = np.partition(last, places)
                for statistic, place in zip(("median", "99_percent", "worst"), places, strict=True):
                    found[f"{name}_{statistic}_us"] = round(ordered[place] / 1e3)
        return found
