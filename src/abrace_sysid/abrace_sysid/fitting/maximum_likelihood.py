"""Poles by maximum likelihood, from one test or from several at once, with their covariance.

At the lines k of a test the model is exact, leakage included:

    Y(k) = sum over inputs of G(z_k) U(k) + T(z_k) + V(k),

where the transfer functions G and the transient T share their poles (`pole_basis`). Given the poles everything else is
linear and real: two coefficients of each pair and one of each real pole, for each channel and input, as many for the
transient, and a direct term. They are projected out by one orthogonal factorisation for all channels (variable
projection, Golub and Pereyra 1973, in Kaufman's form of 1975), and Levenberg-Marquardt steps move the poles alone.
The cost of a step grows linearly with the lines and hardly with the channels.

The noise V is independent from line to line and of one level in each channel, unknown, concentrated out of the
likelihood: the sum over channels of n log(residual sum of squares) is minimised. From channel to channel it is
correlated, since the measured input's noise passes through the structure to all of them. The covariance of the poles
allows for that, and for coloured noise, without a model of them: it is summed from each line's own residuals (Huber
1967, White 1980; a line is a cluster).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.curve_fit import require_stable
from abrace_sysid.fitting.pole_estimate import PoleEstimate, columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation

ITERATIONS = 60

CONVERGED = 0.01
"""A step that small against the standard deviations of the poles ends the iterations."""

FASTEST = 20.0
"""Greatest decay (or growth) of a pole within a sample, as exponent: faster ones are no poles of a sampled rig."""


def fit_poles(observations: Sequence[Observation], start: NDArray[np.complex128]) -> PoleEstimate:
    """The poles that make tests most likely, the same poles in all of them, with their covariance.

    Parameters
    ----------
    observations
        The tests.
    start
        Starting poles [rad/s], of each pair the one above the real axis, and real ones; they keep their order.
        They must be right within a few half-power bandwidths, as those of `vector_fitting` are.

    Raises
    ------
    AbraceError
        If the tests have too few lines, the steps do not converge, or a pole found is unstable.
    """
    poles = np.array(start, dtype=np.complex128)
    if not len(poles) or not np.isfinite(poles).all() or (poles.imag < 0).any():
        raise AbraceError(f"maximum likelihood: start {poles}, expected upper poles of pairs and real poles")
    for observation in observations:
        if not set(observation.poles or ()) <= set(range(len(poles))):
            raise AbraceError(f"{observation.source}: poles {observation.poles}, expected within 0 to {len(poles) - 1}")
    where = ", ".join(dict.fromkeys(observation.source for observation in observations))
    likelihood = _Likelihood.at(observations, poles)
    damping, converged, iterations = 1e-3, likelihood is None, 0
    while likelihood is not None and not converged and iterations < ITERATIONS:
        iterations += 1
        step = likelihood.step(damping)
        small = likelihood.size(step) < CONVERGED
        after = _Likelihood.at(observations, _moved(likelihood.poles, step))
        if after is not None and after.cost < likelihood.cost:
            likelihood, damping, converged = after, damping / 10, small
        else:
            damping, converged = 10 * max(damping, 1e-5), small and damping < 1e-2
    if likelihood is None or not converged:
        raise AbraceError(
            f"{where}: no maximum of the likelihood found in {iterations} steps from the poles {_named(poles)} rad/s; "
            "other starting poles, fewer poles or a narrower band may help"
        )
    require_stable(likelihood.poles, where)
    observed = sum(test.residual.size for test in likelihood.tests)
    unknowns = len(likelihood.gradient) + sum(test.unknowns for test in likelihood.tests)
    return PoleEstimate(likelihood.poles, likelihood.covariance(), likelihood.cost, observed, unknowns, iterations)


@dataclass(frozen=True)
class _TestLikelihood:
    """The likelihood of one test near one set of poles, everything but the poles projected out.

    Complex lines are stacked as real ones above imaginary ones: rows = 2 lines. Of each channel `residual` (rows,
    channels) is left over, `power` (channels,) its mean square. `slopes` (rows, states) are the derivatives of the
    basis with the poles, projected off it; `combinations` (channels, states, parameters) make of them the derivatives
    of each channel. `leverage` (lines,) is the share of a line's noise that the coefficients follow, `unknowns` the
    number of coefficients and noise levels.
    """

    residual: NDArray[np.float64]
    power: NDArray[np.float64]
    slopes: NDArray[np.float64]
    combinations: NDArray[np.float64]
    leverage: NDArray[np.float64]
    unknowns: int

    @classmethod
    def at(cls, observation: Observation, poles: NDArray[np.complex128]) -> _TestLikelihood | None:
        """None where the basis is degenerate: two poles that coincide."""
        excited = observation.poles or tuple(range(len(poles)))
        states, derivatives = _basis(observation, poles[list(excited)])
        lines, columns = states.shape
        parameters = columns_of(poles)
        if 2 * lines <= columns + parameters[-1].stop:
            unknowns = columns + parameters[-1].stop
            raise AbraceError(f"{observation.source}: {lines} frequency lines, expected more than {unknowns // 2}")
        weight = 1 / observation.noise_level[:, None]
        measured = _stacked(observation.measured * weight)
        basis, slopes = _stacked(states * weight), _stacked(derivatives * weight)
        scale = np.linalg.norm(basis, axis=0)
        q, r = np.linalg.qr(basis / np.where(scale > 0, scale, 1.0))
        diagonal = np.abs(np.diag(r))
        if not diagonal.min() > 1e-12:
            return None
        projected = q.T @ measured
        residual = measured - q @ projected
        coefficients = linalg.solve_triangular(r, projected) / scale[:, None]
        slopes = slopes - q @ (q.T @ slopes)
        # of a pair, x1 and x2 have the derivatives s1 and s2 with the real part, and s2 and -s1 with the imaginary one
        channels = measured.shape[1]
        combinations = np.zeros((channels, slopes.shape[1], parameters[-1].stop))
        column = 0
        for i in excited:
            first = parameters[i].start
            for _ in range(_drives(observation)):
                if poles[i].imag > 0:
                    one, two = coefficients[column], coefficients[column + 1]
                    combinations[:, column, first], combinations[:, column + 1, first] = one, two
                    combinations[:, column, first + 1], combinations[:, column + 1, first + 1] = -two, one
                    column += 2
                else:
                    combinations[:, column, first] = coefficients[column]
                    column += 1
        power = np.sum(residual**2, axis=0) / (2 * lines)
        leverage = np.sum(q**2, axis=1).reshape(2, lines).mean(axis=0)
        return cls(residual, power, slopes, combinations, leverage, coefficients.size + channels)

    @property
    def cost(self) -> float:
        """-2 log likelihood, less a constant."""
        tiny = np.finfo(float).tiny
        return float(len(self.residual) * np.sum(np.log(np.maximum(self.power, tiny))))

    def normal(self) -> NDArray[np.float64]:
        """(parameters, parameters) sum over channels of J^T J over the noise power."""
        gram, combined = self.slopes.T @ self.slopes, self.combinations
        return np.asarray(np.einsum("cip,ij,cjq,c->pq", combined, gram, combined, 1 / self.power, optimize=True))

    def gradient(self) -> NDArray[np.float64]:
        """(parameters,) sum over channels of J^T r over the noise power."""
        return np.asarray(np.einsum("cip,ic->p", self.combinations, self.slopes.T @ self.residual / self.power))

    def scatter(self) -> NDArray[np.float64]:
        """(parameters, parameters) covariance of the gradient, summed from the lines' own residuals."""
        lines = len(self.residual) // 2
        score = np.zeros((lines, self.combinations.shape[2]))
        for combination, residual, power in zip(self.combinations, self.residual.T, self.power, strict=True):
            single = (self.slopes @ combination) * (residual / power)[:, None]
            score += single[:lines] + single[lines:]
        # corrected for the leverage of each line on its own fit (MacKinnon and White 1985, HC3)
        score /= (1 - np.minimum(self.leverage, 0.9))[:, None]
        return score.T @ score


@dataclass(frozen=True)
class _Likelihood:
    """The likelihood of all tests near one set of poles, to second order."""

    poles: NDArray[np.complex128]
    tests: tuple[_TestLikelihood, ...]
    normal: NDArray[np.float64]
    gradient: NDArray[np.float64]
    cost: float

    @classmethod
    def at(cls, observations: Sequence[Observation], poles: NDArray[np.complex128]) -> _Likelihood | None:
        """None if poles coincide or are too fast, or a pair crosses the real axis: the likelihood is not defined."""
        exponents = poles * observations[0].samplings[0].sample_period
        if not ((np.abs(exponents.real) < FASTEST) & (np.abs(exponents.imag) < np.pi) & (poles != 0)).all():
            return None
        tests = []
        for observation in observations:
            test = _TestLikelihood.at(observation, poles)
            if test is None:
                return None
            tests.append(test)
        normal = np.sum([test.normal() for test in tests], axis=0)
        if not np.diag(normal).min() > 0:
            return None
        gradient = np.sum([test.gradient() for test in tests], axis=0)
        return cls(poles, tuple(tests), normal, gradient, sum(test.cost for test in tests))

    def step(self, damping: float) -> NDArray[np.float64]:
        """Levenberg-Marquardt step of the poles' parts, in units of each part's own curvature."""
        unit = 1 / np.sqrt(np.diag(self.normal))
        scaled = self.normal * np.outer(unit, unit)
        return np.asarray(
            unit * linalg.solve(scaled + damping * np.eye(len(unit)), unit * self.gradient, assume_a="pos")
        )

    def size(self, step: NDArray[np.float64]) -> float:
        """Length of a step in standard deviations."""
        return float(np.sqrt(step @ self.normal @ step))

    def covariance(self) -> NDArray[np.float64]:
        """Of the poles' parts."""
        unit = 1 / np.sqrt(np.diag(self.normal))
        inverse = np.linalg.inv(self.normal * np.outer(unit, unit)) * np.outer(unit, unit)
        scatter = np.sum([test.scatter() for test in self.tests], axis=0)
        return np.asarray(inverse @ scatter @ inverse)


def _drives(observation: Observation) -> int:
    """How many excitations each pole has: the inputs, and the transient."""
    return len(observation.samplings) + observation.transient


def _basis(
    observation: Observation, poles: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(lines, columns) states of all poles to all drives, then direct terms; slopes with the real part."""
    z = observation.z
    inputs = list(zip(observation.samplings, observation.excitation.T, strict=True))
    drives = [(sampling.response, excitation) for sampling, excitation in inputs]
    if observation.transient:
        drives.append((observation.samplings[0].transient, np.ones(len(z), dtype=np.complex128)))
    basis: list[NDArray[np.complex128]] = []
    slopes: list[NDArray[np.complex128]] = []
    for pole in poles:
        for function, drive in drives:
            if pole.imag > 0:
                for columns, above, below in zip(
                    (basis, slopes), function(pole, z), function(pole.conjugate(), z), strict=True
                ):
                    columns += [drive * (above + below) / 2, drive * (above - below) * 0.5j]
            else:
                for columns, single in zip((basis, slopes), function(pole.real, z), strict=True):
                    columns.append(drive * single)
    basis += [excitation for _, excitation in inputs]
    return np.column_stack(basis), np.column_stack(slopes)


def _stacked(lines: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.vstack([lines.real, lines.imag])


def _moved(poles: NDArray[np.complex128], step: NDArray[np.float64]) -> NDArray[np.complex128]:
    moved = poles.copy()
    for i, columns in enumerate(columns_of(poles)):
        parts = step[columns]
        moved[i] += parts[0] + (1j * parts[1] if len(parts) == 2 else 0)
        if len(parts) == 2 and moved[i].imag <= 0:
            moved[i] = np.nan
    return moved


def _named(poles: NDArray[np.complex128]) -> str:
    return ", ".join(f"{pole.real:.4g}{pole.imag:+.4g}i" if pole.imag else f"{pole.real:.4g}" for pole in poles)
