# SPDX-License-Identifier: Apache-2.0
"""Modes by maximum likelihood, from one test or from several at once, with the covariance of their poles.

At the lines k of a test the model is exact, leakage included:

    Y(k) = C sum over inputs of X(z_k) U(k) + D U(k) + T(z_k) + V(k),

where X are the states of the modes, each input drives each mode by its own factor, and the transient T has the same
poles (`pole_basis`). A mode has the same shape for all inputs: the residues of several inputs are of rank one, and the
model is minimal. Given the poles and, with several inputs, each mode's ratios between them, all other unknowns are
linear and real: shapes, which all tests share, direct terms and transients. These are eliminated (variable projection,
Golub and Pereyra 1973, in Kaufman's form of 1975), and Levenberg-Marquardt steps change only poles and ratios. The
computing time of a step is proportional to the lines and hardly depends on the channels.

The noise V is independent from line to line. Its level in each channel of each test is unknown and concentrated out of
the likelihood: the sum over tests and channels of n log(residual sum of squares) is minimised. Between channels it is
correlated, since the measured input's noise passes through the structure to all of them. The covariance of the poles
allows for that, for coloured noise and for nonlinear distortion, without a model of them (`covariance`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from abrace_core import AbraceError
from abrace_sysid.fitting.condensed_lines import direct_terms
from abrace_sysid.fitting.covariance import covariance, inflation, of_entries
from abrace_sysid.fitting.curve_fit import UnstablePolesError, require_stable
from abrace_sysid.fitting.likelihood import FASTEST, Likelihood
from abrace_sysid.fitting.modes import modes_of, starting_modes
from abrace_sysid.fitting.observation import names_of
from abrace_sysid.fitting.pole_estimate import PoleEstimate, columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.modes import Modes
    from abrace_sysid.fitting.observation import Observation

ITERATIONS = 150

FEW_LINES = 2000
"""Tests with more than twice as many lines are first fitted at about this number, for better starting values."""

CONVERGED = 0.01
"""A step of this length, in standard deviations of the parameters, ends the iterations."""

INSIGNIFICANT = 0.1
"""So does a step that lowers -2 log likelihood by less; a chi-square of one degree of freedom has a mean of 1."""

ROUGH = 2.0
"""The same for starting values. Trials of orders end as fits do: ended so early they find modes that are none."""


def fit_poles(
    observations: Sequence[Observation],
    start: NDArray[np.complex128] | PoleEstimate,
    driven: NDArray[np.bool_] | None = None,
    fixed: NDArray[np.bool_] | None = None,
    most: int = ITERATIONS,
    spread: Literal["none", "modes", "joint"] = "modes",
    delays: NDArray[np.float64] | None = None,
) -> PoleEstimate:
    """Fit modes, common to all tests, by maximum likelihood, with the covariance of their poles.

    Parameters
    ----------
    observations
        The tests; each can have its own outputs.
    start
        Starting poles [rad/s], of each pair the one above the real axis, and real ones; they keep their order.
        They must be right within a few half-power bandwidths, as those of `vector_fitting` are. Or the fit of tests
        with the same inputs, whose drives and delays are started from, too.
    driven
        (poles, inputs) whether an input can drive a mode, inputs in the order of their first appearance in the tests;
        None: all inputs of the tests that show the mode.
    fixed
        (poles,) whether a pole is fixed; None: none is.
    most
        Greatest number of iterations; 0: the poles stay, shapes and drives are fitted to them.
    spread
        Which covariance to compute: "modes", of poles and drives; "joint", also of shapes and direct terms; "none" for
        a trial: the covariance is NaN.
    delays
        (inputs,) starting values of the delays [s] of inputs without direct terms; 0: no delay, which stays fixed. NaN:
        an input with direct terms. None: all inputs have direct terms.

    Raises
    ------
    AbraceError
        If the tests have too few lines, the steps do not converge, or a pole found is unstable.
    """
    poles = np.array(start.poles if isinstance(start, PoleEstimate) else start, dtype=np.complex128)
    if not len(poles) or not np.isfinite(poles).all() or (poles.imag < 0).any():
        raise AbraceError(f"maximum likelihood: start {poles}, expected upper poles of pairs and real poles")
    for observation in observations:
        if not set(observation.poles or ()) <= set(range(len(poles))):
            raise AbraceError(f"{observation.source}: poles {observation.poles}, expected within 0 to {len(poles) - 1}")
    inputs, outputs = names_of(observations)
    where = ", ".join(dict.fromkeys(observation.source for observation in observations))
    many = max(len(observation.z) for observation in observations) > 2 * FEW_LINES
    few = [observation.thinned(FEW_LINES) for observation in observations] if many else observations
    if isinstance(start, PoleEstimate):
        modes, unit = modes_of(start)
    else:
        modes, unit = starting_modes(few, inputs, poles, driven, fixed, delays)
    observations, few = (
        [observation.in_units(dict(zip(inputs, unit, strict=True))) for observation in each]
        for each in (observations, few)
    )
    if many and most and not isinstance(start, PoleEstimate):
        near, converged, _ = _climbed(few, inputs, modes, most, ROUGH)
        modes = near.modes if near is not None and converged else modes
    likelihood, converged, iterations = _climbed(observations, inputs, modes, most, INSIGNIFICANT)
    if likelihood is None or not (converged or most == 0):
        raise AbraceError(
            f"{where}: no maximum of the likelihood found in {iterations} steps from the poles {_named(poles)} rad/s; "
            "other starting poles, fewer poles or a narrower band may help"
        )
    found = likelihood.modes
    require_stable(found.poles, where)
    # weights allow for information on the modes that channels share; each channel's shapes are its own information
    alike = likelihood
    if any(one.weight != 1 for one in observations):
        alike = Likelihood.at([replace(one, weight=1.0) for one in observations], inputs, found) or likelihood
    coefficients = np.array([one.coefficients for one in alike.channels])
    size = len(likelihood.gradient)
    unknowns = sum(int(np.count_nonzero(one.coefficients) + np.sum(one.places >= 0)) for one in likelihood.channels)
    whole = np.full((size, size), np.nan)
    if spread != "none":
        whole = covariance(likelihood, alike if spread == "joint" else None)
    of_modes = whole[:size, :size]
    return PoleEstimate(
        found.poles,
        of_modes,
        likelihood.cost,
        sum(observation.measured.size for observation in observations) * 2,
        size + unknowns,
        inputs,
        outputs,
        found.drive / unit,
        _shapes(found.poles, coefficients),
        _direct(observations, inputs, found, coefficients) / unit,
        np.where(found.direct, np.nan, found.delays),
        inflation(likelihood, of_modes) if spread != "none" else 1.0,
        of_entries(likelihood, whole, inputs, unit) if spread == "joint" else None,
    )


def fit_again(
    observations: Sequence[Observation], start: PoleEstimate, spread: Literal["none", "modes", "joint"] = "modes"
) -> PoleEstimate:
    """As `fit_poles` with the modes of an earlier fit, without those that become unstable or are not sure: no modes.

    A pair of an order search may stand for a few lines that were not linear, or noisier than others.

    Parameters
    ----------
    observations, spread
        As for `fit_poles`.
    start
        The earlier fit, of tests with the same inputs.

    Raises
    ------
    AbraceError
        As `fit_poles`.
    """
    try:
        found = fit_poles(observations, start, spread=spread)
    except UnstablePolesError as error:
        kept = ~error.unstable
        if not kept.any():
            raise
    else:
        unsure = [pair.frequency for pair in found.pairs() if not pair.is_sure]
        kept = np.array([not np.isclose(abs(pole), unsure, rtol=1e-12).any() for pole in found.poles])
        if kept.all() or not kept.any():
            return found
    return fit_poles(observations, start.poles[kept], start.drive[kept] != 0, spread=spread, delays=start.delays)


def _climbed(
    observations: Sequence[Observation], inputs: Sequence[str], modes: Modes, most: int, insignificant: float
) -> tuple[Likelihood | None, bool, int]:
    """The likelihood at the end of the iterations, whether these have converged, and the number of steps."""
    likelihood = Likelihood.at(observations, inputs, modes)
    fastest = FASTEST / observations[0].samplings[0].sample_period
    damping, converged, iterations = 1e-3, likelihood is None, 0
    while likelihood is not None and not converged and iterations < most:
        iterations += 1
        step = likelihood.step(damping, fastest)
        small = likelihood.size(step) < CONVERGED
        after = Likelihood.at(observations, inputs, likelihood.modes.moved(step, fastest), likelihood)
        if after is not None and after.cost < likelihood.cost:
            small = small or likelihood.cost - after.cost < insignificant
            likelihood, damping, converged = after, damping / 10, small
        else:
            damping, converged = 10 * max(damping, 1e-5), small and damping < 1e-2
    return likelihood, converged, iterations


def _shapes(poles: NDArray[np.complex128], coefficients: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(channels, poles) complex shapes: a channel is the real part of shape times state, summed over modes."""
    shapes = np.empty((len(coefficients), len(poles)), dtype=np.complex128)
    for mode, columns in enumerate(columns_of(poles)):
        parts = coefficients[:, columns]
        shapes[:, mode] = parts[:, 0] + (1j * parts[:, 1] if parts.shape[1] == 2 else 0)
    return shapes


def _direct(
    observations: Sequence[Observation], inputs: Sequence[str], modes: Modes, coefficients: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(channels, inputs) direct terms; for each input, those of the test that shows most modes."""
    direct = np.zeros((len(coefficients), len(inputs)))
    groups, _ = direct_terms(observations, inputs, modes)
    for (names, _), first in sorted(groups.items(), key=lambda item: len(item[0][1])):
        own = [i for i in map(inputs.index, names) if modes.direct[i]]
        direct[:, own] = coefficients[:, first : first + len(own)]
    return direct


def _named(poles: NDArray[np.complex128]) -> str:
    return ", ".join(f"{pole.real:.4g}{pole.imag:+.4g}i" if pole.imag else f"{pole.real:.4g}" for pole in poles)
