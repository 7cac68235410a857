# SPDX-License-Identifier: Apache-2.0
"""The figure of a measurement of jitter: distribution of the deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED

if TYPE_CHECKING:
    from collections.abc import Mapping

COLOURS = {"rig": MEASURED, "timer": REFERENCE, "echo": SIMULATED}


def jitter_figure(content: Mapping[str, Any]) -> Figure:
    """Histogram, and share of events above each time, of rig, timer and echo; `content`: that of a jitter.json."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    counts = np.array([content[name]["counts"] for name in COLOURS])
    used = np.flatnonzero(counts.sum(axis=0))
    edges = np.array(content["edges_us"])[used[0] : used[-1] + 2]
    for (name, colour), each in zip(COLOURS.items(), counts[:, used[0] : used[-1] + 1], strict=True):
        above.stairs(each, edges, color=colour, label=f"{name}, {content[name]['missed']} missed")
        below.plot(edges, 1 - np.array([0, *each.cumsum()]) / each.sum(), color=colour)
    for axis in (above, below):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.axvline(1e6 * content["period"], color=REFERENCE, linestyle=":", linewidth=1.0)
    above.set_ylim(bottom=0.8)
    below.set_ylim(bottom=0.8 / counts.sum(axis=1).max())
    above.set_ylabel("events")
    below.set_ylabel("share of events above")
    below.set_xlabel("deviation [us]; dotted: the sample period")
    above.legend(fontsize="small")
    return figure
