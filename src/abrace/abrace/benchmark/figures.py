# SPDX-License-Identifier: Apache-2.0
"""Figures of a benchmark: the criteria of several controllers, and the greatest responses over the height."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace.benchmark.criteria import OF_RESPONSE
from abrace_core.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned, legend_above

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace.benchmark.comparison import Evaluation, Profile

MOST_TICKS = 12
"""Of levels."""
COLOURS = (MEASURED, SIMULATED, ERROR, "#4b8b6f", "#7a5195", "#2a9d8f")
"""Of controllers, the one that was given first."""


def criteria_figure(title: str, evaluations: Sequence[Evaluation]) -> Figure:
    """The worst J1 to J6 of the `evaluations` as bars, with a `title`; 1 is without control."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / len(evaluations)
    for i, evaluation in enumerate(evaluations):
        worst = evaluation.worst()
        places = np.arange(len(OF_RESPONSE)) + (i - (len(evaluations) - 1) / 2) * width
        colour = COLOURS[i % len(COLOURS)]
        axis.bar(places, [worst[name] for name in OF_RESPONSE], width, color=colour, label=evaluation.name)
    axis.axhline(1.0, color=REFERENCE, linewidth=1)
    axis.set_xticks(range(len(OF_RESPONSE)), OF_RESPONSE)
    axis.set_ylabel("ratio to the response without control")
    legend_above(figure, axis, len(evaluations))
    return captioned(figure, f"{title}: worst of J1 to J6 over the cases; 1 is without control.")


def profile_figure(title: str, case: str, uncontrolled: Profile, evaluations: Sequence[Evaluation]) -> Figure:
    """Greatest drift ratio and acceleration of each level.

    Parameters
    ----------
    title
        Of the benchmark.
    case
        Which is shown.
    uncontrolled
        Without control.
    evaluations
        Each with a profile of this case.
    """
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    levels = np.arange(1, len(uncontrolled.drift) + 1)
    shown = [("without control", uncontrolled, REFERENCE)]
    shown += [(one.name, one.profiles[case], COLOURS[i % len(COLOURS)]) for i, one in enumerate(evaluations)]
    for name, profile, colour in shown:
        axes[0].plot(100 * profile.drift, levels, "o-", color=colour, markersize=3, linewidth=1, label=name)
        axes[1].plot(profile.acceleration, levels, "o-", color=colour, markersize=3, linewidth=1)
    axes[0].set_xlabel("greatest drift (% of the storey's height)")
    axes[1].set_xlabel("greatest acceleration (m/s²)")
    axes[0].set_ylabel("storey, floor")
    axes[0].set_yticks(levels[:: 1 + len(levels) // MOST_TICKS])
    for axis in axes:
        axis.set_xlim(left=0)
        axis.grid(alpha=0.3)
    legend_above(figure, axes[0], len(shown))
    return captioned(figure, f"{title}, {case}: greatest drift and acceleration of each level.")
