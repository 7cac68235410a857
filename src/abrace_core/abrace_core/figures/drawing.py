# SPDX-License-Identifier: Apache-2.0
"""Common parts of all figures: colours, legends, ticks, captions.

A figure is a matplotlib Figure without a window. Measured curves have one colour throughout and simulated or
fitted ones another; a reference (another model's curve, the paper's numbers) is grey, the difference of two curves
ochre.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

MEASURED = "#1b3a6b"
SIMULATED = "#d1495b"
REFERENCE = "#8a8a8a"
ERROR = "#d08c1d"
QUIET = 0.03
"""Of a curve's peak, below which a building is at rest as far as a figure shows it."""


def legend_above(figure: Figure, axis: Axes, columns: int) -> None:
    """Legend of an `axis` above all axes of a `figure`, in so many `columns`; the layout is constrained.

    matplotlib's own `loc="outside upper center"` is for 3.7 and newer.
    """
    legend = figure.legend(*axis.get_legend_handles_labels(), loc="upper center", ncols=columns, fontsize="small")
    below = legend.get_window_extent().y0 / figure.bbox.height
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, below))


def plain_ticks(axis: Axis, low: float, high: float) -> None:
    """Ticks of a logarithmic `axis` from `low` to `high` as plain numbers: 1, 2 and 5 of each decade, or decades alone.

    matplotlib writes "6 x 10^0" where an axis spans less than a decade.
    """
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    parts = (1,) if len(decades) > 4 else (1, 2, 5)
    ticks = [part * 10.0**decade for decade in decades for part in parts]
    shown = [tick for tick in ticks if low <= tick * 1.0001 and tick <= high * 1.0001]
    axis.set_ticks(shown, [f"{tick:g}" for tick in shown])
    axis.set_ticks([], minor=True)


def last_motion(time: NDArray[np.float64], *curves: NDArray[np.float64]) -> float:
    """When the last of the `curves` (samples,) over `time` [s] falls below QUIET of its peak and stays there."""
    ends = [np.flatnonzero(np.abs(curve) > QUIET * np.abs(curve).max(initial=0.0)) for curve in curves]
    last = max((int(end[-1]) for end in ends if end.size), default=len(time) - 1)
    return float(time[min(last, len(time) - 1)])


def captioned(figure: Figure, caption: str) -> Figure:
    """The `figure` with a `caption`, which is saved with it: what is shown, from which record or test."""
    figure.set_label(caption)
    return figure
