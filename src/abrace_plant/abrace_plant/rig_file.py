"""The rig file: YAML that describes a rig, checked key by key."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError
from abrace_plant.actuator import Actuator
from abrace_plant.building import Building
from abrace_plant.rig import BraceGroup, LocalMode, Rig, Table
from abrace_plant.sensors import Sensor, SensorSet

if TYPE_CHECKING:
    from pathlib import Path

Positive = Annotated[float, pydantic.Field(gt=0)]
DampingRatio = Annotated[float, pydantic.Field(gt=0, lt=1)]


class _Table(Checked):
    peak_acceleration: Positive
    peak_jerk: Positive


class _Building(Checked):
    storey_height: Positive
    masses: list[Positive]
    stiffness: list[list[float]]
    damping_ratios: list[DampingRatio]


class _Actuator(Checked):
    capacity: Positive
    rate_limit: Positive
    lag: Positive
    integral_rate: Positive
    velocity_feedback: Annotated[float, pydantic.Field(ge=0)]


class _BraceGroup(Checked):
    floor: Annotated[int, pydantic.Field(ge=1)]
    count: Annotated[int, pydantic.Field(ge=1)]
    cosine: Annotated[float, pydantic.Field(gt=0, le=1)]
    stiffener_stiffness: Annotated[float, pydantic.Field(ge=0)]
    actuator: _Actuator


class _LocalMode(Checked):
    frequency: Positive
    damping_ratio: DampingRatio
    mass: Positive
    brace_share: list[float]
    accelerometer_share: list[float]


class _Sensor(Checked):
    range: Positive
    noise: Annotated[float, pydantic.Field(ge=0)]
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]


class _Sensors(Checked):
    displacement: _Sensor
    stroke: _Sensor
    acceleration: _Sensor
    force: _Sensor
    ground_acceleration: _Sensor


class _Rig(Checked):
    name: str
    sample_rate: Positive
    table: _Table
    building: _Building
    braces: Annotated[list[_BraceGroup], pydantic.Field(min_length=1)]
    local_modes: list[_LocalMode] = []
    sensors: _Sensors


def load_rig(path: Path | str) -> Rig:
    """Read and check a rig file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    content = read_config(path, _Rig, "rig")
    floors, groups = len(content.building.masses), len(content.braces)

    def expect(holds: bool, key: str, found: object, expected: str) -> None:
        if not holds:
            raise AbraceError(f"rig file {path}: {key}: {found}, expected {expected}")

    building = content.building
    rows = [len(row) for row in building.stiffness]
    expect(rows == [floors] * floors, "building.stiffness", f"rows of {rows} numbers", f"{floors} rows of {floors}")
    stiffness = np.array(building.stiffness)
    scale = np.abs(stiffness).max()
    expect(np.abs(stiffness - stiffness.T).max() <= 1e-9 * scale, "building.stiffness", "not symmetric", "symmetry")
    least = np.linalg.eigvalsh(stiffness)[0]
    expect(least > 0, "building.stiffness", f"least eigenvalue {least:.6g}", "a positive definite matrix")
    count = len(building.damping_ratios)
    expect(count == floors, "building.damping_ratios", f"{count} numbers", f"one for each of {floors} floors")
    for i, group in enumerate(content.braces):
        expect(group.floor <= floors, f"braces.{i}.floor", group.floor, f"a floor from 1 to {floors}")
    for i, mode in enumerate(content.local_modes):
        key, count = f"local_modes.{i}", len(mode.brace_share)
        expect(count == groups, f"{key}.brace_share", f"{count} numbers", f"one for each of {groups} brace groups")
        count = len(mode.accelerometer_share)
        expect(count == floors, f"{key}.accelerometer_share", f"{count} numbers", f"one for each of {floors} floors")

    return Rig(
        name=content.name,
        sample_rate=content.sample_rate,
        table=Table(**content.table.model_dump()),
        building=Building(np.array(building.masses), stiffness, np.array(building.damping_ratios)),
        braces=tuple(
            BraceGroup(
                group.floor,
                group.count,
                group.cosine,
                group.stiffener_stiffness,
                Actuator(**group.actuator.model_dump()),
            )
            for group in content.braces
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
        sensors=SensorSet(**{key: Sensor(**value) for key, value in content.sensors.model_dump().items()}),
        storey_height=building.storey_height,
    )
