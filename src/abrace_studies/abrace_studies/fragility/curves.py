# SPDX-License-Identifier: Apache-2.0
"""Fragility curves: the probability that a limit is exceeded, over the intensity of the ground motion.

P(exceeded | im) = Phi(ln(im / median) / dispersion), fitted by maximum likelihood to how many of the loops at each
intensity exceed the limit (Baker 2015). The loops of one ground motion are no independent
observations: many models and all intensities share it. So the confidence bands come from a bootstrap of the motions,
whose loops are drawn together.

Counts are separated where no loop exceeds the limit below some intensity and every loop does above it: their likelihood
has no maximum, as it rises while the dispersion falls to 0. Such counts tell only between which intensities the median
lies, from 0 where every loop exceeds the limit, to infinity where none does. So they give no median and no dispersion,
and a separated resample counts with the lower of the two for the lower end of an interval, with the upper one for the
upper end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import log_ndtr, ndtr

from abrace_core import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESAMPLES = 400
"""Resamples of the bootstrap."""
CONFIDENCE = 0.95
DISPERSIONS = (0.01, 3.0)
"""Least and greatest dispersion that is fitted."""
GRID = (240, 80)
"""Medians and dispersions at which a fit begins."""
BEYOND = 8.0
"""A median is looked for from the lowest intensity over this to the highest times it."""
STEPS = 25
"""Most steps of Newton's method."""
MATTERS = 1e-10
"""Change of a parameter at which it ends."""


@dataclass(frozen=True)
class FragilityCurve:
    """How likely a limit is exceeded.

    Parameters
    ----------
    intensity
        (intensities,) [m/s^2].
    loops, exceeded
        (intensities,) number of loops, and of those that exceed the limit.
    median, dispersion
        Intensity at which half of them exceed it [m/s^2], and standard deviation of its logarithm; not numbers where
        the counts are separated, or no dispersion of DISPERSIONS fits.
    between
        Intensities between which the median lies as far as separated counts tell [m/s^2]; twice the median elsewhere.
    resampled
        (resamples, 3) ends of the median and dispersion of the bootstrap, for the bands; empty with one motion.
    """

    intensity: NDArray[np.float64]
    loops: NDArray[np.int64]
    exceeded: NDArray[np.int64]
    median: float
    dispersion: float
    between: tuple[float, float]
    resampled: NDArray[np.float64]

    @property
    def fractions(self) -> NDArray[np.float64]:
        """(intensities,) share of the loops that exceed the limit."""
        return self.exceeded / self.loops

    def probability(self, intensity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability of exceeding the limit, at each `intensity` [m/s^2]."""
        return np.asarray(ndtr(np.log(intensity / self.median) / self.dispersion))

    def band(self, intensity: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, intensities) ends of the probability's confidence interval, at each `intensity` [m/s^2]."""
        low, high, dispersions = self.resampled.T[:, :, None]
        lower, upper = _ends()
        with np.errstate(divide="ignore"):  # a median of 0: the probability is 1
            likely, unlikely = (ndtr((np.log(intensity) - np.log(end)) / dispersions) for end in (low, high))
        return np.stack([np.quantile(unlikely, lower, axis=0), np.quantile(likely, upper, axis=0)])

    def median_interval(self) -> tuple[float, float]:
        """Lower and upper end of the median's confidence interval, not within `between`; without a bootstrap that.

        An end is infinite, or 0, where no loop, or every loop, exceeds the limit.
        """
        if not len(self.resampled):
            return (np.nan, np.nan) if np.isfinite(self.median) else self.between
        ends = zip(self.resampled.T, _ends(), strict=False)
        low, high = (
            np.quantile(each, end, method="inverted_cdf") for each, end in ends
        )  # never between inf and a number
        return min(float(low), self.between[0]), max(float(high), self.between[1])


def fragility_curve(
    intensity: NDArray[np.float64], loops: NDArray[np.int64], exceeded: NDArray[np.int64]
) -> FragilityCurve:
    """Fit a curve to counts.

    Parameters
    ----------
    intensity
        (intensities,) above 0, rising [m/s^2].
    loops, exceeded
        (motions, intensities) number of loops of each motion, and of those that exceed the limit.

    Raises
    ------
    AbraceError
        If the shapes do not fit, or no motion has a loop.
    """
    loops, exceeded = np.asarray(loops), np.asarray(exceeded)
    if loops.shape != exceeded.shape or loops.ndim != 2 or loops.shape[1] != len(intensity) or not loops.any():
        raise AbraceError(
            f"fragility curve: counts of shapes {loops.shape} and {exceeded.shape} at {len(intensity)} intensities, "
            "expected (motions, intensities), and a loop or more"
        )
    motions = len(loops)
    all_loops, all_exceeded = loops.sum(axis=0), exceeded.sum(axis=0)
    ((low, high, dispersion),) = _fits(intensity, all_loops[None], all_exceeded[None])
    resampled = np.zeros((0, 3))
    if motions > 1 and 0 < all_exceeded.sum() < all_loops.sum():
        drawn = np.random.default_rng(0).multinomial(motions, np.full(motions, 1 / motions), RESAMPLES)
        drawn = drawn[(drawn @ loops).any(axis=1)]
        resampled = _fits(intensity, drawn @ loops, drawn @ exceeded)
    found = (low, dispersion) if low == high else (np.nan, np.nan)
    median, dispersion = map(float, found)
    between = float(low), float(high)
    return FragilityCurve(intensity, all_loops, all_exceeded, median, dispersion, between, resampled)


def _fits(intensity: NDArray[np.float64], loops: NDArray, exceeded: NDArray) -> NDArray[np.float64]:
    """(rows, 3) ends of the median, and dispersion, of greatest likelihood for rows of counts (rows, intensities).

    The ends are one number but where the counts do not determine it; the dispersion is then the least of DISPERSIONS.
    """
    x = np.log(intensity)
    medians = np.linspace(x[0] - np.log(BEYOND), x[-1] + np.log(BEYOND), GRID[0])
    dispersions = np.geomspace(*DISPERSIONS, GRID[1])
    eta = ((x - medians[:, None])[:, None] / dispersions[:, None]).reshape(-1, len(x))
    likelihood = exceeded @ log_ndtr(eta).T + (loops - exceeded) @ log_ndtr(-eta).T
    best = likelihood.argmax(axis=1)
    found = np.stack([medians[best // GRID[1]], dispersions[best % GRID[1]]], axis=1)
    for _ in range(STEPS):
        step = _newton_step(x, loops, exceeded, found)
        tried = np.stack([found[:, 0] + step[:, 0], np.clip(found[:, 1] + step[:, 1], *DISPERSIONS)], axis=1)
        better = _likelihood(x, loops, exceeded, tried) >= _likelihood(x, loops, exceeded, found)
        change = np.abs(tried - found).max(axis=1)
        found[better] = tried[better]
        if not (better & (change > MATTERS)).any():
            break
    low, high, separated = _separation(intensity, loops, exceeded)
    median, (least, most) = np.exp(found[:, 0]), DISPERSIONS
    unknown = separated | (found[:, 1] <= least) | (found[:, 1] >= most)
    low, high = np.where(unknown, low, median), np.where(unknown, high, median)
    return np.stack([low, high, np.where(unknown, least, found[:, 1])], axis=1)


def _separation(
    intensity: NDArray[np.float64], loops: NDArray, exceeded: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """(rows,) intensities between which the median lies as the order of the counts tells, and if they are separated.

    That is from the last intensity below which no loop exceeds the limit to the first above which all do.
    """
    count = len(intensity)
    some, not_all = exceeded > 0, exceeded < loops
    first = np.where(some.any(axis=1), some.argmax(axis=1), count)
    last = np.where(not_all.any(axis=1), count - 1 - not_all[:, ::-1].argmax(axis=1), -1)
    ends = np.array([0.0, *intensity, np.inf])
    # of one intensity that some loops exceed and others do not the neighbours
    low = np.where(last < first, last, first - 1)
    high = np.where(last < first, first, last + 1)
    return ends[low + 1], ends[high + 1], last <= first


def _likelihood(x: NDArray, loops: NDArray, exceeded: NDArray, found: NDArray) -> NDArray[np.float64]:
    eta = (x - found[:, :1]) / found[:, 1:]
    return np.sum(exceeded * log_ndtr(eta) + (loops - exceeded) * log_ndtr(-eta), axis=1)


def _newton_step(x: NDArray, loops: NDArray, exceeded: NDArray, found: NDArray) -> NDArray[np.float64]:
    """A step of Fisher's scoring, in ln median and dispersion, (rows, 2)."""
    eta = (x - found[:, :1]) / found[:, 1:]
    density = np.exp(-(eta**2) / 2) / np.sqrt(2 * np.pi)
    below, above = np.maximum(ndtr(eta), 1e-300), np.maximum(ndtr(-eta), 1e-300)
    score = density * (exceeded / below - (loops - exceeded) / above)
    weight = loops * density**2 / (below * above)
    slopes = np.stack([np.broadcast_to(-1 / found[:, 1:], eta.shape), -eta / found[:, 1:]], axis=2)
    gradient = np.einsum("rk,rki->ri", score, slopes)
    information = np.einsum("rk,rki,rkj->rij", weight, slopes, slopes)
    information += 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-12 * np.eye(2)
    return np.asarray(np.linalg.solve(information, gradient[:, :, None])[:, :, 0])


def _ends() -> tuple[float, float]:
    return (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2
