# SPDX-License-Identifier: Apache-2.0
"""The rig as one linear model: building, braces with their actuators, local modes; `motion` steps it.

States: floor displacements x, local modal displacements q, their velocities, and for each brace group the force f of
one brace and the servo's integral g. Inputs: the table's acceleration w and the commands U. Outputs:
z = [x, strokes, absolute accelerations, forces], as recorded in the paper.

A brace group pushes its floor with `count * cosine * f`; its stroke is `cosine * (x_floor - x_below)` plus its share of
the local modes. The stiffeners act on the floors directly: a brace's load cell does not measure their force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_plant.rig.building import storey_direction
from abrace_plant.rig.checks import (  # noqa: TC001, as pydantic reads the annotations
    AngularFrequency,
    DampingRatio,
    Mass,
    Share,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

    from abrace_core.safety.table_stop import Table
    from abrace_plant.rig.actuator import Actuator
    from abrace_plant.rig.building import Building
    from abrace_plant.rig.sensors import Sensor, SensorSet
    from abrace_plant.rig.table_dynamics import TableDynamics


@dataclass(frozen=True)
class BraceGroup:
    """Equal braces in parallel below one floor.

    Parameters
    ----------
    floor
        The floor that they push, 1 the lowest; they stand on the floor below it (1: on the table).
    count
        How many braces.
    cosine
        Horizontal share of a brace's force and stroke.
    stiffener_stiffness
        Horizontal stiffness that the group's stiffeners add at its floor [N/m].
    actuator
        The actuator in each brace.
    connected
        Whether braces and stiffeners are bolted to the floor and the servo is on; a disconnected group neither pushes
        nor measures.
    backlash
        Clearance of a brace's pins from one side to the other, along the brace [m].
    """

    floor: int
    count: int
    cosine: float
    stiffener_stiffness: float
    actuator: Actuator
    connected: bool = True
    backlash: float = 0.0

    def direction(self, floors: int) -> NDArray[np.float64]:
        """(floors,) 1 at the braces' floor, -1 at the floor below: x_floor - x_below."""
        return storey_direction(self.floor, floors)


@dataclass(frozen=True)
class LocalMode:
    """A mode that the actuators excite and the table does not (torsion, a slab, the transverse direction).

    Parameters
    ----------
    frequency, damping_ratio
        [rad/s], of the mode alone.
    mass
        Modal mass [kg].
    brace_share
        (groups,) share of the modal displacement in a brace's stroke, and of its force in the modal force.
    accelerometer_share
        (floors,) share of the modal acceleration in each floor's accelerometer.
    transverse_share
        (floors,) share of the modal acceleration across the accelerometers' axis; empty: none.
    """

    frequency: AngularFrequency
    damping_ratio: DampingRatio
    mass: Mass
    brace_share: tuple[Share, ...]
    accelerometer_share: tuple[Share, ...]
    transverse_share: tuple[Share, ...] = ()


@dataclass(frozen=True)
class Interlock:
    """A limit of one kind, for each channel of that kind.

    Parameters
    ----------
    value
        In the unit of `limits.INTERLOCKS`; 0 for `stuck` and `clipped`, which have none.
    time
        How long the value has to be exceeded before the interlock acts [s]; at least one sample.
    action
        "stop": braces and table are ramped down, and latched; "warn": it is only reported.
    reset
        "person": only a person clears a stop.
    """

    value: float
    time: float
    action: str = "stop"
    reset: str = "person"


@dataclass(frozen=True)
class Rig:
    """A building with braces on a shake table.

    Parameters
    ----------
    name
        The laboratory's name of it.
    sample_rate
        Hz.
    table
        Limits of the shake table.
    building, braces, local_modes
        The physical parts; no braces: the bare frame.
    sensors
        Those that measure the outputs.
    storey_height
        m, the mean where storeys differ.
    interlocks
        Limits by name; those that are left out follow from the other numbers, see `limits.limit_table`.
    table_dynamics
        How the table follows its command; None: exactly.
    table_driven
        Whether abrace drives it; if not, its own controller does, and abrace commands the braces alone.
    """

    name: str
    sample_rate: float
    table: Table
    building: Building
    braces: tuple[BraceGroup, ...]
    local_modes: tuple[LocalMode, ...]
    sensors: SensorSet
    storey_height: float = 3.0
    interlocks: Mapping[str, Interlock] = field(default_factory=dict)
    table_dynamics: TableDynamics | None = None
    table_driven: bool = True

    def __repr__(self) -> str:
        braces = " + ".join(str(count) for count in self.braces_in_group) or "no"
        return f"<Rig {self.name}: {self.floors} floors, {braces} braces, {self.sample_rate:g} Hz>"

    @property
    def floors(self) -> int:
        """Number of floors."""
        return self.building.floors

    @property
    def groups(self) -> int:
        """Number of brace groups."""
        return len(self.braces)

    @property
    def storey_heights(self) -> NDArray[np.float64]:
        """(floors,) [m], the lowest first."""
        return np.array(self.building.heights or [self.storey_height] * self.floors)

    @cached_property
    def braces_in_group(self) -> tuple[int, ...]:
        """(groups,) number of braces."""
        return tuple(group.count for group in self.braces)

    @cached_property
    def _channels(self) -> list[tuple[int, str, Sensor]]:
        """Place among `signals.channel_names`, name and sensor of each channel that is measured."""
        names = signals.channel_names(self.floors, self.braces_in_group)
        sensors = self.sensors.channels(self.floors, self.groups, sum(self.braces_in_group))
        return [
            (place, name, sensor)
            for place, (name, sensor) in enumerate(zip(names, sensors, strict=True))
            if sensor is not None and name not in self.sensors.without
        ]

    @cached_property
    def channel_names(self) -> tuple[str, ...]:
        """(channels,) in the order of `signals.channel_names`, without those that have no sensor."""
        return tuple(name for _, name, _ in self._channels)

    @cached_property
    def channel_sensors(self) -> list[Sensor]:
        """(channels,)."""
        return [sensor for *_, sensor in self._channels]

    @cached_property
    def channel_places(self) -> list[int]:
        """(channels,) the place of each channel among `signals.channel_names`."""
        return [place for place, *_ in self._channels]

    @cached_property
    def not_measured(self) -> tuple[str, ...]:
        """Those of `signals.channel_names` that have no sensor."""
        return tuple(
            name for name in signals.channel_names(self.floors, self.braces_in_group) if name not in self.channel_names
        )

    @cached_property
    def recorded_names(self) -> tuple[str, ...]:
        """As `signals.recorded_names`."""
        return signals.recorded_names(self.floors, self.braces_in_group, self.not_measured)

    def as_in_message(self, reading: list[float]) -> list[float]:
        """A `reading` (channels,) with an entry for each of `signals.channel_names`, NaN for what is not measured."""
        if not self.not_measured:
            return reading
        every = [math.nan] * (len(reading) + len(self.not_measured))
        for place, value in zip(self.channel_places, reading, strict=True):
            every[place] = value
        return every

    def bits_in_message(self, clipped: int) -> int:
        """The bits of `clipped`, bit i that of `channel_names[i]`, as bits of `signals.channel_names`."""
        if not self.not_measured:
            return clipped
        return sum((clipped >> i & 1) << place for i, place in enumerate(self.channel_places))

    @cached_property
    def measured_outputs(self) -> NDArray[np.intp]:
        """(channels but the table's,) which of the outputs z each channel measures; the table's channel is the last."""
        others = 2 * self.floors + self.groups
        groups = others + np.repeat(np.arange(self.groups), self.braces_in_group)
        every = np.concatenate([np.arange(others), groups])
        return every[[place for place in self.channel_places if place < len(every)]].astype(np.intp)

    def readings_of(self, outputs: NDArray[np.float64], ground: NDArray[np.float64]) -> NDArray[np.float64]:
        """(samples, channels) what exact sensors read of `outputs` z (samples, outputs) and `ground` (samples,)."""
        every = np.column_stack([outputs[:, self.measured_outputs], ground])
        return every[:, : len(self.channel_names)]

    @property
    def capacity(self) -> NDArray[np.float64]:
        """(groups,) greatest command of one brace of each group [N]: its capacity, or its command limit."""
        return np.array([min(group.actuator.capacity, group.actuator.command_limit) for group in self.braces])

    @property
    def rate_limit(self) -> NDArray[np.float64]:
        """(groups,) greatest rate of the command of one brace of each group [N/s]."""
        return np.array([group.actuator.rate_limit for group in self.braces])

    def bare_frame(self) -> Rig:
        """The same building without braces, stiffeners and local modes."""
        return replace(self, braces=(), local_modes=())

    def disconnect(self, groups: Collection[int]) -> Rig:
        """The same rig with some brace `groups` (the first is 1) disconnected.

        Raises
        ------
        AbraceError
            If there is no such group.
        """
        unknown = [number for number in groups if not 1 <= number <= self.groups]
        if unknown:
            raise AbraceError(f"brace group {unknown[0]}: expected one of the rig's groups, 1 to {self.groups}")
        braces = tuple(
            replace(group, connected=group.connected and number not in groups)
            for number, group in enumerate(self.braces, 1)
        )
        return replace(self, braces=braces)

    @cached_property
    def model(self) -> LinearModel:
        """The continuous model from [w, U] to z, without sensors; exact except for the effects that `effects` lists."""
        n, h, groups = self.floors, len(self.local_modes), self.groups
        dofs = n + h
        mass = np.concatenate([self.building.masses, [mode.mass for mode in self.local_modes]])
        stiffness, damping = np.zeros((dofs, dofs)), np.zeros((dofs, dofs))
        stiffness[:n, :n], damping[:n, :n] = self.building.stiffness, self.building.damping
        for i, mode in enumerate(self.local_modes):
            stiffness[n + i, n + i] = mode.mass * mode.frequency**2
            damping[n + i, n + i] = 2 * mode.damping_ratio * mode.frequency * mode.mass
        stroke = np.zeros((groups, dofs))
        for j, group in enumerate(self.braces):
            if not group.connected:
                continue
            direction = group.direction(n)
            stiffness[:n, :n] += group.stiffener_stiffness * np.outer(direction, direction)
            stroke[j, :n] = group.cosine * direction
            stroke[j, n:] = [mode.brace_share[j] for mode in self.local_modes]
        count = np.array([group.count for group in self.braces], dtype=np.float64)
        lag = np.array([group.actuator.lag for group in self.braces])
        integral = np.array([group.actuator.integral_rate for group in self.braces])
        feedback = np.array([group.actuator.velocity_feedback for group in self.braces])
        connected = np.array([float(group.connected) for group in self.braces])

        states = 2 * dofs + 2 * groups
        x, v = slice(0, dofs), slice(dofs, 2 * dofs)
        f, g = slice(2 * dofs, 2 * dofs + groups), slice(2 * dofs + groups, states)
        a, b = np.zeros((states, states)), np.zeros((states, 1 + groups))
        a[x, v] = np.eye(dofs)
        a[v, x] = -stiffness / mass[:, None]
        a[v, v] = -damping / mass[:, None]
        a[v, f] = stroke.T * count / mass[:, None]
        b[dofs : dofs + n, 0] = -1.0
        a[f, v] = -(feedback / lag)[:, None] * stroke
        a[f, f] = -np.diag(1 / lag)
        a[f, g] = np.diag(integral / lag)
        b[f, 1:] = np.diag(connected / lag)
        a[g, f] = -np.eye(groups)
        b[g, 1:] = np.diag(connected)

        accelerometers = np.zeros((n, dofs))
        accelerometers[:, :n] = np.eye(n)
        for i, mode in enumerate(self.local_modes):
            accelerometers[:, n + i] = mode.accelerometer_share
        c, d = np.zeros((2 * n + 2 * groups, states)), np.zeros((2 * n + 2 * groups, 1 + groups))
        c[:n, :n] = np.eye(n)
        c[n : n + groups, x] = stroke
        accelerations = slice(n + groups, 2 * n + groups)
        c[accelerations] = accelerometers @ a[v]
        d[accelerations] = accelerometers @ b[v]
        d[accelerations, 0] += 1.0
        c[2 * n + groups :, f] = np.eye(groups)
        inputs = (signals.GROUND, *signals.command_names(groups)) if groups else (signals.GROUND,)
        outputs = signals.response_names(n, groups) if groups else tuple(f"{k}{i + 1}" for k in "xa" for i in range(n))
        delay = (0.0, *(group.actuator.command_delay for group in self.braces))
        of_rig = {"rig": self.name, "sample_period": 1 / self.sample_rate, "force_limit": self.capacity.tolist()}
        return LinearModel(a, b, c, d, inputs, outputs, input_delay=delay, provenance=of_rig)

    @property
    def measured_model(self) -> LinearModel:
        """The `model` with the outputs that are measured alone, as one that is identified on the rig."""
        return self.model.select([name for name in self.model.outputs if name in self.recorded_names])

    def discrete_model(self) -> LinearModel:
        """The exact discrete model at the rig's sample rate: commands held, ground acceleration linear in between."""
        return discretize(self.model, 1 / self.sample_rate)
