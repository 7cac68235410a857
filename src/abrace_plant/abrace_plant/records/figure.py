# SPDX-License-Identifier: Apache-2.0
"""The figure of a record: acceleration, velocity, displacement, Husid plot and response spectra, as read and as played.

The record as read is blue, the motion that is played red.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED
from abrace_plant.records.measures import SIGNIFICANT, STANDARD_GRAVITY, husid, integrate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from abrace_plant.records.measures import Intensity, ResponseSpectrum
    from abrace_plant.records.record import Record
    from abrace_plant.records.table_motion import Demand

RECORDED: dict[str, Any] = {"color": MEASURED, "lw": 1.5}
PLAYED: dict[str, Any] = {"color": SIMULATED, "lw": 0.8}
DASHES = ("--", "-", ":", "-.")
"""Of the spectra, one for each damping ratio."""

Motion = tuple["Record", "Intensity", "ResponseSpectrum"]
"""A motion with its measures and spectra."""


def record_figure(recorded: Motion, played: Motion, demands: Sequence[Demand] = ()) -> Figure:
    """A record as read and as played, in one figure.

    Parameters
    ----------
    recorded, played
        Each a record, its intensity measures and its response spectra.
    demands
        Demands of the played motion on a table: the figure compares peak velocity and displacement with the limits.
    """
    figure = Figure(figsize=(13.0, 9.6), layout="constrained")
    grid = figure.add_gridspec(12, 2, width_ratios=(1.45, 1))
    first = figure.add_subplot(grid[:3, 0])
    histories = [first, *(figure.add_subplot(grid[row : row + 3, 0], sharex=first) for row in (3, 6, 9))]
    top = figure.add_subplot(grid[:4, 1])
    spectra = [top, *(figure.add_subplot(grid[row : row + 4, 1], sharex=top) for row in (4, 8))]
    for motion, label, style in ((recorded, "as read", RECORDED), (played, "as played", PLAYED)):
        _draw_histories(histories, motion, label, style)
        _draw_spectra(spectra, motion[2], label, style)
    first.set_title(recorded[0].name)
    first.legend(loc="upper right", ncols=2)
    names = ("acceleration [m/s²]", "velocity [cm/s]", "displacement [cm]", "Arias intensity [%]")
    for axis, name in zip(histories, names, strict=True):
        axis.set_ylabel(name)
    _in_g(first)
    for axis, quantity in zip(histories[1:3], ("velocity", "displacement"), strict=True):
        for demand in (one for one in demands if one.name == quantity):
            label = f"as played: {100 * demand.value:.3g}, the table's limit is {100 * demand.limit:.3g}"
            axis.lines[-1].set_label(label)
            axis.legend(handles=[axis.lines[-1]], loc="lower right")
    for share in SIGNIFICANT:
        histories[-1].axhline(100 * share, color=REFERENCE, lw=0.8, ls="--")
    histories[-1].legend(loc="lower right")
    histories[-1].set_xlabel("time [s]")
    first.set_xlim(0, max(len(record.acceleration) * record.sample_period for record, *_ in (recorded, played)))
    for axis, name in zip(
        spectra,
        ("pseudo-acceleration [m/s²]", "relative velocity [cm/s]", "relative displacement [cm]"),
        strict=True,
    ):
        axis.set_ylabel(name)
        axis.set_ylim(bottom=0)
    _in_g(top)
    top.set_title("response spectra")
    top.set_xscale("log")
    ticks = [period for period in (0.05, 0.1, 0.2, 0.5, 1, 2, 5) if top.get_xlim()[0] <= period <= top.get_xlim()[1]]
    top.set_xticks(ticks, [f"{period:g}" for period in ticks], minor=False)
    top.set_xticks([], minor=True)
    spectra[-1].legend(loc="upper left", fontsize="small")
    spectra[-1].set_xlabel("natural period [s]")
    for axis in (*histories, *spectra):
        axis.grid(alpha=0.3)
    for axis in (*histories[:-1], *spectra[:-1]):
        axis.tick_params(labelbottom=False)
    return figure


def _draw_histories(axes: Sequence[Axes], motion: Motion, label: str, style: dict[str, Any]) -> None:
    record, measures, _ = motion
    period = record.sample_period
    time = np.arange(len(record.acceleration)) * period
    velocity, displacement = integrate(record.acceleration, period)
    built_up = husid(record.acceleration, period)
    share = 100 * built_up / built_up[-1] if built_up[-1] else built_up
    for axis, values in zip(axes, (record.acceleration, 100 * velocity, 100 * displacement, share), strict=True):
        axis.plot(time, values, label=label, **style)
    measured = f"{built_up[-1]:.3g} m/s, D5-95 {measures.significant_duration:.2f} s"
    axes[-1].lines[-1].set_label(f"{label}: {measured}")
    for moment in (measures.significant_from, measures.significant_to):
        axes[-1].axvline(moment, ls="--", **style)


def _draw_spectra(axes: Sequence[Axes], spectrum: ResponseSpectrum, label: str, style: dict[str, Any]) -> None:
    for i, ratio in enumerate(spectrum.damping_ratios):
        curves = (spectrum.pseudo_acceleration[i], 100 * spectrum.velocity[i], 100 * spectrum.displacement[i])
        for axis, values in zip(axes, curves, strict=True):
            dashes = DASHES[i % len(DASHES)]
            axis.plot(spectrum.periods, values, label=f"{label}, damping {100 * ratio:g} %", ls=dashes, **style)


def _in_g(axis: Axes) -> None:
    """A scale in g at the right of an acceleration in m/s^2."""
    scale = (lambda value: value / STANDARD_GRAVITY, lambda value: value * STANDARD_GRAVITY)
    axis.secondary_yaxis("right", functions=scale).set_ylabel("[g]")
