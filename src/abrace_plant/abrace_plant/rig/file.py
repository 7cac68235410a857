# SPDX-License-Identifier: Apache-2.0
"""The rig file: YAML that describes a rig, checked key by key."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, TypeVar

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config
from abrace_core.files.quantity import Quantity
from abrace_core.model import signals
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building_file import BuildingContent, read_building
from abrace_plant.rig.checks import (
    Acceleration,
    Force,
    Hertz,
    Length,
    NotNegative,
    Positive,
    Real,
    SampleRate,
    SomeAcceleration,
    SomeForce,
    SomeLength,
    Velocity,
    expect,
    expect_one_each,
)
from abrace_plant.rig.detectors import detectors
from abrace_plant.rig.limits import check_limits, frequencies
from abrace_plant.rig.model import BraceGroup, Interlock, LocalMode, Rig
from abrace_plant.rig.ranges import check_ranges
from abrace_plant.rig.sensors import KINDS, AntiAlias, Sensor, SensorSet
from abrace_plant.rig.table_file import TableContent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class _BraceGroup(Checked):
    floor: Annotated[int, pydantic.Field(ge=1)]
    count: Annotated[int, pydantic.Field(ge=1, le=26)]
    cosine: Annotated[float, pydantic.Field(ge=0.1, le=1)]
    stiffener_stiffness: Annotated[NotNegative, Quantity("N/m")]
    actuator: Actuator
    backlash: SomeLength = 0.0


class _Sensor(Checked):
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]
    hum_frequency: Annotated[float, pydantic.Field(ge=45, le=65), Quantity("Hz")] = 60.0
    bandwidth: Hertz = np.inf
    channels: Annotated[list[str], pydantic.Field(min_length=1)] | None = None


class _LengthSensor(_Sensor):
    range: Length
    noise: SomeLength
    bias: Annotated[Real, Quantity("m")] = 0.0
    drift: Annotated[Real, Quantity("m/s")] = 0.0
    hum: SomeLength = 0.0


class _Accelerometer(_Sensor):
    range: Acceleration
    noise: SomeAcceleration
    bias: Annotated[Real, Quantity("m/s^2")] = 0.0
    drift: Annotated[Real, Quantity("m/s^3")] = 0.0
    hum: SomeAcceleration = 0.0


class _LoadCell(_Sensor):
    range: Force
    noise: SomeForce
    bias: Annotated[Real, Quantity("N")] = 0.0
    drift: Annotated[Real, Quantity("N/s")] = 0.0
    hum: SomeForce = 0.0


class _Sensors(Checked):
    displacement: _LengthSensor | None = None
    stroke: _LengthSensor | None = None
    acceleration: _Accelerometer | None = None
    force: _LoadCell | None = None
    ground_acceleration: _Accelerometer | None = None
    anti_alias: AntiAlias | None = None
    cross_axis: Annotated[float, pydantic.Field(ge=0, le=0.2), Quantity("1")] = 0.0


class _ReadingInterlock(Checked):
    time: Annotated[float, pydantic.Field(ge=0, le=2), Quantity("s")]
    action: Literal["stop", "warn"] = "stop"
    reset: Literal["person"] = "person"


Times = Annotated[Positive, Quantity("1")]
Value = TypeVar("Value")


class _Interlock(_ReadingInterlock, Generic[Value]):
    value: Value


class _Interlocks(Checked):
    drift: _Interlock[Length] | None = None
    displacement: _Interlock[Length] | None = None
    velocity: _Interlock[Velocity] | None = None
    stroke: _Interlock[Length] | None = None
    acceleration: _Interlock[Acceleration] | None = None
    force: _Interlock[Force] | None = None
    force_error: _Interlock[Force] | None = None
    oscillation: _Interlock[Force] | None = None
    table_displacement: _Interlock[Length] | None = None
    table_velocity: _Interlock[Velocity] | None = None
    implausible_acceleration: _Interlock[Acceleration] | None = None
    implausible_stroke: _Interlock[Length] | None = None
    noisy: _Interlock[Times] | None = None
    dead: _Interlock[Times] | None = None
    stuck: _ReadingInterlock | None = None
    clipped: _ReadingInterlock | None = None


class _Rig(Checked):
    name: str
    sample_rate: SampleRate
    table: TableContent
    building: BuildingContent
    braces: Annotated[list[_BraceGroup], pydantic.Field(min_length=1)]
    local_modes: list[LocalMode] = []
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


def recorded_rig(facts: Mapping[str, str]) -> Rig | None:
    """The rig of a bag, from `rig_file` of its `facts`, which is the file's text; None: not recorded.

    Raises
    ------
    AbraceError
        If the file is wrong.
    """
    if "rig_file" not in facts:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        path.write_text(facts["rig_file"], encoding="utf-8")
        return load_rig(path)


def _rig(content: _Rig) -> Rig:
    building, storey_height, stated_stiffness = read_building(content.building)
    floors, groups = building.floors, len(content.braces)
    for i, group in enumerate(content.braces):
        expect(group.floor <= floors, f"braces.{i}.floor", group.floor, f"a floor from 1 to {floors}")
        # backlash is crossed at the speed that the oil column's stiffness gives the valve's flow
        possible = not group.backlash or group.actuator.velocity_feedback > 0
        expected = "0 if actuator.velocity_feedback is 0: the speed at which it is crossed would be undefined"
        expect(possible, f"braces.{i}.backlash", f"{group.backlash:g} m", expected)
    for i, mode in enumerate(content.local_modes):
        expect_one_each(mode.brace_share, f"local_modes.{i}.brace_share", groups, "brace groups")
        expect_one_each(mode.accelerometer_share, f"local_modes.{i}.accelerometer_share", floors, "floors")
        if mode.transverse_share:
            expect_one_each(mode.transverse_share, f"local_modes.{i}.transverse_share", floors, "floors")

    rig = Rig(
        name=content.name,
        sample_rate=content.sample_rate,
        table=content.table.table(),
        building=building,
        braces=tuple(BraceGroup(**dict(group)) for group in content.braces),
        local_modes=tuple(content.local_modes),
        sensors=_sensors(content.sensors, floors, [group.count for group in content.braces]),
        storey_height=storey_height,
        interlocks={
            name: Interlock(**{"value": 0.0} | dict(given)) for name, given in content.interlocks if given is not None
        },
        table_dynamics=content.table.dynamics,
        table_driven=content.table.driven,
    )
    check_ranges(rig, stated_stiffness)
    _expect_fast_enough(rig)
    check_limits(rig, detectors(rig).noise)
    return rig


def _sensors(sensors: _Sensors, floors: int, braces: Sequence[int]) -> SensorSet:
    kinds: dict[str, Any] = dict.fromkeys(KINDS)
    given = {kind: sensor for kind, sensor in sensors if isinstance(sensor, _Sensor)}
    expect(bool(given), "sensors", "none", f"one or more of {', '.join(KINDS)}")
    for kind, sensor in given.items():
        kinds[kind] = Sensor(**{key: value for key, value in sensor if key != "channels"})
    names, without = signals.channel_names(floors, braces), set()
    of_kind = SensorSet(**kinds).channels(floors, len(braces), sum(braces))
    for kind, sensor in given.items():
        possible = [name for name, one in zip(names, of_kind, strict=True) if one is kinds[kind]]
        if sensor.channels is not None:
            for i, name in enumerate(sensor.channels):
                known = name in possible and name not in sensor.channels[:i]
                expect(known, f"sensors.{kind}.channels.{i}", name, f"one of {', '.join(possible)}, each once")
            without.update(set(possible) - set(sensor.channels))
    return SensorSet(**kinds, anti_alias=sensors.anti_alias, cross_axis=sensors.cross_axis, without=frozenset(without))


def _expect_fast_enough(rig: Rig) -> None:
    """Half the sample rate must be above every mode: faster ones are aliased and cannot be controlled."""
    modes = [
        (frequency, f"mode {i} of the building with its stiffeners") for i, frequency in enumerate(frequencies(rig), 1)
    ]
    modes += [(mode.frequency, f"local_modes.{i}") for i, mode in enumerate(rig.local_modes)]
    fastest, name = max(modes)
    hertz = fastest / (2 * np.pi)
    expected = f"more than {2 * hertz:.6g} Hz, twice the frequency of {name}"
    expect(rig.sample_rate > 2 * hertz, "sample_rate", f"{rig.sample_rate:.6g} Hz", expected)
