# SPDX-License-Identifier: Apache-2.0
"""The likelihood of recorded tests near given modes, to second order; `maximum_likelihood` maximises it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_sysid.fitting.condensed_lines import condensed
from abrace_sysid.fitting.modes import LEAST_DELAY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.condensed_lines import CondensedLines
    from abrace_sysid.fitting.modes import Modes
    from abrace_sysid.fitting.observation import Observation

FASTEST = 8.0
"""Greatest decay (or growth) of a pole within a sample, as exponent: a sampled rig shows no faster poles."""

DEGENERATE = 1e-12
"""Two poles coincide if the share of a basis column that is independent of the others is less than this."""

LEAST_DAMPING = 1e-11
"""A parameter is indistinguishable from others if the independent share of its curvature is less than this."""

REWEIGHTINGS = 8
"""Most iterations of a channel's fit to several tests; each uses the noise levels of the iteration before."""

SAME_NOISE = 1e-3
"""Relative change of these levels that ends the iterations."""


@dataclass(frozen=True)
class _Channel:
    """One channel in all tests: its coefficients, noise power in each test, residuals and derivatives."""

    coefficients: NDArray[np.float64]
    power: NDArray[np.float64]
    residual: NDArray[np.float64]
    slopes: NDArray[np.float64]
    projection: NDArray[np.float64]
    triangle: NDArray[np.float64]


@dataclass(frozen=True)
class Likelihood:
    """The likelihood of all tests near given modes.

    Parameters
    ----------
    modes
        The modes at which it is computed.
    normal, gradient
        Hessian, in the Gauss-Newton approximation, and gradient of half the cost; parameters of `Modes.parameters`.
    cost
        -2 log likelihood, minus a constant.
    """

    modes: Modes
    tests: tuple[CondensedLines, ...]
    channels: tuple[_Channel, ...]
    normal: NDArray[np.float64]
    gradient: NDArray[np.float64]
    cost: float

    @classmethod
    def at(
        cls, observations: Sequence[Observation], inputs: Sequence[str], modes: Modes, near: Likelihood | None = None
    ) -> Likelihood | None:
        """Compute it; None if poles coincide or are too fast, or a pair has crossed the real axis.

        Parameters
        ----------
        inputs
        observations
            The tests.
        modes
            The modes at which it is computed.
        near
            The likelihood at modes nearby, whose noise levels the channels' fits begin with.
        """
        exponents = modes.poles * observations[0].samplings[0].sample_period
        highest = 10 * np.pi if observations[0].samplings[0].hold == "band" else np.pi
        slow_enough = (np.abs(exponents.real) <= FASTEST * (1 + 1e-9)) & (np.abs(exponents.imag) < highest)
        if not (slow_enough & (modes.poles != 0)).all():
            return None
        tests = condensed(observations, inputs, modes)
        parameters = modes.size
        channels = fit_channels(tests, parameters, [channel.power for channel in near.channels] if near else None)
        if channels is None:
            return None
        normal, gradient, cost = np.zeros((parameters, parameters)), np.zeros(parameters), 0.0
        for channel in channels:
            normal += channel.slopes.T @ channel.slopes
            gradient += channel.slopes.T @ channel.residual
            lines = np.array([test.observation.weight * len(test.measured) for test in tests])
            cost += float(lines @ np.log(np.maximum(channel.power, np.finfo(float).tiny)))
        if not np.diag(normal).min() > 0:
            return None
        return cls(modes, tests, channels, normal, gradient, cost)

    @property
    def free(self) -> NDArray[np.bool_]:
        """(parameters,) whether a parameter is free: all except those of fixed poles."""
        free = np.ones(len(self.gradient), dtype=np.bool_)
        for mode, direction, columns in self.modes.parameters():
            if direction is None and self.modes.fixed[mode]:
                free[columns] = False
        return free

    def step(self, damping: float, fastest: float) -> NDArray[np.float64]:
        """Levenberg-Marquardt step of the parameters; `damping` is a share of each parameter's own curvature.

        A real pole at the limit `fastest` [rad/s] does not become faster, and a delay of zero does not become negative.
        """
        free = self.free
        for i, column in self.modes.delay_columns().items():
            if self.modes.delays[i] <= LEAST_DELAY and self.gradient[column] < 0:
                free[column] = False
        for mode, direction, columns in self.modes.parameters():
            if direction is None and self.modes.poles[mode] == -fastest and self.gradient[columns.start] < 0:
                free[columns] = False
        unit = 1 / np.sqrt(np.diag(self.normal)[free])
        scaled = self.normal[np.ix_(free, free)] * np.outer(unit, unit)
        step = np.zeros(len(free))
        step[free] = unit * linalg.solve(
            scaled + max(damping, LEAST_DAMPING) * np.eye(len(unit)), unit * self.gradient[free], assume_a="pos"
        )
        return step

    def size(self, step: NDArray[np.float64]) -> float:
        """Length of a step in standard deviations."""
        return float(np.sqrt(step @ self.normal @ step))

    def inverse(self) -> NDArray[np.float64]:
        """Inverse of the normal matrix, with zeros for fixed parameters; indistinguishable parameters are damped."""
        free = np.ix_(self.free, self.free)
        unit = 1 / np.sqrt(np.diag(self.normal)[self.free])
        found = np.zeros_like(self.normal)
        values, vectors = np.linalg.eigh(self.normal[free] * np.outer(unit, unit))
        found[free] = (vectors / np.maximum(values, LEAST_DAMPING)) @ vectors.T * np.outer(unit, unit)
        return found


def fit_channels(
    tests: Sequence[CondensedLines], parameters: int, powers: Sequence[NDArray[np.float64]] | None = None
) -> tuple[_Channel, ...] | None:
    """Fit every channel to all `tests`: coefficients, and residuals and derivatives in units of the channel's noise.

    Parameters
    ----------
    parameters
        Number of parameters of the modes.
    powers
        Of each channel, the noise power in each test with which the fit begins; None: the power of the channel.

    Returns
    -------
    tuple of _Channel or None
        None if the basis is degenerate.
    """
    total = 1 + max(int(test.columns.max()) for test in tests)
    lines = np.array([len(test.measured) for test in tests])
    counts = np.sqrt([test.observation.weight for test in tests])
    # only the first rows of the triangular factor belong to the basis: the rows below are orthogonal to it
    sizes = [test.basis.shape[1] for test in tests]
    ends = np.cumsum([*sizes, *(len(test.small) - size for test, size in zip(tests, sizes, strict=True))])
    of_test = np.tile(np.arange(len(tests)), 2)
    above = int(ends[len(tests) - 1])

    def ordered(parts: Sequence[NDArray[np.float64]], relative: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rows of all tests, divided by their relative noise; those of the bases first."""
        weighted = [part / weight for part, weight in zip(parts, relative, strict=True)]
        tops = [part[:size] for part, size in zip(weighted, sizes, strict=True)]
        return np.concatenate([*tops, *(part[size:] for part, size in zip(weighted, sizes, strict=True))])

    one = _factor(tests, 1 / counts, total) if len(tests) == 1 else None
    found = []
    for c in range(tests[0].measured.shape[1]):
        small = [test.parts[2][:, c] for test in tests]
        level = np.array([np.linalg.norm(part) for part in small]) / np.sqrt(lines)
        if powers is not None:
            level = np.sqrt(powers[c])
        for _ in range(REWEIGHTINGS):
            relative = level / level[0] / counts
            factor = one if len(tests) == 1 else _factor(tests, relative, total)
            if factor is None:
                return None
            q, r, scale = factor
            left = ordered(small, relative)
            projected = q.T @ left[:above]
            left[:above] -= q @ projected
            power = np.zeros(len(tests))
            for test, piece in zip(of_test, np.split(left, ends[:-1]), strict=True):
                power[test] += piece @ piece
            power /= lines
            level = np.maximum(relative * np.sqrt(power), np.finfo(float).tiny)
            if np.abs(level / level[0] / counts / relative - 1).max() < SAME_NOISE:
                break
        coefficients = linalg.solve_triangular(r, projected) / scale
        slopes = ordered([(test.derivatives(coefficients, parameters) @ test.parts[1].T).T for test in tests], relative)
        on_basis = q.T @ slopes[:above]
        projection = linalg.solve_triangular(r, on_basis) / scale[:, None]
        unit = level[0]
        slopes[:above] -= q @ on_basis
        found.append(_Channel(coefficients, level**2, left / unit, slopes / unit, projection, r * scale / unit))
    return tuple(found)


def _factor(
    tests: Sequence[CondensedLines], relative: NDArray[np.float64], total: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Q, R and column scales of the tests' stacked bases, each divided by its relative noise."""
    blocks = []
    for test, weight in zip(tests, relative, strict=True):
        rows = test.basis.shape[1]
        block = np.zeros((rows, total))
        block[:, test.columns] = test.parts[0][:rows] / weight
        blocks.append(block)
    above = np.vstack(blocks)
    scale = np.linalg.norm(above, axis=0)
    scale[scale == 0] = 1.0
    q, r = np.linalg.qr(above / scale)
    if not np.abs(np.diag(r)).min() > DEGENERATE:
        return None
    return q, r, scale
