# SPDX-License-Identifier: Apache-2.0
"""Detection of spikes: single readings far from their neighbours, caused for example by a loose plug or a lost byte.

If a channel is sampled fast enough, the cubic through two readings on either side predicts each reading except for
noise. A reading is a spike if it deviates from this cubic much more than usual. The usual deviation is estimated by the
median over the record, which spikes do not affect. No motion deviates for one or two readings and returns at once.

A brace with backlash is an exception: while its force reverses it stays at zero for a sample, and at the following
impact accelerations jump. Such a reading of the force lies between its two neighbours; a spike does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CUBIC = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6
"""Weights of five readings that give the middle reading minus the cubic through its neighbours."""

FAR = 10.0
"""A spike deviates from that cubic by at least this many times the usual; five linear rigs reached at most 5.1."""

ALONE = 0.3
"""A single wrong reading changes its neighbours' deviations by known amounts. They may differ from these by this share
of its own deviation."""

BEYOND = 0.2
"""A spike is above or below both its neighbours by at least this share of its deviation."""


def spikes(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The readings that are spikes.

    Parameters
    ----------
    series
        (samples,).

    Returns
    -------
    where, size
        (spikes,) sample indices, and deviation of each from the cubic through its neighbours.
    """
    where, size, beyond = _apart(series)
    return where[beyond], size[beyond]


def reversals_with_play(force: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the samples at which a brace's `force` (samples,) stays at zero while it reverses."""
    where, _, beyond = _apart(force)
    return where[~beyond]


def _apart(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Indices of single deviating readings, their deviations, and whether they are beyond both neighbours."""
    away = np.zeros(len(series))
    away[2:-2] = np.convolve(series, CUBIC, "valid")
    steps = np.abs(np.diff(series))
    # a step of the converter's last bit is not a spike
    usual = max(float(np.median(np.abs(away))) / 0.6745, float(steps[steps > 0].min(initial=np.inf)))
    far = np.flatnonzero(np.abs(away) > FAR * usual)
    far = far[(far >= 4) & (far < len(series) - 4)]
    # a single wrong reading changes its neighbours' deviations by the same weights; an impact in the rig does not
    around = away[far[:, None] + np.arange(-2, 3)]
    alone = np.abs(around / away[far][:, None] - CUBIC / CUBIC[2]).max(axis=1, initial=0) < ALONE
    far = far[alone]
    before, reading, after = series[far - 1], series[far], series[far + 1]
    beyond = np.maximum(reading - np.maximum(before, after), np.minimum(before, after) - reading)
    return far, away[far], beyond > BEYOND * np.abs(away[far])
