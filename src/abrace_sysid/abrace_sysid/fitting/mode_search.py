# SPDX-License-Identifier: Apache-2.0
"""The search for the modes of an unknown structure: one by one, each kept if it improves the prediction.

The first part of a record is fitted by maximum likelihood. The mode that lowers the cost most, in addition to those
already found, is searched on a grid of frequencies and damping ratios and fitted together with the others. It is kept
if the fit then predicts the rest of the record, which was not used, better (hold-out validation; Ljung 1999, sec.
16.4). A description length would also count the residual of a nonlinear or drifting peak as modes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.condensed_lines import combined, stacked
from abrace_sysid.fitting.maximum_likelihood import ITERATIONS, fit_poles
from abrace_sysid.fitting.pole_basis import sides_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate

DAMPING = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Damping ratios of the grid; 1: a real pole."""

REACH = 20.0
"""Half-width of the range of lines around a mode that show it, in its half-power half-bandwidths."""

LEAST_REACH = 8
"""Least half-width of that range, in lines."""

ABOVE, ABOVE_DAMPING = 1.4, 0.01
"""Frequency, divided by the band's upper edge, and damping ratio of the pairs that represent the modes above it."""

REFUSALS = 12
"""Number of refused candidates in a row that ends the search."""

NARROWEST = 0.5
"""Least half-power bandwidth of a mode, in lines: a narrower peak is not resolved."""

ALIKE = 0.5
"""Greatest distance between a mode's poles from both parts, divided by the sum of their decay rates."""

HEAVIEST = 0.9
"""Greatest damping ratio: beyond it a pair can hardly be distinguished from two real poles."""

TRIAL_ITERATIONS = 30
"""Most steps of a fit with a candidate: a true mode takes about ten."""

NEAR = 0.01
"""Candidates nearer to a refused one than this share of the frequency are not tried."""

NEIGHBOURS = 9
"""Lines over which the level of the residual is averaged."""


def fit_with_residual_terms(
    observation: Observation,
    poles: NDArray[np.complex128],
    iterations: int = ITERATIONS,
    spread: Literal["none", "modes"] = "modes",
) -> PoleEstimate:
    """As `fit_poles`, with residual terms of the modes above the band: one pair with a fixed pole for each input.

    Parameters
    ----------
    observation
        The test.
    poles
        Starting poles [rad/s].
    iterations
        Greatest number of steps.
    spread
        As for `fit_poles`.
    """
    count = len(observation.inputs)
    highest = float(np.angle(observation.z[-1])) / observation.samplings[0].sample_period
    above = np.full(count, ABOVE * highest * complex(-ABOVE_DAMPING, 1))
    fixed = np.arange(len(poles) + count) >= len(poles)
    driven = np.vstack([np.ones((len(poles), count), dtype=np.bool_), np.eye(count, dtype=np.bool_)])
    return fit_poles([observation], np.concatenate([poles, above]), driven, fixed, iterations, spread)


def search_modes(
    halves: tuple[Observation, Observation], most: int, progress: Callable[[int], None] = lambda _pairs: None
) -> NDArray[np.complex128]:
    """(modes,) upper poles of the pairs that help to predict [rad/s].

    Parameters
    ----------
    halves
        Two parts of a record: modes are fitted to each and validated by the other.
    most
        Greatest number of pairs.
    progress
        Called with the number of pairs found.

    Raises
    ------
    AbraceError
        If no pair can be fitted.
    """
    found = [np.zeros(0, dtype=np.complex128) for _ in halves]
    costs = [np.inf for _ in halves]
    residuals = [half.measured / np.sqrt(np.mean(np.abs(half.measured) ** 2, axis=0)) for half in halves]
    refused: list[complex] = []
    reason, grid = "none helps to predict", _Grid(halves[0])
    while len(found[0]) < most and len(refused) < REFUSALS:
        candidate = grid.strongest(residuals[0], refused)
        refused.append(candidate)
        try:
            trials = [
                fit_with_residual_terms(half, np.append(poles, candidate), TRIAL_ITERATIONS, "none")
                for half, poles in zip(halves, found, strict=True)
            ]
            judged = [prediction(trial, half)[0] for trial, half in zip(trials, halves[::-1], strict=True)]
        except AbraceError as error:
            reason = str(error)
            continue
        number = len(found[0])
        better = all(cost < before for cost, before in zip(judged, costs, strict=True))
        if better and _same(trials[0].poles[number], trials[1].poles[number], halves[0].seconds):
            costs, found, refused = judged, [trial.poles[: number + 1] for trial in trials], []
            residuals = [prediction(trial, half)[1] for trial, half in zip(trials, halves, strict=True)]
            progress(number + 1)
    if not len(found[0]):
        raise AbraceError(f"{halves[0].source}: no mode could be fitted: {reason}")
    return np.asarray((found[0] + found[1]) / 2)


def _same(one: complex, other: complex, seconds: float) -> bool:
    """Whether two records of that length show the same mode, and can resolve it."""
    half_widths = abs(one.real) + abs(other.real)
    if HEAVIEST < max(-one.real / abs(one), -other.real / abs(other)) < 1:
        return False
    return half_widths > NARROWEST * 2 * np.pi / seconds and abs(one - other) < ALIKE * half_widths


def prediction(estimate: PoleEstimate, observation: Observation) -> tuple[float, NDArray[np.complex128]]:
    """The error of the prediction of a test; only its transient is fitted.

    Parameters
    ----------
    estimate
        Modes from another test, or from another part of this one.
    observation
        The test to predict.

    Returns
    -------
    cost, residual
        -2 log likelihood, less a constant; (lines, channels) in units of each channel's noise.
    """
    z = observation.z
    named = [estimate.inputs.index(name) for name in observation.inputs]
    simulated = observation.excitation @ estimate.direct[:, named].T
    delays = np.nan_to_num(estimate.delays)[named]
    transients: list[NDArray[np.complex128]] = []
    for mode, pole in enumerate(estimate.poles):
        sides = sides_of(pole)
        states = [
            np.column_stack(
                [
                    excitation * sampling.response(side, z, delay)[0]
                    for sampling, excitation, delay in zip(
                        observation.samplings, observation.excitation.T, delays, strict=True
                    )
                ]
            )
            for side in sides
        ]
        parts = (estimate.shapes[:, mode].real, estimate.shapes[:, mode].imag)
        for state, part in zip(combined(states, estimate.drive[mode, named]), parts, strict=False):
            simulated = simulated + np.outer(state, part)
    for pole in dict.fromkeys(estimate.poles):
        sides = sides_of(pole)
        transients += combined([observation.samplings[0].transient(side, z)[0][:, None] for side in sides], np.ones(1))
    weight = 1 / observation.noise_level[:, None]
    left = stacked((observation.measured - simulated) * weight)
    if observation.transient:
        q, _ = np.linalg.qr(stacked(np.column_stack(transients) * weight))
        left = left - q @ (q.T @ left)
    power = np.maximum(np.mean(left**2, axis=0), np.finfo(float).tiny)
    scaled = left / np.sqrt(power)
    return float(len(left) * np.sum(np.log(power))), scaled[: len(z)] + 1j * scaled[len(z) :]


def weighed(
    observations: Sequence[Observation], estimate: PoleEstimate, neighbours: int = NEIGHBOURS
) -> list[Observation]:
    """Tests whose lines are weighted by the residual of a fit around them, in all channels and tests.

    The residual is larger at a resonance: noise of the measured inputs passes through the structure, and peaks are
    never exactly linear.

    Parameters
    ----------
    observations
        Tests of one kind.
    estimate
        The fit to them.
    neighbours
        Number of lines over which the level of the residual is averaged.
    """
    powers = []
    for one in observations:
        _, residual = prediction(estimate, one)
        powers.append(np.mean(np.abs(residual) ** 2, axis=1))
    power, angle = np.concatenate(powers), np.concatenate([np.angle(one.z) for one in observations])
    order = np.argsort(angle, kind="stable")
    more = np.empty(len(power))
    # without the line itself, whose own error must not reduce its weight
    level = neighbours * uniform_filter1d(power[order], neighbours) - power[order]
    more[order] = np.sqrt(level / (neighbours - 1))
    ends = np.cumsum([len(one.z) for one in observations])[:-1]
    parts = np.split(more, ends)
    levels = [one.noise_level * part for one, part in zip(observations, parts, strict=True)]
    return [one.with_noise(level / np.median(level)) for one, level in zip(observations, levels, strict=True)]


class _Candidate(NamedTuple):
    """A pole of the grid: the lines around its `frequency` [rad/s] that show it, and orthonormal columns of it there.

    A column has the real parts of two real ones, for real and imaginary parts of the lines, in one complex number.
    """

    pole: complex
    frequency: float
    damping: float
    lines: slice
    columns: NDArray[np.complex64]


class _Grid:
    """Poles that may be modes of an `observation`, each alone."""

    def __init__(self, observation: Observation) -> None:
        omega = np.angle(observation.z) / observation.samplings[0].sample_period
        self._spacing = float(np.median(np.diff(omega)))
        self._rows = 2 * len(omega)
        self._candidates = []
        for damping in DAMPING:
            frequency = omega[0]
            while frequency <= omega[-1]:
                pole = frequency * complex(-damping, np.sqrt(1 - damping**2))
                reach = max(REACH * damping * frequency, LEAST_REACH * self._spacing)
                lines = slice(*np.searchsorted(omega, [frequency - reach, frequency + reach]).tolist())
                q = np.linalg.qr(stacked(_columns(observation, pole, lines)))[0]
                both = (q[: len(q) // 2] + 1j * q[len(q) // 2 :]).astype(np.complex64)
                self._candidates.append(_Candidate(pole, float(frequency), damping, lines, both))
                frequency = frequency + max(self._spacing, damping * frequency)

    def strongest(self, residual: NDArray[np.complex128], refused: Sequence[complex]) -> complex:
        """The pole that explains most of a `residual` (lines, channels), away from those refused."""
        single = residual.astype(np.complex64)
        best, found = -np.inf, 0j
        for pole, frequency, damping, lines, columns in self._candidates:
            if any(abs(pole - other) < 2 * self._spacing + max(damping, NEAR) * frequency for other in refused):
                continue
            explained = np.sum((columns.conj().T @ single[lines]).real ** 2, axis=0)
            gain = -float(np.sum(np.log(np.maximum(1 - 2 * explained / self._rows, 1e-9))))
            if gain > best:
                best, found = gain, pole
        return found


def _columns(observation: Observation, pole: complex, chosen: slice) -> NDArray[np.complex128]:
    """(lines, columns) of one mode alone: its states to each input, and its transient."""
    z, excitation = observation.z[chosen], observation.excitation[chosen]
    columns = []
    for sampling, drive in zip(observation.samplings, excitation.T, strict=True):
        columns += combined([(drive * sampling.response(side, z)[0])[:, None] for side in sides_of(pole)], np.ones(1))
    if observation.transient:
        leaks = [observation.samplings[0].transient(side, z)[0][:, None] for side in sides_of(pole)]
        columns += combined(leaks, np.ones(1))
    return np.column_stack(columns)
