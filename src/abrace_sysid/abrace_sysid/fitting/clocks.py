# SPDX-License-Identifier: Apache-2.0
"""Clocks of sampling devices that differ: a channel that comes later and later against what the model predicts.

A device whose clock is fast by e stamps what happens at t with (1 + e) t. Its channel is then y(t / (1 + e)), about
y(t) - e t dy/dt, and the regression of what a model leaves on t dy/dt of the predicted channel gives e.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from numpy.typing import NDArray

CERTAIN = 6.0
"""A clock is named from so many standard deviations on."""

EXPLAINS = 0.8
"""Greatest share of what a model leaves that is left beside a clock's error that is named."""

PIECES = 16
"""Parts of a record whose scores are taken as independent, for the standard deviation."""

STEPS = 8
"""Gauss and Newton's steps."""


class Clock(NamedTuple):
    """By how much the clock of a channel is fast, as a share, with its standard deviation.

    `left` is the share that remains, beside it, of the power that the model leaves.
    """

    fast: float
    deviation: float
    left: float

    @property
    def is_certain(self) -> bool:
        """Whether it is far beyond its uncertainty, and explains what the model does not."""
        return abs(self.fast) > CERTAIN * self.deviation and self.left < EXPLAINS

    def words(self) -> str:
        """As "98 ± 4 ppm fast"."""
        return f"{1e6 * abs(self.fast):.3g} ± {1e6 * NORMAL_95 * self.deviation:.2g} ppm {self._side}"

    @property
    def _side(self) -> str:
        return "fast" if self.fast > 0 else "slow"


def clock_of(measured: NDArray[np.float64], predicted: NDArray[np.float64]) -> Clock:
    """The clock of a channel against that of the inputs.

    Parameters
    ----------
    measured, predicted
        (samples,) of the channel, and what a model predicts of it from the inputs.
    """
    place = np.arange(len(measured)) - (len(measured) - 1) / 2
    of_place = CubicSpline(place, predicted - predicted.mean())
    fast, left, first = 0.0, 1.0, 0.0
    scores, size = np.zeros(PIECES), 0.0
    for _ in range(STEPS):
        moved = place * (1 - fast)
        level, slope = of_place(moved), of_place(moved, 1)
        others = np.column_stack([slope, level, place * level, np.ones(len(place))])
        basis = np.linalg.qr(others / np.linalg.norm(others, axis=0))[0]
        both = np.column_stack([place * slope, measured])
        own, rest = (both - basis @ (basis.T @ both)).T
        size = float(own @ own)
        if not size > 0:
            return Clock(0.0, np.inf, 1.0)
        share = float(own @ rest) / size
        after = rest - share * own
        first = first or max(float(rest @ rest), np.finfo(float).tiny)
        left = float(after @ after) / first
        scores = np.array([part.sum() for part in np.array_split(own * after, PIECES)])
        fast -= share
    return Clock(fast, float(np.sqrt(np.sum(scores**2))) / size, left)
