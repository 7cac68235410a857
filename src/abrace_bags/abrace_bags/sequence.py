# SPDX-License-Identifier: Apache-2.0
"""Numbers that are missing in a `sequence`: message by message as they come, or in an array of those recorded."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class SequenceCounter:
    """Counts the numbers that a stream of messages leaves out; a number that does not rise begins a new run, no gap.

    `every`: of so many numbers one is kept, that which it divides; the others are not missing.
    """

    def __init__(self, every: int = 1) -> None:
        self._every = every
        self.sequence = -1
        """Number of the last message; -1: none yet."""
        self.gaps = 0
        """Places where numbers are missing."""
        self.missing = 0
        """Numbers missing in all."""

    def add(self, number: int) -> int:
        """Count the `number` of a message; returns how many are missing just before it, -1 where a new run begins."""
        last, self.sequence = self.sequence, number
        if last < 0 or number <= last:
            return -1
        missing = (number - last - 1) // self._every
        if missing:
            self.gaps += 1
            self.missing += missing
        return missing

    def restart(self) -> None:
        """Count no gap before the next message."""
        self.sequence = -1


def breaks(sequence: NDArray[Any]) -> NDArray[np.intp]:
    """Positions in a `sequence` (messages,) of whole numbers that the next number does not follow."""
    return np.flatnonzero(sequence[1:] - sequence[:-1] != 1)


class NumberRanges:
    """The numbers of recorded messages as ranges without a gap, from arrays that come one after the other.

    Neither order nor repeated numbers matter: several runs count as one. `every` is as of `SequenceCounter`.
    """

    def __init__(self, every: int = 1) -> None:
        self._every = every
        self._ranges: list[tuple[int, int]] = []
        self._most = 1000

    def add(self, sequence: NDArray[Any]) -> None:
        """Add the `sequence` (messages,) of some messages."""
        if not sequence.size:
            return
        numbers = np.unique(sequence // self._every)
        ends = np.append(breaks(numbers), numbers.size - 1)
        begins = np.append(0, ends[:-1] + 1)
        for first, last in zip(numbers[begins].tolist(), numbers[ends].tolist(), strict=True):
            if self._ranges and self._ranges[-1][1] + 1 == first:
                self._ranges[-1] = self._ranges[-1][0], last
            else:
                self._ranges.append((first, last))
        if len(self._ranges) > self._most:
            self._join()
            self._most = 1000 + 2 * len(self._ranges)

    def _join(self) -> None:
        joined: list[tuple[int, int]] = []
        for first, last in sorted(self._ranges):
            if joined and first <= joined[-1][1] + 1:
                joined[-1] = joined[-1][0], max(last, joined[-1][1])
            else:
                joined.append((first, last))
        self._ranges = joined

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First and last number of each range, in order."""
        self._join()
        return [(first * self._every, last * self._every) for first, last in self._ranges]

    @property
    def gaps(self) -> int:
        """Places where numbers are missing."""
        return max(len(self.ranges) - 1, 0)

    @property
    def missing(self) -> int:
        """Numbers missing in them."""
        return sum((after - before) // self._every - 1 for (_, before), (after, _) in itertools.pairwise(self.ranges))


def clock_was_set_back(time: NDArray[Any], sequence: NDArray[Any]) -> bool:
    """Whether the `time` (messages,) of messages steps back where their `sequence` goes on, in the order of recording.

    The messages were then recorded in their order, by a clock that was not.
    """
    return bool(((time[1:] < time[:-1]) & (sequence[1:] > sequence[:-1])).any())


def are_interleaved(sequence: NDArray[Any]) -> bool:
    """Whether a `sequence` (messages,) is one run out of order, in contrast to several runs one after the other."""
    drops = np.flatnonzero(sequence[1:] <= sequence[:-1])
    first = sequence[np.append(0, drops + 1)]
    last = sequence[np.append(drops, sequence.size - 1)]
    return bool(drops.size and (last[1:] > first[:-1]).all() and np.unique(sequence).size == sequence.size)
