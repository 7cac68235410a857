# SPDX-License-Identifier: Apache-2.0
"""For every interlock a cause that trips it before any other one, planted in a rig in lockstep, without ROS.

The rig's loop is that of the node `plant`. Braces and table are driven gently (`calm_force`, `calm_table`) unless the
cause is in what drives them. Where another interlock would act first, the rig file's limit of this one is lower.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from simulated_loop import RUN, active_safety, loop_of

from abrace_core.safety.table_guard import TableGuard
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.rig.interlocks import NUMBER

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from abrace_core.safety.rig_safety import RigSafety
    from abrace_plant.devices.device import Reading, Wanted
    from abrace_plant.live.loop import RigLoop, Sample
    from abrace_plant.rig.actuator import Actuator
    from abrace_plant.rig.model import Rig

Array = NDArray[np.float64]
CHANNELS = ("x1", "x2", "x3", "xf", "a1", "a2", "a3", "fa", "fb", "w")
START = 1.0
"""Second from which a sensor fails."""
PATIENCE = 6.0
"""Seconds within which every cause trips."""
MODES = (7.363, 22.93)
"""First two natural frequencies of the paper's rig [rad/s]."""
LOCAL_MODE = 56.55
"""[rad/s]."""


def calm_force(time: float) -> float:
    """Force of every brace [N] at a `time` [s]."""
    return 2000.0 * min(time, 1.0)


def calm_table(time: float) -> float:
    """Acceleration of the table [m/s^2] at a `time` [s]."""
    return 0.05 * math.cos(2 * math.pi * time)


@dataclass(frozen=True)
class Planted:
    """A cause; what is not given is as it should be.

    Parameters
    ----------
    name
        What is wrong.
    says
        How the rig's message begins.
    limits
        By key in the rig file, values of interlocks that differ from the paper's rig.
    force
        Of every brace [N], by the time [s].
    table
        Acceleration of the table [m/s^2], by the time [s].
    fault
        A sensor fault such as "a2=stuck", from START on.
    tamper
        Changes a reading (channels,) in place, from START on; its second argument is the sample's number.
    built
        The rig as it really is, made of that of the rig file.
    """

    name: str
    says: str
    limits: Mapping[str, float] = field(default_factory=dict)
    force: Callable[[float], float] = calm_force
    table: Callable[[float], float] = calm_table
    fault: str = ""
    tamper: Callable[[Array, int], None] | None = None
    built: Callable[[Rig], Rig] | None = None

    @property
    def begins(self) -> float:
        """Second from which something is wrong."""
        return START if self.fault or self.tamper else 0.0

    def without_cause(self) -> Planted:
        """The same rig file, and nothing wrong."""
        return Planted("nothing", "", self.limits)

    def limited(self, rig: Rig) -> Rig:
        """The `rig` with the limits."""
        limits = {name: replace(rig.interlocks[name], value=value) for name, value in self.limits.items()}
        return replace(rig, interlocks={**rig.interlocks, **limits})


def _sine(amplitude: float, frequency: float) -> Callable[[float], float]:
    return lambda time: amplitude * math.sin(frequency * time)


def _cosine(amplitude: float, frequency: float) -> Callable[[float], float]:
    return lambda time: amplitude * math.cos(frequency * time)


def _with_actuators(**changes: float) -> Callable[[Rig], Rig]:
    def built(rig: Rig) -> Rig:
        def changed(actuator: Actuator) -> Actuator:
            return replace(actuator, **changes)

        return replace(rig, braces=tuple(replace(group, actuator=changed(group.actuator)) for group in rig.braces))

    return built


def _soft_second_storey(rig: Rig) -> Rig:
    storey = np.array([-1.0, 1.0, 0.0])
    stiffness = rig.building.stiffness - 1.5e6 * np.outer(storey, storey)
    return replace(rig, building=replace(rig.building, stiffness=stiffness))


def _scale(channel: str, factor: float) -> Callable[[Array, int], None]:
    place = CHANNELS.index(channel)

    def tamper(reading: Array, _: int) -> None:
        reading[place] *= factor

    return tamper


def _last_bit(channel: str, step: float) -> Callable[[Array, int], None]:
    place = CHANNELS.index(channel)

    def tamper(reading: Array, sample: int) -> None:
        reading[place] = step * (sample // 3 % 2)

    return tamper


PLANTED = {
    "drift": Planted(
        "the second storey has lost a third of its stiffness, the table moves at the building's first mode",
        "interstorey drift of storey 2: ",
        table=_cosine(0.5, 6.6),
        built=_soft_second_storey,
    ),
    "displacement": Planted(
        "the table moves at the building's first mode",
        "displacement x3: ",
        {"displacement": 0.08},
        table=_cosine(0.5, MODES[0]),
    ),
    "velocity": Planted(
        "the table moves at the building's first mode",
        "velocity of floor 3: ",
        {"velocity": 0.5},
        table=_cosine(0.5, MODES[0]),
    ),
    "stroke": Planted(
        "the braces excite the building at its first mode", "stroke xf: ", {"stroke": 0.02}, _sine(8e3, MODES[0])
    ),
    "acceleration": Planted(
        "the table moves at the building's second mode", "acceleration a1: ", table=_cosine(1.0, MODES[1])
    ),
    "force": Planted(
        "a load cell reads a fifth too much",
        "force fa: ",
        force=lambda time: 23e3 * min(time / 2, 1.0),
        tamper=_scale("fa", 1.2),
    ),
    "force_error": Planted(
        "the hydraulic supply fails, the valves give hardly any flow",
        "force f",
        force=_sine(8e3, math.pi),
        built=_with_actuators(flow_limit=1e3),
    ),
    "oscillation": Planted(
        "a commander's loop is unstable with a local mode",
        "oscillation of force fa, rms above ",
        force=lambda time: min(200.0 * math.exp(2 * time), 24e3) * math.sin(LOCAL_MODE * time),
    ),
    "table_displacement": Planted(
        "the commanded motion never turns back",
        "place where the table would stop: ",
        table=lambda time: 0.2 * min(time, 1.0),
    ),
    "table_velocity": Planted(
        "a motion is faster than the table may be",
        "velocity of the table: ",
        {"table_velocity": 0.3},
        table=_cosine(1.0, math.pi),
    ),
    "implausible_acceleration": Planted(
        "an accelerometer is mounted the wrong way round",
        "a2 against x2 and w: ",
        table=_cosine(0.2, MODES[0]),
        tamper=_scale("a2", -1.0),
    ),
    "implausible_stroke": Planted(
        "a stroke transducer has the calibration of another one",
        "stroke xf against its floor's displacement: ",
        force=_sine(3e3, MODES[0]),
        tamper=_scale("xf", 0.5),
    ),
    "noisy": Planted("a cable is torn off: an open input", "jumps of a1: ", fault="a1=noise"),
    "dead": Planted(
        "an amplifier has lost its supply: the converter's last bit is left",
        "a2: less than its own noise, at ",
        force=lambda _: 100.0,
        table=lambda _: 0.0,
        tamper=_last_bit("a2", 6.0 / 2**15),
    ),
    "stuck": Planted("a converter hangs", "x2: stuck at ", fault="x2=stuck"),
    "clipped": Planted(
        "the table accelerates beyond its accelerometer's range",
        "w: at the end of its range, at 1.5 ",
        table=_cosine(1.8, 4 * math.pi),
    ),
    NUMBER: Planted("the device gives no number", "a3: nan, expected a number", tamper=_scale("a3", math.nan)),
}
"""By interlock; NUMBER: what stops a rig whose readings are no numbers."""


def names(message: str, interlock: str) -> bool:
    """Whether a rig's message names this interlock as its cause."""
    return message.endswith("expected a number" if interlock == NUMBER else f"(interlocks.{interlock})")


class _FailingRig(SimulatedRig):
    """A simulated rig with the cause in it."""

    def __init__(self, rig: Rig, planted: Planted) -> None:
        super().__init__(planted.built(rig) if planted.built else rig, seed=1, by_the_clock=False)
        self._planted, self._number = planted, -1
        self._begins = round(START * rig.sample_rate)

    def begin(self) -> None:
        """Let the cause begin START from now on."""
        fault = self._planted.fault
        self.set_sensor_faults([f"{fault}@{START + self._samples * self._period}"] if fault else [])
        self._number = 0

    def exchange(self, command: Sequence[float], table: float, wanted: Wanted, arm: int) -> Reading:
        reading = super().exchange(command, table, wanted, arm)
        if self._number >= 0:
            self._number += 1
            if self._planted.tamper and self._number > self._begins:
                self._planted.tamper(reading.values, self._number)
        return reading


class Ran(NamedTuple):
    """A run of a rig.

    Parameters
    ----------
    loop, safety
        At its end.
    samples
        All since commands acted.
    table
        (samples,) velocity of the table [m/s].
    trip
        The first sample that tells of a fault; -1: none does.
    """

    loop: RigLoop
    safety: RigSafety
    samples: list[Sample]
    table: list[float]
    trip: int


def run_planted(rig: Rig, planted: Planted, seconds_after: float = 0.0) -> Ran:
    """Run a `rig` until it trips, for PATIENCE at most, and go on driving it for `seconds_after` as if nothing was."""
    rig = planted.limited(rig)
    safety = active_safety(rig)
    device = _FailingRig(rig, planted)
    loop = loop_of(rig, device, safety)
    table = safety.outputs[1]
    assert isinstance(table, TableGuard)
    samples: list[Sample] = []
    velocities: list[float] = []
    trip, end = -1, round(PATIENCE * rig.sample_rate)
    loop.until_it_acts()
    device.begin()
    while len(samples) <= end:
        sample = loop.step()
        samples.append(sample)
        velocities.append(table.state.velocity)
        if sample.cause and trip < 0:
            trip = len(samples) - 1
            end = trip + round(seconds_after * rig.sample_rate)
        time = (len(samples) - 1) / rig.sample_rate
        loop.receive_command(RUN, loop.sequence, [planted.force(time)] * rig.groups, "")
        loop.receive_ground_acceleration(sample.stamp, planted.table(time))
    return Ran(loop, safety, samples, velocities, trip)


class Tripped(NamedTuple):
    """What a planted cause did.

    Parameters
    ----------
    message
        The rig's message at the trip; empty: it did not trip.
    seconds
        From where something is wrong to the trip [s]; infinite: it did not trip.
    alone
        Whether the message names this interlock, and the rig does not trip without the cause.
    """

    message: str
    seconds: float
    alone: bool


def tripped(rig: Rig, interlock: str) -> Tripped:
    """What the planted cause of an `interlock` does to a `rig`."""
    planted = PLANTED[interlock]
    ran = run_planted(rig, planted)
    if ran.trip < 0:
        return Tripped("", math.inf, False)
    message = ran.samples[ran.trip].cause
    alone = names(message, interlock) and run_planted(rig, planted.without_cause()).trip < 0
    return Tripped(message, ran.trip / rig.sample_rate - planted.begins, alone)
