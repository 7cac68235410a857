# SPDX-License-Identifier: Apache-2.0
"""Findings on channels: dead, saturated, with spikes, swapped, late, in a wrong unit or with a wrong sign."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.files.units import unit_as_stated, unit_of
from abrace_core.model import signals
from abrace_core.model.verdict import Verdict, judged
from abrace_sysid.validity.finding import Finding
from abrace_sysid.validity.kinematics import CONTRADICTION, Change, kinematics

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleEstimate
    from abrace_sysid.recorded.test import Test
    from abrace_sysid.validity.kinematics import Kinematics
    from abrace_sysid.validity.motion import Motion


WRONG = ("swapped sensors", "wrong unit", "wrong sign")
"""Faults of channels with which the equations of floors and braces do not hold."""

IN_PHASE = 0.5
"""Greatest angle of the squared ratio of two sensors of a floor, of a mode that both show well [rad]."""

SATURATED = (0.0, 0.02)
"""Limits of the share of a channel's samples at the end of its range: "trust with care" above the first, "don't trust"
above the second."""

SPIKED = (0.0, 0.02)
"""Limits, likewise, of the power of spikes over that of the channel."""

LATE = (0.0015, 0.01)
"""Limits, likewise, of the time [s] between two sensors of a floor; with the filters and transducers of the rig
`ncree_as_a_rig` it is 0.0007 s."""


def dead(test: Test) -> list[Finding]:
    """A finding for each channel of a `test` that does not respond; a single one if all respond."""
    check, reasons = "channels respond", test.faults
    if test.floors and len(reasons) == len(test.names) and not test.moving:
        # if no channel responds to the table's acceleration, that channel itself is dead
        reasons = {signals.GROUND: "no channel answers to it"}
    if not reasons:
        return [Finding.of(check, test.source, 0.0, (0.0,), "every channel answers", unit="channels")]
    return [
        Finding.of(
            check,
            f"{name}, {test.source}",
            1.0,
            (0.0,),
            f"{name} is dead in {test.source}: {reason}; no model has it",
            "dead channel",
            "Check sensor, cable and channel number, and repeat the test",
            "channels",
        )
        for name, reason in reasons.items()
    ]


def saturated(test: Test) -> list[Finding]:
    """A finding for each channel of a `test` that reaches the end of its range; a single one if none does."""
    check, source, samples = "within the range", test.source, test.period or len(test.outputs)
    found = [(count / samples, name, count) for name, count in test.clipped.items()]
    if not found:
        return [Finding.of(check, source, 0.0, SATURATED, "no channel is saturated")]
    excited = test.moving or test.inputs
    return [
        Finding.of(
            check,
            f"{name}, {source}",
            share,
            SATURATED,
            f"{name} is saturated in {source}: {count} samples ({share:.2g} of them) are at its extremes",
            "saturation",
            "Use a smaller input" if name in excited else "Repeat the test with less excitation",
        )
        for share, name, count in sorted(found, reverse=True)
    ]


def spiked(test: Test, names: Sequence[str]) -> list[Finding]:
    """A finding for each channel of a test that has spikes; a single one if none has.

    Parameters
    ----------
    names
        Names of the channels that are checked, if they respond.
    """
    check, found = "spikes", []
    names = [name for name in names if name not in test.faults]
    forces = set(names) & set(signals.numbered("f", test.groups))
    struck = [reversals_with_play(test.channel(name)) for name in forces]
    blows = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *struck])[:, None] + np.arange(-1, 2))
    for name in names:
        values = test.channel(name)
        where, size = spikes(values)
        own = ~np.isin(where, blows)
        where, size = where[own], size[own]
        if len(where):
            found.append((float(np.sum(size**2) / np.sum((values - values.mean()) ** 2)), name, len(where)))
    if not found:
        return [Finding.of(check, test.source, 0.0, SPIKED, "no channel has spikes")]
    return [
        Finding.of(
            check,
            f"{name}, {test.source}",
            share,
            SPIKED,
            f"{name} has {count} spikes in {test.source}, {share:.2g} of its power: readings far from their neighbours",
            "spikes",
            "Check plug, cable and shielding of the sensor, and repeat the test",
        )
        for share, name, count in sorted(found, reverse=True)
    ]


def contradicting(motion: Motion, band: tuple[float, float]) -> list[Finding]:
    """Findings on sensors of one test that contradict each other.

    Parameters
    ----------
    motion
    band
        Band [Hz] of the building's modes.
    """
    found = kinematics(motion, band)
    check, source, limits = "sensors agree", motion.source, (CONTRADICTION, CONTRADICTION)
    if not found.contradictions:
        meaning = f"no two sensors of {source} measure the same, well above their noise: they can't be judged here"
        advice = "Connect the sensors that are dead, or test with more excitation"
        return [Finding.of(check, source, nan, limits, meaning, "", advice)]
    worst = max(found.contradictions.values())
    findings = [
        Finding.of(
            check, f"{' and '.join(one.channels)}, {source}", worst, limits, *_named(one, source), verdict=Verdict.DONT
        )
        for one in found.changes
    ]
    if max(found.left.values(), default=0.0) > CONTRADICTION:
        rest = ", ".join(name for name, value in found.left.items() if value > CONTRADICTION)
        findings.append(
            Finding.of(
                check,
                f"{rest}, {source}",
                max(found.left.values()),
                limits,
                f"{rest} contradict each other in {source}, and no swap, unit or sign explains it",
                "sensors that disagree",
                "Check these channels one by one: tap, tilt or move each sensor by hand",
            )
        )
    if not findings:
        meaning = "no sensor contradicts another"
        findings.append(Finding.of(check, source, worst, limits, meaning, verdict=Verdict.TRUST))
    return findings + _late(found, source)


def _named(change: Change, source: str) -> tuple[str, str, str]:
    """Meaning, cause and advice for a fault of channels."""
    if change.kind == "swapped":
        both = " and ".join(change.channels)
        return f"{both} are swapped in {source}", WRONG[0], "Correct the channel list, or the cables"
    (name,) = change.channels
    if change.kind == "reversed":
        return f"{name} has the wrong sign in {source}", WRONG[2], "Reverse the sensor, or its sign in the calibration"
    size = f"{abs(change.factor):.4g} times too large" + (" and reversed" if change.factor < 0 else "")
    unit = f": it reads as if in {change.unit}" if change.unit else ""
    return f"{name} is {size} in {source}{unit}", WRONG[1], "Correct unit or sensitivity in the calibration"


def _stated_factor(units: Mapping[str, str], name: str) -> float:
    """The factor to SI units of the unit that a signal states; 1: none that its kind of quantity has."""
    found = unit_as_stated(units.get(name, ""))
    is_of_kind = found is not None and found.dimension == unit_of(signals.unit(name)).dimension
    return found.factor if found is not None and is_of_kind else 1.0


def other_units(estimate: PoleEstimate, units: Mapping[str, str], source: str) -> list[Finding]:
    """A finding for each floor of measured data whose acceleration is not the second derivative of its displacement.

    The shapes of a mode p are those of a floor's sensors: that of `a3` is p^2 times that of `x3`, whatever drives it.

    Parameters
    ----------
    estimate
        Modes of the data.
    units
        Those that the data state, by name; they are believed.
    source
        The data, for messages.
    """
    found, names = [], estimate.outputs
    pairs = estimate.poles.imag > 0
    for floor in (name[1:] for name in names if name[0] == "x" and name[1:].isdigit() and f"a{name[1:]}" in names):
        x, a = (f"{letter}{floor}" for letter in "xa")
        displaced = estimate.poles[pairs] ** 2 * estimate.shapes[names.index(x), pairs]
        read = estimate.shapes[names.index(a), pairs]
        size = np.abs(displaced) * np.linalg.norm(estimate.drive[pairs], axis=1) / np.abs(estimate.poles[pairs])
        ratio = read[np.argmax(size)] / displaced[np.argmax(size)]
        ratio = ratio * _stated_factor(units, a) / _stated_factor(units, x)
        # one sensor in another unit is likelier than two
        alone = (signals.read_as(a, abs(ratio)), ""), ("", signals.read_as(x, 1 / abs(ratio)))
        factors = signals.OTHER_UNITS["x"].items()
        both = [(of_a, unit) for unit, factor in factors if (of_a := signals.read_as(a, abs(ratio) * factor))]
        of_a, of_x = next(iter([*filter(any, alone), *both, ("", "")]))
        said = " and ".join(f"{name} reads as if in {unit}" for name, unit in ((a, of_a), (x, of_x)) if unit)
        if said and abs(abs(ratio) - 1) > signals.SAME_UNIT and abs(np.angle(ratio**2)) < IN_PHASE:
            meaning = f"{said}: {a} is {abs(ratio):.3g} times the second derivative of {x}"
            advice = "Name the units (`units`), or correct them; nothing was converted"
            where = f"{a} and {x}, {source}"
            found.append(
                Finding.of("units", where, abs(ratio), (1.0,), meaning, WRONG[1], advice, verdict=Verdict.CARE)
            )
    return found


def _late(found: Kinematics, source: str) -> list[Finding]:
    if not found.lags or found.changes:
        return []
    findings = []
    for name, lag in found.lags.items():
        others = "the displacement sensors" if name == signals.GROUND else f"x{name[1:]}"
        findings += late(name, others, lag, source)
    late_ones = [one for one in findings if one.verdict]
    return late_ones or [max(findings, key=lambda one: one.value)]


def late(name: str, others: str, lag: float, source: str) -> list[Finding]:
    """A finding on the time between two sensors.

    Parameters
    ----------
    name, others
        Names of the sensors compared.
    lag
        Time by which the first is later [s].
    source
        Name of the test.
    """
    first, second = (name, others) if lag > 0 else (others, name)
    advice = "Give these sensors the same filter, or sample them together"
    meaning = f"{name} and {others} are in time in {source}"
    if judged(abs(lag), *LATE):
        reads = "read" if first.startswith("the") else "reads"
        meaning = f"{first} {reads} {1e3 * abs(lag):.2g} ms later than {second} in {source}"
    return [Finding.of("sensors synchronous", f"{name}, {source}", abs(lag), LATE, meaning, "lag", advice, "s")]


CUBIC = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6
"""Weights of five readings that give the middle reading minus the cubic through its neighbours."""

FAR = 10.0
"""A spike deviates from that cubic by at least this many times the usual; five linear rigs reached at most 5.1."""

ALONE = 0.3
"""A single wrong reading changes its neighbours' deviations by known amounts. They may differ from these by this share
of its own deviation."""

BEYOND = 0.2
"""A spike is above or below both its neighbours by at least this share of its deviation."""


def spikes(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The readings that are spikes.

    Parameters
    ----------
    series
        (samples,).

    Returns
    -------
    where, size
        (spikes,) sample indices, and deviation of each from the cubic through its neighbours.
    """
    where, size, beyond = _apart(series)
    return where[beyond], size[beyond]


def reversals_with_play(force: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the samples at which a brace's `force` (samples,) stays at zero while it reverses."""
    where, _, beyond = _apart(force)
    return where[~beyond]


def _apart(series: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Indices of single deviating readings, their deviations, and whether they are beyond both neighbours."""
    away = np.zeros(len(series))
    away[2:-2] = np.convolve(series, CUBIC, "valid")
    steps = np.abs(np.diff(series))
    # a step of the converter's last bit is not a spike
    usual = max(float(np.median(np.abs(away))) / 0.6745, float(steps[steps > 0].min(initial=np.inf)))
    far = np.flatnonzero(np.abs(away) > FAR * usual)
    far = far[(far >= 4) & (far < len(series) - 4)]
    # a single wrong reading changes its neighbours' deviations by the same weights; an impact in the rig does not
    around = away[far[:, None] + np.arange(-2, 3)]
    alone = np.abs(around / away[far][:, None] - CUBIC / CUBIC[2]).max(axis=1, initial=0) < ALONE
    far = far[alone]
    before, reading, after = series[far - 1], series[far], series[far + 1]
    beyond = np.maximum(reading - np.maximum(before, after), np.minimum(before, after) - reading)
    return far, away[far], beyond > BEYOND * np.abs(away[far])
