# SPDX-License-Identifier: Apache-2.0
"""Findings on the identified model: its residuals in the tests, the agreement of the tests, and the servos' lags."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from abrace_core import AbraceError
from abrace_core.model.modes import match_modes, nearest_mode
from abrace_core.model.verdict import Verdict, judged
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.validity.finding import Finding
from abrace_sysid.validity.missing_mode import missing_mode
from abrace_sysid.validity.residuals import by_own_modes, dependence
from abrace_sysid.validity.rig_findings import FALSE_ALARM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.input_tests import InputTests
    from abrace_sysid.spectra.frequency_response import FrequencyResponse
    from abrace_sysid.validity.missing_mode import MissingMode
    from abrace_sysid.validity.residuals import Dependence, Residual


UNEXPLAINED = (0.01, 0.2)
"""Limits of the residual beyond noise, as a share of a channel's response: "trust with care" above the first, "don't
trust" above the second."""

NEGLIGIBLE = 0.005
"""If the residual is below this share of the response, its colour does not matter."""

LINEAR = 0.6
"""If more than this share of a residual's power follows the input, the model lacks linear dynamics."""

DIFFERENT_FREQUENCY, DIFFERENT_DAMPING = (1e-3, 0.05), (0.03, 0.5)
"""Limits of a mode's relative difference between two tests: "trust with care", and "don't trust"."""

LAG_DIFFERENCE = (0.5, 0.0005)
"""A servo's lag differs from `servo_lag` if the difference exceeds both this share of it and this many seconds."""


def not_by_chance(probability: Any, comparisons: int) -> Any:
    """Whether what has this `probability` by chance, in each of so many `comparisons`, is none; so is NaN."""
    return np.logical_not(probability * comparisons >= FALSE_ALARM)


def unexplained(residual: Residual, nonlinear: Sequence[str]) -> list[Finding]:
    """Findings on the model's residual in one test: its size, its whiteness, and its dependence on the input.

    Parameters
    ----------
    nonlinear
        Names of faults already found that cause a residual.
    """
    depends = dependence(residual) if residual.test.transient else None
    mode = None
    if residual.excess.max() > NEGLIGIBLE:
        mode = missing_mode(residual)
    worst = int(np.argmax(residual.excess))
    name, source = residual.test.outputs[worst], residual.test.source
    certain = not_by_chance(residual.probability.min(), len(residual.test.outputs))
    excess = float(residual.excess[worst]) if certain else 0.0
    verdict = judged(excess, *UNEXPLAINED)
    independence = None if depends is None else _independence(residual, depends)
    cause, advice = "", ""
    if verdict or (independence is not None and independence.verdict):
        cause, advice = _cause(residual, depends, mode, nonlinear)
    meaning = f"the model leaves {_percent(excess)} of {name} unexplained in {source}, beyond noise"
    if verdict and mode is not None and mode.is_one:
        meaning += (
            f"; a mode at {mode.frequency / (2 * np.pi):.3g} Hz, {_percent(mode.damping)} of damping, explains it"
        )
    elif not verdict:
        meaning = f"the model explains {source} except for noise"
    findings = [
        Finding.of("residual", f"{name}, {source}", excess, UNEXPLAINED, meaning, cause, advice),
        _whiteness(residual),
    ]
    if independence is not None:
        findings.append(replace(independence, cause=cause, advice=advice))
    if mode is not None and mode.is_one and not verdict:
        findings.append(_small_mode(residual, mode))
    return findings


def _cause(
    residual: Residual, depends: Dependence | None, mode: MissingMode | None, nonlinear: Sequence[str]
) -> tuple[str, str]:
    if mode is not None and mode.is_one:
        return "mode missed", "Raise modes by one, or widen the band, and identify again"
    worst = int(np.argmax(residual.excess))
    excess = max(float(residual.excess[worst]), 1e-12)
    follows = float(by_own_modes(residual)[worst]) if residual.excess[worst] > NEGLIGIBLE else 0.0
    if depends is not None:
        follows = max(follows, (depends.total[worst] / excess) ** 2)
    if follows > LINEAR:
        advice = "The rest is linear dynamics: another order, band or lag may explain it"
        return "unmodelled dynamics", advice
    if nonlinear:
        return nonlinear[0], ""
    return "nonlinear", "Test at two amplitudes, and use the model at that of its tests"


def _small_mode(residual: Residual, mode: MissingMode) -> Finding:
    """The finding on a missing mode whose residual is small."""
    at = f"{mode.frequency / (2 * np.pi):.3g} Hz"
    where, size = f"{at}, {residual.test.source}", float(residual.excess.max())
    meaning, advice = f"a mode at {at} is not in the model", "Raise modes by one and identify again"
    return Finding.of("modes", where, size, (NEGLIGIBLE,), meaning, "mode missed", advice, verdict=Verdict.CARE)


def _whiteness(residual: Residual) -> Finding:
    """The finding on whiteness, for the channel with the greatest coloured residual relative to its response."""
    distance, frequency = residual.whiteness()
    coloured = ~(distance <= float(stats.kstwobign.isf(FALSE_ALARM / len(distance))))
    shares = np.where(coloured, residual.excess, 0.0)
    worst = int(np.argmax(shares))
    name, source = residual.test.outputs[worst], residual.test.source
    share = float(shares[worst])
    meaning = f"the residual of {source} is as white as noise, or too small to matter"
    if judged(share, NEGLIGIBLE):
        hertz = float(frequency[worst]) / (2 * np.pi)
        meaning = f"the residual of {name} in {source} is not noise: most of it is near {hertz:.3g} Hz"
    return Finding.of("whiteness", f"{name}, {source}", share, (NEGLIGIBLE,), meaning)


def _independence(residual: Residual, depends: Dependence) -> Finding:
    """The finding on independence, without its cause."""
    # in channels whose dependence is not significant the share is due to noise
    significant = not_by_chance(depends.probability.min(axis=0), depends.probability.size)
    shares = np.where(significant & ~(residual.excess <= NEGLIGIBLE), depends.total, 0.0)
    worst = int(np.argmax(shares))
    share = float(shares[worst])
    at = float(depends.omega[np.argmin(depends.probability[:, worst])]) / (2 * np.pi)
    name, source = residual.test.outputs[worst], residual.test.source
    meaning = (
        f"{_percent(share)} of {name} in {source} follows the input but is not in the model, mainly at {at:.3g} Hz"
        if judged(share, *UNEXPLAINED)
        else f"the residual of {source} does not follow the input"
    )
    return Finding.of("independence", f"{name}, {source}", share, UNEXPLAINED, meaning)


def disagreeing(
    check: str,
    names: tuple[str, str],
    one: Sequence[PoleInterval],
    other: Sequence[PoleInterval],
    cause: str,
    building: Sequence[PoleInterval],
) -> list[Finding]:
    """A finding on two estimates of the same modes: Wald's test, and how large the difference is.

    Parameters
    ----------
    check, names
    one, other
        Pole pairs of the two estimates.
    cause
        The fault that would explain a difference.
    building
        The modes of the building. Any other mode that differs between the tests is not a mode of the rig, and affects
        the model little.
    """
    found = differences(one, other)
    if not found:
        return []
    certain = [each for each in found if not_by_chance(each.probability, len(found))]
    worst = max(certain or found, key=_size)
    verdict = _different(worst) if certain else Verdict.TRUST
    value = max(abs(worst.damping_change), _size(worst) * DIFFERENT_DAMPING[0]) if certain else 0.0
    meaning, advice = f"{names[0]} and {names[1]} agree on {len(found)} modes", ""
    if verdict:
        meaning = (
            f"{names[0]} and {names[1]} do not agree: mode at {worst.frequency / (2 * np.pi):.3g} Hz, frequency "
            f"{100 * worst.frequency_change:+.2g} %, damping {100 * worst.damping_change:+.2g} %, by chance with a "
            f"probability of {worst.probability:.1g}"
        )
        advice = "Use the poles of the test whose amplitude is nearest to that of use; the common poles lie in between"
        if verdict == Verdict.DONT and nearest_mode([mode.frequency for mode in building], worst.frequency) is None:
            verdict, cause = Verdict.CARE, "a mode too many"
            advice = "Lower modes by one: the mode named is not a mode of the rig"
    where = f"{worst.frequency / (2 * np.pi):.3g} Hz"
    return [Finding.of(check, where, value, DIFFERENT_DAMPING, meaning, cause, advice, verdict=verdict)]


def _size(one: Difference) -> float:
    return max(
        abs(one.frequency_change) / DIFFERENT_FREQUENCY[0],
        abs(one.damping_change) / DIFFERENT_DAMPING[0],
    )


def _different(one: Difference) -> Verdict:
    return max(
        judged(abs(one.frequency_change), *DIFFERENT_FREQUENCY), judged(abs(one.damping_change), *DIFFERENT_DAMPING)
    )


def modes_of_both(table: Sequence[PoleInterval], common: Sequence[PoleInterval]) -> list[Finding]:
    """A finding for each mode that the table tests show and the model of all tests lacks.

    Parameters
    ----------
    table, common
        Pole pairs of the table tests, and of the model.
    """
    known = [pair.frequency for pair in common]
    frequencies = [pair.frequency for pair in table if nearest_mode(known, pair.frequency) is None]
    missing = [f"{frequency / (2 * np.pi):.3g} Hz" for frequency in frequencies]
    return [
        Finding.of(
            "modes",
            at,
            float(len(missing)),
            (0.0, 0.0),
            f"the table's tests show a mode at {at} that the model does not have",
            "mode missed",
            "Raise modes by one and identify again",
        )
        for at in missing
    ]


def repeated(
    data: InputTests, poles: NDArray[np.complex128], cause: str, building: Sequence[PoleInterval]
) -> list[Finding]:
    """Findings on the agreement of the modes of repeated tests of one input, or of the halves of a single test.

    Parameters
    ----------
    data
    poles
        Poles, estimated from all tests, that appear in these tests.
    cause, building
        As in `disagreeing`.
    """
    if not data.periodic and data.input != data.together[0]:
        return []
    return [
        finding
        for (name, one), (other_name, other) in pairwise(pieces_of(data, poles))
        for finding in disagreeing("repeated tests", (name, other_name), one, other, cause, building)
    ]


def lag_of_response(response: FrequencyResponse, force: str) -> float:
    """The lag [s] of a servo, from the phase of force over command in the upper half of the band.

    Parameters
    ----------
    response
        Transfer functions from the command, hold included.
    force
        Name of the force among the outputs.
    """
    measured = response.select([force])
    upper = measured.omega > measured.omega[-1] / 2
    omega, phase = measured.omega[upper], np.unwrap(np.angle(measured.response[:, 0]))[upper]
    phase -= 2 * np.pi * np.round(np.median(phase) / (2 * np.pi))
    return float(-np.sum(omega * phase) / np.sum(omega**2)) - measured.sample_period / 2


def lag(command: str, source: str, measured: float, given: float) -> list[Finding]:
    """A finding on a servo's lag.

    Parameters
    ----------
    command, source
        Name of the servo's command, and of the tests.
    measured, given
        Identified lag, and that of the bench test [s]; 0: no bench test.
    """
    difference, limit = abs(measured - given) if given else 0.0, max(LAG_DIFFERENCE[0] * given, LAG_DIFFERENCE[1])
    bench = f"servo_lag says {1e3 * given:.2g} ms" if given else "no bench test to compare with"
    meaning = f"{command} acts {1e3 * measured:.2g} ms late in {source}, {bench}"
    advice = "the models have the measured lag; correct servo_lag, or look for filters and delays in the signal path"
    return [Finding.of("lag of the servo", command, difference, (limit,), meaning, "lag", advice, "s")]


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


LEAST_SECONDS = 30.0
"""Pieces of a test shorter than this are not fitted."""


@dataclass(frozen=True)
class Difference:
    """The difference of one mode between two estimates.

    Parameters
    ----------
    frequency
        Frequency in the first estimate [rad/s].
    frequency_change, damping_change
        Relative change from the first estimate to the second.
    probability
        Probability that noise alone causes such a difference (chi-square, two degrees of freedom).
    """

    frequency: float
    frequency_change: float
    damping_change: float
    probability: float


def differences(one: Sequence[PoleInterval], other: Sequence[PoleInterval]) -> list[Difference]:
    """The differences of the modes that two independent estimates have in common.

    Parameters
    ----------
    one, other
        Pole pairs with their standard deviations.
    """
    found = []
    for i, j in match_modes([pair.frequency for pair in one], [pair.frequency for pair in other]):
        pair, near = one[i], other[j]
        deviations = (
            np.hypot(pair.frequency_deviation, near.frequency_deviation),
            np.hypot(pair.damping_deviation, near.damping_deviation),
        )
        steps = (near.frequency - pair.frequency, near.damping - pair.damping)
        statistic = sum((step / deviation) ** 2 for step, deviation in zip(steps, deviations, strict=True))
        found.append(
            Difference(
                pair.frequency,
                near.frequency / pair.frequency - 1,
                near.damping / pair.damping - 1,
                float(stats.chi2.sf(statistic, 2)),
            )
        )
    return found


def pieces_of(data: InputTests, poles: NDArray[np.complex128]) -> list[tuple[str, tuple[PoleInterval, ...]]]:
    """The modes of each repeated test, or of both halves of a single test, with the name of the test or half.

    Parameters
    ----------
    data
        Tests of one input. A single periodic test has no pieces.
    poles
        Poles of all tests together, as initial values: the real ones, and of each pair the one above the real axis.
    """
    if data.periodic:
        both = zip(data.tests, data.responses, strict=True) if len(data.tests) > 1 else ()
        observed = [(test.source, Observation.of_response(response, test.source)) for test, response in both]
    else:
        tests = [(test.source, test) for test in data.tests]
        if len(tests) == 1:
            whole = tests[0][1]
            middle, end = len(whole.outputs) // 2, len(whole.outputs)
            tests = [
                (f"the first half of {whole.source}", whole.part(0, middle)),
                ("the second half", whole.part(middle, end)),
            ]
        band = data.responses[0].band
        observed = [
            (name, Observation.of_test(test, data.together, band, data.outputs))
            for name, test in tests
            if test.seconds >= LEAST_SECONDS
        ]
    found = []
    for name, observation in observed:
        try:
            found.append((name, tuple(fit_poles([observation], poles).pairs())))
        except AbraceError:
            continue
    return found
