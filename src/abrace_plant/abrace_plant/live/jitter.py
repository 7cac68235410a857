# SPDX-License-Identifier: Apache-2.0
"""Timing of samples: their deviations from the clock, and those of a bare timer on the same machine."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

QUANTILES = {"median_us": 50.0, "p99_us": 99.0, "p999_us": 99.9, "p9999_us": 99.99, "worst_us": 100.0}
EDGES = np.geomspace(0.1, 1e7, 161)
"""Edges of a histogram's intervals [us], 20 a decade up to 10 s: the same in every run, so that counts can be added."""


@dataclass(frozen=True)
class Jitter:
    """Deviations of events from when they were due.

    Attributes
    ----------
    times
        (events,) [s], 0 or more.
    missed
        Events that did not come at all.
    """

    times: NDArray[np.float64]
    missed: int = 0

    def statistics(self) -> dict[str, float]:
        """Number of events, of missed ones, and quantiles [us]; a quantile that few events tell is their worst."""
        values = np.percentile(1e6 * self.times, list(QUANTILES.values()), method="higher").tolist()
        return {"events": len(self.times), "missed": self.missed, **dict(zip(QUANTILES, values, strict=True))}

    def counts(self) -> list[int]:
        """Events in each interval of `EDGES`; the first and the last also have those beyond their ends."""
        found: list[int] = np.histogram(np.clip(1e6 * self.times, EDGES[0], EDGES[-1]), EDGES)[0].tolist()
        return found


@dataclass(frozen=True)
class Arrivals:
    """Samples as they came.

    Attributes
    ----------
    received
        (samples,) [ns], of a clock that does not jump.
    stamps, sequences
        (samples,) what they say themselves: [ns], and their numbers.
    """

    received: Sequence[int]
    stamps: Sequence[int]
    sequences: Sequence[int]

    def jitter(self) -> tuple[Jitter, float]:
        """Deviations of the times between samples from those of a clock, and its period [s].

        Raises
        ------
        AbraceError
            If there are too few samples, or they are those of more than one run.
        """
        if len(self.sequences) < 3:
            raise AbraceError(f"{len(self.sequences)} samples on response, expected a running rig")
        steps = np.diff(np.array(self.sequences, dtype=np.float64))  # a wrong one may be of 64 bits
        if steps.min() < 1:
            raise AbraceError("the rig was restarted during the measurement, expected one run")
        period = float(np.median(np.diff(np.array(self.stamps, dtype=np.int64)) / steps)) / 1e9
        between = np.diff(np.array(self.received, dtype=np.int64)).astype(np.float64) / 1e9
        return Jitter(np.abs(between - period * steps), int((steps - 1).sum())), period


def bare_timer(period: float, duration: float) -> Jitter:
    """How late a thread wakes that only sleeps until each multiple of `period` [s], for `duration` [s]."""
    due = time.monotonic() + period
    late = np.empty(max(1, round(duration / period)))
    for k in range(len(late)):
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        late[k] = now - due
        due = max(due + period, now)
    return Jitter(late)


def as_json(found: Mapping[str, Jitter], period: float, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What is written: `period` [s], `settings`, edges, and statistics and counts of each part `found`, by its name."""
    return {
        "period": period,
        "settings": dict(settings),
        "edges_us": EDGES.tolist(),
        **{name: {**one.statistics(), "counts": one.counts()} for name, one in found.items()},
    }
