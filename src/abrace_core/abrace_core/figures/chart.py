# SPDX-License-Identifier: Apache-2.0
"""Time histories and frequency responses: panels of curves, which matplotlib draws for paper and Plotly in a browser.

Both draw the same description. A long curve keeps the least and the greatest point of each of many narrow intervals, so
that no peak is lost.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, plain_ticks

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

COLOURS = (MEASURED, SIMULATED, "#2a7f62", ERROR, "#6a4c93", REFERENCE)
"""Of curves next to each other, in turn."""
KINDS = {
    "xf": "stroke",
    "x": "displacement",
    "a": "acceleration",
    "w": "ground acceleration",
    "f": "force",
    "U": "command",
}
"""Of a rig's signals, by the beginning of their names."""
INTERVALS = 700
"""Of a long curve."""
INTERVALS_OF_POINTS = 100
"""Of many points: each takes a browser as long as hundreds of samples of a curve."""
POINTS = "."
"""Style of a curve that is drawn as points."""
DASHES = {"-": "solid", "--": "dash", ":": "dot"}
LEFT, BELOW, TITLE, ABOVE = 1.0, 0.55, 0.35, 0.3
"""Space next to axes for their numbers and labels, for titles, and for a legend above them [inches]."""
PIXELS = 96.0
"""Of a browser, in an inch."""
MARGINS = {"l": 64, "r": 34, "t": 34, "b": 44}
FRAME = {
    "showline": True, "mirror": True, "linecolor": "#777777", "gridcolor": "#e8e8e8", "zeroline": False,
    "ticklabeloverflow": "allow",  # where it is not, every number is measured
}  # fmt: skip
LEGEND, GAP = 26, 34
"""Height of the legend above panels in several columns, and between rows [pixels]."""
BETWEEN = 0.08
"""Space between columns, as a share of the width."""


@dataclass(frozen=True)
class Curve:
    """A curve.

    Parameters
    ----------
    x, y
        (points,); y not a number: a gap.
    label
        In the legend; empty: none.
    colour
        As matplotlib has it.
    width
        Of the line [points].
    style
        "-", "--" or ":"; POINTS: no line.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    label: str = ""
    colour: str = MEASURED
    width: float = 0.8
    style: str = "-"


@dataclass(frozen=True)
class Panel:
    """Axes with curves.

    Parameters
    ----------
    curves
        Later ones are drawn over earlier ones.
    title, x_label, y_label
        Texts.
    logarithmic
        The axes that are: "", "x", "y" or "xy".
    x_limits, y_limits
        Ends of the axes; None: those of the curves.
    y_ticks
        Numbers at the y axis; none: chosen.
    """

    curves: tuple[Curve, ...]
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    logarithmic: str = ""
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None
    y_ticks: tuple[float, ...] = ()


@dataclass(frozen=True)
class Chart:
    """Panels in rows and columns; those of a column have one x axis.

    Parameters
    ----------
    rows
        (rows, columns) of panels.
    size
        Width and height [inches].
    caption
        What is shown, from which record or test.
    heights
        Relative heights of the rows; none: all alike.
    """

    rows: tuple[tuple[Panel, ...], ...]
    size: tuple[float, float]
    caption: str = ""
    heights: tuple[float, ...] = ()

    def figure(self) -> Figure:
        """The chart as a figure of matplotlib, its caption as the figure's label."""
        (width, height), rows, columns = self.size, len(self.rows), len(self.rows[0])
        figure = Figure(figsize=self.size, label=self.caption)
        across, down = (width - LEFT * columns) / columns / 1.02, (height - 1.0) / rows
        above = TITLE + (ABOVE if columns > 1 else 0.0)
        places = {
            "left": LEFT / width, "right": 1 - 0.15 / width, "bottom": BELOW / height, "top": 1 - above / height,
            "wspace": LEFT / across, "hspace": 0.15 / down,
            "height_ratios": self.heights or None,
        }  # fmt: skip
        axes = figure.subplots(rows, columns, sharex="col", squeeze=False, gridspec_kw=places)
        named: dict[str, Any] = {}
        for axis, (_, _, panel) in zip(axes.flat, self._panels(), strict=True):
            _draw(axis, panel)
            handles, labels = axis.get_legend_handles_labels()
            new = {label: handle for handle, label in zip(handles, labels, strict=True) if label not in named}
            named |= new
            if new and columns == 1:
                axis.legend(new.values(), new, loc="upper right", ncols=len(new), fontsize="small")
        if named and columns > 1:
            figure.legend(named.values(), named, loc="upper center", ncols=len(named), fontsize="small", frameon=False)
        return figure

    def plotly(self) -> dict[str, Any]:
        """Data and layout of Plotly's; the width is left to the page."""
        columns = len(self.rows[0])
        height = self.size[1] * PIXELS
        margins = MARGINS | ({"t": MARGINS["t"] + LEGEND} if columns > 1 else {})
        inner = height - margins["t"] - margins["b"]
        across = _domains((1.0,) * columns, BETWEEN)
        down = [(1 - high, 1 - low) for low, high in _domains(self.heights or (1.0,) * len(self.rows), GAP / inner)]
        layout: dict[str, Any] = {
            "height": round(height), "margin": margins, "annotations": [], "modebar": {"orientation": "v"},
            "paper_bgcolor": "white", "plot_bgcolor": "white", "font": {"size": 12, "color": "black"},
        }  # fmt: skip
        data: list[dict[str, Any]] = []
        named = {""}
        for number, (i, j, panel) in enumerate(self._panels(), 1):
            suffix = "" if number == 1 else str(number)
            first = "" if j == 0 else str(j + 1)
            last = i == len(self.rows) - 1
            layout[f"xaxis{suffix}"] = {
                **_axis(panel.x_label, "x" in panel.logarithmic, panel.x_limits),
                "domain": across[j], "anchor": f"y{suffix}", "showticklabels": last,
                **({"matches": f"x{first}"} if i else {}),
            }  # fmt: skip
            layout[f"yaxis{suffix}"] = {
                **_axis(panel.y_label, "y" in panel.logarithmic, panel.y_limits, panel.y_ticks),
                "domain": down[i], "anchor": f"x{suffix}",
            }  # fmt: skip
            if panel.title:
                layout["annotations"].append(_title(panel.title, across[j][0], down[i][1]))
            labels = [label for label in dict.fromkeys(curve.label for curve in panel.curves) if label not in named]
            legend = "legend" if columns > 1 else f"legend{suffix}"
            layout.setdefault(legend, _legend(0.0, 1 + LEGEND / inner) if columns > 1 else _legend(1.0, down[i][1]))
            for curve in panel.curves:
                trace = {**_trace(curve), "xaxis": f"x{suffix}", "yaxis": f"y{suffix}", "legendgroup": curve.label}
                data.append({**trace, "legend": legend, "showlegend": curve.label in labels})
            named.update(labels)
        return {"data": data, "layout": layout}

    def _panels(self) -> Iterator[tuple[int, int, Panel]]:
        for i, row in enumerate(self.rows):
            for j, panel in enumerate(row):
                yield i, j, panel


def thinned(y: NDArray[np.float64], intervals: int = INTERVALS) -> NDArray[np.intp]:
    """Which points of a curve `y` (points,) to keep: the least and the greatest of each of so many `intervals`.

    The ends, and of an interval with a gap its first missing point, are kept as well.

    >>> thinned(np.array([0, 1, 9, 1, 0, 1, 0, 0, -5, 0, 2, 0.0]), 2)
    array([ 0,  2,  8, 10, 11])
    """
    points = len(y)
    if points <= 2 * intervals:
        return np.arange(points)
    length = -(-points // intervals)
    rows = np.pad(y, (0, -points % length), constant_values=np.nan).reshape(-1, length)
    finite = np.isfinite(rows)
    least, greatest = np.where(finite, rows, np.inf).argmin(axis=1), np.where(finite, rows, -np.inf).argmax(axis=1)
    missing = np.where(finite.all(axis=1), least, finite.argmin(axis=1))
    kept = length * np.arange(len(rows)) + np.array([least, greatest, missing])
    return np.unique(np.minimum([0, points - 1, *kept.ravel()], points - 1))


def time_histories(
    time: NDArray[np.float64], signals: Mapping[str, tuple[NDArray[np.float64], str]], title: str
) -> Chart:
    """Signals over time, a panel for each kind.

    Parameters
    ----------
    time
        (samples,) [s].
    signals
        By name: (samples,), and the unit.
    title
        What they are of.
    """
    kinds: dict[tuple[str, str], list[str]] = {}
    for name, (_, unit) in signals.items():
        kind = next((kind for start, kind in KINDS.items() if name.startswith(start)), name)
        kinds.setdefault((kind, unit), []).append(name)
    panels = [
        Panel(
            beside(time, {name: signals[name][0] for name in names}),
            y_label=f"{kind}\n[{unit.replace('^2', '²')}]",
            x_limits=(time[0], time[-1]),
        )
        for (kind, unit), names in kinds.items()
    ]
    return below_each_other(panels, 1.8, title=title)


def gains(
    frequency: NDArray[np.float64],
    response: NDArray[np.complex128],
    outputs: Sequence[str],
    inputs: Sequence[str],
    units: Mapping[str, str],
) -> Chart:
    """The gain of a frequency response, a column for each input.

    Parameters
    ----------
    frequency
        (frequencies,) [Hz].
    response
        (frequencies, outputs, inputs).
    outputs, inputs
        Names.
    units
        Units of the signals by name; empty: SI units.
    """
    row = []
    shown, y_label = [with_unit(name, units) for name in outputs], "gain" if units else "gain [SI units]"
    for j, driven_by in enumerate(inputs):
        size = dict(zip(shown, np.abs(response[:, :, j]).T, strict=True))
        title = f"from {with_unit(driven_by, units)}"
        row.append(Panel(beside(frequency, size), title, "frequency [Hz]", y_label, "xy"))
    return Chart((tuple(row),), (1.0 + 5.0 * len(inputs), 4.4))


def with_unit(name: str, units: Mapping[str, str]) -> str:
    """A signal's name with its unit out of `units`; alone where it is not among them, or the name has it.

    >>> with_unit("a1", {"a1": "m/s^2"}), with_unit("f", {}), with_unit("f [kN]", {"f [kN]": "kN"})
    ('a1 [m/s²]', 'f', 'f [kN]')
    """
    unit = units.get(name, "")
    return f"{name} [{unit.replace('^2', '²')}]" if unit and not name.endswith("]") else name


def below_each_other(panels: Sequence[Panel], height: float, caption: str = "", title: str = "") -> Chart:
    """A chart of `panels` of one time axis, of this `height` each [inches], with its `caption` and a `title`."""
    rows = [replace(panel, x_label="") for panel in panels]
    rows[0] = replace(rows[0], title=title)
    rows[-1] = replace(rows[-1], x_label="time [s]")
    return Chart(tuple((panel,) for panel in rows), (10.0, 0.8 + height * len(rows)), caption)


def beside(x: NDArray[np.float64], curves: Mapping[str, NDArray[np.float64]]) -> tuple[Curve, ...]:
    """The `curves` of several quantities over `x`, by name, each in a colour of its own."""
    return tuple(Curve(x, y, name, COLOURS[i % len(COLOURS)]) for i, (name, y) in enumerate(curves.items()))


def _draw(axis: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        given: dict[str, Any] = {"color": curve.colour, "label": curve.label}
        if curve.style == POINTS:
            axis.plot(curve.x, curve.y, ls="none", marker=".", ms=2.5, rasterized=True, **given)
        else:
            kept = thinned(curve.y)
            axis.plot(curve.x[kept], curve.y[kept], lw=curve.width, ls=curve.style, **given)
    scales = {f"{name}scale": "log" if name in panel.logarithmic else "linear" for name in "xy"}
    axis.set(**scales, xlabel=panel.x_label, ylabel=panel.y_label)
    axis.set_title(panel.title, loc="left", fontsize="medium")
    axis.set(**{f"{name}lim": ends for name, ends in (("x", panel.x_limits), ("y", panel.y_limits)) if ends})
    if panel.y_ticks:
        axis.yaxis.set_ticks(panel.y_ticks, [f"{tick:g}" for tick in panel.y_ticks])
        axis.yaxis.set_ticks([], minor=True)
    for name, place in (("x", axis.xaxis), ("y", axis.yaxis)):
        if name in panel.logarithmic and not (name == "y" and panel.y_ticks):
            plain_ticks(place, *place.get_view_interval())
    axis.grid(alpha=0.3)


def _domains(sizes: Sequence[float], gap: float) -> list[tuple[float, float]]:
    """Begin and end, as shares of a whole, of parts of relative `sizes` with a `gap` between them."""
    lengths = np.array(sizes) / sum(sizes) * (1 - gap * (len(sizes) - 1))
    ends = np.cumsum(lengths + gap) - gap
    return [(float(end - length), float(end)) for end, length in zip(ends, lengths, strict=True)]


def _axis(
    label: str, logarithmic: bool, limits: tuple[float, float] | None, ticks: tuple[float, ...] = ()
) -> dict[str, Any]:
    axis: dict[str, Any] = {**FRAME, "title": {"text": label.replace("\n", "<br>"), "standoff": 6}}
    if logarithmic:
        axis |= {"type": "log", "exponentformat": "power"}
    if limits:
        axis["range"] = [float(end) for end in (np.log10(limits) if logarithmic else limits)]
    if ticks:
        axis |= {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}
    return axis


def _title(text: str, x: float, y: float) -> dict[str, Any]:
    place = {"x": x, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
    return {"text": text, "showarrow": False, "font": {"size": 13}, **place}


def _legend(x: float, y: float) -> dict[str, Any]:
    return {"orientation": "h", "x": x, "xanchor": "right" if x else "left", "y": y, "yanchor": "bottom"}


def _trace(curve: Curve) -> dict[str, Any]:
    kept = thinned(curve.y, INTERVALS_OF_POINTS if curve.style == POINTS else INTERVALS)
    drawn: dict[str, Any] = {"mode": "lines"}
    drawn["line"] = {"color": curve.colour, "width": 1.3 * curve.width, "dash": DASHES.get(curve.style)}
    if curve.style == POINTS:
        drawn = {"mode": "markers", "marker": {"color": curve.colour, "size": 3}}
    return {"type": "scatter", "name": curve.label, "x": _packed(curve.x[kept]), "y": _packed(curve.y[kept]), **drawn}


def _packed(values: NDArray[np.float64]) -> dict[str, str]:
    """Numbers as Plotly takes them packed, in single precision."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}
