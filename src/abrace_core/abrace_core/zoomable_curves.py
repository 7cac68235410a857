# SPDX-License-Identifier: Apache-2.0
"""The curves, bars, points and words of matplotlib axes as those of Plotly, for `abrace_core.zoomable`.

Long curves keep the least and the greatest point of each of many narrow bins: a peak is never lost.
"""

from __future__ import annotations

import base64
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgba

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

PIXELS = 96.0
"""A browser's, in an inch."""
BINS = 700
"""Of a long curve."""
BINS_OF_MARKS = 250
"""Of many marks: each takes a browser as long as hundreds of points of a curve."""
DASHES = {"--": "dash", ":": "dot", "-.": "dashdot"}
MARKERS = {
    ".": "circle", "o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down",
    "+": "cross-thin", "x": "x-thin", "1": "y-down", "*": "asterisk", "|": "line-ns", "_": "line-ew",
}  # fmt: skip
COMBINING = {"ddot": "\u0308", "dot": "\u0307", "hat": "\u0302", "bar": "\u0304"}
LETTERS = {"omega": "\u03c9", "zeta": "\u03b6", "sigma": "\u03c3", "pm": "\u00b1", "times": "\u00d7", "cdot": "\u00b7"}


def thinned(x: NDArray[np.float64], y: NDArray[np.float64], bins: int = BINS) -> NDArray[np.intp]:
    """Which points of a curve `y` over `x` (points,) to keep: of each of `bins` the ends, the least and the greatest.

    >>> thinned(np.arange(12.0), np.array([0, 1, 9, 1, 0, 1, 0, 0, -5, 0, 2, 0.0]), 2)
    array([ 0,  2,  5,  6,  8, 10, 11])
    """
    if len(x) <= 4 * bins:
        return np.arange(len(x))
    kept = []
    for part in np.array_split(np.arange(len(x)), bins):
        values = y[part]
        finite = np.isfinite(values)
        kept += [part[0], part[-1]]
        if finite.any():
            kept += [
                part[np.argmin(np.where(finite, values, np.inf))],
                part[np.argmax(np.where(finite, values, -np.inf))],
            ]
        if not finite.all():
            kept.append(part[np.argmin(finite)])
    return np.unique(np.asarray(kept))


def html_text(text: str) -> str:
    r"""The `text` of a label, with matplotlib's TeX between dollars, as HTML.

    >>> html_text(r"$\ddot{x}_{1a}$ [m/s^2] at $10^{-3}$")
    '<i>x\u0308</i><sub>1a</sub> [m/s^2] at 10<sup>-3</sup>'
    """
    parts = text.split("$")
    return "".join(_tex(part) if i % 2 else part.replace("\n", "<br>") for i, part in enumerate(parts))


def _tex(text: str) -> str:
    text = re.sub(r"\\mathdefault\{(.*)\}", r"\1", text)
    for name, mark in COMBINING.items():
        text = re.sub(rf"\\{name}\{{(\w)\}}", rf"\g<1>{mark}", text)
    for name, letter in LETTERS.items():
        text = text.replace(f"\\{name}", letter)
    text = re.sub(r"(?<![A-Za-z{\\])([A-Za-z][\u0300-\u036f]?)(?![A-Za-z])(?![^{]*\})", r"<i>\1</i>", text)
    text = re.sub(r"_(?:\{([^{}]*)\}|(\w))", lambda found: f"<sub>{found[1] or found[2]}</sub>", text)
    text = re.sub(r"\^(?:\{([^{}]*)\}|(\w))", lambda found: f"<sup>{found[1] or found[2]}</sup>", text)
    return text.replace("{", "").replace("}", "").replace("\u2212", "-")


def pixels(points: Any) -> float:
    """A size in `points` in a browser's pixels; letters are a little wider there."""
    return round(0.95 * points * PIXELS / 72, 1)


def traces(axis: Axes) -> Iterator[dict[str, Any]]:
    """What is drawn in an `axis`, each with its name where it has a label."""
    for collection in axis.collections:
        yield from _collection(collection)
    grouped: set[int] = set()
    for container in axis.containers:
        patches = list(getattr(container, "patches", ()))
        if patches:
            grouped |= {id(one) for one in patches}
            colours = {colour_of(one.get_facecolor()) for one in patches}
            if len(colours) == 1:
                yield _named(_polygons(patches), container.get_label())
            else:
                for one in patches:
                    yield _polygons([one])
    for patch in axis.patches:
        if id(patch) not in grouped and patch.get_visible():
            yield _named(_polygons([patch]), patch.get_label())
    for line in sorted(axis.lines, key=lambda line: line.get_zorder()):
        if not line.get_visible():
            continue
        of_x, of_y = line.get_transform().contains_branch_seperately(axis.transData)
        if of_x and of_y:
            yield _named(_line(line), line.get_label())
        elif of_x or of_y:
            yield _named(_across(axis, line, of_x), line.get_label())


def _named(trace: dict[str, Any], label: object) -> dict[str, Any]:
    text = str(label)
    return {**trace, "name": html_text(text)} if text and not text.startswith("_") else trace


def _line(line: Line2D) -> dict[str, Any]:
    x, y = (np.asarray(values, float) for values in (line.get_xdata(orig=False), line.get_ydata(orig=False)))
    style = _style(line)
    kept = thinned(x, y, BINS_OF_MARKS if "marker" in style else BINS)
    return {"type": "scatter", "x": _packed(x[kept]), "y": _packed(y[kept]), **style}


def _across(axis: Axes, line: Line2D, of_x: bool) -> dict[str, Any]:
    """A line over the whole height or width of an axes."""
    if of_x:
        x = [float(value) for value in np.ravel(line.get_xdata())]
        x, y = [x[0], x[-1]], [float(value) for value in axis.get_ylim()]
    else:
        y = [float(value) for value in np.ravel(line.get_ydata())]
        x, y = [float(value) for value in axis.get_xlim()], [y[0], y[-1]]
    return {"type": "scatter", "x": x, "y": y, "hoverinfo": "skip", **_style(line)}


def _style(line: Line2D) -> dict[str, Any]:
    marker, dash = line.get_marker(), line.get_linestyle()
    has_line, has_marks = dash not in ("None", "none", " ", ""), marker in MARKERS
    found: dict[str, Any] = {"mode": "+".join(["lines"] * has_line + ["markers"] * has_marks) or "none"}
    colour = colour_of(line.get_color(), line.get_alpha())
    if has_line:
        found["line"] = {"color": colour, "width": pixels(line.get_linewidth()), "dash": DASHES.get(dash, "solid")}
    if has_marks:
        size, hollow = line.get_markersize() * PIXELS / 72, line.get_markerfacecolor() == "none"
        size *= 0.5 if marker == "." else 1.0
        edge = colour_of(line.get_markeredgecolor(), line.get_alpha())
        found["marker"] = {
            "symbol": MARKERS[marker] + ("-open" if hollow or marker in "+x1*|_" else ""),
            "size": size,
            "color": edge if hollow or marker in "+x1*|_" else colour_of(line.get_markerfacecolor(), line.get_alpha()),
            "line": {"color": edge, "width": pixels(line.get_markeredgewidth()) if marker != "." else 0},
        }
    return found


def _polygons(patches: Sequence[Any]) -> dict[str, Any]:
    """Closed shapes of one kind in the units of their axes."""
    shapes = [
        patch.get_patch_transform().transform_path(patch.get_path()).to_polygons(closed_only=False) for patch in patches
    ]
    corners = [np.vstack([polygon, [[np.nan, np.nan]]]) for several in shapes for polygon in several]
    x, y = np.vstack(corners)[:-1].T if corners else np.empty((2, 0))
    patch = patches[0]
    filled = to_rgba(patch.get_facecolor())[3] > 0
    edge = patch.get_edgecolor() if to_rgba(patch.get_edgecolor())[3] > 0 else patch.get_facecolor()
    return {
        "type": "scatter", "x": _listed(x), "y": _listed(y), "mode": "lines", "hoverinfo": "skip",
        "fill": "toself" if filled else "none", "fillcolor": colour_of(patch.get_facecolor()),
        "line": {"color": colour_of(edge), "width": pixels(patch.get_linewidth() if not filled else 0.1)},
    }  # fmt: skip


def _collection(collection: Any) -> Iterator[dict[str, Any]]:
    if not collection.get_visible():
        return
    label = collection.get_label()
    if isinstance(collection, PathCollection):
        x, y = np.ma.filled(np.ma.asarray(collection.get_offsets(), float), np.nan).T
        colours = collection.get_facecolor() if len(collection.get_facecolor()) else collection.get_edgecolor()
        drawn = [colour_of(one) for one in colours]
        size = float(np.sqrt(np.mean(collection.get_sizes()))) * PIXELS / 72
        marker = {"size": size, "color": drawn if len(drawn) == len(x) else drawn[0]}
        yield _named({"type": "scatter", "x": _packed(x), "y": _packed(y), "mode": "markers", "marker": marker}, label)
    elif isinstance(collection, PolyCollection):
        for path in collection.get_paths():
            x, y = np.asarray(path.vertices).T
            colour = colour_of(collection.get_facecolor()[0])
            filled = {"mode": "none", "fill": "toself", "fillcolor": colour, "hoverinfo": "skip"}
            yield _named({"type": "scatter", "x": _packed(x), "y": _packed(y), **filled}, label)
    elif isinstance(collection, LineCollection):
        segments = [np.vstack([segment, [[np.nan, np.nan]]]) for segment in collection.get_segments() if len(segment)]
        if segments:
            x, y = np.vstack(segments)[:-1].T
            line = {
                "color": colour_of(collection.get_color()[0]),
                "width": pixels(np.ravel(collection.get_linewidth())[0]),
            }
            yield _named({"type": "scatter", "x": _listed(x), "y": _listed(y), "mode": "lines", "line": line}, label)


def colour_of(colour: Any, alpha: float | None = None) -> str:
    """A matplotlib `colour`, with another opacity `alpha` where one is given."""
    red, green, blue, opacity = to_rgba(colour)
    opacity = opacity if alpha is None else alpha
    if opacity >= 1:
        return to_hex((red, green, blue))
    return f"rgba({round(255 * red)},{round(255 * green)},{round(255 * blue)},{opacity:.3g})"


def _packed(values: NDArray[np.float64]) -> dict[str, str] | list[float | None]:
    """Numbers as Plotly takes them packed, in single precision."""
    if len(values) < 20:
        return _listed(values)
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{value:.7g}") if np.isfinite(value) else None for value in values]
