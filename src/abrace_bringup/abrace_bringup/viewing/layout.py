# SPDX-License-Identifier: Apache-2.0
"""The layout for Foxglove and Lichtblick of any rig: the installed one, its plots with the rig's own channels."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from abrace_bringup.viewing.named_channels import UTILISATION
from abrace_bringup.viewing.server import CHANNELS
from abrace_core.installed import find_file

if TYPE_CHECKING:
    from collections.abc import Sequence

COLOURS = ("#4e98e2", "#f5774d", "#f7df71", "#5cd6a9", "#a395e2", "#6ee0e8")
PLOTS = {
    "Plot!displacement": r"x.*",
    "Plot!acceleration": r"a\d+|w",
    "Plot!force": r"[fU]\d*",
    "Plot!utilisation": rf".*{UTILISATION}",
}
"""Which channels each plot of the layout has."""


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
