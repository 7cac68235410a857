"""The rig file: YAML that describes a rig, checked key by key."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError
from abrace_core.safety.table_stop import Table
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building import Building, modal_damping, rayleigh_damping, shear_stiffness, stiffness_of_modes
from abrace_plant.rig.detectors import detectors, sensor_noise
from abrace_plant.rig.limits import check_limits
from abrace_plant.rig.model import BraceGroup, Interlock, LocalMode, Rig
from abrace_plant.rig.plausibility import Number, check_units
from abrace_plant.rig.sensors import Sensor, SensorSet

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

LARGEST = 1e15
"""Largest number in SI units, and 1 over the smallest positive one: no ratio of two overflows."""


def _not_tiny(number: float) -> float:
    if 0 < number < 1 / LARGEST:
        raise ValueError(f"a number in SI units is at least {1 / LARGEST:g}")
    return number


Real = Annotated[float, pydantic.Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, pydantic.Field(ge=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]
Positive = Annotated[float, pydantic.Field(gt=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]
DampingRatio = Annotated[float, pydantic.Field(gt=0, lt=1)]


class _Table(Checked):
    peak_acceleration: Positive
    peak_jerk: Positive
    peak_velocity: Positive
    peak_displacement: Positive


class _Modes(Checked):
    frequencies: list[Positive]
    shapes: list[list[Real]]


class _Rayleigh(Checked):
    modes: Annotated[list[Annotated[int, pydantic.Field(ge=1)]], pydantic.Field(min_length=2, max_length=2)]
    damping_ratios: Annotated[list[DampingRatio], pydantic.Field(min_length=2, max_length=2)]


class _Building(Checked):
    storey_height: Positive
    masses: Annotated[list[Positive], pydantic.Field(min_length=1)]
    storey_stiffness: list[Positive] | None = None
    stiffness: list[list[Real]] | None = None
    modes: _Modes | None = None
    damping_ratios: list[DampingRatio] | None = None
    rayleigh: _Rayleigh | None = None


class _Actuator(Checked):
    capacity: Positive
    rate_limit: Positive
    lag: Positive
    integral_rate: Positive
    velocity_feedback: NotNegative
    flow_limit: Positive
    stroke_limit: Positive
    stop_stiffness: Positive
    command_delay: NotNegative = 0.0


class _BraceGroup(Checked):
    floor: Annotated[int, pydantic.Field(ge=1)]
    count: Annotated[int, pydantic.Field(ge=1, le=26)]
    cosine: Annotated[float, pydantic.Field(gt=0, le=1)]
    stiffener_stiffness: NotNegative
    actuator: _Actuator


class _LocalMode(Checked):
    frequency: Positive
    damping_ratio: DampingRatio
    mass: Positive
    brace_share: list[Real]
    accelerometer_share: list[Real]


class _Sensor(Checked):
    range: Positive
    noise: NotNegative
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]
    bias: Real = 0.0
    drift: Real = 0.0


class _Sensors(Checked):
    displacement: _Sensor
    stroke: _Sensor
    acceleration: _Sensor
    force: _Sensor
    ground_acceleration: _Sensor


class _ReadingInterlock(Checked):
    time: Annotated[float, pydantic.Field(ge=0, le=2)]
    action: Literal["stop", "warn"] = "stop"
    reset: Literal["person"] = "person"


class _Interlock(_ReadingInterlock):
    value: Positive


class _Interlocks(Checked):
    drift: _Interlock | None = None
    displacement: _Interlock | None = None
    velocity: _Interlock | None = None
    stroke: _Interlock | None = None
    acceleration: _Interlock | None = None
    force: _Interlock | None = None
    force_error: _Interlock | None = None
    oscillation: _Interlock | None = None
    table_displacement: _Interlock | None = None
    table_velocity: _Interlock | None = None
    implausible_acceleration: _Interlock | None = None
    implausible_stroke: _Interlock | None = None
    noisy: _Interlock | None = None
    dead: _Interlock | None = None
    stuck: _ReadingInterlock | None = None
    clipped: _ReadingInterlock | None = None


class _Rig(Checked):
    name: str
    sample_rate: Positive
    table: _Table
    building: _Building
    braces: Annotated[list[_BraceGroup], pydantic.Field(min_length=1)]
    local_modes: list[_LocalMode] = []
    sensors: _Sensors
    interlocks: _Interlocks = _Interlocks()


def load_rig(path: Path | str) -> Rig:
    """Read and check a rig file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    content = read_config(path, _Rig, "rig")
    try:
        return _rig(content)
    except AbraceError as error:
        raise AbraceError(f"rig file {path}: {error}") from error


def _rig(content: _Rig) -> Rig:
    masses = np.array(content.building.masses)
    stiffness, stated_stiffness = _stiffness(content.building)
    _expect_definite(".".join(stated_stiffness[0].key.split(".")[:2]), masses, stiffness)
    damping, stated_damping = _damping(content.building, stiffness)
    floors, groups = len(masses), len(content.braces)
    for i, group in enumerate(content.braces):
        _expect(group.floor <= floors, f"braces.{i}.floor", group.floor, f"a floor from 1 to {floors}")
    for i, mode in enumerate(content.local_modes):
        _expect_one_each(mode.brace_share, f"local_modes.{i}.brace_share", groups, "brace groups")
        _expect_one_each(mode.accelerometer_share, f"local_modes.{i}.accelerometer_share", floors, "floors")

    rig = Rig(
        name=content.name,
        sample_rate=content.sample_rate,
        table=Table(**dict(content.table)),
        building=Building(masses, stiffness, damping),
        braces=tuple(
            BraceGroup(**dict(group) | {"actuator": Actuator(**dict(group.actuator))}) for group in content.braces
        ),
        local_modes=tuple(
            LocalMode(
                mode.frequency,
                mode.damping_ratio,
                mode.mass,
                tuple(mode.brace_share),
                tuple(mode.accelerometer_share),
            )
            for mode in content.local_modes
        ),
        sensors=SensorSet(**{kind: Sensor(**dict(sensor)) for kind, sensor in content.sensors}),
        storey_height=content.building.storey_height,
        interlocks={
            name: Interlock(**{"value": 0.0} | dict(given)) for name, given in content.interlocks if given is not None
        },
    )
    check_units(rig, stated_stiffness, stated_damping)
    _expect_fast_enough(rig)
    check_limits(rig, detectors(rig).noise(sensor_noise(rig)))
    return rig


def _stiffness(building: _Building) -> tuple[NDArray[np.float64], list[Number]]:
    """The condensed stiffness (floors, floors) [N/m], and the numbers that state it."""
    floors = len(building.masses)
    _expect_one_of(building, "storey_stiffness", "stiffness", "modes")
    if building.storey_stiffness is not None:
        key, storeys = "building.storey_stiffness", building.storey_stiffness
        _expect_one_each(storeys, key, floors, "storeys")
        return shear_stiffness(np.array(storeys)), _numbers(key, storeys, "N/m", 0.5)
    if building.stiffness is not None:
        key, rows = "building.stiffness", [len(row) for row in building.stiffness]
        _expect(rows == [floors] * floors, key, f"rows of {rows} numbers", f"{floors} rows of {floors}")
        matrix = np.array(building.stiffness)
        asymmetry = np.abs(matrix - matrix.T)
        i, j = divmod(int(np.argmax(asymmetry)), floors)
        pair = f"not symmetric: {matrix[i, j]:.9g} in row {i + 1}, column {j + 1}, and {matrix[j, i]:.9g} opposite"
        _expect(asymmetry.max() <= 1e-9 * np.abs(matrix).max(), key, pair, "symmetry")
        diagonal = [Number(f"{key}.{i}.{i}", value, "N/m", 0.5) for i, value in enumerate(np.diag(matrix))]
        return (matrix + matrix.T) / 2, diagonal
    modes = building.modes
    assert modes is not None
    key, frequencies = "building.modes.frequencies", modes.frequencies
    _expect_one_each(frequencies, key, floors, "modes, as many as floors")
    ascending = all(slower < faster for slower, faster in pairwise(frequencies))
    _expect(ascending, key, frequencies, "frequencies in ascending order, the slowest first")
    _expect_one_each(modes.shapes, "building.modes.shapes", floors, "modes, as many as floors", "shapes")
    for i, shape in enumerate(modes.shapes):
        _expect_one_each(shape, f"building.modes.shapes.{i}", floors, "floors")
    try:
        matrix = stiffness_of_modes(np.array(building.masses), np.array(frequencies), np.array(modes.shapes).T)
    except AbraceError as error:
        raise AbraceError(f"building.modes.shapes: {error}") from error
    return matrix, _numbers(key, frequencies, "rad/s", 1.0)


def _damping(building: _Building, stiffness: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[Number]]:
    """The condensed damping (floors, floors) [N s/m], and the ratios that state it."""
    floors, masses = len(building.masses), np.array(building.masses)
    _expect_one_of(building, "damping_ratios", "rayleigh")
    if building.damping_ratios is not None:
        key, ratios = "building.damping_ratios", building.damping_ratios
        _expect_one_each(ratios, key, floors, "floors")
        return modal_damping(masses, stiffness, np.array(ratios)), _numbers(key, ratios, "of critical")
    rayleigh = building.rayleigh
    assert rayleigh is not None
    one, other = rayleigh.modes
    possible = one != other and max(one, other) <= floors
    _expect(possible, "building.rayleigh.modes", rayleigh.modes, f"two different modes from 1 to {floors}")
    first, second = ratios = rayleigh.damping_ratios
    try:
        damping = rayleigh_damping(masses, stiffness, (one, other), (first, second))
    except AbraceError as error:
        raise AbraceError(f"building.rayleigh: {error}") from error
    return damping, _numbers("building.rayleigh.damping_ratios", ratios, "of critical")


def _expect_definite(key: str, masses: NDArray[np.float64], stiffness: NDArray[np.float64]) -> None:
    """The stiffness must be positive definite, by more than rounding errors."""
    root = np.sqrt(masses)
    squares = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    found = f"squares of the frequencies {', '.join(f'{square:.4g}' for square in squares)} 1/s^2"
    _expect(squares[0] > 1e-12 * squares[-1], key, found, "positive ones: a positive definite matrix")


def _expect_fast_enough(rig: Rig) -> None:
    """Half the sample rate must be above every mode: faster ones are aliased and cannot be controlled."""
    stiffness = rig.building.stiffness + sum(
        group.stiffener_stiffness * np.outer(group.direction(rig.floors), group.direction(rig.floors))
        for group in rig.braces
    )
    frequencies, _ = Building(rig.building.masses, stiffness, rig.building.damping).modes()
    modes = [(frequency, f"mode {i} of the building with its stiffeners") for i, frequency in enumerate(frequencies, 1)]
    modes += [(mode.frequency, f"local_modes.{i}") for i, mode in enumerate(rig.local_modes)]
    fastest, name = max(modes)
    hertz = fastest / (2 * np.pi)
    expected = f"more than {2 * hertz:.6g} Hz, twice the frequency of {name}"
    _expect(rig.sample_rate > 2 * hertz, "sample_rate", f"{rig.sample_rate:.6g} Hz", expected)


def _numbers(key: str, values: list[float], unit: str, power: float = 1.0) -> list[Number]:
    return [Number(f"{key}.{i}", value, unit, power) for i, value in enumerate(values)]


def _expect(holds: bool, key: str, found: object, expected: str) -> None:
    if not holds:
        raise AbraceError(f"{key}: {found}, expected {expected}")


def _expect_one_each(
    values: list[float] | list[list[float]], key: str, count: int, of: str, what: str = "numbers"
) -> None:
    _expect(len(values) == count, key, f"{len(values)} {what}", f"one for each of {count} {of}")


def _expect_one_of(building: _Building, *keys: str) -> None:
    given = [key for key in keys if getattr(building, key) is not None]
    alternatives = f"{', '.join(keys[:-1])} or {keys[-1]}"
    _expect(len(given) == 1, "building", " and ".join(given) or "none of them", f"exactly one of {alternatives}")
