# SPDX-License-Identifier: Apache-2.0
"""Figure of the effects that a rig's linear model leaves out: storeys, pins and valve, table and filters."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED
from abrace_plant.rig.building import Building
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensor_dynamics import low_pass, sections

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

SWINGS = 6
"""Of the first mode, and of the brace on the bench."""
COLOURS = (MEASURED, SIMULATED, "#2e8b57", "#b8860b")


def effects_figure(rig: Rig) -> Figure:
    """Hysteresis of the storeys, the first brace on the bench, gains of table and sensors of a `rig`."""
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    storeys, brace, gains = figure.subplots(1, 3)
    _storeys(storeys, rig)
    _brace(brace, rig)
    _gains(gains, rig)
    for axis in (storeys, brace, gains):
        axis.grid(alpha=0.3)
    return figure


def _moved(rig: Rig, ground: NDArray[np.float64], command: NDArray[np.float64]) -> NDArray[np.float64]:
    """(samples, channels) [z, w] of a `rig` without filters and cross-axis."""
    motion = RigMotion(replace(rig, sensors=replace(rig.sensors, anti_alias=None, cross_axis=0.0)))
    return np.array([[*motion.outputs(*one), motion.ground_acceleration] for one in zip(ground, command, strict=True)])


def _storeys(axis: Axes, rig: Rig) -> None:
    """Force of each storey minus that of the linear frame, while the table shakes the bare frame in its first mode."""
    bare = replace(rig.bare_frame(), table_dynamics=None)
    frequencies, _ = bare.building.modes()
    seconds = np.arange(0.0, SWINGS * 2 * np.pi / frequencies[0], 1 / rig.sample_rate)
    ground = 0.02 * frequencies[0] ** 2 * rig.storey_height / 3 / SWINGS * np.sin(frequencies[0] * seconds)
    found = _moved(bare, ground, np.zeros((len(ground), 0)))
    floors, period = rig.floors, 1 / rig.sample_rate
    x, a = found[:, :floors], found[:, floors : 2 * floors]
    # forces on the floors, then of the storeys: the sum of those above
    linear = x @ bare.building.stiffness + np.gradient(x, period, axis=0) @ bare.building.damping
    beyond = np.cumsum((-a * bare.building.masses - linear)[:, ::-1], axis=1)[:, ::-1]
    drift = np.diff(x, axis=1, prepend=0.0)
    for storey in range(min(floors, len(COLOURS))):
        axis.plot(
            1e3 * drift[:, storey], beyond[:, storey], lw=0.8, color=COLOURS[storey], label=f"storey {storey + 1}"
        )
    axis.set_title("storeys, minus the linear frame")
    axis.set_xlabel("drift [mm]")
    axis.set_ylabel("force [N]")
    axis.legend()


def _brace(axis: Axes, rig: Rig) -> None:
    """Load cell against command and stroke of the first brace, with its rod blocked."""
    group = rig.braces[0]
    still = Building(np.array([1e15]), np.array([[1e15]]), np.zeros((1, 1)))
    bench = replace(
        rig, building=still, braces=(replace(group, floor=1, count=1),), local_modes=(), table_dynamics=None
    )
    seconds = np.arange(0.0, SWINGS, 1 / rig.sample_rate)
    command = 0.02 * group.actuator.capacity * seconds / SWINGS * np.sin(2 * np.pi * seconds)
    found = _moved(bench, 0 * command, command[:, None])
    axis.plot(1e3 * found[:, 1], found[:, 3], lw=0.8, color=MEASURED)
    axis.set_title("first brace on the bench")
    axis.set_xlabel("stroke, rod blocked [mm]")
    axis.set_ylabel("force [N]")


def _gains(axis: Axes, rig: Rig) -> None:
    """Table against its command, with the building on it, and an accelerometer's reading against the acceleration."""
    if rig.table_dynamics is not None:
        random = np.random.default_rng(0).normal(0.0, 0.1, 60 * int(rig.sample_rate))
        table = _moved(rig, random, np.zeros((len(random), rig.groups)))[:, -1]
        segments = len(random) // 20
        window = np.hanning(segments)

        def spectra(signal: NDArray[np.float64]) -> NDArray[np.complex128]:
            starts = range(0, len(random) - segments + 1, segments // 2)
            return np.fft.rfft([window * signal[i : i + segments] for i in starts], axis=1)

        given, reached = spectra(random), spectra(table)
        gain = np.abs((reached * given.conj()).mean(axis=0)) / (np.abs(given) ** 2).mean(axis=0)
        axis.plot(np.fft.rfftfreq(segments, 1 / rig.sample_rate)[1:], gain[1:], lw=0.8, color=MEASURED, label="table")
    cascade = sections(rig.sensors.acceleration, rig.sensors.anti_alias)
    if cascade:
        a, b = low_pass(cascade)
        hertz = np.linspace(0.1, rig.sample_rate / 2, 500)
        response = [np.linalg.solve(2j * np.pi * f * np.eye(len(b)) - a, b)[-1] for f in hertz]
        axis.plot(hertz, np.abs(response), lw=1.2, color=SIMULATED, label="accelerometer and filter")
    axis.axhline(1.0, color=REFERENCE, lw=0.8, ls=":")
    axis.set_xscale("log")
    axis.set_title("table and sensors")
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("gain [-]")
    axis.set_xlim(0.2, rig.sample_rate / 2)
    if axis.get_legend_handles_labels()[0]:
        axis.legend()
