# SPDX-License-Identifier: Apache-2.0
"""Figures of a fragility study: curves with their bands, safety against force, what a failing sensor costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned
from abrace_lqg.fragility.study import INTACT, ZERO_COMMAND, unit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_lqg.fragility.curves import FragilityCurve

COLOURS = (MEASURED, SIMULATED, ERROR, "#3a7d44", "#6a4c93", "#2a9d8f", "#8c564b")
"""Of controllers; the zero command is grey."""
POINTS = 200
"""Of a curve."""


@dataclass(frozen=True)
class Subject:
    """A controller, its sensors intact or one of them failing.

    Parameters
    ----------
    controller, fault
        Their names.
    curves
        For each limit, by its quantity.
    force
        (intensities,) mean over the loops of the rms command [N].
    saturated, interlocked
        (intensities,) share of the loops in which a command was at its limit, and in which an interlock acted.
    """

    controller: str
    fault: str
    curves: dict[str, FragilityCurve]
    force: NDArray[np.float64]
    saturated: NDArray[np.float64]
    interlocked: NDArray[np.float64]


def fragility_figure(subjects: Sequence[Subject], limits: Mapping[str, float]) -> Figure:
    """The probability that each of the `limits` is exceeded, of the intact `subjects`: fits, bands, and fractions."""
    figure, axes = _axes(len(limits))
    colours = _colours(subjects)
    for axis, (name, limit) in zip(axes, limits.items(), strict=True):
        for subject in _intact(subjects):
            curve, colour = subject.curves[name], colours[subject.controller]
            axis.plot(curve.intensity, curve.fractions, "o", color=colour, markersize=4)
            label = subject.controller
            if not np.isfinite(curve.median):
                axis.plot([], [], "o", color=colour, label=f"{label}: no curve")
                continue
            x = np.geomspace(curve.intensity[0] / 2, curve.intensity[-1] * 1.5, POINTS)
            axis.plot(x, curve.probability(x), color=colour, label=f"{label}: {curve.median:.3g} m/s²")
            if len(curve.resampled):
                axis.fill_between(x, *curve.band(x), color=colour, alpha=0.18, linewidth=0)
        axis.set(title=_limit(name, limit), xlabel="peak ground acceleration (m/s²)", ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
        _legend(axis)
    axes[0].set_ylabel("probability of exceeding the limit")
    return captioned(
        figure,
        "Fragility: dots are fractions of the loops, curves the lognormal fit, bands its 95 % confidence intervals",
    )


def trade_off_figure(subjects: Sequence[Subject], limits: Mapping[str, float]) -> Figure:
    """For each of the `limits` the median of the intact `subjects` over the rms of their commands.

    An arrow to the upper edge is an interval without an upper end.
    """
    figure, axes = _axes(len(limits))
    colours, unbounded = _colours(subjects), False
    for axis, (name, limit) in zip(axes, limits.items(), strict=True):
        for subject in _intact(subjects):
            curve = subject.curves[name]
            if not np.isfinite(curve.median):
                continue
            low, high = curve.median_interval()
            force = subject.force[len(subject.force) // 2] / 1e3
            colour = colours[subject.controller]
            top = curve.median if np.isinf(high) else high
            reach = None if np.isnan(low) else [[max(curve.median - low, 0.0)], [max(top - curve.median, 0.0)]]
            if np.isinf(high):
                unbounded = True
                arrow = {"arrowstyle": "->", "color": colour, "shrinkA": 0, "shrinkB": 0}
                axis.margins(y=0.2)
                axis.annotate("", (force, 1.0), (force, curve.median), ("data", "axes fraction"), "data", arrow)
            axis.errorbar(
                force,
                curve.median,
                reach,
                fmt="o",
                color=colour,
                capsize=3,
                label=subject.controller,
            )
        axis.set(title=_limit(name, limit), xlabel="rms of the command (kN)")
        axis.grid(alpha=0.3)
        _legend(axis)
    axes[0].set_ylabel("median intensity (m/s²)")
    middle = next(iter(subjects[0].curves.values())).intensity[len(subjects[0].force) // 2]
    return captioned(
        figure,
        f"Intensity at which half the loops exceed the limit, against the command's rms at {middle:.3g} m/s²"
        + ("; arrows: no upper end" if unbounded else ""),
    )


def sensor_faults_figure(subjects: Sequence[Subject], limits: Mapping[str, float]) -> Figure:
    """For each of the `limits` the median of the `subjects` with each fault, over that with intact sensors."""
    figure, axes = _axes(len(limits))
    colours = _colours(subjects)
    faults = list(dict.fromkeys(subject.fault for subject in subjects if subject.fault != INTACT))
    controllers = [subject.controller for subject in _intact(subjects) if subject.controller != ZERO_COMMAND]
    width = 0.8 / max(1, len(controllers))
    found = {(subject.controller, subject.fault): subject for subject in subjects}
    for axis, (name, limit) in zip(axes, limits.items(), strict=True):
        zero = found[ZERO_COMMAND, INTACT].curves[name].median
        for i, controller in enumerate(controllers):
            whole = found[controller, INTACT].curves[name].median
            failing = [found.get((controller, fault)) for fault in faults]
            shares = [each.curves[name].median / whole if each else np.nan for each in failing]
            places = np.arange(len(faults)) + (i - (len(controllers) - 1) / 2) * width
            axis.bar(places, 100 * np.array(shares, dtype=float), width, color=colours[controller], label=controller)
            if np.isfinite(zero / whole):
                ends = (-0.5, max(len(faults) - 0.5, 0.5))
                axis.plot(ends, [100 * zero / whole] * 2, "--", color=colours[controller], linewidth=1)
        axis.axhline(100, color=REFERENCE, linewidth=1)
        axis.set_xticks(range(len(faults)), faults)
        axis.set(title=_limit(name, limit), xlabel="fault: reading over true value")
        if controllers:
            _legend(axis)
    axes[0].set_ylabel("median intensity (% of intact sensors)")
    return captioned(figure, "What a failing sensor costs: dashed, with zero command")


FIGURES: dict[str, Callable[[Sequence[Subject], Mapping[str, float]], Figure]] = {
    "fragility": fragility_figure,
    "trade_off": trade_off_figure,
    "sensor_faults": sensor_faults_figure,
}


def _axes(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(1.2 + 4.4 * count, 4.2), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def _legend(axis: Axes) -> None:
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="best", fontsize=8)
    else:
        axis.text(0.5, 0.5, "no curve", transform=axis.transAxes, ha="center", va="center", color=REFERENCE)


def _colours(subjects: Sequence[Subject]) -> dict[str, str]:
    names = dict.fromkeys(subject.controller for subject in subjects if subject.controller != ZERO_COMMAND)
    return {ZERO_COMMAND: REFERENCE} | {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(names)}


def _intact(subjects: Sequence[Subject]) -> list[Subject]:
    return [subject for subject in subjects if subject.fault == INTACT]


def _limit(name: str, limit: float) -> str:
    return f"{name} above {limit:g} {unit(name)}".replace("^2", "²")
