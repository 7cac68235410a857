# SPDX-License-Identifier: Apache-2.0
"""The figure of an ambient test: its stabilisation diagram, with intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED, legend_above
from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from abrace_sysid.ambient.modes import AmbientTest

SHOWN_DEVIATION = 0.02
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
        shown = (deviation < SHOWN_DEVIATION * found.frequency) & (found.damping > 0)
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
