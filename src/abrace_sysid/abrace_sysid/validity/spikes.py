# SPDX-License-Identifier: Apache-2.0
"""Spikes of a channel: single readings far from their neighbours, as a loose plug or a lost byte makes them.

What the neighbours of a reading say of it, by the cubic through two on either side, is right but for noise as long as
the channel is sampled often enough for what it measures. The usual deviation is that of the record; its median is not
moved by the spikes. No motion leaves its course for a reading or two and is back in it at once.
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
    return far[alone], away[far[alone]]
