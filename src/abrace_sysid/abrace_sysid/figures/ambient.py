# SPDX-License-Identifier: Apache-2.0
"""Figures of ambient tests: stabilisation diagram with intervals, and changes of modes between two tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, legend_above
from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.ambient.change import BuildingChange
    from abrace_sysid.ambient.modes import AmbientTest

SHOWN = 0.02
"""A pole is drawn if its frequency's relative standard deviation is below this."""


def ambient_stabilization(test: AmbientTest) -> Figure:
    """Poles of a `test` at rising order with 95 % intervals, its modes, and in the background the spectrum."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axis = figure.subplots()
    behind = axis.twinx()
    behind.semilogy(*test.spectrum.T, color=REFERENCE, lw=0.8, alpha=0.7)
    behind.set_ylabel("first singular value of the spectra [-]")
    axis.set_zorder(behind.get_zorder() + 1)
    axis.patch.set_visible(False)
    for k, found in enumerate(test.candidates):
        deviation = np.sqrt(found.covariance[:, 0, 0])
        shown = (deviation < SHOWN * found.frequency) & (found.damping > 0)
        axis.errorbar(
            found.frequency[shown] / (2 * np.pi),
            np.full(int(shown.sum()), found.order),
            xerr=NORMAL_95 * deviation[shown] / (2 * np.pi),
            fmt=".",
            color=MEASURED,
            ms=4,
            lw=1,
            label="pole, 95 %" if k == 0 else None,
        )
    for k, mode in enumerate(test.modes):
        label = "mode" if k == 0 else None
        axis.axvline(mode.frequency / (2 * np.pi), color=SIMULATED, lw=0.8, ls="--", label=label)
    highest = max((mode.frequency for mode in test.modes), default=2 * np.pi * test.spectrum[-1, 0])
    axis.set_xlim(0, min(1.3 * highest / (2 * np.pi), test.spectrum[-1, 0]))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("number of poles")
    legend_above(figure, axis, 2)
    return figure


def building_change(change: BuildingChange) -> Figure:
    """Relative change of each mode's frequency and damping ratio with 95 % intervals."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = range(len(change.modes))
    frequency = [mode.frequency_change for mode in change.modes]
    damping = [mode.damping_change for mode in change.modes]
    deviations = [np.sqrt(np.diag(mode.before.covariance + mode.after.covariance)) for mode in change.modes]
    frequency_error = [d[0] / mode.before.frequency for d, mode in zip(deviations, change.modes, strict=True)]
    damping_error = [d[1] / mode.before.damping for d, mode in zip(deviations, change.modes, strict=True)]
    changed = {id(mode) for mode in change.changed}
    panels: tuple[tuple[str, Sequence[float], Sequence[float]], ...] = (
        ("frequency", frequency, frequency_error),
        ("damping ratio", damping, damping_error),
    )
    for axis, (name, values, errors) in zip((left, right), panels, strict=True):
        axis.axvline(0, color="k", lw=0.6)
        for row, value, error, mode in zip(rows, values, errors, change.modes, strict=True):
            colour = SIMULATED if id(mode) in changed else MEASURED
            axis.errorbar(100 * value, row, xerr=100 * NORMAL_95 * error, fmt="o", color=colour, capsize=3)
        axis.set_yticks(list(rows), [f"{mode.before.frequency / (2 * np.pi):.3g} Hz" for mode in change.modes])
        axis.set_ylim(len(change.modes) - 0.5, -0.5)
        axis.set_xlabel(f"change of {name} [%]")
        axis.grid(alpha=0.3)
    left.set_title("changed" if changed else "no change beyond chance", loc="left", fontsize="medium")
    return figure
