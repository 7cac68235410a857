# SPDX-License-Identifier: Apache-2.0
"""Ranges of a rig's numbers relative to each other: a number in a wrong unit is refused where a range tells it.

A single number is seldom impossible; a ratio of two often is. The ranges accept a table-top model of three floors of
2 kg, a full-scale frame of ten storeys and what is between them. Ranges of single numbers are in the file's schema.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_core.safety.command_guard import rate_problem
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_plant.rig.building import STANDARD_GRAVITY, storey_direction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace_plant.rig.model import BraceGroup, Rig


ISOLATORS = 2e-4
"""Least stiffness of the lowest storey over the median of all: isolators below stiff storeys."""

SLOWEST = 0.18
"""Least first frequency [Hz], also on isolators."""


class Range(NamedTuple):
    """A ratio of a rig's numbers, the key of the number that it is about, and between what it has to be."""

    key: str
    words: str
    """Of the ratio, with {} in its place."""
    ratio: float
    least: float
    most: float


def check_ranges(rig: Rig, stiffness: tuple[str, Sequence[float]]) -> None:
    """Refuse a rig with a number out of range, or a rate limit too low to ramp the force down.

    Parameters
    ----------
    rig
        As the file describes it, its brace groups, local modes and floors in the file's order.
    stiffness
        Key of the building's stiffness, and the numbers there: of each storey, the matrix's diagonal, or frequencies.

    Raises
    ------
    AbraceError
        `<key>: <ratio>, expected <range>`, of the first ratio out of its range, or
        `<key>: <limit>, expected at least <limit> ...`.
    """
    for found in (*_table(rig), *_building(rig, *stiffness), *_braces(rig), *_local_modes(rig), *_sensors(rig)):
        if not found.least <= found.ratio <= found.most:
            raise AbraceError(
                f"{found.key}: {found.words.format(f'{found.ratio:.3g}')}, expected {found.least:.3g} to "
                f"{found.most:.3g}: a wrong unit? A number may carry its own, such as 24.5 kN"
            )
    for i, group in enumerate(rig.braces):
        actuator = group.actuator
        if actuator.capacity < actuator.command_limit < np.inf:
            raise AbraceError(
                f"braces.{i}.actuator.command_limit: {actuator.command_limit:g} N, expected at most the capacity, "
                f"{actuator.capacity:g} N"
            )
        if problem := rate_problem(actuator.capacity, actuator.rate_limit, 1 / rig.sample_rate, RAMP_TIME):
            raise AbraceError(f"braces.{i}.actuator.rate_limit: {problem}")


def _table(rig: Rig) -> Iterator[Range]:
    table = rig.table
    acceleration, velocity, displacement = table.peak_acceleration, table.peak_velocity, table.peak_displacement
    yield Range("table.peak_jerk", "{} 1/s times peak_acceleration", table.peak_jerk / acceleration, 5.0, 5000.0)
    share = displacement / rig.storey_height
    yield Range("table.peak_displacement", "{} times the storey's height", share, 0.005, 2.0)
    # the frequency from which the velocity limits the motion, and that up to which it does
    hertz = velocity / displacement / (2 * np.pi)
    yield Range("table.peak_velocity", "that of peak_displacement at {} Hz", hertz, 0.05, 20.0)
    hertz = acceleration / velocity / (2 * np.pi)
    yield Range("table.peak_velocity", "that of peak_acceleration at {} Hz", hertz, 0.1, 60.0)
    if rig.table_dynamics is not None:
        share = rig.table_dynamics.mass / rig.building.masses.sum()
        yield Range("table.dynamics.mass", "{} times the building's mass", share, 0.05, 50.0)


def _building(rig: Rig, key: str, stated: Sequence[float]) -> Iterator[Range]:
    building, weight = rig.building, STANDARD_GRAVITY * rig.building.masses.sum()
    for name, numbers, times in (("building.masses", building.masses, 50.0), (key, stated, 200.0)):
        for i, number in enumerate(numbers):
            ratio = number / float(np.median(numbers))
            least = 1 / times
            if name == "building.storey_stiffness" and i == 0:
                isolated = np.sqrt(number / building.masses.sum()) / (2 * np.pi)
                least = ISOLATORS if isolated > SLOWEST else least
            yield Range(f"{name}.{i}", "{} times the median of all floors", ratio, least, times)
    for mass in (building.masses.min(), building.masses.max()):
        density = mass / rig.storey_height**3
        yield Range("building.masses", "{} kg/m^3 in a cube as high as the storey", density, 5.0, 5e4)
    frequencies, _ = building.modes()
    # the first mode of an isolated building is that of its isolators
    hertz, spread = frequencies[0] / (2 * np.pi), frequencies[-1] / frequencies[min(1, rig.floors - 1)]
    both = f"{key} with building.masses"
    yield Range(both, "the bare frame's first frequency is {} Hz", hertz, SLOWEST, 60.0 / rig.floors)
    yield Range(both, "the fastest frequency is {} times the second", spread, 1.0, 20.0 + 8.0 * rig.floors**2)
    for i, limit in enumerate(building.friction):
        if limit:
            yield Range(f"building.friction.{i}", "{} times the building's weight", limit / weight, 1e-6, 0.05)
    for i, spring in enumerate(building.hysteresis):
        name = f"building.hysteresis.{i}"
        share = spring.stiffness / _storey_stiffness(rig, spring.storey)
        yield Range(f"{name}.stiffness", "{} times the frame's stiffness there", share, 0.01, 1.0)
        share = spring.yield_drift / rig.storey_height
        yield Range(f"{name}.yield_drift", "{} times the storey's height", share, 2e-4, 0.1)


def _storey_stiffness(rig: Rig, storey: int) -> float:
    """Force between a `storey`'s floors for each metre between them [N/m], in the bare frame."""
    direction = storey_direction(storey, rig.floors)
    return float(1 / (direction @ np.linalg.solve(rig.building.stiffness, direction)))


def _braces(rig: Rig) -> Iterator[Range]:
    weight, first = STANDARD_GRAVITY * rig.building.masses.sum(), rig.building.modes()[0][0]
    for i, group in enumerate(rig.braces):
        key, actuator = f"braces.{i}.actuator", group.actuator
        if group.stiffener_stiffness:
            share = group.stiffener_stiffness / _storey_stiffness(rig, group.floor)
            yield Range(f"braces.{i}.stiffener_stiffness", "{} times the frame's stiffness there", share, 0.002, 50.0)
        push = group.count * group.cosine * actuator.capacity / weight
        yield Range(f"{key}.capacity", "the group pushes with {} times the building's weight", push, 0.001, 0.9)
        # a command of full capacity within a millisecond: no actuator follows it, and its valve does not survive it
        for name, most in (("rate_limit", 1e3), ("flow_limit", 2e4)):
            rate = getattr(actuator, name) / actuator.capacity
            yield Range(f"{key}.{name}", "{} 1/s times the capacity", rate, 2.0, most)
        share = actuator.integral_rate / first
        yield Range(f"{key}.integral_rate", "{} times the bare frame's first frequency", share, 0.003, 100.0)
        if actuator.velocity_feedback:
            speed = actuator.flow_limit * actuator.lag / actuator.velocity_feedback
            yield Range(f"{key}.velocity_feedback", "flow_limit times lag over it is {} m/s", speed, 0.005, 10.0)
        share = actuator.stroke_limit / rig.storey_height
        yield Range(f"{key}.stroke_limit", "{} times the storey's height", share, 0.0005, 0.5)
        share = actuator.stop_stiffness * actuator.stroke_limit / actuator.capacity
        yield Range(f"{key}.stop_stiffness", "{} times capacity over stroke_limit", share, 0.5, 3e4)
        yield from _effects(group, f"braces.{i}")


def _effects(group: BraceGroup, key: str) -> Iterator[Range]:
    """Of the effects of a brace beyond an ideal one."""
    actuator = group.actuator
    if group.backlash:
        yield Range(f"{key}.backlash", "{} times stroke_limit", group.backlash / actuator.stroke_limit, 1e-4, 0.2)
    for name, least, most in (("friction", 1e-4, 0.3), ("deadband", 1e-5, 0.2), ("stall_force", 0.8, 10.0)):
        if 0 < (value := getattr(actuator, name)) < np.inf:
            yield Range(f"{key}.actuator.{name}", "{} times the capacity", value / actuator.capacity, least, most)


def _local_modes(rig: Rig) -> Iterator[Range]:
    first, whole = rig.building.modes()[0][0], rig.building.masses.sum()
    for i, mode in enumerate(rig.local_modes):
        share = mode.frequency / first
        yield Range(f"local_modes.{i}.frequency", "{} times the bare frame's first frequency", share, 0.3, 500.0)
        yield Range(f"local_modes.{i}.mass", "{} times the building's mass", mode.mass / whole, 5e-4, 20.0)


def _sensors(rig: Rig) -> Iterator[Range]:
    """Of the ranges against what the rig can do, and of the errors against the ranges."""
    stroke, capacity = (
        max(getattr(group.actuator, name) for group in rig.braces) for name in ("stroke_limit", "capacity")
    )
    peak = rig.table.peak_acceleration
    for kind, words, scale, least, most in (
        ("displacement", "the storey's height", rig.storey_height, 5e-4, 2.0),
        ("stroke", "the greatest stroke_limit", stroke, 0.05, 5.0),
        ("acceleration", "table.peak_acceleration", peak, 0.08, 60.0),
        ("force", "the greatest capacity", capacity, 0.5, 5.0),
        ("ground_acceleration", "table.peak_acceleration", peak, 0.03, 10.0),
    ):
        sensor, key = getattr(rig.sensors, kind), f"sensors.{kind}"
        if sensor is None:
            continue
        yield Range(f"{key}.range", f"{{}} times {words}", sensor.range / scale, least, most)
        for error, share in (("noise", 0.2), ("bias", 0.5), ("drift", 0.1), ("hum", 0.2)):
            yield Range(f"{key}.{error}", "{} times the range", abs(getattr(sensor, error)) / sensor.range, 0.0, share)
        if np.isfinite(sensor.bandwidth):
            yield Range(f"{key}.bandwidth", "{} times the sample_rate", sensor.bandwidth / rig.sample_rate, 0.02, 100.0)
    if rig.sensors.anti_alias is not None:
        share = rig.sensors.anti_alias.cutoff / rig.sample_rate
        yield Range("sensors.anti_alias.cutoff", "{} times the sample_rate", share, 0.02, 100.0)
