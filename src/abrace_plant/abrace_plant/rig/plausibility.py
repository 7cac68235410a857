# SPDX-License-Identifier: Apache-2.0
"""Plausibility checks of a rig's numbers: finds those that are written in another unit than expected.

A single number is seldom impossible; a dimensionless ratio often is. Each rule has one such ratio of the rig's
numbers (or a single number, where laboratories differ little) and a range so wide that no sensible rig is outside
it, from a table-top model of three floors of 2 kg to a full-scale frame of ten storeys. The error for a number outside
its range names the units, or else the factors, that would bring it inside.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.safety.command_guard import rate_problem
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_plant.rig.building import STANDARD_GRAVITY as G
from abrace_plant.rig.building import storey_direction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace_plant.rig.model import BraceGroup, Rig

UNITS = {
    "kg": {"kgf s^2/m": G, "t": 1e3, "g": 1e-3},
    "N": {"kgf": G, "kN": 1e3, "tf": 1e3 * G},
    "N/s": {"kgf/s": G, "kN/s": 1e3, "tf/s": 1e3 * G},
    "N/m": {"kgf/m": G, "kgf/cm": 100 * G, "kN/m": 1e3, "tf/m": 1e3 * G, "kN/mm": 1e6},
    "N s/m": {"kgf s/m": G, "kgf s/cm": 100 * G, "kN s/m": 1e3, "tf s/m": 1e3 * G},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "m": {"cm": 1e-2, "mm": 1e-3},
    "m/s^2": {"g": G, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    "m/s^3": {"g/s": G, "cm/s^3": 1e-2, "mm/s^3": 1e-3},
    "s": {"ms": 1e-3},
    "1/s": {"1/ms": 1e3},
    "Hz": {"kHz": 1e3},
    "rad/s": {"Hz": 2 * np.pi},
    "of critical": {"%": 1e-2},
    "": {"%": 1e-2},
}
"""For each SI unit the units that are mistaken for it, in SI units."""
FACTORS = (G, 1e3, 1e3 * G, 1e6)
"""Other likely errors: units converted twice; with G only where a unit contains gravity."""


@dataclass(frozen=True)
class Number:
    """A number of the rig file.

    Parameters
    ----------
    key
        Its key in the file.
    value, unit
        In the expected SI unit, a key of `UNITS`.
    power
        The rule's ratio grows with this power of the number.
    """

    key: str
    value: float
    unit: str
    power: float = 1.0


@dataclass(frozen=True)
class _Rule:
    ratio: float
    least: float
    most: float
    meaning: str
    """Of the ratio, with {} for its range; empty if the ratio is the number itself."""
    numbers: tuple[Number, ...]
    """Of the ratio, the one most likely to be wrong first."""

    def holds(self, factor: float = 1.0) -> bool:
        return self.least <= self.ratio * factor <= self.most

    def error(self, rules: Sequence[_Rule]) -> str:
        """Message with the suspected number, its range, and the single mistake after which all `rules` hold."""
        causes = self._causes(rules) or self._causes([self])
        suspect = next(iter(causes), self.numbers[0])
        ends = [suspect.value * (end / self.ratio) ** (1 / suspect.power) for end in (self.least, self.most)]
        unit = f" {suspect.unit}".rstrip()
        text = f"{suspect.key}: {suspect.value:.6g}{unit}, expected {_short(min(ends))} to {_short(max(ends))}{unit}"
        if self.meaning:
            span = f"{_short(self.least)} to {_short(self.most)}"
            text += f" ({self.meaning.format(span)}, not {_short(self.ratio)})"
        questions = [f"{'it' if number is suspect else number.key} {cause}" for number, cause in causes.items()]
        return f"{text}; is {', or '.join(questions)}?" if questions else text

    def _causes(self, rules: Sequence[_Rule]) -> dict[Number, str]:
        """The possible mistake of each number that alone could be wrong; those of unit first."""
        units = {number: _units(number, rules) for number in self.numbers if number.power}
        factors = {number: _factors(number, rules) for number, found in units.items() if not found}
        return {number: found for number, found in (*units.items(), *factors.items()) if found}


def _units(number: Number, rules: Sequence[_Rule]) -> str:
    """The units in which a number may be written by mistake."""
    factors = {unit: factor for unit, factor in UNITS[number.unit].items() if _all_hold(number, factor, rules)}
    named = [f"{unit} ({_short(factor)} {number.unit}".rstrip() + ")" for unit, factor in factors.items()]
    return f"in {' or '.join(named)}" if named else ""


def _factors(number: Number, rules: Sequence[_Rule]) -> str:
    """The factors by which a number may be wrong otherwise."""
    found = []
    likely = [factor for factor in FACTORS if G in UNITS[number.unit].values() or factor in (1e3, 1e6)]
    for word, sign in (("small", 1), ("great", -1)):
        factors = [_short(factor) for factor in likely if _all_hold(number, factor**sign, rules)]
        found += [f"{' or '.join(factors)} times too {word}"] if factors else []
    return ", or ".join(found)


def _all_hold(number: Number, factor: float, rules: Sequence[_Rule]) -> bool:
    """Whether all rules on a number hold once it is multiplied by a factor."""
    return all(rule.holds(factor**one.power) for rule in rules for one in rule.numbers if one.key == number.key)


def _short(value: float) -> str:
    """Three digits, without the sign of a zero."""
    return f"{float(f'{value:.3g}') + 0.0:.6g}"


def check_units(rig: Rig, stiffness: Sequence[Number], damping: Sequence[Number]) -> None:
    """Refuse a rig with a number that seems to be in another unit, or a rate limit too low to ramp the force down.

    Parameters
    ----------
    rig
        As the file describes it, its brace groups, local modes and floors in the file's order.
    stiffness
        The building's stiffness as in the file: that of each storey, or the matrix's diagonal, or the frequencies. A
        frequency grows with their power.
    damping
        The bare frame's damping ratios as in the file.

    Raises
    ------
    AbraceError
        `<key>: <number>, expected <range>, ...; is it in <unit>?`, for the first rule that does not hold, or
        `<key>: <rate limit>, expected at least <rate limit> ...`.
    """
    masses = [Number(f"building.masses.{i}", mass, "kg") for i, mass in enumerate(rig.building.masses)]
    rules = [
        *_table(rig),
        *_building(rig, masses, stiffness, damping),
        *_departures(rig),
        *_braces(rig, _median(masses, -1.0)),
        *_local_modes(rig),
        *_sensors(rig),
    ]
    for rule in rules:
        if not rule.holds():
            raise AbraceError(rule.error(rules))
    for i, group in enumerate(rig.braces):
        actuator = group.actuator
        if actuator.capacity < actuator.command_limit < np.inf:
            raise AbraceError(
                f"braces.{i}.actuator.command_limit: {actuator.command_limit:g} N, expected at most the capacity, "
                f"{actuator.capacity:g} N"
            )
        if problem := rate_problem(actuator.capacity, actuator.rate_limit, 1 / rig.sample_rate, RAMP_TIME):
            raise AbraceError(f"braces.{i}.actuator.rate_limit: {problem}")


def _median(numbers: Sequence[Number], power: float) -> Number:
    """The median of a list of numbers, which have one unit."""
    key = re.sub(r"(\.\d+)+$", "", numbers[0].key)
    return Number(key, float(np.median([number.value for number in numbers])), numbers[0].unit, power)


def _against_median(numbers: Sequence[Number], times: float, name: str) -> Iterator[_Rule]:
    """Rules of each number of a list against their median: one alone may be in another unit."""
    median = np.median([number.value for number in numbers])
    for number in numbers:
        alone = replace(number, power=1.0)
        yield _Rule(number.value / median, 1 / times, times, f"{{}} times the median of the {name}", (alone,))


def _table(rig: Rig) -> Iterator[_Rule]:
    """Rules of single numbers, with which the others are compared."""
    height, rate = rig.storey_height, rig.sample_rate
    yield _Rule(height, 0.1, 10.0, "", (Number("building.storey_height", height, "m"),))
    yield _Rule(rate, 20.0, 2e4, "", (Number("sample_rate", rate, "Hz"),))
    peak = Number("table.peak_acceleration", rig.table.peak_acceleration, "m/s^2")
    yield _Rule(peak.value, 1.0, 100.0, "", (peak,))
    jerk = Number("table.peak_jerk", rig.table.peak_jerk, "m/s^3")
    ratio, below = jerk.value / peak.value, replace(peak, power=-1.0)
    yield _Rule(ratio, 5.0, 5000.0, "{} 1/s times table.peak_acceleration", (jerk, below))
    velocity = Number("table.peak_velocity", rig.table.peak_velocity, "m/s")
    stroke = Number("table.peak_displacement", rig.table.peak_displacement, "m")
    yield _Rule(velocity.value, 0.03, 10.0, "", (velocity,))
    yield _Rule(stroke.value / height, 0.005, 2.0, "{} times the storey's height", (stroke,))
    # the frequency from which the velocity limits the motion, and that up to which it does
    hertz = velocity.value / stroke.value / (2 * np.pi)
    yield _Rule(hertz, 0.05, 20.0, "over 2 pi peak_displacement {} Hz", (velocity, replace(stroke, power=-1.0)))
    hertz = peak.value / velocity.value / (2 * np.pi)
    yield _Rule(hertz, 0.1, 60.0, "peak_acceleration over 2 pi times it {} Hz", (replace(velocity, power=-1.0), peak))
    if rig.table_dynamics is not None:
        key, dynamics = "table.dynamics", rig.table_dynamics
        mass = Number(f"{key}.mass", dynamics.mass, "kg")
        yield _Rule(mass.value / rig.building.masses.sum(), 0.05, 50.0, "{} times the building's mass", (mass,))
        yield _Rule(dynamics.frequency, 20.0, 1000.0, "", (Number(f"{key}.frequency", dynamics.frequency, "rad/s"),))
        damping = Number(f"{key}.damping_ratio", dynamics.damping_ratio, "of critical")
        yield _Rule(damping.value, 0.005, 2.0, "", (damping,))


def _building(
    rig: Rig, masses: Sequence[Number], stiffness: Sequence[Number], damping: Sequence[Number]
) -> Iterator[_Rule]:
    yield from _against_median(masses, 50.0, "masses")
    whole, height = _median(masses, 1.0), Number("building.storey_height", rig.storey_height, "m", -3.0)
    for mass in (rig.building.masses.min(), rig.building.masses.max()):
        density = mass / rig.storey_height**3
        yield _Rule(density, 5.0, 5e4, "{} kg/m^3 in a cube as high as the storey", (whole, height))
    for number in damping:
        yield _Rule(number.value, 5e-5, 0.4, "", (number,))
    yield from _against_median(stiffness, 200.0, "floors")
    frequencies, _ = rig.building.modes()
    stated = _median(stiffness, stiffness[0].power)
    weighed = replace(whole, power=stated.power - 1.0)
    hertz, most = frequencies[0] / (2 * np.pi), 60.0 / rig.floors
    yield _Rule(hertz, 0.18, most, "the bare frame's first frequency {} Hz", (stated, weighed))
    spread, most = frequencies[-1] / frequencies[0], 20.0 + 8.0 * rig.floors**2
    yield _Rule(spread, 1.0, most, "the bare frame's fastest frequency {} times its first", (stiffness[-1],))


def _departures(rig: Rig) -> Iterator[_Rule]:
    """Rules for the effects of a building beyond a linear frame."""
    building, weight = rig.building, G * rig.building.masses.sum()
    for i, limit in enumerate(building.friction):
        if limit:
            number = Number(f"building.friction.{i}", limit, "N")
            yield _Rule(limit / weight, 1e-6, 0.05, "{} times the building's weight", (number,))
    for i, spring in enumerate(building.hysteresis):
        key = f"building.hysteresis.{i}"
        stiffness = Number(f"{key}.stiffness", spring.stiffness, "N/m")
        ratio = spring.stiffness / _storey(rig, spring.storey)
        yield _Rule(ratio, 0.01, 1.0, "{} times the frame's stiffness there", (stiffness,))
        drift = Number(f"{key}.yield_drift", spring.yield_drift, "m")
        yield _Rule(drift.value / rig.storey_height, 2e-4, 0.1, "{} times the storey's height", (drift,))


def _braces(rig: Rig, mass: Number) -> Iterator[_Rule]:
    weight = G * rig.building.masses.sum()
    first = rig.building.modes()[0][0]
    for i, group in enumerate(rig.braces):
        key, actuator = f"braces.{i}", group.actuator
        yield _Rule(group.cosine, 0.1, 1.0, "", (Number(f"{key}.cosine", group.cosine, ""),))
        if group.stiffener_stiffness:
            number = Number(f"{key}.stiffener_stiffness", group.stiffener_stiffness, "N/m")
            ratio = group.stiffener_stiffness / _storey(rig, group.floor)
            yield _Rule(ratio, 0.002, 50.0, "{} times the bare frame's stiffness there", (number,))

        key = f"{key}.actuator"
        capacity = Number(f"{key}.capacity", actuator.capacity, "N")
        ratio = group.count * group.cosine * actuator.capacity / weight
        yield _Rule(ratio, 0.001, 0.9, "the group's push {} times the building's weight", (capacity, mass))
        rate = Number(f"{key}.rate_limit", actuator.rate_limit, "N/s")
        yield _Rule(rate.value / capacity.value, 2.0, 2e4, "{} 1/s times the capacity", (rate,))
        lag = Number(f"{key}.lag", actuator.lag, "s")
        yield _Rule(lag.value, 1e-5, 0.05, "", (lag,))
        integral = Number(f"{key}.integral_rate", actuator.integral_rate, "1/s")
        yield _Rule(integral.value / first, 0.003, 100.0, "{} times the bare frame's first frequency", (integral,))
        flow = Number(f"{key}.flow_limit", actuator.flow_limit, "N/s")
        yield _Rule(flow.value / capacity.value, 2.0, 2e4, "{} 1/s times the capacity", (flow,))
        if actuator.velocity_feedback:
            feedback = Number(f"{key}.velocity_feedback", actuator.velocity_feedback, "N s/m", -1.0)
            velocity = flow.value * lag.value / feedback.value
            yield _Rule(velocity, 0.005, 10.0, "the free speed, flow_limit times lag over it, {} m/s", (feedback,))
        stroke = Number(f"{key}.stroke_limit", actuator.stroke_limit, "m")
        yield _Rule(stroke.value / rig.storey_height, 0.0005, 0.5, "{} times the storey's height", (stroke,))
        stop = Number(f"{key}.stop_stiffness", actuator.stop_stiffness, "N/m")
        ratio = stop.value * stroke.value / capacity.value
        yield _Rule(ratio, 0.5, 3e4, "{} times capacity over stroke_limit", (stop,))
        if actuator.command_delay:
            delay = Number(f"{key}.command_delay", actuator.command_delay, "s")
            yield _Rule(delay.value, 1e-5, 0.1, "", (delay,))
        yield from _faults_of_a_brace(group, f"braces.{i}", capacity)


def _faults_of_a_brace(group: BraceGroup, key: str, capacity: Number) -> Iterator[_Rule]:
    """Rules for the effects of a brace beyond an ideal one."""
    actuator = group.actuator
    if group.backlash:
        backlash = Number(f"{key}.backlash", group.backlash, "m")
        yield _Rule(backlash.value / actuator.stroke_limit, 1e-4, 0.2, "{} times stroke_limit", (backlash,))
    forces = (("friction", 1e-4, 0.3), ("deadband", 1e-5, 0.2), ("stall_force", 0.8, 10.0))
    for name, least, most in forces:
        number = Number(f"{key}.actuator.{name}", getattr(actuator, name), "N")
        if 0 < number.value < np.inf:
            yield _Rule(number.value / capacity.value, least, most, "{} times the capacity", (number,))


def _storey(rig: Rig, storey: int) -> float:
    """Force between a `storey`'s floors for each metre between them [N/m], in the bare frame."""
    direction = storey_direction(storey, rig.floors)
    return float(1 / (direction @ np.linalg.solve(rig.building.stiffness, direction)))


def _local_modes(rig: Rig) -> Iterator[_Rule]:
    first, whole = rig.building.modes()[0][0], rig.building.masses.sum()
    for i, mode in enumerate(rig.local_modes):
        key = f"local_modes.{i}"
        frequency = Number(f"{key}.frequency", mode.frequency, "rad/s")
        yield _Rule(frequency.value / first, 0.3, 500.0, "{} times the bare frame's first frequency", (frequency,))
        ratio = Number(f"{key}.damping_ratio", mode.damping_ratio, "of critical")
        yield _Rule(ratio.value, 5e-5, 0.4, "", (ratio,))
        mass = Number(f"{key}.mass", mode.mass, "kg")
        yield _Rule(mass.value / whole, 5e-4, 20.0, "{} times the building's mass", (mass,))
        for name in ("brace_share", "accelerometer_share", "transverse_share"):
            for j, share in enumerate(getattr(mode, name)):
                number = Number(f"{key}.{name}.{j}", share, "")
                yield _Rule(abs(share), 0.0, 2.0, "{} of the mode's greatest displacement", (number,))


def _sensors(rig: Rig) -> Iterator[_Rule]:
    """Rules of the ranges against what the rig can do, and of the errors against the ranges."""
    height = Number("building.storey_height", rig.storey_height, "m", -1.0)
    peak = Number("table.peak_acceleration", rig.table.peak_acceleration, "m/s^2", -1.0)
    stroke, capacity = (
        max(
            (
                Number(f"braces.{i}.actuator.{name}", getattr(group.actuator, name), unit, -1.0)
                for i, group in enumerate(rig.braces)
            ),
            key=lambda number: number.value,
        )
        for name, unit in (("stroke_limit", "m"), ("capacity", "N"))
    )
    ranges = (
        ("displacement", "m", "m/s", height, 5e-4, 2.0),
        ("stroke", "m", "m/s", stroke, 0.05, 5.0),
        ("acceleration", "m/s^2", "m/s^3", peak, 0.08, 60.0),
        ("force", "N", "N/s", capacity, 0.5, 5.0),
        ("ground_acceleration", "m/s^2", "m/s^3", peak, 0.03, 10.0),
    )
    for kind, unit, rate, scale, least, most in ranges:
        sensor, key = getattr(rig.sensors, kind), f"sensors.{kind}"
        greatest = Number(f"{key}.range", sensor.range, unit)
        yield _Rule(sensor.range / scale.value, least, most, f"{{}} times {scale.key}", (greatest, scale))
        if np.isfinite(sensor.bandwidth):
            yield from _bandwidth(rig, f"{key}.bandwidth", sensor.bandwidth)
        for error, share in (("noise", 0.2), ("bias", 0.5), ("drift", 0.1), ("hum", 0.2)):
            value = getattr(sensor, error)
            number = Number(f"{key}.{error}", value, rate if error == "drift" else unit)
            yield _Rule(abs(value) / sensor.range, 0.0, share, "{} times the range", (number,))
    if rig.sensors.anti_alias is not None:
        yield from _bandwidth(rig, "sensors.anti_alias.cutoff", rig.sensors.anti_alias.cutoff)


def _bandwidth(rig: Rig, key: str, value: float) -> Iterator[_Rule]:
    yield _Rule(value / rig.sample_rate, 0.02, 100.0, "{} times the sample_rate", (Number(key, value, "Hz"),))
