# SPDX-License-Identifier: Apache-2.0
"""Pole pairs with their uncertainty, as text (95 % intervals) and as a file (standard deviations)."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from abrace_core.files import write_text
from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from abrace_sysid.fitting.pole_estimate import PoleInterval


def write_poles(pairs: Mapping[str, Sequence[PoleInterval]], path: Path) -> None:
    """Write the `pairs` of each test to the JSON file `path`; a standard deviation that is not known becomes null."""
    content = {test: [_as_json(pair) for pair in values] for test, values in pairs.items()}
    write_text(path, json.dumps(content, indent=1) + "\n")


def poles_text(pairs: Sequence[PoleInterval]) -> str:
    """One line for each of the `pairs`: rad/s and damping ratio, each with its 95 % interval if that is known."""
    return "\n".join(
        f"  {_text(pair.frequency, pair.frequency_deviation)}  {_text(pair.damping, pair.damping_deviation)}"
        for pair in pairs
    )


def _as_json(pair: PoleInterval) -> dict[str, Any]:
    values = {
        "frequency": pair.frequency,
        "damping_ratio": pair.damping,
        "frequency_deviation": pair.frequency_deviation,
        "damping_ratio_deviation": pair.damping_deviation,
    }
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _text(value: float, deviation: float) -> str:
    if not math.isfinite(deviation):
        return f"{value:10.5f}"
    return f"{value:10.5f} +- {NORMAL_95 * deviation:.2g}".ljust(22)
