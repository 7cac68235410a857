# SPDX-License-Identifier: Apache-2.0
"""The last seconds of a rig's readings, thinned for a screen: of every bin the least and the greatest value."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

BIN = 40_000_000
"""Nanoseconds: 25 bins a second, of two values each. No peak is hidden."""
SECONDS = 30
"""Length of what is kept."""


class Bin(NamedTuple):
    """Least and greatest reading of each channel within `BIN`; `begin` [s] counts from the first sample of the run."""

    begin: float
    low: list[float | None]
    high: list[float | None]


class Traces:
    """Bins of one run; a new run, or a rig of another size, begins anew. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._bins: deque[Bin] = deque(maxlen=SECONDS * 1_000_000_000 // BIN)
        self._open = np.empty((0, 0))
        self._run = (0, 0)
        self._first = self._index = 0
        # of the last bin that is whole, counted over all runs; and what it was when this run began
        self._number = self._began = 0
        self._lock = threading.Lock()

    def add(self, runs: NDArray[np.uint64], stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add samples: (samples,) runs and stamps [ns], and (samples, channels) values."""
        bins, values = stamps // BIN, np.where(np.isfinite(values), values, np.nan)
        changes = np.flatnonzero((np.diff(bins) != 0) | (runs[1:] != runs[:-1])) + 1
        with self._lock:
            for part in np.split(np.arange(len(bins)), changes):
                first = part[0]
                self._add(int(runs[first]), int(bins[first]), int(stamps[first]), values[part])

    def _add(self, run: int, index: int, stamp: int, values: NDArray[np.float64]) -> None:
        """Add `values` of one bin."""
        if self._run != (run, values.shape[1]) or index < self._index:
            self._run, self._first = (run, values.shape[1]), stamp
            self._bins.clear()
            self._open = values
            self._number += 1
            self._began = self._number
        elif index > self._index:
            low, high = (_rounded(each) for each in self._open)
            self._bins.append(Bin(max(0, self._index * BIN - self._first) / 1e9, low, high))
            self._open = values
            self._number += 1
        else:
            self._open = np.vstack([self._open, values])
        self._index = index
        self._open = np.vstack([np.fmin.reduce(self._open), np.fmax.reduce(self._open)])

    def since(self, number: int) -> dict[str, Any]:
        """The bins after the one of that `number`, for JSON, and the `number` of the last one.

        `anew`: the bins given before are of another run, or too old.
        """
        with self._lock:
            last, began, kept = self._number, self._began, list(self._bins)
        anew = number < max(began, last - len(kept))
        bins = kept if anew else kept[len(kept) - (last - number) :]
        return {
            "number": last,
            "anew": anew,
            "begin": [each.begin for each in bins],
            "low": [each.low for each in bins],
            "high": [each.high for each in bins],
        }


def _rounded(values: NDArray[np.float64]) -> list[float | None]:
    """For JSON, which has no NaN."""
    return [None if np.isnan(value) else float(f"{value:.6g}") for value in values.tolist()]
