# SPDX-License-Identifier: Apache-2.0
"""Figures of an exploration: response against force, coloured by margins; robust responses against the mean ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, captioned
from abrace_core.errors import AbraceError
from abrace_lqg.exploration.report import pareto_front, ranked
from abrace_lqg.exploration.study import RANKED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_lqg.exploration.study import Outcome

MARGINS = (("gain", 1.0, "gain margin (dB)"), ("phase", 1.0, "phase margin (deg)"), ("delay", 1e3, "delay margin (ms)"))
"""Margin, factor from SI units, label."""

COLOUR_QUANTILE = 0.95
"""Quantile of a margin at which the colour scale ends: a few controllers with hardly any command have large margins."""


def trade_off(outcomes: Sequence[Outcome], picked: Sequence[int] = ()) -> Figure:
    """Rms of displacements and accelerations over those with zero command, against the command's rms.

    The Pareto front is drawn as a line; the given weights and the `picked` sets are marked.

    Parameters
    ----------
    outcomes
        Of all sets; set 0 is the given weights.
    picked
        Numbers of sets to mark.
    """
    found = [outcome for outcome in outcomes if outcome.command is not None]
    if not found:
        raise AbraceError("trade-off: no set of weights gave a controller, expected at least one")
    force = np.array([outcome.command.rms for outcome in found if outcome.command is not None]) / 1e3
    figure = Figure(figsize=(11, 6.6), layout="constrained")
    axes = figure.subplots(2, len(MARGINS), sharex=True, sharey="row", squeeze=False)
    for row, kind in enumerate(RANKED):
        response = 100 * np.array([outcome.response(kind) for outcome in found])
        front = pareto_front(force, response)
        for axis, (margin, factor, label) in zip(axes[row], MARGINS, strict=True):
            values = factor * np.array([getattr(outcome.margins, margin) for outcome in found])
            finite = values[np.isfinite(values)]
            highest = float(np.quantile(finite, COLOUR_QUANTILE)) if len(finite) else 1.0
            axis.plot(force[front], response[front], color=MEASURED, linewidth=1, label="Pareto front")
            points = axis.scatter(force, response, 14, np.minimum(values, highest), cmap="viridis", zorder=2)
            for outcome, x, y in zip(found, force, response, strict=True):
                if outcome.number == 0:
                    axis.plot(x, y, "*", color=SIMULATED, markersize=13, zorder=3, label="given weights", ls="none")
                elif outcome.number in picked:
                    axis.plot(x, y, "s", color=SIMULATED, markersize=8, fillstyle="none", zorder=3)
                    axis.annotate(str(outcome.number), (x, y), (5, 5), textcoords="offset points", color=SIMULATED)
            axis.grid(alpha=0.3)
            if row == 0:
                figure.colorbar(
                    points, ax=axes[:, axis.get_subplotspec().colspan.start], label=label, location="top", extend="max"
                )
            else:
                axis.set_xlabel("rms of the command (kN)")
        axes[row, 0].set_ylabel(f"{kind}s, rms\n(% of zero command)")
    axes[0, 0].legend(loc="upper right", fontsize=8)
    return figure


def robust_figure(outcomes: Sequence[Outcome], quantile: float) -> Figure:
    """The robust response of every set over its mean one, displacements and accelerations, coloured by the command.

    The given weights and the first of `ranked` are marked. On the dashed line robust and mean
    responses are the same; a set far above it fails where something differs from the simulation model.

    Parameters
    ----------
    outcomes
        Of all sets, the given weights first.
    quantile
        Of the robust responses.
    """
    found = [outcome for outcome in outcomes if outcome.command is not None]
    if not found:
        raise AbraceError("robust responses: no set of weights gave a controller, expected at least one")
    marked = [("*", 13, "given weights", outcomes[0])]
    marked += [("D", 8, f"set {one.number}, rank 1", one) for one in ranked(outcomes)[:1]]
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    axes = figure.subplots(1, len(RANKED))
    force = [outcome.command.rms / 1e3 for outcome in found if outcome.command is not None]
    for axis, kind in zip(axes, RANKED, strict=True):
        mean = np.array([100 * outcome.response(kind) for outcome in found])
        robust = np.array([100 * outcome.robust[kind] for outcome in found])
        points = axis.scatter(mean, robust, 14, force, cmap="viridis", zorder=2)
        same = np.linspace(mean.min(), mean.max(), 50)
        axis.plot(same, same, "--", color=REFERENCE, linewidth=1)
        for marker, size, label, one in marked:
            if one.command is not None:
                at = 100 * one.response(kind), 100 * one.robust[kind]
                axis.plot(*at, marker, color=SIMULATED, markersize=size, fillstyle="none", zorder=3, label=label)
        axis.set(xlabel=f"{kind}s, mean rms\n(% of zero command)", yscale="log")
        axis.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel(f"quantile {quantile:g} over all loops (%)")
    axes[0].legend(loc="upper left", fontsize=8)
    figure.colorbar(points, ax=axes, label="rms of the command (kN)")
    return captioned(figure, f"Robust against mean responses: {found[0].loops} loops for each set of weights")
