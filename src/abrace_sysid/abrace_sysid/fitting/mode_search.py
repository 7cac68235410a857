# SPDX-License-Identifier: Apache-2.0
"""The modes of an unknown structure, from any record: no order, band or kind of excitation has to be known.

candidates  poles of subspace identification in overlapping octaves of the lines (McKelvey, Akcay and Ljung 1996)
search      the candidate that explains most is added and all poles are refined, while it pays
choice      of the poles found, the set with the greatest likelihood, the noise estimated anew with each set; a pole
            must pay for its parameters
left over   the same with what this leaves

A fixed noise cannot tell a mode from a noise with a peak; the likelihood with each set's own noise can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg
from scipy.stats import chi2

from abrace_core import AbraceError
from abrace_sysid.fitting.line_fit import LineFit, Lines, parameters_of, poles_of, refined
from abrace_sysid.fitting.line_noise import LAST_STEPS, noise_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.line_noise import LineNoise
    from abrace_sysid.fitting.observation import Observation

LEAST_LINES, NEXT_BAND = 60, 1.4
"""Lines of the narrowest band of a local subspace; each band is an octave, and begins at this multiple of the last."""

ORDERS, MOST_BLOCKS = (2, 4, 6, 9, 12), 22
"""Orders of a local subspace, and most powers of its variable."""

SPREAD = 0.6
"""Parameter of the bilinear map from a band to part of the unit circle."""

HEAVIEST, GROWING, LIGHT = 0.3, 0.03, 2e-4
"""Greatest damping ratio of a candidate; one that grows by less than the second is taken with the third."""

ALIKE = 0.35
"""Candidates closer than this share of their half-widths are one."""

CHANCE, FREE_CHANCE = 1e-8, 1e-6
"""Probability that noise explains as much as a pole must, and as much as its forced or its free part must."""

REST_CHANCE = 0.01
"""Probability that records that begin at rest are not taken as such."""

AT_ONCE = 4
"""Poles that are added before the noise is estimated anew."""

FORCED = 0.01
"""Where the number of pairs is given, the forced part of each explains at least this share of what it explains."""

LOOKED_AT = 12
"""Candidates whose gains are computed anew after a pole is added; all are before the search ends."""

IN_VAIN = 6
"""Sets in a row that do not pay end the choice."""

CARE, CAREFUL = 20.0, (0.05, 0.3)
"""A driven pole that is no mode is damped as is usual for the second, if that costs less than the first: a mode just
beyond the reach of the input has a damping that nobody knows, and too small a one costs the prediction most."""

SURE_DAMPING, SURE_FREQUENCY = 0.35, 0.004
"""Greatest standard deviation of a mode's damping and frequency, as shares."""

LEAST_DECAY = 0.03
"""A mode decays by at least this much (as exponent) within the record; a steady hum does not."""


@dataclass(frozen=True)
class FoundModes:
    """The poles that were found in records.

    Parameters
    ----------
    poles
        (poles,) [rad/s], upper ones of pairs that the inputs drive, lowest first: they predict.
    is_mode
        (poles,) which of them are modes: told from their neighbours and from no damping, and decaying in the record.
    not_driven
        [rad/s] poles of motion that the inputs do not cause: hum, drift, free decay. They are left out.
    noise
        For each record (lines,) the noise's standard deviation, over outputs their geometric mean, median 1.
    at_rest
        Whether the records are explained by forced motion alone, from rest.
    passes_through
        Whether noise of the inputs, nonlinearity or unmeasured forces pass through the modes (`LineNoise`).
    cost
        -2 log likelihood and what the poles must pay, a line: of the same records the least is best.
    """

    poles: NDArray[np.complex128]
    is_mode: NDArray[np.bool_]
    not_driven: NDArray[np.complex128]
    noise: tuple[NDArray[np.float64], ...]
    at_rest: bool
    passes_through: bool
    cost: float


def find_modes(
    observations: Sequence[Observation],
    fixed_poles: NDArray[np.complex128],
    most: int,
    progress: Callable[[int], None] = lambda _modes: None,
    given: int = 0,
) -> FoundModes:
    """The modes of records of one structure.

    Parameters
    ----------
    observations
        Of the records, with their free decays.
    fixed_poles
        As of `Lines`.
    most
        Greatest number of poles.
    progress
        Called with the number of poles found so far.
    given
        Number of pairs that the inputs drive: the best ones, more than pay if need be; 0: those that pay.

    Raises
    ------
    AbraceError
        If the records do not have so many pairs.
    """
    lines = Lines(observations, fixed_poles)
    most = max(most, given)
    if given > (enough := lines.values // (1 + lines.forced_parts + lines.free_parts)):
        raise AbraceError(f"identification: {given} modes, expected at most {enough} of {len(lines.omega)} lines")
    fit = _searched(lines, most, progress)
    fit, noise = _chosen(lines, LineFit.at(lines, fit.poles[:0]), fit.poles)
    for _ in range(2):
        more = _added(lines, fit, _candidates(lines, fit.errors())[0], most, noise)
        if len(more.poles) == len(fit.poles):
            break
        fit, noise = _chosen(lines, fit, more.poles[len(fit.poles) :])
        progress(len(fit.poles))
    noise = noise_of(fit, LAST_STEPS)
    lines.deviation = np.sqrt(noise.variance)
    fit = refined(lines, fit.poles, 30, 1e-4)
    if len(fit.poles) and all(one.record for one in observations):
        # free decays cost certainty: of what is excited at the end of a record, and if there is but one hit
        still = Lines(observations, fixed_poles, at_rest=True)
        still.deviation = lines.deviation
        alone = refined(still, fit.poles, 15, 1e-3)
        if alone.misfit < fit.misfit + chi2.isf(REST_CHANCE, lines.free_parts * len(fit.poles)):
            fit = alone
    if given:
        fit, noise = _with_pairs(fit, given)
    return _reported(fit, noise, given)


def _with_pairs(fit: LineFit, given: int) -> tuple[LineFit, LineNoise]:
    """The fit with so many pairs that the inputs drive: the weakest left out, or the best candidates added."""
    lines = fit.lines
    while True:
        forced = fit.explained(forced=True)
        # what moves nearly free is no pair that the inputs drive, however well it is seen
        driven = _is_driven(fit) & (forced > FORCED * fit.explained())
        if np.count_nonzero(driven) <= given:
            break
        fit = refined(lines, np.delete(fit.poles, int(np.argmin(np.where(driven, forced, np.inf)))), 6, 0.1)
    missing = given - int(np.count_nonzero(driven))
    while missing:
        candidates, more = _candidates(lines, fit.errors())[0], list[complex]()
        gains = fit.gains(candidates)
        # a pole that explains less than its parameters do of noise is none
        for i in [i for i in np.argsort(-gains) if gains[i] > 2 + lines.forced_parts + lines.free_parts]:
            apart = all(abs(candidates[i] - one) > -2 * min(candidates[i].real, one.real) for one in more)
            if apart and len(more) < min(AT_ONCE, missing):
                more.append(complex(candidates[i]))
        new = refined(lines, np.append(fit.poles, more), 5, 0.1) if more else fit
        if not new.misfit < fit.misfit:
            most = given - missing
            raise AbraceError(f"identification: {given} modes, expected at most {most}: the data show no more")
        fit, missing = new, missing - len(more)
    noise = noise_of(fit, LAST_STEPS)
    lines.deviation = np.sqrt(noise.variance)
    return refined(lines, fit.poles, 30, 1e-4), noise


def _reported(fit: LineFit, found: LineNoise, given: int = 0) -> FoundModes:
    """The driven poles of a fit, `given` or those that pay, and which are modes; others are damped with care."""
    lines, careful = fit.lines, fit.usual.copy()
    seconds = max(one.seconds for one in lines.observations)
    spread = np.sqrt(np.maximum(np.diag(fit.covariance()), 0)).reshape(-1, 2)
    driven = _is_driven(fit)
    if given:
        driven = np.isin(np.arange(len(fit.poles)), np.argsort(-fit.explained(forced=True))[:given])
    size, damping = np.abs(fit.poles), -fit.poles.real / np.abs(fit.poles)
    decay = damping * size * seconds
    is_mode = (spread[:, 1] < SURE_DAMPING) & (spread[:, 0] < SURE_FREQUENCY) & (damping < HEAVIEST)
    is_mode &= (decay > LEAST_DECAY) & (size < lines.omega.max()) & (size > lines.omega.min())
    for i in np.flatnonzero(driven & ~is_mode):
        usual, start = careful.copy(), parameters_of(fit.poles)
        usual[i], start[i, 1] = CAREFUL, max(start[i, 1], np.log(CAREFUL[0]))
        new = refined(lines, poles_of(start), 10, 1e-2, usual)
        if new.misfit < fit.misfit + CARE:
            fit, careful = new, usual
    cost = (found.cost + _threshold(lines, found) * len(fit.poles)) / len(lines.omega)
    kept = np.flatnonzero(driven)
    kept = kept[np.argsort(np.abs(fit.poles[kept]))]
    level = lines.level()
    noise = tuple(level[rows] for rows in lines.rows)
    return FoundModes(
        fit.poles[kept], is_mode[kept], fit.poles[~driven], noise, lines.at_rest, found.passes_through, cost
    )


def _is_driven(fit: LineFit) -> NDArray[np.bool_]:
    """(poles,) whether the forced part of each pole pays."""
    least = chi2.isf(FREE_CHANCE, fit.lines.forced_parts)
    return fit.explained(forced=True) > least


def _threshold(lines: Lines, noise: LineNoise) -> float:
    """What a pole must explain; errors that pass through the model are one error of all outputs, and count for each."""
    parts = lines.forced_parts + lines.free_parts
    if noise.passes_through:
        return float(lines.outputs * chi2.isf(CHANCE, 2 + parts / lines.outputs))
    return float(chi2.isf(CHANCE, 2 + parts))


def _searched(lines: Lines, most: int, progress: Callable[[int], None]) -> LineFit:
    """The poles that a search finds from nothing, more than there are modes."""
    candidates, variance = _candidates(lines, lines.measured)
    known = np.isfinite(variance)
    variance = np.where(known, variance, np.median(variance[known]) if known.any() else 1.0)
    lines.deviation = np.sqrt(variance + 1e-16 * np.mean(np.abs(lines.measured) ** 2, axis=0))
    fit = LineFit.at(lines, np.zeros(0, dtype=np.complex128))
    noise = noise_of(fit)
    while len(fit.poles) < most:
        before, count = noise, len(fit.poles)
        fit = _added(lines, fit, candidates, min(most, count + AT_ONCE), noise)
        progress(len(fit.poles))
        if len(fit.poles) < count + AT_ONCE:
            break
        noise = noise_of(fit)
        lines.deviation = np.sqrt(noise.variance)
        fit = refined(lines, fit.poles, 4, 0.5)
        # with the noise's own estimate all four together may not pay for one: what is left is noise
        if before.cost - noise.cost < _threshold(lines, noise):
            break
    return fit


def _added(lines: Lines, fit: LineFit, candidates: NDArray[np.complex128], most: int, noise: LineNoise) -> LineFit:
    """The fit with the candidates that pay, beside this noise, the best one first."""
    least = _threshold(lines, noise)
    gains, are_new = fit.gains(candidates), True
    while len(fit.poles) < most and len(candidates):
        if not are_new:
            # a pole more changes the gains near it: those that were best are enough, until none of them pays
            best = np.argsort(-gains)[:LOOKED_AT]
            gains[best] = fit.gains(candidates[best])
        for i in np.argsort(-gains)[:3]:
            if gains[i] < 0.5 * least:
                continue
            new = refined(lines, np.append(fit.poles, candidates[i]), 5, 0.1)
            if fit.misfit - new.misfit > least:
                fit, are_new = new, False
                break
        else:
            if are_new:
                break
            gains, are_new = fit.gains(candidates), True
    return fit


class _Set(NamedTuple):
    """A set of poles with its noise."""

    poles: NDArray[np.complex128]
    noise: LineNoise


def _settled(
    lines: Lines, poles: NDArray[np.complex128], turns: int, steps: int, settled: float
) -> tuple[LineFit, LineNoise]:
    """Poles refined and their noise estimated in turn."""
    fit = refined(lines, poles, steps, settled)
    noise = noise_of(fit)
    for _ in range(turns - 1):
        lines.deviation = np.sqrt(noise.variance)
        fit = refined(lines, fit.poles, steps, settled)
        noise = noise_of(fit)
    return fit, noise


def _chosen(lines: Lines, start: LineFit, more: NDArray[np.complex128]) -> tuple[LineFit, LineNoise]:
    """Of the poles of a fit and `more` the set that pays by the likelihood in which each set has its own noise.

    Returned with this noise.
    """
    path, left, costs = [_Set(start.poles, noise_of(start))], list(more), list[float]()
    while True:
        costs.append(path[-1].noise.cost + _threshold(lines, path[-1].noise) * len(path[-1].poles))
        if not left or len(path) - int(np.argmin(costs)) > IN_VAIN:
            break
        lines.deviation = np.sqrt(path[-1].noise.variance)
        now = LineFit.at(lines, path[-1].poles)
        next_pole = left.pop(int(np.argmax(now.gains(np.array(left)))))
        fit, noise = _settled(lines, np.append(now.poles, next_pole), 2, 4, 0.5)
        path.append(_Set(fit.poles, noise))
    best = path[int(np.argmin(costs))]
    lines.deviation = np.sqrt(best.noise.variance)
    fit, noise = _settled(lines, best.poles, 2, 15, 0.1)
    while len(fit.poles):
        least = _threshold(lines, noise)
        lines.deviation = np.sqrt(noise.variance)
        fit = LineFit.at(lines, fit.poles)
        losses = fit.explained()
        for i in np.argsort(losses)[:3]:
            if losses[i] > 30 * least:
                continue
            new = refined(lines, np.delete(fit.poles, i), 6, 0.1)
            its_noise = noise_of(new)
            if its_noise.cost - noise.cost < least:
                lines.deviation = np.sqrt(its_noise.variance)
                fit, noise = _settled(lines, new.poles, 1, 5, 0.1)
                break
        else:
            break
    lines.deviation = np.sqrt(noise.variance)
    return refined(lines, fit.poles, 5, 0.1), noise


def _candidates(lines: Lines, responses: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Poles of local subspaces, and (lines, outputs) the variance beside them (infinite: unknown).

    Records with the same channels have their subspaces in common.
    """
    found: list[NDArray[np.complex128]] = []
    variance = np.full(responses.shape, np.inf)
    spacing = [2 * np.pi / one.seconds if len(one.omega) > 1 else one.omega[0] for one in lines.observations]
    channels = np.hstack([lines.driven, lines.present])
    for pattern in np.unique(channels, axis=0):
        inputs, outputs = np.flatnonzero(pattern[: lines.inputs]), np.flatnonzero(pattern[lines.inputs :])
        alike = np.flatnonzero((channels == pattern).all(axis=1))
        longest = lines.omega[lines.rows[max(alike, key=lambda i: lines.rows[i].stop - lines.rows[i].start)]]
        for own in _bands(len(longest)):
            low, high = longest[own.start], longest[own.stop - 1]
            in_band = (lines.omega >= low) & (lines.omega <= high)
            within = [lines.rows[i].start + np.flatnonzero(in_band[lines.rows[i]]) for i in alike]
            place = np.concatenate(within)
            of_record = np.repeat(np.eye(len(alike)), [len(each) for each in within], axis=0)
            omega, u, y = lines.omega[place], lines.excitation[np.ix_(place, inputs)], responses[np.ix_(place, outputs)]
            try:
                poles = _local_poles(omega, u, y, of_record)
                if not poles:
                    continue
                beside = _variance_beside(omega, u, y, of_record, poles[-1])
            except np.linalg.LinAlgError:
                continue
            found += [each[(each.imag > 0.7 * low) & (each.imag < 1.4 * high)] for each in poles]
            variance[np.ix_(place, outputs)] = np.minimum(variance[np.ix_(place, outputs)], beside)
    if not found:
        return np.zeros(0, dtype=np.complex128), variance
    pooled = np.concatenate(found)
    size, damping = np.abs(pooled), -pooled.real / np.abs(pooled)
    usable = (damping > -GROWING) & (damping < HEAVIEST)
    size, damping = size[usable], np.maximum(damping[usable], LIGHT)
    pooled = (size * (-damping + 1j * np.sqrt(1 - damping**2)))[np.argsort(size)]
    kept: list[complex] = []
    for pole in pooled:
        near = (abs(pole - one) < -ALIKE * max(pole.real, one.real) + 0.1 * min(spacing) for one in kept[-12:])
        if not any(near):
            kept.append(complex(pole))
    return np.array(kept, dtype=np.complex128), variance


def _bands(count: int) -> list[slice]:
    """Overlapping parts of so many lines, each an octave wide or LEAST_LINES lines."""
    found: list[slice] = []
    start = 0
    while start < count - LEAST_LINES // 2 or not found:
        found.append(slice(start, min(count, max(start + LEAST_LINES, 2 * start))))
        start = max(start + LEAST_LINES // 2, int(NEXT_BAND * start))
    return found


def _local_poles(
    omega: NDArray[np.float64], u: NDArray[np.complex128], y: NDArray[np.complex128], of_record: NDArray[np.float64]
) -> list[NDArray[np.complex128]]:
    """Poles [rad/s] of rising orders of a band: complex subspace of powers of a map of the band to the unit circle.

    `of_record` (lines, records) is 1 where a line is the record's.
    """
    middle, half = (omega.max() + omega.min()) / 2, (omega.max() - omega.min()) / 2
    place, count, channels = (omega - middle) / half, len(omega), y.shape[1]
    z = (SPREAD + 1j * place) / (SPREAD - 1j * place)
    tiny = np.finfo(float).tiny
    outputs = y / np.sqrt(np.mean(np.abs(y) ** 2, axis=0) + tiny)
    # what the inputs and a smooth leakage explain is projected out
    leakage = of_record, of_record * place[:, None]
    inputs = np.column_stack([u / np.sqrt(np.mean(np.abs(u) ** 2, axis=0) + tiny), *leakage])
    blocks = int(np.clip(count // (2 * (inputs.shape[1] + channels)), 4, MOST_BLOCKS))
    powers = z[None, :] ** np.arange(blocks)[:, None]
    of_inputs = np.concatenate([powers * column for column in inputs.T])
    of_outputs = (powers[:, None, :] * outputs.T[None]).reshape(blocks * channels, count)
    triangle = linalg.qr(np.concatenate([of_inputs, of_outputs]).conj().T, mode="r", check_finite=False)[0].conj().T
    first = len(of_inputs)
    rest = triangle[first : first + blocks * channels, first : min(count, first + blocks * channels)]
    if not rest.size:
        return []
    noise = linalg.cholesky(powers @ powers.conj().T / count + 1e-8 * np.eye(blocks), lower=True)
    weights = np.kron(noise, np.eye(channels))
    left = weights @ linalg.svd(linalg.solve_triangular(weights, rest, lower=True), full_matrices=False)[0]
    found = []
    for order in ORDERS:
        if order > min((blocks - 1) * channels, left.shape[1], count // 6):
            break
        shift = np.linalg.lstsq(left[:-channels, :order], left[channels:, :order], rcond=None)[0]
        values = np.linalg.eigvals(shift)
        values = values[np.isfinite(values) & (np.abs(values + 1) > 1e-9)]
        found.append(1j * middle + half * SPREAD * (values - 1) / (values + 1))
    return found


def _variance_beside(
    omega: NDArray[np.float64],
    u: NDArray[np.complex128],
    y: NDArray[np.complex128],
    of_record: NDArray[np.float64],
    poles: NDArray[np.complex128],
) -> NDArray[np.float64]:
    """(outputs,) variance of the lines of a band beside these poles, a smooth response and a smooth leakage."""
    middle, half = (omega.max() + omega.min()) / 2, (omega.max() - omega.min()) / 2
    place = (omega - middle) / half
    poles = np.where(np.abs(poles.real) < 1e-4 * half, -1e-4 * half + 1j * poles.imag, poles)
    peaks = half / (1j * omega[:, None] - poles)
    smooth = np.column_stack([peaks, place[:, None] ** np.arange(3)])
    columns = np.column_stack(
        [
            *(peaks * column[:, None] for column in u.T),
            u,
            u * place[:, None],
            *(smooth * column[:, None] for column in of_record.T),
        ]
    )
    columns = columns / (np.linalg.norm(columns, axis=0) + np.finfo(float).tiny)
    q, r, _ = linalg.qr(columns, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(r))
    q = q[:, size > 1e-9 * size[0]]
    left = y - q @ (q.conj().T @ y)
    return np.asarray(np.sum(np.abs(left) ** 2, axis=0) / max(len(omega) - q.shape[1], 1))
