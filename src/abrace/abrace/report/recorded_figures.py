# SPDX-License-Identifier: Apache-2.0
"""Figures of recorded tests: the table's motion with its spectra, and the building's response."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import welch

from abrace_core import signals
from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, captioned
from abrace_core.response import shown_unit
from abrace_core.zoomable_curves import thinned
from abrace_plant.records.record import Record
from abrace_plant.records.response_spectrum import response_spectrum
from abrace_sysid.figures.symbols import symbol

if TYPE_CHECKING:
    from abrace.report.recorded import RecordedTest
    from abrace.report.units import Units
    from abrace_core.run import Run

PERIODS = np.geomspace(0.05, 5.0, 61)
"""Of response spectra [s]."""
RATIOS = (0.02, 0.05, 0.10)
COLOURS = (REFERENCE, MEASURED, SIMULATED, "#2a7f62", "#d08c1d")
WELCH_SECONDS = 16.0
"""Length of a segment of a spectrum."""


def motion_figure(test: RecordedTest, run: Run, units: Units) -> Figure:
    """The motion of the table as measured in a `test`: its history, its spectrum, and of a record its response spectra.

    `run` is what its bag has; numbers are in these `units`.
    """
    factor, unit = shown_unit(signals.GROUND, units.system)
    is_noise = "rms" in test.motion
    figure = Figure(figsize=(10.0, 3.0), layout="constrained")
    history, spectrum = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    kept = thinned(run.time, run.ground_acceleration)
    history.plot(run.time[kept], factor * run.ground_acceleration[kept], color=MEASURED, lw=0.6)
    history.set(xlabel="time [s]", ylabel=f"{symbol(signals.GROUND)} [{unit}]", xlim=(run.time[0], run.time[-1]))
    if is_noise:
        frequency, power = _spectrum(run)
        spectrum.semilogy(frequency, factor * np.sqrt(power), color=MEASURED, lw=1.0)
        highest = 2 * float(test.motion["band"][1])
        spectrum.set(xlabel="frequency [Hz]", ylabel=f"amplitude spectral density [{unit}/√Hz]", xlim=(0, highest))
        shown = np.sqrt(power[(frequency > 0) & (frequency < highest)])
        spectrum.set_ylim(factor * shown.min() / 2, factor * shown.max() * 2)
        spectrum_text = "its amplitude spectral density"
    else:
        record = Record(test.step, run.sample_period, run.ground_acceleration)
        found = response_spectrum(record, PERIODS, RATIOS)
        for ratio, values, style in zip(RATIOS, found.pseudo_acceleration, (":", "-", "--"), strict=True):
            spectrum.plot(
                PERIODS, factor * values, color=MEASURED, ls=style, lw=1.2, label=f"damping {100 * ratio:g} %"
            )
        spectrum.set(
            xscale="log", xlabel="natural period [s]", ylabel=f"pseudo-acceleration [{unit}]", xlim=(0.05, 5.0)
        )
        ticks = [0.05, 0.1, 0.2, 0.5, 1, 2, 5]
        spectrum.set_xticks(ticks, [f"{period:g}" for period in ticks])
        spectrum.set_xticks([], minor=True)
        spectrum.set_ylim(bottom=0)
        spectrum.legend(fontsize="small")
        spectrum_text = "its response spectra"
    for axis in (history, spectrum):
        axis.grid(alpha=0.3)
    return captioned(figure, f"Acceleration of the table in test {test.step} ({test.drive}), and {spectrum_text}.")


def _spectrum(run: Run) -> tuple[np.ndarray, np.ndarray]:
    length = min(len(run.ground_acceleration), round(WELCH_SECONDS / run.sample_period))
    frequency, power = welch(run.ground_acceleration, 1 / run.sample_period, nperseg=length)
    return frequency[1:], power[1:]


def response_figure(test: RecordedTest, run: Run, units: Units) -> Figure:
    """The response of building and braces in a `test`: displacements, accelerations, forces with commands.

    `run` is read from its bag; numbers are in these `units`. Of many floors three are drawn.
    """
    floors = sorted({1, (run.floors + 1) // 2, run.floors}, reverse=True)
    rows = [[f"x{floor}" for floor in floors], [f"a{floor}" for floor in floors]]
    rows += [list(signals.numbered("f", run.groups)) + list(run.command_names)] if run.groups else []
    figure = Figure(figsize=(10.0, 1.9 * len(rows) + 0.4), layout="constrained")
    axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axis, names in zip(axes, rows, strict=True):
        factor, unit = shown_unit(names[0], units.system)
        for name, colour in zip(names, COLOURS * 4, strict=False):
            values = factor * run.channels([name])[:, 0]
            kept = thinned(run.time, values)
            axis.plot(
                run.time[kept],
                values[kept],
                color=colour,
                lw=0.7,
                label=symbol(name),
                ls="--" if name[0] == "U" else "-",
            )
        axis.set_ylabel(f"[{unit}]")
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small", ncols=len(names), loc="upper right")
    axes[-1].set(xlabel="time [s]", xlim=(run.time[0], run.time[-1]))
    controller = f", controller {test.facts['controller']}" if test.facts.get("controller") else ""
    caption = (
        f"Test {test.step} ({test.drive}{controller}): displacements relative to the table, absolute accelerations"
    )
    return captioned(figure, caption + (", forces and commands of the braces." if run.groups else "."))
