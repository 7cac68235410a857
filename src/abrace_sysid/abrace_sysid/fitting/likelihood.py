# SPDX-License-Identifier: Apache-2.0
"""The likelihood of recorded tests near given modes, to second order; `maximum_likelihood` maximises it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_sysid.fitting.condensed_lines import condensed
from abrace_sysid.fitting.modes import LEAST_DELAY
from abrace_sysid.fitting.observation import names_of

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
    """One channel in all tests: coefficients, noise power in each test, residuals and derivatives.

    `places` are its columns in the tests; -1: not measured, where the noise power is 1.
    """

    places: NDArray[np.int64]
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


class _Stack:
    """The rows of the tests that measure a channel, one above the other: those of their bases, then all others."""

    def __init__(self, tests: Sequence[CondensedLines]) -> None:
        self.tests = tests
        self.columns = np.unique(np.concatenate([test.columns for test in tests]))
        """Indices of the coefficients that the tests have."""
        self.lines = np.array([len(test.measured) for test in tests])
        self.counts = np.sqrt([test.observation.weight for test in tests])
        # only the first rows of a triangular factor belong to the basis: the rows below are orthogonal to it
        self._sizes = [test.basis.shape[1] for test in tests]
        beneath = (len(test.small) - size for test, size in zip(tests, self._sizes, strict=True))
        self._ends = np.cumsum([*self._sizes, *beneath])
        self.above = int(self._ends[len(tests) - 1])
        self._alone = self._factor(1 / self.counts) if len(tests) == 1 else None

    def ordered(self, parts: Sequence[NDArray[np.float64]], relative: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rows of all tests, divided by their relative noise."""
        weighted = [part / weight for part, weight in zip(parts, relative, strict=True)]
        both = list(zip(weighted, self._sizes, strict=True))
        return np.concatenate([*(part[:size] for part, size in both), *(part[size:] for part, size in both)])

    def power(self, left: NDArray[np.float64]) -> NDArray[np.float64]:
        """(tests,) mean square of these rows of each test."""
        pieces = [piece @ piece for piece in np.split(left, self._ends[:-1])]
        return np.asarray(np.array(pieces).reshape(2, -1).sum(axis=0) / self.lines)

    def factor(
        self, relative: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
        """Q, R and column scales of the stacked bases, each divided by its test's relative noise."""
        return self._factor(relative) if len(self.tests) > 1 else self._alone

    def _factor(
        self, relative: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
        blocks = []
        for test, weight in zip(self.tests, relative, strict=True):
            rows = test.basis.shape[1]
            block = np.zeros((rows, len(self.columns)))
            block[:, np.searchsorted(self.columns, test.columns)] = test.parts[0][:rows] / weight
            blocks.append(block)
        above = np.vstack(blocks)
        scale = np.linalg.norm(above, axis=0)
        scale[scale == 0] = 1.0
        q, r = np.linalg.qr(above / scale)
        if not np.abs(np.diag(r)).min() > DEGENERATE:
            return None
        return q, r, scale


def fit_channels(
    tests: Sequence[CondensedLines], parameters: int, powers: Sequence[NDArray[np.float64]] | None = None
) -> tuple[_Channel, ...] | None:
    """Fit every channel to the `tests` that measure it: coefficients, residuals and derivatives in units of its noise.

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
    stacks: dict[tuple[int, ...], _Stack] = {}
    found = []
    for c, name in enumerate(names_of([test.observation for test in tests])[1]):
        places = np.array([(*test.observation.outputs, name).index(name) for test in tests])
        having = tuple(i for i, test in enumerate(tests) if places[i] < len(test.observation.outputs))
        if having not in stacks:
            stacks[having] = _Stack([tests[i] for i in having])
        stack, own = stacks[having], list(having)
        small = [tests[i].parts[2][:, places[i]] for i in own]
        level = np.array([np.linalg.norm(part) for part in small]) / np.sqrt(stack.lines)
        if powers is not None:
            level = np.sqrt(powers[c][own])
        for _ in range(REWEIGHTINGS):
            relative = level / level[0] / stack.counts
            factor = stack.factor(relative)
            if factor is None:
                return None
            q, r, scale = factor
            left = stack.ordered(small, relative)
            projected = q.T @ left[: stack.above]
            left[: stack.above] -= q @ projected
            level = np.maximum(relative * np.sqrt(stack.power(left)), np.finfo(float).tiny)
            if np.abs(level / level[0] / stack.counts / relative - 1).max() < SAME_NOISE:
                break
        coefficients, projection = np.zeros(total), np.zeros((total, parameters))
        coefficients[stack.columns] = linalg.solve_triangular(r, projected) / scale
        changes = [(test.derivatives(coefficients, parameters) @ test.parts[1].T).T for test in stack.tests]
        slopes = stack.ordered(changes, relative)
        on_basis = q.T @ slopes[: stack.above]
        projection[stack.columns] = linalg.solve_triangular(r, on_basis) / scale[:, None]
        unit = level[0]
        slopes[: stack.above] -= q @ on_basis
        triangle, power = np.eye(total), np.ones(len(tests))
        triangle[np.ix_(stack.columns, stack.columns)] = r * scale / unit
        power[own] = level**2
        of_tests = np.full(len(tests), -1)
        of_tests[own] = places[own]
        found.append(_Channel(of_tests, coefficients, power, left / unit, slopes / unit, projection, triangle))
    return tuple(found)
