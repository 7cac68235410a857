# SPDX-License-Identifier: Apache-2.0
"""Latency of a node's answers: statistics over the last samples."""

from __future__ import annotations

from array import array

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
        # rings: reported while the loop goes on, they are read without a Python object for each time
        self._from_receipt, self._from_stamp = (array("q", bytes(8 * WINDOW)) for _ in range(2))
        self._received = self._stamped = self._last = 0
        self.late = 0
        """Answers so far whose delay after the stamp is more than a sample period longer than that of the answer
        before, where stamps are of this clock. After an overrun all stamps stay behind the clock."""

    def add(self, from_receipt: int, from_stamp: int) -> None:
        """Add an answer sent `from_receipt` ns after its sample was received and `from_stamp` ns after its stamp."""
        self._from_receipt[self._received % WINDOW] = from_receipt
        self._received += 1
        if 0 <= from_stamp < SAME_CLOCK:
            if self._stamped:
                self.late += from_stamp - self._last > self._period
            self._from_stamp[self._stamped % WINDOW] = self._last = from_stamp
            self._stamped += 1

    def report(self) -> dict[str, object]:
        """Median, 99 % and worst of both delays over the last samples [us], where they were measured.

        Of n delays in order the 99 % is the one of number 0.99 n, rounded up; so is the median.
        """
        found: dict[str, object] = {"late": self.late}
        rings = ("answer", self._from_receipt, self._received), ("stamp_to_command", self._from_stamp, self._stamped)
        for name, ring, count in rings:
            if n := min(count, WINDOW):
                places = (n + 1) // 2 - 1, -(-99 * n // 100) - 1, n - 1
                ordered = np.partition(np.frombuffer(ring, np.int64, n), places)
                for statistic, place in zip(("median", "99_percent", "worst"), places, strict=True):
                    found[f"{name}_{statistic}_us"] = round(ordered[place] / 1e3)
        return found
