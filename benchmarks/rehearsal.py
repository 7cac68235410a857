# SPDX-License-Identifier: Apache-2.0
"""Tests of a rig sample by sample without ROS, with its interlocks: for their margins, and for what trips them.

The parts are those that run in the nodes: motion within the limits, sensors with their faults, command guards, the
control law. A trip ramps braces and table down; the test goes on for as long as it was to last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from abrace_core.model.controller_file import Controller
from abrace_core.model.noise import banded_noise
from abrace_core.safety.rig_safety import RigSafety, State
from abrace_core.safety.table_guard import TableGuard
from abrace_lqg.control_law import ControlLaw
from abrace_lqg.design import design
from abrace_plant.live.loop import rig_outputs
from abrace_plant.records.files import read_record
from abrace_plant.records.options import Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.interlocks import Interlocks, Trip
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.published import INTENSITY
from abrace_plant.rig.sensors import Measurement, OverRange, parse_fault
from abrace_sysid.models.reduction import balanced_truncation, typical_scales

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace_lqg.weights import Weights
    from abrace_plant.rig.model import Rig

Array = NDArray[np.float64]
TENTH_OF_G = 0.980665


class Outcome(NamedTuple):
    """Result of a test: trip and its time [s], greatest true drift until then and in all [m], and the utilisation."""

    trip: Trip | None
    time: float
    drift: float
    greatest_drift: float
    utilisation: dict[str, float]


def controller(rig: Rig, weights: Weights, gain: float = 1.0) -> Controller:
    """The controller of these weights on the rig's model of 8 states.

    With another `gain` than 1 it is wrong (-1: its sign), and winds up, as Eq. (13) is printed.
    """
    reduced = balanced_truncation(rig.model, 8, typical_scales(rig.model, (0.3, 30.0), INTENSITY)).model
    made = design(reduced, weights, 1 / rig.sample_rate)
    law = replace(made.controller, c=gain * made.controller.c, d=gain * made.controller.d)
    correction = made.correction if gain == 1 else 0 * made.correction
    return Controller("law", law, correction, made.prediction, rig.capacity, "", "", "")


@dataclass(frozen=True)
class Cause:
    """A fault that begins at `start` [s].

    Parameters
    ----------
    start
        [s].
    fault
        A sensor fault such as "a2=stuck".
    tamper
        Changes a reading in place.
    table
        Acceleration [m/s^2] that the table has beyond the commanded one.
    """

    start: float = 0.0
    fault: str = ""
    tamper: Callable[[Array], None] | None = None
    table: float = 0.0


def rehearse(
    rig: Rig,
    ground: Array,
    excitation: Array | None = None,
    law: Controller | None = None,
    cause: Cause | None = None,
    seed: int = 1,
) -> Outcome:
    """Run a test.

    Parameters
    ----------
    rig
        The rig.
    ground
        (samples,) acceleration of the table [m/s^2].
    excitation
        (samples,) command of every group [N]; None: zero, or the law's.
    law
        The controller, from the first sample on.
    cause
        What goes wrong; None: nothing.
    seed
        Of the sensors' noise.
    """
    cause = cause or Cause()
    period, groups = 1 / rig.sample_rate, rig.groups
    names, sensors = rig.channel_names, rig.channel_sensors
    measurement, over_range = Measurement(sensors, seed, period), OverRange(sensors)
    if cause.fault:
        measurement.faults = (parse_fault(f"{cause.fault}@{cause.start}", names, period),)
    interlocks, motion = Interlocks(rig), RigMotion(rig)
    safety = RigSafety()
    safety.configure(rig_outputs(rig), period)
    safety.activate()
    safety.begin()
    while safety.state is not State.RUNNING:
        safety.act([None, None])
    braces, table = safety.outputs
    assert isinstance(table, TableGuard)
    running = ControlLaw(law, names) if law else None
    start = round(cause.start / period)
    wanted, true = [0.0] * groups, np.zeros(len(names))
    drift = greatest = time = 0.0
    trip = None
    for k, planned in enumerate(ground):
        until_now = braces.value
        safety.act([wanted, [planned + (cause.table if k >= start else 0.0)]])
        if running and k:
            running.advance(braces.value)
        true[:-1] = motion.outputs(table.value[0], np.array(braces.value))[rig.measured_outputs]
        true[-1] = motion.ground_acceleration
        reading = measurement.read(true)
        if cause.tamper and k >= start:
            cause.tamper(reading)
        turning, clipped = table.turning_point, over_range.check(reading)
        found = interlocks.check(reading, until_now, table.state.velocity, turning, clipped)
        greatest = max(greatest, float(np.abs(np.diff(true[: rig.floors], prepend=0.0)).max()))
        if found and not trip:
            trip, time, drift = found, k * period, greatest
            safety.fault(str(found))
        if running:
            wanted = running.update(reading.tolist()).tolist()
        elif excitation is not None:
            wanted = [excitation[k]] * groups
    return Outcome(trip, time, drift, greatest, interlocks.utilisation())


def el_centro(sample_rate: float, seconds: float = 0.0) -> Array:
    """El Centro at 0.1 g; whole unless `seconds` [s] are given."""
    return prepare(read_record("el_centro"), sample_rate, Treatment(peak_acceleration=TENTH_OF_G, duration=seconds))


def pulse(sample_rate: float) -> Array:
    """A near-fault pulse of 1 s at 0.1 g, as in the Kobe record, and the 12 s after it."""
    time = np.arange(round(15 * sample_rate)) / sample_rate - 3.0
    motion = np.cos(2 * np.pi * time) * np.exp(-(time**2) / 0.5)
    return _table_motion(motion, sample_rate) * TENTH_OF_G


def earthquake(sample_rate: float, seed: int = 3000) -> Array:
    """Noise with the envelope of an earthquake, at 0.1 g, 40 s."""
    time = np.arange(round(40 * sample_rate)) / sample_rate
    rise_and_decay = np.minimum(time / 2, 1) * np.exp(-np.maximum(time - 8, 0) / 8)
    noise = banded_noise(len(time), sample_rate, (0.3, 12.0), 1.0, seed) * rise_and_decay
    return _table_motion(noise, sample_rate) * TENTH_OF_G


def harmonic(sample_rate: float, frequency: float, amplitude: float, seconds: float = 20.0) -> Array:
    """A sinusoid of `frequency` [rad/s] and `amplitude` [m/s^2] that rises within 3 s."""
    time = np.arange(round(seconds * sample_rate)) / sample_rate
    # from the rest of the displacement, so that the table does not drift
    return _table_motion(np.minimum(time / 3, 1) * np.sin(frequency * time), sample_rate) * amplitude


def table_noise(sample_rate: float, seconds: float, rms: float, seed: int) -> Array:
    """White noise of the table with an `rms` [m/s^2], from the lowest frequency that the table can follow to 10 Hz."""
    noise = _table_motion(banded_noise(round(seconds * sample_rate), sample_rate, (0.0, 10.0), 1.0, seed), sample_rate)
    return noise * rms / np.sqrt(np.mean(noise**2))


def command_noise(sample_rate: float, seconds: float, rms: float, seed: int) -> Array:
    """White noise of the command up to 30 Hz with an `rms` [N]."""
    return banded_noise(round(seconds * sample_rate), sample_rate, (0.0, 30.0), rms, seed)


def _table_motion(motion: Sequence[float] | Array, sample_rate: float) -> Array:
    """The motion, scaled to a peak of 1, without frequencies that the table cannot follow."""
    record = Record("motion", 1 / sample_rate, np.asarray(motion, dtype=np.float64))
    return prepare(record, sample_rate, Treatment(low_cut=0.3, peak_acceleration=1.0))
