# SPDX-License-Identifier: Apache-2.0
"""Figure of an exploration: response against force, coloured by margins (the trade-off behind Table 1's one point)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, SIMULATED
from abrace_core.errors import AbraceError
from abrace_lqg.exploration.report import pareto_front

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
    for row, kind in enumerate(("displacement", "acceleration")):
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
