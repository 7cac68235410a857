# SPDX-License-Identifier: Apache-2.0
"""The figure of a measurement of jitter: distribution of the deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from abrace_plant.live.jitter import Jitter

COLOURS = (MEASURED, REFERENCE, SIMULATED)


def jitter_figure(found: Mapping[str, Jitter], period: float) -> Figure:
    """Histograms, and shares of events above each time, of every part `found`, by its name; `period` [s]."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    smallest = 1e-7
    largest = max(float(one.times.max()) for one in found.values()) + smallest
    edges = np.geomspace(smallest, largest, 80)
    for (name, one), colour in zip(found.items(), COLOURS, strict=False):
        times = np.sort(np.maximum(one.times, smallest))
        above.hist(1e6 * times, 1e6 * edges, histtype="step", color=colour, label=name)
        below.step(1e6 * times, 1 - np.arange(len(times)) / len(times), where="post", color=colour)
    for axis in (above, below):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.axvline(1e6 * period, color=REFERENCE, linestyle=":", linewidth=1.0)
    above.set_ylabel("events")
    below.set_ylabel("share of events above")
    below.set_xlabel("deviation [us]; dotted: the sample period")
    above.legend(fontsize="small")
    return figure
