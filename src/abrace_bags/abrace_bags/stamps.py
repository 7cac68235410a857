# SPDX-License-Identifier: Apache-2.0
"""Times of samples by the stamps of their messages: of an array, or of a stream of any length."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.files.sample_times import sample_times

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.files.sample_times import SampleTimes

MOST = 10_000
"""Stamps of a stream that are kept."""


def stamped_times(stamps: NDArray[np.int64], numbers: NDArray[np.int64]) -> SampleTimes:
    """The times of samples by their `stamps` [ns] and `numbers`, each (samples,)."""
    if not stamps.size:
        return sample_times(np.empty(0), numbers)
    middle = np.partition(stamps, stamps.size // 2)[stamps.size // 2]
    resolution = 1e-9 * float(np.gcd.reduce(np.diff(stamps))) if stamps.size > 1 else 0.0
    return sample_times(1e-9 * (stamps - middle), numbers, resolution)


class StampStream:
    """Stamps of a stream with the samples' numbers: all of a short one, of a longer one every second, fourth, ..."""

    def __init__(self) -> None:
        self._stamps, self._numbers = array("q"), array("q")
        self._count, self._every = 0, 1

    def __len__(self) -> int:
        """Stamps that are kept."""
        return len(self._stamps)

    def add(self, stamps: NDArray[np.int64], numbers: NDArray[Any] | None = None) -> None:
        """Add `stamps` [ns] and `numbers`, each (messages,); None: messages are numbered as they come."""
        if numbers is None:
            numbers = np.arange(self._count, self._count + stamps.size)
        first = -self._count % self._every
        for kept, given in ((self._stamps, stamps), (self._numbers, numbers)):
            kept.frombytes(given[first :: self._every].astype(np.int64).tobytes())
        self._count += stamps.size
        while len(self) > MOST:
            self._stamps, self._numbers = self._stamps[::2], self._numbers[::2]
            self._every *= 2

    def times(self) -> SampleTimes:
        """The times of the samples."""
        return stamped_times(np.array(self._stamps, np.int64), np.array(self._numbers, np.int64))
