# SPDX-License-Identifier: Apache-2.0
"""A rig's characteristics drawn in the manner of the paper's Figs. 2 and 3, with its poles and its first mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED, plain_ticks
from abrace_plant.rig import published
from abrace_plant.rig.characteristics import LINES, bench_response, force_response

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from abrace_plant.rig.characteristics import Characteristics, Pairs
    from abrace_plant.rig.model import Rig


def characteristics_figure(rig: Rig, found: Characteristics) -> Figure:
    """Bench test, f/U in the building, poles and first mode, of the paper's rig with the paper's numbers.

    Parameters
    ----------
    rig
        The rig.
    found
        Its characteristics.
    """
    figure = Figure(figsize=(12.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    omega = 2 * np.pi * np.linspace(0.02, published.BENCH_BAND, 5 * LINES)
    colours = (MEASURED, SIMULATED, "#2e8b57", "#b8860b")
    for number, group in enumerate(rig.braces):
        label = f"group {number + 1}" if rig.groups > 1 else "rig"
        style = {"color": colours[number % len(colours)], "lw": 1.2, "label": label}
        for column, response in ((0, bench_response(group.actuator, omega)), (1, force_response(rig, number, omega))):
            axes[0, column].plot(omega / (2 * np.pi), np.abs(response), **style)
            axes[1, column].plot(omega / (2 * np.pi), np.degrees(np.unwrap(np.angle(response))), **style)
    axes[0, 0].set_title("actuator on the bench (Fig. 2): f / U")
    axes[0, 1].set_title("actuator in the building (Fig. 3): f / U")
    axes[0, 0].set_ylim(0.0, 1.2)
    axes[0, 1].set_yscale("log")
    if rig.name == published.RIG:
        phase = -np.degrees(omega * published.BENCH_LAG)
        axes[1, 0].plot(omega / (2 * np.pi), phase, color=REFERENCE, ls="--", label="paper: 0.8 ms")
        axes[1, 0].legend()
    for frequency, _ in found.zero_command:
        axes[0, 1].axvline(frequency / (2 * np.pi), color=REFERENCE, lw=0.8, ls=":")
    plain_ticks(axes[0, 1].yaxis, *axes[0, 1].get_ylim())
    if rig.groups > 1:
        axes[0, 1].legend()
    for column in (0, 1):
        axes[0, column].set_ylabel("amplitude [-]")
        axes[1, column].set_ylabel("phase angle [deg]")
        axes[1, column].set_xlabel("frequency [Hz]")
    _poles(axes[0, 2], rig, found)
    _first_mode(axes[1, 2], rig, found)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    return figure


def _poles(axis: Axes, rig: Rig, found: Characteristics) -> None:
    def draw(pairs: Pairs, marker: str, colour: str, label: str, size: float) -> None:
        frequencies = [frequency for frequency, _ in pairs]
        percent = [100 * ratio for _, ratio in pairs]
        filled = colour if size < 8 else "none"
        axis.loglog(frequencies, percent, marker, ms=size, mfc=filled, mec=colour, ls="none", label=label)

    if rig.name == published.RIG:
        draw(published.BARE, "o", REFERENCE, "paper: bare frame", 11)
        draw(published.ZERO_COMMAND, "s", REFERENCE, "paper: zero command", 11)
        draw(published.EXTRA, "D", REFERENCE, "paper: further pairs of A2", 11)
    draw(found.bare, "o", MEASURED, "bare frame", 5)
    draw(found.zero_command, "s", SIMULATED, "zero command", 5)
    draw(found.extra, "D", "k", "further pairs", 5)
    axis.set_ylim(top=5 * axis.get_ylim()[1])
    plain_ticks(axis.xaxis, *axis.get_xlim())
    plain_ticks(axis.yaxis, *axis.get_ylim())
    axis.set_title("poles")
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("damping ratio [%]")
    axis.legend(fontsize=7, ncols=2, loc="upper left")


def _first_mode(axis: Axes, rig: Rig, found: Characteristics) -> None:
    height = np.cumsum([0.0, *rig.storey_heights])
    axis.plot([0.0, *found.shape], height, "o-", color=MEASURED, label="rig")
    if rig.name == published.RIG:
        axis.plot([0.0, *published.SHAPE], height, "s--", color=REFERENCE, mfc="none", label="paper: rms of Table 1")
    axis.set_title("first mode, zero command")
    axis.set_xlabel("displacement [-]")
    axis.set_ylabel("height [m]")
    axis.legend()
