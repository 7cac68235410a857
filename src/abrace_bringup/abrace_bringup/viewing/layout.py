# SPDX-License-Identifier: Apache-2.0
"""Layouts of any rig for Foxglove, Lichtblick and PlotJuggler: those installed, plots with the rig's own channels."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from abrace_bringup.viewing.named_channels import UTILISATION
from abrace_bringup.viewing.server import CHANNELS
from abrace_core.installed import find_file
from abrace_core.signals import GROUND, command_names, load_cell_names, numbered

if TYPE_CHECKING:
    from collections.abc import Sequence

COLOURS = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#a395e2", "#6ee0e8")
PLOTS = {
    "Plot!displacement": r"x.*",
    "Plot!acceleration": r"a\d+|w",
    "Plot!force": r"[fU]\d*",
    "Plot!utilisation": rf".*{UTILISATION}",
}
"""Which channels each plot of the layout for Foxglove has."""
PLOTJUGGLER_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
PLOTJUGGLER_PLOTS = {
    "displacements [m]": ("displacement",),
    "accelerations [m/s^2]": ("acceleration", "ground_acceleration"),
    "force and command of a brace [N]": ("force", "command"),
    "stroke [m]": ("stroke",),
}
"""Which fields of a response each plot of the layout for PlotJuggler has."""


def layout(names: Sequence[str]) -> dict[str, Any]:
    """The layout for a rig.

    Parameters
    ----------
    names
        Of its channels, as `named_channels.names_of` has them.
    """
    text = find_file("foxglove", "abrace_bringup", "viewer", ".json", "layout").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    for panel, pattern in PLOTS.items():
        settings = content["configById"][panel]
        curve = settings["paths"][0]
        shown = [name for name in names if re.fullmatch(pattern, name)]
        settings["paths"] = [
            {**curve, "value": f"{CHANNELS}.{name}", "color": COLOURS[number % len(COLOURS)], "label": name}
            for number, name in enumerate(shown)
        ]
    return content


def plotjuggler_layout(floors: int, braces: Sequence[int], topic: str) -> bytes:
    """The layout of a rig for PlotJuggler, an XML file: custom series give each number of a response its name.

    Parameters
    ----------
    floors
        How many.
    braces
        How many are in each group.
    topic
        Of the rig's samples.
    """
    names = {
        "displacement": [f"x{floor + 1}" for floor in range(floors)],
        "acceleration": [f"a{floor + 1}" for floor in range(floors)],
        "stroke": numbered("xf", len(braces)) if braces else (),
        "force": load_cell_names(braces) if braces else (),
        "command": command_names(len(braces)) if braces else (),
    }
    sources = {name: f"{field}[{place}]" for field, found in names.items() for place, name in enumerate(found)}
    sources[GROUND] = "ground_acceleration"
    root = ElementTree.fromstring(find_file("plotjuggler", "abrace_bringup", "viewer", ".xml", "layout").read_bytes())
    for area in root.iter("DockArea"):
        for plot in area.findall("plot"):
            if fields := PLOTJUGGLER_PLOTS.get(area.get("name", "")):
                plot[:] = _curves([name for name, source in sources.items() if source.partition("[")[0] in fields])
            else:
                _of_topic(plot, topic)
    for series in root.findall("customMathEquations"):
        series[:] = [_named(name, f"{topic}/{source}") for name, source in sources.items()]
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _curves(names: Sequence[str]) -> list[ElementTree.Element]:
    colours = PLOTJUGGLER_COLOURS
    return [
        ElementTree.Element("curve", name=name, color=colours[number % len(colours)])
        for number, name in enumerate(names)
    ]


def _of_topic(plot: ElementTree.Element, topic: str) -> None:
    """Let the curves of a plot, of fields that have one number, be those of a `topic`."""
    for curve in plot.iter("curve"):
        curve.set("name", f"{topic}/{curve.get('name', '').rpartition('/')[2]}")


def _named(name: str, source: str) -> ElementTree.Element:
    """A custom series: the numbers of its `source` under a `name`."""
    snippet = ElementTree.Element("snippet", name=name)
    for tag, text in (("global", None), ("function", "return value"), ("linked_source", source)):
        ElementTree.SubElement(snippet, tag).text = text
    return snippet
