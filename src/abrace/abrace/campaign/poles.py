# SPDX-License-Identifier: Apache-2.0
"""Comparison of identified poles with the rig's own and the paper's."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json
from abrace_core.model.linear_model import pole_table
from abrace_core.model.modes import match_modes
from abrace_core.model.response import PAPER_RIG
from abrace_plant.rig.published import PAPER_POLES
from abrace_sysid.figures.poles import pole_chart

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig


def compare_poles(results: Path, step: str, rig: Rig, simulated: bool) -> None:
    """Compare the poles that a `step` identified with the paper's and, for a simulated rig, with its own.

    Writes poles.json and a chart into the folder of `results`.
    """
    found = json.loads((results / step / "poles.json").read_text(encoding="utf-8"))
    identified = {test: found[test] for test in ("table", "command")}
    own = rig.model.poles if simulated else np.array([])
    pairs = [{"frequency": w, "damping_ratio": damping} for w, damping in pole_table(own)]
    # the table test excites the building's modes, not the local ones: the rig's poles nearest to those found
    true = {"table": _nearest(identified["table"], pairs), "command": pairs[: len(identified["command"])]}
    poles = {test: {"identified": found, "true": true[test]} for test, found in identified.items()}
    content = {"rig": rig.name, **poles}
    write_json(results / "poles.json", content)
    highest = 1.2 * max(pair["frequency"] for pair in identified["command"])
    reference = {"rig": own[np.abs(own) < highest]} if own.size else {}
    if rig.name == PAPER_RIG:
        reference["paper, A1 and A2"] = np.concatenate([PAPER_POLES["table"], PAPER_POLES["command"]])
    chart = pole_chart({f"{test} test": _complex(found) for test, found in identified.items()}, reference)
    save_figure(chart, results / step / "poles.svg")


def _nearest(found: list[dict[str, float]], own: list[dict[str, float]]) -> list[dict[str, float]]:
    """For each identified pole pair the rig's own that is nearest in frequency, each used once."""
    ours, theirs = ([pair["frequency"] for pair in pairs] for pairs in (found, own))
    return [own[i] for i in sorted(j for _, j in match_modes(ours, theirs, tolerance=10.0))]


def _complex(pairs: list[dict[str, float]]) -> NDArray[np.complex128]:
    frequency, damping = (np.array([pair[key] for pair in pairs]) for key in ("frequency", "damping_ratio"))
    return frequency * (-damping + 1j * np.sqrt(1 - damping**2))
