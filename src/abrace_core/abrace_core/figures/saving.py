# SPDX-License-Identifier: Apache-2.0
"""How figures are saved: with their captions, and charts also as the report draws them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG

from abrace_core import AbraceError
from abrace_core.figures.chart import Chart
from abrace_core.files.writing import write_atomically, write_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

RESOLUTION = 160
"""Dots per inch of PNG files."""
IMAGES = (".svg", ".png")
"""Suffixes of figures' files."""
CHART = ".plotly.json"
"""Suffix of the file that the report takes a chart from."""
DIGITS = 6
"""Decimals of places in the figure."""


def save_figure(figure: Figure | Chart, path: Path | str) -> None:
    """Write a `figure` with its caption to one file, atomically; a chart also for the report.

    SVG where its name ends in that, else PNG.

    Raises
    ------
    AbraceError
        If it has another suffix.
    """
    path = Path(path)
    if path.suffix not in ("", *IMAGES):
        raise AbraceError(f"figure {path}: expected a name that ends in {' or '.join(IMAGES)}")
    if isinstance(figure, Chart):
        content = {"caption": figure.caption, "plotly": figure.plotly()}
        write_text(path.with_suffix(CHART), json.dumps(content, separators=(",", ":"), allow_nan=False))
        figure = figure.figure()
    _lay_out(figure)
    figure.set_dpi(RESOLUTION)
    caption = {"Description": str(figure.get_label())}
    # the canvas itself draws once, `savefig` twice
    with write_atomically(path) as temporary, rc_context({"svg.hashsalt": "abrace"}):
        if path.suffix == ".svg":  # without a date and a salt of its own the file is the same each time
            FigureCanvasSVG(figure).print_svg(temporary, metadata={**caption, "Date": None})
        else:
            FigureCanvasAgg(figure).print_png(temporary, metadata=caption)


def _lay_out(figure: Figure) -> None:
    """Place all parts of a `figure`, rounded: the layout's solver finds other last digits each time."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)
    for part in _parts(figure):
        if part is not figure:
            box = part.bbox_relative
            box.p0, box.p1 = np.round(box.p0, DIGITS), np.round(box.p1, DIGITS)
    for axis in figure.axes:
        axis.set_position(np.round(axis.get_position().bounds, DIGITS).tolist())


def _parts(figure: Any) -> Iterator[Any]:
    """The `figure` and its subfigures, parents first."""
    yield figure
    for part in figure.subfigs:
        yield from _parts(part)
