# SPDX-License-Identifier: Apache-2.0
"""The last seconds of a rig's readings, thinned for a screen: of every bin the least and the greatest value."""

from __future__ import annotations

import math
import threading
from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

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
        self._samples: list[Sequence[float]] = []
        self._run = (0, 0)
        self._first = self._index = 0
        # of the last bin that is whole, counted over all runs; and what it was when this run began
        self._number = self._began = 0
        self._lock = threading.Lock()

    def add(self, run: int, stamp: int, values: Sequence[float]) -> None:
        """Add the `values` (channels,) of the sample at `stamp` [ns] of a `run`."""
        index = stamp // BIN
        with self._lock:
            if self._run != (run, len(values)) or index < self._index:
                self._run, self._first, self._index = (run, len(values)), stamp, index
                self._bins.clear()
                self._samples.clear()
                self._number += 1
                self._began = self._number
            elif index > self._index:
                self._close()
                self._index = index
            self._samples.append(values)

    def _close(self) -> None:
        channels = list(zip(*self._samples, strict=True))
        begin = max(0, self._index * BIN - self._first) / 1e9
        self._bins.append(Bin(begin, [_least(each) for each in channels], [_greatest(each) for each in channels]))
        self._samples.clear()
        self._number += 1

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


def _least(values: Sequence[float]) -> float | None:
    finite = [value for value in values if math.isfinite(value)]
    return float(f"{min(finite):.6g}") if finite else None


def _greatest(values: Sequence[float]) -> float | None:
    finite = [value for value in values if math.isfinite(value)]
    return float(f"{max(finite):.6g}") if finite else None
