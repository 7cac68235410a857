# SPDX-License-Identifier: Apache-2.0
"""Findings on nonlinearities of the rig: friction of storeys, backlash of braces."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, NamedTuple

from scipy import stats

from abrace_core.model.verdict import Verdict
from abrace_sysid.validity.finding import Finding
from abrace_sysid.validity.mechanics import backlashes, storey_frictions
from abrace_sysid.validity.sensor_findings import late

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.validity.mechanics import StoreyFriction
    from abrace_sysid.validity.motion import Motion

FALSE_ALARM = 1e-3
"""Probability of a false alarm of one check on a linear rig, over all storeys, brace groups and tests together."""

ADDED_DAMPING = (2e-4, 0.03)
"""Limits of the damping ratio that friction adds at a test's amplitude: "trust with care" above the first, "don't
trust" above the second."""

LOOSE_PINS = (0.003, 0.2)
"""Limits, likewise, of half the clearance of a brace's pins over the rms of its stroke."""

AGREEING = 2.0
"""The equation of the floor below must show the same friction with at least this many standard deviations."""


def normal_limit(checks: int) -> float:
    """Standard deviations that noise exceeds in any of `checks` comparisons with the probability FALSE_ALARM."""
    return float(stats.norm.isf(FALSE_ALARM / 2 / max(checks, 1)))


def friction(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> list[Finding]:
    """A finding for each storey that has friction; a single one if no storey has.

    Parameters
    ----------
    tests
        Each test with the band [Hz] in which its floors' equations are fitted.
    """
    found = storey_frictions(tests)
    limit = normal_limit(len(found))

    def certain(one: StoreyFriction) -> bool:
        agrees = isnan(one.opposite) or one.opposite > AGREEING
        return one.acceleration > limit * one.deviation and agrees

    advice = "Damping and intervals hold only at the tests' amplitude: test at that of use, or free the bearings"
    parts = [
        _Part(f"storey {one.storey}", one.damping, certain(one), f"in storey {one.storey}: ", _amount(one, source))
        for source, one in found
    ]
    return _findings("friction", "of critical damping", ADDED_DAMPING, advice, parts)


def _amount(one: StoreyFriction, source: str) -> str:
    relative = one.deviation / one.acceleration
    size = f"{one.force:.3g} +- {relative * one.force:.1g} N"
    if isnan(one.force):
        size = f"{one.acceleration:.2g} +- {one.deviation:.1g} m/s^2 of the floor's mass"
    return f"{size} in {source} (adds {100 * one.damping:.2g} % of damping)"


def backlash(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> list[Finding]:
    """A finding for each brace group whose pins are loose; a single one if no group's are.

    Parameters
    ----------
    tests
        Each test with the band [Hz] in which its strokes' equations are fitted.
    """
    each = [(motion, one) for motion, band in tests for one in backlashes(motion, band)]
    found = [(motion.source, one) for motion, one in each]
    limit = normal_limit(len(found))
    loose = {one.group for _, one in found if one.share > LOOSE_PINS[0] and one.clearance > limit * one.deviation}
    # a loose rod that is not driven is late by itself when it crosses the clearance
    late_ones = [
        finding
        for motion, one in each
        if (one.group not in loose or motion.driven(one.group)) and abs(one.lag) > limit * one.lag_deviation
        for finding in late(one.stroke, "the floors", one.lag, motion.source)
        if finding.verdict
    ]
    advice = "Tighten or shim the pins; until then the model does not hold for forces that only cross the clearance"
    parts = [
        _Part(
            f"brace group {one.group}",
            one.share,
            one.clearance > limit * one.deviation,
            f"in the pins of brace group {one.group}: ",
            f"{1e3 * one.clearance:.2g} mm in {source}",
        )
        for source, one in found
    ]
    return late_ones + _findings("backlash", "of the stroke", LOOSE_PINS, advice, parts)


class _Part(NamedTuple):
    """The fault of a storey or brace group in one test: size, significance, place and amount as text."""

    where: str
    value: float
    certain: bool
    place: str
    amount: str


def _findings(fault: str, unit: str, limits: tuple[float, float], advice: str, parts: Sequence[_Part]) -> list[Finding]:
    """A finding for each storey or brace group that has the fault, from all tests; a single one if none has."""
    if not parts:
        return []
    findings = []
    for where in dict.fromkeys(part.where for part in parts):
        shown = [part for part in parts if part.where == where and part.certain and part.value > limits[0]]
        if shown:
            worst = max(part.value for part in shown)
            meaning = f"{fault} {shown[0].place}{'; '.join(part.amount for part in shown)}"
            findings.append(Finding.of(fault, where, worst, limits, meaning, fault, advice, unit))
    if not findings:
        value = max(0.0, *(part.value for part in parts))
        fine = Finding.of(fault, "everywhere", value, limits, f"no {fault}", unit=unit, verdict=Verdict.TRUST)
        findings.append(fine)
    return findings
