# SPDX-License-Identifier: Apache-2.0
"""The layout of a rig for Foxglove and Lichtblick."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from abrace_core.model.signals import GROUND, command_names, load_cell_names

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")


def foxglove_layout(
    floors: int, braces: Sequence[int], response: str, description: str, without: Collection[str] = ()
) -> bytes:
    """The layout, a JSON file.

    Parameters
    ----------
    floors
        How many.
    braces
        How many are in each group.
    response, description
        Topics of the rig's samples, and of its robot description.
    without
        Channels that have no sensor.
    """
    curves = {
        "Displacements [m]": {f"x{i + 1}": f"displacement[{i}]" for i in range(floors)},
        "Accelerations [m/s^2]": {
            **{f"a{i + 1}": f"acceleration[{i}]" for i in range(floors)},
            GROUND: "ground_acceleration",
        },
        "Force and command of a brace [N]": {
            **{name: f"force[{i}]" for i, name in enumerate(load_cell_names(braces))},
            **{name: f"command[{i}]" for i, name in enumerate(command_names(len(braces)))},
        },
    }
    camera = {
        "perspective": True,
        "distance": 18,
        "phi": 78,
        "thetaOffset": 25,
        "targetOffset": [0, 0, 4.5],
        "fovy": 45,
    }
    urdf = {"layerId": "foxglove.Urdf", "sourceType": "topic", "topic": description, "visible": True}
    panels: dict[str, Any] = {
        "3D!building": {"cameraState": camera, "followTf": "table", "layers": {"rig": urdf}},
        "DiagnosticSummary!nodes": {"minLevel": 0, "topicToRender": "/diagnostics", "secondsUntilStale": 3},
        "StateTransitions!state": {"paths": [{"value": f"{response}.state", "label": "state"}], "isSynced": True},
    }
    plots: list[str] = []
    for title, every in curves.items():
        fields = {name: field for name, field in every.items() if name not in without}
        if not fields:
            continue
        plots.append(f"Plot!{len(plots)}")
        paths = [
            {"value": f"{response}.{field}", "enabled": True, "color": COLOURS[number % len(COLOURS)], "label": name}
            for number, (name, field) in enumerate(fields.items())
        ]
        panels[plots[-1]] = {"title": title, "paths": paths, "isSynced": True, "followingViewWidth": 20}
    left = {"direction": "column", "splitPercentage": 66, "first": "3D!building", "second": "DiagnosticSummary!nodes"}
    right: Any = "StateTransitions!state"
    for number, plot in enumerate(reversed(plots), 2):
        right = {"direction": "column", "splitPercentage": 100 / number, "first": plot, "second": right}
    layout = {"direction": "row", "splitPercentage": 45, "first": left, "second": right}
    content = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(content, indent=1).encode()
