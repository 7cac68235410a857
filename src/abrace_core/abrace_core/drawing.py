# SPDX-License-Identifier: Apache-2.0
"""Common parts of all figures: colours, and how they are saved.

A figure is a matplotlib Figure without a window. Measured curves have one colour throughout and simulated or
fitted ones another; a reference (another model's curve, the paper's numbers) is grey, the difference of two curves
ochre.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.files import write_atomically, write_text
from abrace_core.zoomable import DIGITS, parts_of, plotly_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

MEASURED = "#1b3a6b"
SIMULATED = "#d1495b"
REFERENCE = "#8a8a8a"
ERROR = "#d08c1d"
RESOLUTION = 160
"""Dots per inch of saved figures."""
QUIET = 0.03
"""Of a curve's peak, below which a building is at rest as far as a figure shows it."""
IMAGES = (".png", ".svg")
"""Suffixes of figures' files."""
ZOOMABLE = ".plotly.json"
"""Suffix of the file that the report takes a figure from."""


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
    axis.set_ticks(
        shown, [f"{tick:g}" if 1e-4 < tick < 1e5 else f"$10^{{{round(math.log10(tick))}}}$" for tick in shown]
    )
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


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a `figure` with its caption to a PNG file and, in the same folder, as SVG and as JSON for Plotly."""
    path = Path(path)
    figure.draw_without_rendering()
    figure.set_layout_engine(None)
    _round_places(figure)
    content = {"caption": str(figure.get_label()), "plotly": plotly_figure(figure)}
    for suffix in (".png", ".svg"):
        save_image(figure, path.with_suffix(suffix))
    write_text(path.with_suffix(ZOOMABLE), json.dumps(content, separators=(",", ":"), allow_nan=False))


def _round_places(figure: Figure) -> None:
    """Round the places of subfigures and axes, whose last digits the layout's solver finds anew each time."""
    for part in parts_of(figure):
        if part is not figure:
            box = part.bbox_relative
            box.p0, box.p1 = np.round(box.p0, DIGITS), np.round(box.p1, DIGITS)
    for axis in figure.axes:
        axis.set_position(np.round(axis.get_position().bounds, DIGITS).tolist())


def save_image(figure: Figure, path: Path | str) -> None:
    """Write a `figure` to one file, PNG or, as its suffix says, SVG, with its caption, atomically.

    Raises
    ------
    AbraceError
        If it has another suffix.
    """
    path = Path(path)
    suffix = path.suffix or IMAGES[0]
    if suffix not in IMAGES:
        raise AbraceError(f"figure {path}: expected a name that ends in {' or '.join(IMAGES)}")
    facts = {"Description": str(figure.get_label()), **({"Date": None} if suffix == ".svg" else {})}
    from matplotlib import rc_context

    # without a date and a salt of its own an SVG file is the same each time
    with write_atomically(path) as temporary, rc_context({"svg.hashsalt": "abrace"}):
        figure.savefig(temporary, format=suffix[1:], dpi=RESOLUTION, metadata=facts)
