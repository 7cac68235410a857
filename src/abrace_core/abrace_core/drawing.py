"""What all figures share: colours, and how they are saved.

A figure is a matplotlib Figure that belongs to no window. Measured curves have one colour throughout and simulated or
fitted ones another; a reference (another model's curve, the paper's numbers) is grey.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.files import write_atomically, write_text
from abrace_core.zoomable import plotly_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED = "#1b3a6b"
SIMULATED = "#d1495b"
REFERENCE = "#8a8a8a"
RESOLUTION = 160
"""Dots per inch of saved figures."""
ZOOMABLE = ".plotly.json"
"""Suffix of the file that the report takes a figure from."""


def legend_above(figure: Figure, axis: Axes, columns: int) -> None:
    """Legend of an `axis` above all axes of a `figure`, in so many `columns`; the layout is constrained.

    matplotlib's own `loc="outside upper center"` is for 3.7 and newer.
    """
    legend = figure.legend(*axis.get_legend_handles_labels(), loc="upper center", ncols=columns, fontsize="small")
    below = legend.get_window_extent().y0 / figure.bbox.height
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, below))


def captioned(figure: Figure, caption: str) -> Figure:
    """The `figure` with a `caption`, which is saved with it: what is shown, from which record or test."""
    figure.set_label(caption)
    return figure


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a `figure` to a PNG file, and beside it as SVG and as the report zooms it, with its caption."""
    path = Path(path)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    caption = str(figure.get_label())
    content = {"caption": caption, "plotly": plotly_figure(figure)}
    for suffix, facts in ((".png", {"Description": caption}), (".svg", {"Description": caption, "Date": None})):
        with write_atomically(path.with_suffix(suffix)) as temporary:
            figure.savefig(temporary, format=suffix[1:], dpi=RESOLUTION, metadata=facts)
    write_text(path.with_suffix(ZOOMABLE), json.dumps(content, separators=(",", ":"), allow_nan=False))
