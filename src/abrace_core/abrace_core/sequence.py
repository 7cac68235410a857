"""Numbers that are missing in a `sequence`: message by message as they come, or in an array of those recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class SequenceCounter:
    """Counts the numbers that a stream of messages leaves out; a number that does not rise begins a new run, no gap."""

    def __init__(self) -> None:
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
        missing = number - last - 1
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


def missing_numbers(sequence: NDArray[Any]) -> tuple[int, int]:
    """Gaps between the least and the greatest of the recorded numbers, and how many numbers are missing in them.

    In a `sequence` (messages,) of several runs these count as one: neither order nor repeated numbers matter.
    """
    if not sequence.size:
        return 0, 0
    numbers = np.unique(sequence)
    return breaks(numbers).size, int(numbers[-1]) - int(numbers[0]) + 1 - numbers.size
