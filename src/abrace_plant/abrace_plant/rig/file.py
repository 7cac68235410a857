# SPDX-License-Identifier: Apache-2.0
"""The rig file: YAML that describes a rig, checked key by key."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building import Building
from abrace_plant.rig.building_file import BuildingContent, frame_file, read_building
from abrace_plant.rig.checks import DampingRatio, NotNegative, Positive, Real, expect, expect_one_each
from abrace_plant.rig.detectors import detectors, sensor_noise
from abrace_plant.rig.limits import check_limits
from abrace_plant.rig.model import BraceGroup, Interlock, LocalMode, Rig
from abrace_plant.rig.plausibility import check_units
from abrace_plant.rig.sensors import AntiAlias, Sensor, SensorSet
from abrace_plant.rig.table_dynamics import TableDynamics
from abrace_plant.rig.table_file import TableContent

if TYPE_CHECKING:
    from collections.abc import Mapping


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
    friction: NotNegative = 0.0
    deadband: NotNegative = 0.0
    stall_force: Positive = np.inf
    command_limit: Positive = np.inf


class _BraceGroup(Checked):
    floor: Annotated[int, pydantic.Field(ge=1)]
    count: Annotated[int, pydantic.Field(ge=1, le=26)]
    cosine: Annotated[float, pydantic.Field(gt=0, le=1)]
    stiffener_stiffness: NotNegative
    actuator: _Actuator
    backlash: NotNegative = 0.0


class _LocalMode(Checked):
    frequency: Positive
    damping_ratio: DampingRatio
    mass: Positive
    brace_share: list[Real]
    accelerometer_share: list[Real]
    transverse_share: list[Real] = []


class _Sensor(Checked):
    range: Positive
    noise: NotNegative
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]
    bias: Real = 0.0
    drift: Real = 0.0
    hum: NotNegative = 0.0
    hum_frequency: Annotated[float, pydantic.Field(ge=45, le=65)] = 60.0
    bandwidth: Positive = np.inf


class _AntiAlias(Checked):
    cutoff: Positive
    order: Annotated[int, pydantic.Field(ge=1, le=10)]


class _Sensors(Checked):
    displacement: _Sensor
    stroke: _Sensor
    acceleration: _Sensor
    force: _Sensor
    ground_acceleration: _Sensor
    anti_alias: _AntiAlias | None = None
    cross_axis: Annotated[float, pydantic.Field(ge=0, le=0.2)] = 0.0


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
    table: TableContent
    building: BuildingContent
    braces: Annotated[list[_BraceGroup], pydantic.Field(min_length=1)]
    local_modes: list[_LocalMode] = []
    sensors: _Sensors
    interlocks: _Interlocks = _Interlocks()


def load_rig(path: Path | str, frame: Path | None = None) -> Rig:
    """Read and check a rig file.

    Parameters
    ----------
    path
        The rig file.
    frame
        The frame file; None: the one that the rig file names, if it names one.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    content = read_config(path, _Rig, "rig")
    try:
        return _rig(content, frame)
    except AbraceError as error:
        raise AbraceError(f"rig file {path}: {error}") from error


def frame_of(path: Path | str) -> Path | None:
    """The frame file that a rig file names.

    Raises
    ------
    AbraceError
        If it is no rig file, or there is no such frame file.
    """
    named = read_config(path, _Rig, "rig").building.frame
    return None if named is None else frame_file(named)


def recorded_rig(facts: Mapping[str, str]) -> Rig | None:
    """The rig of a bag, from its `facts` `rig_file` and `frame_file`, which are the files' texts; None: not recorded.

    A bag without `frame_file` was recorded by an older version: then the frame file is the one that the rig file names.

    Raises
    ------
    AbraceError
        If a file is wrong, or the frame file is neither in the bag nor on this machine.
    """
    if "rig_file" not in facts:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path, frame = Path(folder) / "rig.yaml", Path(folder) / "frame.yaml"
        path.write_text(facts["rig_file"], encoding="utf-8")
        if "frame_file" not in facts:
            return load_rig(path)
        frame.write_text(facts["frame_file"], encoding="utf-8")
        return load_rig(path, frame)


def _rig(content: _Rig, frame: Path | None) -> Rig:
    building, storey_height, stated_stiffness, stated_damping = read_building(content.building, frame)
    floors, groups = building.floors, len(content.braces)
    for i, group in enumerate(content.braces):
        expect(group.floor <= floors, f"braces.{i}.floor", group.floor, f"a floor from 1 to {floors}")
    for i, mode in enumerate(content.local_modes):
        expect_one_each(mode.brace_share, f"local_modes.{i}.brace_share", groups, "brace groups")
        expect_one_each(mode.accelerometer_share, f"local_modes.{i}.accelerometer_share", floors, "floors")
        if mode.transverse_share:
            expect_one_each(mode.transverse_share, f"local_modes.{i}.transverse_share", floors, "floors")
    _check_braces(content)

    rig = Rig(
        name=content.name,
        sample_rate=content.sample_rate,
        table=content.table.table(),
        building=building,
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
                tuple(mode.transverse_share),
            )
            for mode in content.local_modes
        ),
        sensors=_sensors(content.sensors),
        storey_height=storey_height,
        interlocks={
            name: Interlock(**{"value": 0.0} | dict(given)) for name, given in content.interlocks if given is not None
        },
        table_dynamics=TableDynamics(**dict(content.table.dynamics)) if content.table.dynamics else None,
    )
    check_units(rig, stated_stiffness, stated_damping)
    _expect_fast_enough(rig)
    check_limits(rig, detectors(rig).noise(sensor_noise(rig)))
    return rig


def _check_braces(content: _Rig) -> None:
    """Backlash is crossed at the speed that the oil column's stiffness gives the valve's flow."""
    for i, group in enumerate(content.braces):
        possible = not group.backlash or group.actuator.velocity_feedback > 0
        expected = "0 if actuator.velocity_feedback is 0: the speed at which it is crossed would be undefined"
        expect(possible, f"braces.{i}.backlash", f"{group.backlash:g} m", expected)


def _sensors(sensors: _Sensors) -> SensorSet:
    kinds = {kind: Sensor(**dict(sensor)) for kind, sensor in sensors if isinstance(sensor, _Sensor)}
    filters = AntiAlias(**dict(sensors.anti_alias)) if sensors.anti_alias else None
    return SensorSet(**kinds, anti_alias=filters, cross_axis=sensors.cross_axis)


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
    expect(rig.sample_rate > 2 * hertz, "sample_rate", f"{rig.sample_rate:.6g} Hz", expected)
