# SPDX-License-Identifier: Apache-2.0
"""Fewer values for a viewer, none of the extremes left out: of every window the smallest and the largest.

A curve through each window's minimum and maximum, in the order in which they came, covers the same range as the curve
through all values: no peak is hidden, however short.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def extremes(times: NDArray[np.int64], values: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The smallest and the largest value of each channel, whichever came first in the first row.

    >>> times, rows = extremes(np.arange(4), np.array([[0.0, 5.0], [3.0, 4.0], [-1.0, 4.5], [1.0, 1.0]]))
    >>> times.tolist(), rows.tolist()
    ([0, 2], [[3.0, 5.0], [-1.0, 1.0]])

    Parameters
    ----------
    times
        (samples,) of the samples, rising [ns].
    values
        (samples, channels), at least one sample. A channel with a NaN has that in one of its rows.

    Returns
    -------
    times
        (2,) one and three quarters of the way through the window, so that windows in a row give evenly spaced times: a
        value is shown within three quarters of a window of its own time. Two samples or one keep their times.
    values
        (2, channels), or (1, channels) of one sample.
    """
    count = len(values)
    if count <= 2:
        return times, values
    low, high = values.argmin(axis=0), values.argmax(axis=0)
    rows = np.stack([np.minimum(low, high), np.maximum(low, high)])
    span = (times[-1] - times[0]) * count // (count - 1)
    return times[0] + np.array([span // 4, 3 * span // 4]), np.take_along_axis(values, rows, axis=0)


def greatest(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The value of the greatest magnitude of each channel, with its sign; NaN, where a channel has one.

    >>> greatest(np.array([[0.0, 5.0], [-3.0, 4.0], [1.0, 1.0]])).tolist()
    [-3.0, 5.0]

    Parameters
    ----------
    values
        (samples, channels), at least one sample.

    Returns
    -------
    values
        (channels,)
    """
    rows = np.abs(values).argmax(axis=0)
    return np.take_along_axis(values, rows[None], axis=0)[0]
