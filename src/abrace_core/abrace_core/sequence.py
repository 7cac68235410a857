"""Numbers that are missing in a `sequence`: message by message as they come, or in an array of those recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class SequenceCounter:
    """Counts the numbers that a stream of messages leaves out; a number that does not rise begins a new run, no gap.

    Attributes
    ----------
    sequence
        Number of the last message; -1: none yet.
    gaps
        Places where numbers are missing.
    missing
        Numbers missing in all.
    """

    def __init__(self) -> None:
        self.sequence = -1
        self.gaps = 0
        self.missing = 0

    def add(self, number: int) -> int:
        """Count a message.

        Parameters
        ----------
        number
            Its number.

        Returns
        -------
        int
            Numbers missing just before it; -1 where a new run begins, as with the first message.
        """
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
    """Where an array of numbers does not go on with the next one: positions of the numbers before the breaks.

    Parameters
    ----------
    sequence
        (messages,) whole numbers, in the order of the messages.
    """
    return np.flatnonzero(sequence[1:] - sequence[:-1] != 1)


def missing_numbers(sequence: NDArray[Any]) -> tuple[int, int]:
    """Gaps between the least and the greatest of the recorded numbers, and how many numbers are missing in them.

    The order of the messages does not matter, nor whether a number comes again: several runs in one bag count as one.

    Parameters
    ----------
    sequence
        (messages,) whole numbers; may be empty.
    """
    if not sequence.size:
        return 0, 0
    numbers = np.unique(sequence)
    return breaks(numbers).size, int(numbers[-1]) - int(numbers[0]) + 1 - numbers.size
