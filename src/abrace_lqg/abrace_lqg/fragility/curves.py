# SPDX-License-Identifier: Apache-2.0
"""Fragility curves: the probability that a limit is exceeded, over the intensity of the ground motion.

P(exceeded | im) = Phi(ln(im / median) / dispersion), fitted by maximum likelihood to how many of the loops at each
intensity exceed the limit (Baker 2015). The loops of one ground motion are no independent
observations: many models and all intensities share it. So the confidence bands come from a bootstrap of the motions,
whose loops are drawn together. A resample in which no loop exceeds the limit has an infinite median, and one in which
all do has a median of 0. They count like the others, so an end of the median's interval can be infinite or 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import log_ndtr, ndtr

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESAMPLES = 400
"""Of the bootstrap."""
CONFIDENCE = 0.95
DISPERSIONS = (0.01, 3.0)
"""Least and greatest dispersion that is fitted."""
GRID = (240, 80)
"""Medians and dispersions at which a fit begins."""
BEYOND = 8.0
"""A median is looked for from the lowest intensity over this to the highest times it."""
STEPS = 25
"""Of Newton's method, at most."""
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
        Intensity at which half of them exceed it [m/s^2], and standard deviation of its logarithm; not numbers where no
        loop exceeds the limit, or all do.
    resampled
        (resamples, 2) medians and dispersions of the bootstrap, for the bands; empty with one motion. A median is
        infinite where no loop of a resample exceeds the limit, 0 where all do; the dispersion has no meaning there.
    """

    intensity: NDArray[np.float64]
    loops: NDArray[np.int64]
    exceeded: NDArray[np.int64]
    median: float
    dispersion: float
    resampled: NDArray[np.float64]

    @property
    def fractions(self) -> NDArray[np.float64]:
        """(intensities,) share of the loops that exceed the limit."""
        return self.exceeded / self.loops

    def probability(self, intensity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of exceeding the limit, at each `intensity` [m/s^2]."""
        return np.asarray(ndtr(np.log(intensity / self.median) / self.dispersion))

    def band(self, intensity: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, intensities) ends of the probability's confidence interval, at each `intensity` [m/s^2]."""
        medians, dispersions = self.resampled.T[:, :, None]
        with np.errstate(divide="ignore"):  # a median of 0: the probability is 1
            logarithms = np.log(medians)
        return np.quantile(ndtr((np.log(intensity) - logarithms) / dispersions), _ends(), axis=0)

    def median_interval(self) -> tuple[float, float]:
        """Lower and upper end of the median's confidence interval; not numbers without a bootstrap.

        An end is infinite, or 0, where it falls among resamples in which no loop, or every loop, exceeds the limit.
        """
        if not len(self.resampled):
            return np.nan, np.nan
        low, high = np.quantile(self.resampled[:, 0], _ends(), method="inverted_cdf")  # never between inf and a number
        return float(low), float(high)


def fragility_curve(
    intensity: NDArray[np.float64], loops: NDArray[np.int64], exceeded: NDArray[np.int64], seed: int = 0
) -> FragilityCurve:
    """Fit a curve to counts.

    Parameters
    ----------
    intensity
        (intensities,) above 0, rising [m/s^2].
    loops, exceeded
        (motions, intensities) number of loops of each motion, and of those that exceed the limit.
    seed
        Of the bootstrap.

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
    median, dispersion = _fits(intensity, all_loops[None], all_exceeded[None])[0]
    resampled = np.zeros((0, 2))
    if not all_exceeded.any() or np.array_equal(all_exceeded, all_loops):
        median = dispersion = np.nan
    elif motions > 1:
        drawn = np.random.default_rng(seed).multinomial(motions, np.full(motions, 1 / motions), RESAMPLES)
        drawn = drawn[(drawn @ loops).any(axis=1)]
        resampled = _fits(intensity, drawn @ loops, drawn @ exceeded)
    return FragilityCurve(intensity, all_loops, all_exceeded, float(median), float(dispersion), resampled)


def _fits(intensity: NDArray[np.float64], loops: NDArray, exceeded: NDArray) -> NDArray[np.float64]:
    """(rows, 2) medians and dispersions of greatest likelihood for rows of counts (rows, intensities).

    The median is infinite where no loop exceeds the limit, and 0 where all do.
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
    found[:, 0] = np.exp(found[:, 0])
    total, of_all = exceeded.sum(axis=1), loops.sum(axis=1)
    found[total == of_all] = 0.0, DISPERSIONS[0]
    found[total == 0] = np.inf, DISPERSIONS[0]
    return found


def _likelihood(x: NDArray, loops: NDArray, exceeded: NDArray, found: NDArray) -> NDArray[np.float64]:
    eta = (x - found[:, :1]) / found[:, 1:]
    return np.sum(exceeded * log_ndtr(eta) + (loops - exceeded) * log_ndtr(-eta), axis=1)


def _newton_step(x: NDArray, loops: NDArray, exceeded: NDArray, found: NDArray) -> NDArray[np.float64]:
    """Of Fisher's scoring, in ln median and dispersion, (rows, 2)."""
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
