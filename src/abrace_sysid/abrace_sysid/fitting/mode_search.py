# SPDX-License-Identifier: Apache-2.0
"""The modes of an unknown structure: starting poles by subspace identification, refined by maximum likelihood.

PO-MOESP (Verhaegen 1994) gives the poles of every order from one factorisation of the records. Each order's poles are
refined (`fit_poles`); orders rise until the description length no longer falls. Where the two halves of the record
predict each other, the order is the one up to there with which they do it best (hold-out validation; Ljung 1999, sec.
16.4): the description length counts the residual of a nonlinear or drifting peak as modes, the prediction noise that it
meets by chance. A sweep, an earthquake or a quiet half predicts nothing; then the description length decides.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy import signal
from scipy.ndimage import uniform_filter1d

from abrace_core import AbraceError
from abrace_core.model.modes import modal_assurance
from abrace_sysid.fitting.curve_fit import stacked
from abrace_sysid.fitting.maximum_likelihood import ITERATIONS, fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.pole_basis import combined, sides_of, transients

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleEstimate
    from abrace_sysid.recorded.test import Test

BLOCK_ROWS, MOST_ROWS = 40, 1800
"""Block rows of the Hankel matrices, and rows of all of them together, at most; more give hardly other poles."""

COLUMNS = 5000
"""Columns of the Hankel matrices that are factorised at a time, for long records."""

ABOVE, ABOVE_DAMPING = 1.4, 0.01
"""Frequency, divided by the band's upper edge, and damping ratio of the pairs that represent the modes above it."""

IN_VAIN = 4
"""Orders in a row that cannot be fitted, or have no shorter description, end the search after so many."""

LINES_OF_A_MODE = 20
"""Lines that there must be for each mode."""

NARROWEST, SAME_SHAPE = 0.05, 0.8
"""Least decay rate of a mode, in lines; and the modal assurance from which overlapping modes are one."""

LEFT_ORDER = 8
"""Order of the subspace of what the best order leaves."""

HEAVIEST = 0.9
"""Greatest damping ratio: beyond it a pair can hardly be distinguished from two real poles."""

HEAVY = 0.3
"""Poles damped more than this are left out where the fit with them fails."""

TRIAL_ITERATIONS = 30
"""Most steps of the fit of an order: a true mode takes about ten."""

NEIGHBOURS = 9
"""Lines over which the level of the residual is averaged."""


def residual_poles(observation: Observation) -> NDArray[np.complex128]:
    """The fixed poles [rad/s] that represent modes above the band of an `observation`, one for each input."""
    sampling = observation.samplings[0]
    highest = float(np.angle(observation.z[-1])) / sampling.sample_period
    # a held input says nothing of poles beyond half the sample rate
    above_it = sampling.hold == "band" or ABOVE * highest * sampling.sample_period < np.pi
    return np.full(len(observation.inputs) if above_it else 0, ABOVE * highest * complex(-ABOVE_DAMPING, 1))


def fit_with_residual_terms(
    observations: Sequence[Observation],
    poles: NDArray[np.complex128],
    iterations: int = ITERATIONS,
    spread: Literal["none", "modes"] = "modes",
) -> PoleEstimate:
    """As `fit_poles`, with residual terms of the modes above the band: one pair with a fixed pole for each input.

    Parameters
    ----------
    observations
        The records.
    poles
        Starting poles [rad/s].
    iterations
        Greatest number of steps.
    spread
        As for `fit_poles`.
    """
    above, inputs = residual_poles(observations[0]), len(observations[0].inputs)
    fixed = np.arange(len(poles) + len(above)) >= len(poles)
    driven = np.ones((len(poles) + len(above), inputs), dtype=np.bool_)
    driven[len(poles) :] = np.eye(len(above), inputs, dtype=np.bool_)
    return fit_poles(observations, np.concatenate([poles, above]), driven, fixed, iterations, spread)


class _Trial(NamedTuple):
    """The fit of an order, with its number of modes and what it costs to predict each half from the other."""

    estimate: PoleEstimate
    modes: int
    crossed: float


def search_modes(
    records: Sequence[Test],
    band: tuple[float, float],
    most: int,
    predict: Callable[[PoleEstimate, Test], NDArray[np.float64]],
    progress: Callable[[int], None] = lambda _modes: None,
) -> tuple[PoleEstimate, int]:
    """The fit of the best order, and how many of its first poles are modes; those after them are residual terms.

    Parameters
    ----------
    records, band
        Records of one structure, and the band [Hz] in which modes are searched.
    most
        Greatest number of modes.
    predict
        The outputs (samples, outputs) of a record as a fit predicts them.
    progress
        Called with the number of modes of each order that could be fitted.

    Raises
    ------
    AbraceError
        If no order can be fitted.
    """
    whole = observed(records, band)
    middles = [len(one.outputs) // 2 for one in records]
    first = observed([one.part(0, middle) for one, middle in zip(records, middles, strict=True)], band)
    second = observed([one.part(middle, len(one.outputs)) for one, middle in zip(records, middles, strict=True)], band)
    most = min(most, max(1, sum(len(one.z) for one in whole) // LINES_OF_A_MODE))
    subspace, trials, reason, vain = _Subspace(records, band), list[_Trial](), "no pole in the band", 0
    for order in range(2, min(subspace.highest, 4 * most) + 1, 2):
        vain += 1
        poles = subspace.poles(order)
        light = poles[-poles.real < HEAVY * np.abs(poles)]
        for start in (poles,) if len(light) == len(poles) else (poles, light):
            if not (trials[-1].modes if trials else 0) < len(start) <= most:
                continue
            try:
                trial = _tried(whole, (first, second), start)
            except AbraceError as error:
                reason = str(error)
                continue
            vain = 0 if not trials or trial.estimate.mdl < min(one.estimate.mdl for one in trials) else vain
            trials.append(trial)
            progress(trial.modes)
            break
        if trials and vain == IN_VAIN:
            break
    if not trials:
        source = ", ".join(one.source for one in records)
        raise AbraceError(f"{source}: no mode from {band[0]:.4g} to {band[1]:.4g} Hz could be fitted: {reason}")
    best = min(trials, key=lambda one: one.estimate.mdl)
    if best.crossed < 0:
        best = min((one for one in trials if one.modes <= best.modes), key=lambda one: one.crossed)
    # weak modes beside strong ones show in what is left, where the strong ones' lines count less
    try:
        settled = fit_with_residual_terms(
            weighed(whole, best.estimate), best.estimate.poles[: best.modes], ITERATIONS, "none"
        )
    except AbraceError:
        settled = best.estimate
    left = [replace(one, outputs=one.outputs - predict(settled, one)) for one in records]
    for pole in _Subspace(left, band).poles(LEFT_ORDER):
        try:
            trial = _tried(whole, (first, second), np.append(best.estimate.poles[: best.modes], pole))
        except AbraceError:
            continue
        if trial.estimate.mdl < best.estimate.mdl and (trial.crossed < best.crossed or not best.crossed < 0):
            best = trial
            progress(best.modes)
    return best.estimate, best.modes


def observed(records: Sequence[Test], band: tuple[float, float]) -> list[Observation]:
    """The lines of each of the `records` in a `band` [Hz], of all their inputs."""
    return [Observation.of_test(one, one.inputs, band) for one in records]


def _tried(
    whole: Sequence[Observation],
    halves: tuple[Sequence[Observation], Sequence[Observation]],
    start: NDArray[np.complex128],
) -> _Trial:
    """The fit from these starting poles; an error where a pair is no mode, or one mode is fitted twice."""
    estimate = fit_with_residual_terms(whole, start, TRIAL_ITERATIONS, "none")
    pairs = np.flatnonzero(estimate.poles[: len(start)].imag > 0)
    poles, shapes, line = (
        estimate.poles[pairs],
        estimate.shapes[:, pairs].T,
        2 * np.pi / max(one.seconds for one in whole),
    )
    if (-poles.real < NARROWEST * line).any():
        raise AbraceError("a pair has no damping that the record could show")
    apart = np.abs(poles[:, None] - poles)
    same = (apart < -(poles.real[:, None] + poles.real)) & (modal_assurance(shapes, shapes) > SAME_SHAPE)
    if np.triu((apart < line) | same, 1).any():
        raise AbraceError("one mode is fitted twice")
    return _Trial(estimate, len(start), _crossed(estimate, len(start), halves))


def _crossed(estimate: PoleEstimate, modes: int, halves: tuple[Sequence[Observation], Sequence[Observation]]) -> float:
    """The cost of predicting each half with the shapes fitted to the other; below 0: better than by zero, both."""
    costs = []
    for half, other in (halves, halves[::-1]):
        try:
            fitted = fit_with_residual_terms(half, estimate.poles[:modes], 0, "none")
        except AbraceError:
            return np.inf
        cost = 0.0
        for one in other:
            unmoved = float(2 * len(one.z) * np.sum(np.log(np.mean(stacked(one.measured) ** 2, axis=0))))
            cost += prediction(fitted, one)[0] - unmoved
        costs.append(cost)
    return sum(costs) if max(costs) < 0 else np.inf


class _Subspace:
    """The observability matrix of every order, from the part of all records in a band, by PO-MOESP.

    `highest` is the greatest order.
    """

    def __init__(self, records: Sequence[Test], band: tuple[float, float]) -> None:
        first, series = records[0], []
        for one in records:
            samples = min(len(one.outputs), 2 * int(band[1] * one.seconds))
            # what is above the band falls away with the sample rate, what is below with its lines
            still = signal.detrend(np.hstack([one.excitation, one.outputs]), axis=0)
            series.append(signal.resample(still, samples, axis=0))
        size = np.sqrt(sum(len(each) * each.var(axis=0) for each in series) / sum(map(len, series)))
        samples, count, channels = min(len(one) for one in series), len(first.inputs), len(first.names)
        whole = sum(len(one) for one in series)
        rows = min(
            BLOCK_ROWS, MOST_ROWS // (2 * (count + channels)), whole // (2 * (count + channels + 1)), samples // 4
        )
        if rows < 2:
            raise AbraceError(f"{first.source}: {whole} samples in the band for {channels} channels, expected more")
        self.channels, self.band = channels, band
        self.sample_period = max(one.seconds / len(kept) for one, kept in zip(records, series, strict=True))
        factor = np.zeros((0, 2 * rows * (count + channels)))
        for each in series:
            scaled = each / np.maximum(size, np.finfo(float).tiny)
            windows = np.lib.stride_tricks.sliding_window_view(scaled, 2 * rows, axis=0)
            for start in range(0, len(windows), COLUMNS):
                part = windows[start : start + COLUMNS]
                u, y = part[:, :count].swapaxes(1, 2), part[:, count:].swapaxes(1, 2)
                blocks = [
                    block.reshape(len(part), -1) for block in (u[:, rows:], u[:, :rows], y[:, :rows], y[:, rows:])
                ]
                factor = np.asarray(np.linalg.qr(np.vstack([factor, np.hstack(blocks)]), mode="r"))
        inputs, end = rows * count, rows * (2 * count + channels)
        self._left, self._values, _ = np.linalg.svd(factor.T[end:, inputs:end], full_matrices=False)
        self.highest = min((rows - 1) * channels, int(np.linalg.matrix_rank(np.diag(self._values))))

    def poles(self, order: int) -> NDArray[np.complex128]:
        """The poles in the band [rad/s]: of each pair the one above the real axis, and real ones; all stable."""
        observability = self._left[:, :order] * np.sqrt(self._values[:order])
        above, below = observability[: -self.channels], observability[self.channels :]
        discrete = np.linalg.eigvals(np.linalg.lstsq(above, below, rcond=None)[0]).astype(np.complex128)
        discrete = discrete[(discrete.imag > 0) | ((discrete.imag == 0) & (discrete.real > 0))]
        found = np.log(discrete) / self.sample_period
        found = -np.abs(found.real) + 1j * found.imag
        size, low, high = np.abs(found), *(2 * np.pi * edge for edge in self.band)
        found = found[(size > low) & (size < high) & ((found.imag == 0) | (-found.real < HEAVIEST * size))]
        return found[np.argsort(np.abs(found))]


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
    weight = 1 / observation.noise_level[:, None]
    left = stacked((observation.measured - simulated) * weight)
    if observation.transient:
        leaks = transients(list(dict.fromkeys(estimate.poles)), z, observation.samplings[0])
        q, _ = np.linalg.qr(stacked(np.column_stack(leaks) * weight))
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
    estimate
    observations
        Tests of one kind.
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
