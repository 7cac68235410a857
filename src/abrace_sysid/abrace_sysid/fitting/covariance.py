# SPDX-License-Identifier: Apache-2.0
"""The covariance of fitted modes, estimated from the residuals of the tests in two ways.

By lines    each frequency line is a cluster (White 1980; MacKinnon and White 1985, HC3): right for noise of any
            spectrum, correlated from channel to channel as that of a measured input is.
By pieces   nonlinear distortion is made of the same input at all lines, so that lines depend on each other and
            clusters of lines miss up to three quarters of the variance (Schoukens and Pintelon 2010): damping that
            depends on the amplitude follows the envelope of the motion. In time, its effect is limited to the memory of
            the structure. Therefore the scores of a record are transformed to time, and their slow fluctuation is
            estimated with as many cosines as the record is memories long (Mueller 2007; Lazarus et al. 2018). A
            multisine repeats its distortion; its pieces are realizations, tests with other phases, at least four.

Standard deviations are those by lines, unless those by pieces differ significantly; with fewer than eight pieces the
larger of both is used. Those by pieces are widened for their few degrees of freedom (Student 1908). Correlations are
those by lines, because there are many lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, linalg, stats

from abrace_sysid.fitting.condensed_lines import direct_terms
from abrace_sysid.fitting.pole_estimate import NORMAL_95, columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.likelihood import Likelihood


LEAST_PIECES = 4
"""Fewest cosines of a record; fewest realizations of a multisine from which a variance is taken."""

ENOUGH_PIECES = 8
"""Fewest pieces whose variance is used if it is less than that by lines."""

CHANCE = 0.05
"""Significance level of a difference between the variances by pieces and by lines."""

MOST_LEVERAGE = 0.9
"""Upper limit of a line's leverage in HC3."""


def covariance(likelihood: Likelihood, joint: Likelihood | None = None) -> NDArray[np.float64]:
    """Covariance of the parameters of `Modes.parameters` and, if `joint` is given, of the `lasting` coefficients.

    Fixed parameters have a covariance of 0.

    Parameters
    ----------
    likelihood
        The likelihood at its maximum.
    joint
        The likelihood, of the same tests and modes, with the coefficients; None: only parameters are wanted.
    """
    influence = _influence(likelihood, joint)
    by_lines, by_pieces = np.zeros_like(influence), np.zeros_like(influence)
    fewest: float = np.inf
    for tests in _kinds(likelihood):
        lines, pieces, freedom = _scatter(likelihood, tests, joint)
        by_lines += lines
        by_pieces += pieces
        fewest = min(fewest, freedom)
    found = influence @ by_lines @ influence.T
    if np.isinf(fewest):
        return np.asarray(found)
    variance = np.diag(found)
    ratio = np.sum((influence @ by_pieces) * influence, axis=1) / np.where(variance > 0, variance, np.inf)
    widening = float(stats.t.ppf(0.975, fewest)) / NORMAL_95
    low, high = 0.0, 1 / widening**2
    if fewest >= ENOUGH_PIECES:
        low, high = (float(stats.chi2.ppf(share, fewest)) / fewest for share in (CHANCE, 1 - CHANCE))
    factor = np.where((ratio > low) & (ratio < high), 1.0, widening * np.sqrt(ratio))
    factor[variance == 0] = 1.0
    return np.asarray(found * np.outer(factor, factor))


def _kinds(likelihood: Likelihood) -> list[list[int]]:
    """Groups of tests, by index: each record with noise alone, multisines on the same inputs together."""
    records: list[list[int]] = []
    periodic: dict[tuple[str, ...], list[int]] = {}
    for i, test in enumerate(likelihood.tests):
        if test.observation.is_record:
            records.append([i])
        else:
            periodic.setdefault(test.observation.inputs, []).append(i)
    return [*records, *periodic.values()]


def _scatter(
    likelihood: Likelihood, tests: list[int], joint: Likelihood | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Covariance of the scores of one group of tests by lines and by pieces, and the pieces' degrees of freedom.

    With too few pieces the covariance by lines is given for both, with infinite degrees of freedom.
    """
    whole, by_test = [], []
    for i in tests:
        clusters = _scores(likelihood, i, joint, in_time=False)
        whole.append(clusters.sum(axis=0))
        clusters /= (1 - np.minimum(_leverage(likelihood, i), MOST_LEVERAGE))[:, None]
        by_test.append(clusters.T @ clusters)
    lines = np.sum(by_test, axis=0)
    if likelihood.tests[tests[0]].observation.is_record:
        count = _memories(likelihood, tests[0])
        fluctuation = _cosines(len(clusters), count) @ _scores(likelihood, tests[0], joint, in_time=True)
        return lines, fluctuation.T @ fluctuation / count, count
    count = len(tests)
    if count < LEAST_PIECES:
        return lines, lines, np.inf
    apart = np.array(whole) - np.mean(whole, axis=0)
    return lines, apart.T @ apart * (count / (count - 1)), count - 1


def _influence(likelihood: Likelihood, joint: Likelihood | None) -> NDArray[np.float64]:
    """(parameters, scores) change of the parameters per score, with coefficients if `joint`: inverse normal matrix."""
    of_modes = likelihood.inverse()
    if joint is None:
        return of_modes
    parameters = len(of_modes)
    kept = lasting(joint)
    found = np.eye(parameters + len(kept) * len(joint.channels))
    found[:parameters, :parameters] = of_modes
    for first, channel in zip(range(parameters, len(found), len(kept)), joint.channels, strict=True):
        # coefficients depend on the modes: they compensate for changes of the modes as far as they can
        found[first : first + len(kept), :parameters] = -channel.projection[kept] @ of_modes
    return found


def lasting(likelihood: Likelihood) -> NDArray[np.int64]:
    """Indices of the coefficients that belong to a model: shapes and direct terms, without the tests' transients.

    Parameters
    ----------
    likelihood
    """
    inputs = tuple(dict.fromkeys(name for test in likelihood.tests for name in test.observation.inputs))
    _, end = direct_terms([test.observation for test in likelihood.tests], inputs, likelihood.modes)
    return np.arange(end)


def _scores(likelihood: Likelihood, test: int, joint: Likelihood | None, in_time: bool) -> NDArray[np.float64]:
    """(lines, scores) derivatives of one test's log likelihood, by line or, `in_time`, by as many pieces of time.

    For coefficients: the changes of the coefficients.
    """
    one, parameters = likelihood.tests[test], len(likelihood.gradient)
    lines, own, size = len(one.measured) // 2, one.columns, one.basis.shape[1]
    kept = np.arange(0) if joint is None else lasting(joint)
    found = np.empty((parameters + len(kept) * len(likelihood.channels), lines))
    slopes, measured = (_in_time(rows) if in_time else rows for rows in (one.slopes, one.measured))
    basis, of_slopes, of_modes = slopes[:, :size], np.ascontiguousarray(slopes.T), found[:parameters]
    found[:] = 0
    for c, channel in enumerate(likelihood.channels):
        place = channel.places[test]
        if place < 0:
            continue
        left = measured[:, place] - basis @ channel.coefficients[own]
        score = _product(of_slopes, left * (one.observation.weight / channel.power[test]))
        of_modes += one.derivatives(channel.coefficients, parameters) @ score
        of_modes -= channel.projection[own].T @ score[:size]
        if joint is not None:
            alike, first = joint.channels[c], parameters + c * len(kept)
            left = (measured[:, place] - basis @ alike.coefficients[own]) / alike.power[test]
            inverse = linalg.solve_triangular(alike.triangle, np.eye(len(alike.triangle)))
            found[first : first + len(kept)] = inverse[kept] @ inverse[own].T @ _product(of_slopes[:size], left)
    return found.T * (lines if in_time else 1)


def _in_time(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The band's signals in time from `rows` of lines; real parts above imaginary parts in both."""
    half = len(rows) // 2
    series = fft.ifft(rows[:half] + 1j * rows[half:], axis=0)
    return np.vstack([series.real, series.imag])


def _product(slopes: NDArray[np.float64], residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """(slopes, lines) real part of each line's slope, conjugate, times its residual; slopes are (slopes, 2 lines)."""
    half = len(residual) // 2
    found: NDArray[np.float64] = slopes[:, :half] * residual[:half]
    found += slopes[:, half:] * residual[half:]
    return found


def _leverage(likelihood: Likelihood, test: int) -> NDArray[np.float64]:
    """(lines,) leverage of each line: the share of its own error that the fit follows, mean of the channels."""
    one = likelihood.tests[test]
    channels = [channel for channel in likelihood.channels if channel.places[test] >= 0]
    # the channels of one test have the same basis and differ by a factor alone
    channels = channels if len(likelihood.tests) > 1 else channels[:1]
    leverage = np.zeros(len(one.basis))
    for channel in channels:
        inside = linalg.solve_triangular(channel.triangle, np.eye(len(channel.triangle)))[one.columns]
        leverage += np.sum((one.basis @ inside) ** 2, axis=1) * (one.observation.weight / channel.power[test])
    half = len(leverage) // 2
    return np.asarray((leverage[:half] + leverage[half:]) / (2 * len(channels)))


def _memories(likelihood: Likelihood, test: int) -> int:
    """Length of a record in memories of the structure: duration times the narrowest half-power bandwidth."""
    observation, modes = likelihood.tests[test].observation, likelihood.modes
    shown = list(observation.shown(modes.poles))
    decay = np.abs(modes.poles.real[shown])[(modes.poles.imag[shown] > 0) & ~modes.fixed[shown]]
    if not len(decay):
        return LEAST_PIECES
    return max(LEAST_PIECES, min(round(observation.seconds * float(decay.min()) / np.pi), len(observation.z) // 4))


def _cosines(lines: int, count: int) -> NDArray[np.float64]:
    """(count, lines) cosines of half a wave to `count` half waves within a record, of unit mean square."""
    return np.sqrt(2) * np.cos(np.pi * np.outer(np.arange(1, count + 1), (np.arange(lines) + 0.5) / lines))


def inflation(likelihood: Likelihood, covariance: NDArray[np.float64]) -> float:
    """Greatest ratio, over the pairs, of a pair's variance to its variance if channels and lines were independent.

    Parameters
    ----------
    likelihood
        The likelihood at its maximum.
    covariance
        Covariance of its parameters.
    """
    modes, free = likelihood.modes, likelihood.free
    independent = np.diag(likelihood.inverse())
    ratio = np.ones(len(free))
    ratio[free] = np.diag(covariance)[free] / independent[free]
    places = columns_of(modes.poles)
    pairs = np.flatnonzero((modes.poles.imag > 0) & ~modes.fixed)
    return max((float(np.mean(ratio[places[pair]])) for pair in pairs), default=1.0)


def of_entries(
    likelihood: Likelihood, covariance: NDArray[np.float64], inputs: Sequence[str], unit: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The covariance `joint` of `PoleEstimate`.

    Parameters
    ----------
    likelihood
        The likelihood at its maximum.
    covariance
        Covariance of its parameters and of each channel's coefficients, without those of transients.
    inputs, unit
        Names of all inputs, and (inputs,) their units in the likelihood.
    """
    modes, channels = likelihood.modes, len(likelihood.channels)
    places, count, first = columns_of(modes.poles), len(inputs), len(likelihood.gradient)
    states, size = places[-1].stop, (len(covariance) - first) // channels
    end = states * (1 + count)
    entries = np.zeros((end + channels * (states + count) + count, len(covariance)))
    entries[:states, :states] = np.eye(states)
    for mode, direction, columns in modes.parameters():
        if direction is None:
            continue
        turned = modes.directions[mode][:, direction] / unit
        for factor, column in zip((1, 1j), range(columns.start, columns.stop), strict=False):
            parts = (factor * turned).real, (factor * turned).imag
            for place, part in zip(range(places[mode].start, places[mode].stop), parts, strict=False):
                entries[states + place * count : states + (place + 1) * count, column] = part
    at: dict[str, int] = {}
    groups, _ = direct_terms([test.observation for test in likelihood.tests], inputs, modes)
    for (names, _), place in sorted(groups.items(), key=lambda item: len(item[0][1])):
        direct = [name for name in names if modes.direct[inputs.index(name)]]
        at.update({name: place + i for i, name in enumerate(direct)})
    for c in range(channels):
        own = first + c * size
        entries[end + c * states + np.arange(states), own + np.arange(states)] = 1
        for name, place in at.items():
            j = inputs.index(name)
            entries[end + channels * states + c * count + j, own + place] = 1 / unit[j]
    for i, column in modes.delay_columns().items():
        entries[i - count, column] = 1
    return np.asarray(entries @ covariance @ entries.T)
