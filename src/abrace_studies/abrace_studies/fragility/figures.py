# SPDX-License-Identifier: Apache-2.0
"""The figure of a fragility study: curves with their bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned
from abrace_studies.fragility.study import INTACT, ZERO_COMMAND

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_studies.fragility.curves import FragilityCurve

COLOURS = (MEASURED, SIMULATED, ERROR, "#3a7d44", "#6a4c93", "#2a9d8f", "#8c564b")
"""Colours of controllers; the zero command is grey."""
POINTS = 200
"""Points of a curve."""


@dataclass(frozen=True)
class Subject:
    """A controller, its sensors intact or one of them failing.

    Parameters
    ----------
    controller, fault
        Their names.
    curves
        The curve for each limit, by its quantity.
    force
        (intensities,) mean over the loops of the rms command [N].
    saturated
        (intensities,) share of the loops in which a command was at its limit.
    """

    controller: str
    fault: str
    curves: dict[str, FragilityCurve]
    force: NDArray[np.float64]
    saturated: NDArray[np.float64]


def fragility_figure(subjects: Sequence[Subject], limits: Mapping[str, str], peak: str, unit: str) -> Figure:
    """The probability that each of the `limits` is exceeded, of the intact `subjects`: fits, bands, and fractions.

    Parameters
    ----------
    limits
        Names of the quantities, by title.
    peak, unit
        What the intensities are, and their unit.
    """
    unit = unit.replace("^2", "²")
    figure, axes = _axes(len(limits))
    colours = _colours(subjects)
    for axis, (title, name) in zip(axes, limits.items(), strict=True):
        for subject in _intact(subjects):
            curve, colour = subject.curves[name], colours[subject.controller]
            axis.plot(curve.intensity, curve.fractions, "o", color=colour, markersize=4)
            label = subject.controller
            if not np.isfinite(curve.median):
                axis.plot([], [], "o", color=colour, label=f"{label}: no curve")
                continue
            x = np.geomspace(curve.intensity[0] / 2, curve.intensity[-1] * 1.5, POINTS)
            axis.plot(x, curve.probability(x), color=colour, label=f"{label}: {curve.median:.3g} {unit}")
            if len(curve.resampled):
                axis.fill_between(x, *curve.band(x), color=colour, alpha=0.18, linewidth=0)
        axis.set(title=title.replace("^2", "²"), xlabel=f"{peak} ({unit})", ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
        _legend(axis)
    axes[0].set_ylabel("probability of exceeding the limit")
    return captioned(
        figure,
        "Fragility: dots are fractions of the loops, curves the lognormal fit, bands its 95 % confidence intervals",
    )


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
