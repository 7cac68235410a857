# SPDX-License-Identifier: Apache-2.0
"""A matplotlib Figure converted to Plotly, so that it can be zoomed in a browser: the same axes, curves and texts.

Lines, bars, polygons, error bars, points and texts are taken over at their places.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator

from abrace_core.zoomable_curves import PIXELS, colour_of, html_text, pixels, traces

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

FRAME = {
    "showline": True,
    "linecolor": "black",
    "linewidth": 0.8,
    "mirror": True,
    "ticks": "outside",
    "zeroline": False,
}
PIXELS_OF_A_TICK = 28.0
"""Least distance of the numbers at an axis."""
BUTTONS = 36.0
"""Width of the buttons next to a figure [pixels]."""
DIGITS = 6
"""Decimals of places in the figure: the layout's solver finds other last digits each time."""
SCALES = {"linear": "linear", "log": "log"}


def plotly_figure(figure: Figure) -> dict[str, Any] | None:
    """Data and layout of Plotly's for a `figure` that has been laid out; None: it cannot be zoomed.

    Images and scales other than linear and logarithmic cannot.
    """
    axes = sorted((axis for axis in figure.axes if axis.get_visible()), key=lambda axis: axis.get_zorder())
    if any(axis.images or {axis.get_xscale(), axis.get_yscale()} - set(SCALES) for axis in axes):
        return None
    width, height = (float(inches * PIXELS) for inches in figure.get_size_inches())
    layout: dict[str, Any] = {
        "width": width + BUTTONS,
        "height": height,
        "margin": {"l": 0, "r": BUTTONS, "t": 0, "b": 0},
        "modebar": {"orientation": "v"},
        "paper_bgcolor": "white",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "DejaVu Sans, Verdana, sans-serif", "size": 12, "color": "black"},
        "hovermode": "closest",
        "showlegend": False,
        "annotations": [],
        "shapes": [],
    }
    names = _names(axes)
    legends = _legends(figure, axes, layout)
    found: list[dict[str, Any]] = []
    for axis in axes:
        x, y = names[axis]
        _add_axes(layout, figure, axes, names, axis)
        for trace in traces(axis):
            owner = legends.get(trace.get("name", ""), {}) if trace.get("name") else {}
            legend = owner.get(axis, owner.get(None))
            shown = {"showlegend": True, "legend": legend} if legend else {"showlegend": False}
            found.append({**trace, **shown, "xaxis": x, "yaxis": y})
        _add_texts(layout, axis.texts, figure, (x, y), axis)
        titles = [one for one in axis.get_children() if isinstance(one, Text) and one not in axis.texts]
        _add_texts(layout, [*titles, axis.xaxis.label, axis.yaxis.label], figure)
    for part in parts_of(figure):
        _add_texts(layout, [*part.texts, *filter(None, [getattr(part, "_suptitle", None)])], figure)
        if part is not figure and to_rgba(part.patch.get_facecolor())[3]:
            layout["shapes"].append({**_place(part.bbox, figure), "fillcolor": colour_of(part.patch.get_facecolor())})
    shown_once: set[tuple[str, str]] = set()
    for trace in found:
        if trace["showlegend"]:
            key = (trace["legend"], trace["name"])
            trace["showlegend"] = key not in shown_once
            shown_once.add(key)
    layout["showlegend"] = bool(shown_once)
    return {"data": found, "layout": layout}


def parts_of(figure: Any) -> Iterator[Any]:
    """The `figure` and its subfigures, parents first."""
    yield figure
    for part in figure.subfigs:
        yield from parts_of(part)


def _names(axes: Sequence[Axes]) -> dict[Axes, tuple[str, str]]:
    """Names of each axes' two axes; those at the same place, as `twinx` makes them, have one x axis."""
    names: dict[Axes, tuple[str, str]] = {}
    for number, axis in enumerate(axes, 1):
        suffix = str(number) if number > 1 else ""
        below = next((one for one in names if _twins(one, axis)), None)
        names[axis] = names[below][0] if below else f"x{suffix}", f"y{suffix}"
    return names


def _twins(one: Axes, other: Axes) -> bool:
    same = np.allclose(one.bbox.extents, other.bbox.extents)
    return bool(same and one.get_shared_x_axes().joined(one, other))


def _place(box: Any, figure: Figure) -> dict[str, Any]:
    (x0, y0), (x1, y1) = np.round([box.min / figure.bbox.max, box.max / figure.bbox.max], DIGITS)
    corners = dict(zip(("x0", "y0", "x1", "y1"), map(float, (x0, y0, x1, y1)), strict=True))
    return {"type": "rect", "xref": "paper", "yref": "paper", "layer": "below", "line": {"width": 0}, **corners}


def _add_axes(
    layout: dict[str, Any], figure: Figure, axes: Sequence[Axes], names: dict[Axes, tuple[str, str]], axis: Axes
) -> None:
    x, y = names[axis]
    place = _place(axis.bbox, figure)
    drawn = {
        "showline": True,
        "linecolor": "black",
        "linewidth": 0.8,
        "mirror": True,
        "ticks": "outside",
        "zeroline": False,
    }
    if not axis.axison:
        drawn = {"visible": False}
    x_key, y_key = (f"{name[0]}axis{name[1:]}" for name in (x, y))
    if x_key not in layout:
        layout[x_key] = {
            **drawn, **_axis(axis.xaxis, axis.get_xlim(), axis.get_xscale(), axis.bbox.width),
            "domain": _domain(place["x0"], place["x1"]), "anchor": y,
        }  # fmt: skip
        first = next(one for one in axes if one is axis or one.get_shared_x_axes().joined(one, axis))
        if names[first][0] != x:
            layout[x_key]["matches"] = names[first][0]
    layout[y_key] = {
        **drawn, **_axis(axis.yaxis, axis.get_ylim(), axis.get_yscale(), axis.bbox.height),
        "domain": _domain(place["y0"], place["y1"]), "anchor": x,
    }  # fmt: skip
    if axis.yaxis.get_ticks_position() == "right":
        layout[y_key] |= {"side": "right"}
    below = next(one for one in axes if names[one][0] == x)
    if below is not axis:
        layout[y_key] |= {"overlaying": names[below][1], "showgrid": False}
    else:
        first = next(one for one in axes if one is axis or one.get_shared_y_axes().joined(one, axis))
        if names[first][1] != y and names[first][0] != x:
            layout[y_key]["matches"] = names[first][1]


def _domain(low: float, high: float) -> list[float]:
    return [min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)]


def _axis(axis: Axis, limits: tuple[float, float], scale: str, length: float) -> dict[str, Any]:
    low, high = (float(limit) for limit in limits)
    found: dict[str, Any] = {
        "type": SCALES[scale],
        "range": [np.log10(low), np.log10(high)] if scale == "log" else [low, high],
        "showgrid": any(line.get_visible() for line in axis.get_gridlines()),
        "gridcolor": "#e3e3e3",
        "showticklabels": any(label.get_visible() and label.get_text() for label in axis.get_ticklabels()),
    }
    sizes = [label.get_fontsize() for label in axis.get_ticklabels()[:1]]
    found["tickfont"] = {"size": pixels(sizes[0] if sizes else 10.0)}
    if isinstance(axis.get_major_locator(), FixedLocator):
        ticks = axis.get_majorticklocs()
        words = axis.get_major_formatter().format_ticks(list(ticks))
        found |= {"tickvals": list(map(float, ticks)), "ticktext": list(map(html_text, words))}
    elif scale == "log":
        found |= {"dtick": 1 if abs(np.log10(high / low)) > 1.3 else "D2", "exponentformat": "power"}
    else:
        found["nticks"] = max(3, min(8, int(length / PIXELS_OF_A_TICK)))
    return found


def _legends(figure: Figure, axes: Sequence[Axes], layout: dict[str, Any]) -> dict[str, dict[Axes | None, str]]:
    """Names of the legends by label and axes, None for those of the figure; their places go into `layout`."""
    found: dict[str, dict[Axes | None, str]] = {}
    several: list[tuple[Axes | None, Legend]] = [(None, one) for part in parts_of(figure) for one in part.legends]
    several += [(axis, legend) for axis in axes if (legend := axis.get_legend()) is not None]
    for number, (owner, legend) in enumerate(several, 1):
        name = "legend" if number == 1 else f"legend{number}"
        left, _, right, top = _corners(legend, figure)
        words = legend.get_texts()
        # with axes in several columns the entries of a legend are stacked, as there is no space next to them
        in_rows = owner is None or len({round(word.get_window_extent().y0) for word in words}) == 1
        middle = 0.5 if owner is None else float((owner.bbox.x0 + owner.bbox.x1) / 2 / figure.bbox.x1)
        # held at the side that is nearer to its axes' edge, as letters are not as wide here
        side = "left" if (left + right) / 2 <= middle else "right"
        layout[name] = {
            "x": left if side == "left" else right, "y": top, "xanchor": side, "yanchor": "top",
            "bgcolor": "rgba(255,255,255,0.8)", "font": {"size": pixels(words[0].get_fontsize())},
            "tracegroupgap": 0, "orientation": "h" if in_rows else "v", "itemwidth": 30,
        }  # fmt: skip
        for text in words:
            found.setdefault(html_text(text.get_text()), {})[owner] = name
    return found


def _add_texts(
    layout: dict[str, Any],
    texts: Sequence[Text],
    figure: Figure,
    names: tuple[str, str] | None = None,
    axis: Axes | None = None,
) -> None:
    """Each text where it is drawn; arrows of annotations from point to point."""
    for text in texts:
        if not text.get_visible():
            continue
        if isinstance(text, Annotation) and text.arrow_patch is not None and names and axis:
            (x, y), (from_x, from_y) = (_logarithmic(axis, point) for point in (text.xy, text.xyann))
            layout["annotations"].append(
                {"x": x, "y": y, "ax": from_x, "ay": from_y, "xref": names[0], "yref": names[1], "axref": names[0],
                 "ayref": names[1], "showarrow": True, "arrowhead": 2, "arrowwidth": 1, "text": "",
                 "arrowcolor": colour_of(text.arrow_patch.get_edgecolor())}
            )  # fmt: skip
        if not text.get_text().strip():
            continue
        x0, y0, x1, y1 = _corners(text, figure)
        side = "center" if text.get_rotation() else text.get_horizontalalignment()
        words = html_text(text.get_text())
        layout["annotations"].append({
            "x": {"left": x0, "center": (x0 + x1) / 2, "right": x1}[side], "y": (y0 + y1) / 2,
            "xref": "paper", "yref": "paper", "xanchor": side, "yanchor": "middle", "showarrow": False,
            "text": f"<b>{words}</b>" if text.get_fontweight() in ("bold", 700) else words, "align": "left",
            "font": {"size": pixels(text.get_fontsize()), "color": colour_of(text.get_color())},
            "textangle": -text.get_rotation(), "borderpad": 0,
        })  # fmt: skip


def _corners(artist: Any, figure: Figure) -> list[float]:
    """Left, bottom, right and top of the drawing, in shares of the `figure`."""
    corners = artist.get_window_extent().get_points() / figure.bbox.max
    return np.round(corners.ravel(), DIGITS).tolist()


def _logarithmic(axis: Axes, point: tuple[float, float]) -> list[float]:
    scales = (axis.get_xscale(), axis.get_yscale())
    return [float(np.log10(value) if scale == "log" else value) for value, scale in zip(point, scales, strict=True)]
