# SPDX-License-Identifier: Apache-2.0
"""Spikes of a channel: single readings far from their neighbours, as a loose plug or a lost byte makes them.

What the neighbours of a reading say of it, by the cubic through two on either side, is right but for noise as long as
the channel is sampled often enough for what it measures. The usual deviation is that of the record; its median is not
moved by the spikes. No motion leaves its course for a reading or two and is back in it at once.

A brace whose pins have play is an exception: while its force reverses it stays at zero for a sample, and where it
strikes then, accelerations jump. That reading of the force lies between those before and after it; a spike does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CUBIC = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6
"""A reading less what the cubic through its neighbours has there."""

FAR = 10.0
"""Usual deviations from that cubic, from which on a reading is a spike; five linear rigs had 5.1 at most."""

ALONE = 0.3
"""Greatest difference of its neighbours' deviations from those that a single reading makes, as a share of its own."""

BEYOND = 0.2
"""How far a spike is at least above or below both readings beside it, as a share of its deviation."""


def spikes(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The readings that are spikes.

    Parameters
    ----------
    series
        (samples,).

    Returns
    -------
    where, size
        (spikes,) their numbers, and how far each is from the course of its neighbours.
    """
    where, size, beyond = _apart(series)
    return where[beyond], size[beyond]


def reversals_with_play(force: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of the samples at which a brace's `force` (samples,) stays at zero while it reverses."""
    where, _, beyond = _apart(force)
    return where[~beyond]


def _apart(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Single readings far from their neighbours' course, how far, and whether they are beyond both neighbours."""
    away = np.zeros(len(series))
    away[2:-2] = np.convolve(series, CUBIC, "valid")
    steps = np.abs(np.diff(series))
    # a converter's last bit is no spike
    usual = max(float(np.median(np.abs(away))) / 0.6745, float(steps[steps > 0].min(initial=np.inf)))
    far = np.flatnonzero(np.abs(away) > FAR * usual)
    far = far[(far >= 4) & (far < len(series) - 4)]
    # one reading alone spoils its neighbours' cubics by the same numbers; a blow in the rig does not
    around = away[far[:, None] + np.arange(-2, 3)]
    alone = np.abs(around / away[far][:, None] - CUBIC / CUBIC[2]).max(axis=1, initial=0) < ALONE
    far = far[alone]
    before, reading, after = series[far - 1], series[far], series[far + 1]
    beyond = np.maximum(reading - np.maximum(before, after), np.minimum(before, after) - reading)
    return far, away[far], beyond > BEYOND * np.abs(away[far])
