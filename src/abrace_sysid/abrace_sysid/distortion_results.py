# SPDX-License-Identifier: Apache-2.0
"""Noise and nonlinear distortion of tests with multisines, channel by channel, as text and as a file."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from abrace_sysid.spectra.measured_tests import TestData

KINDS = ("noise", "odd", "even")
"""The levels that are given, each as a share of the response."""


def distortion_shares(data: TestData) -> dict[str, dict[str, float]]:
    """Noise, odd and even distortion of each channel as shares of its response (rms over band and realizations).

    The noise's power is subtracted from the distortion. NaN: the multisine leaves out no odd (or even) line, so this
    distortion cannot be measured. An empty result: the tests were not multisines.

    Parameters
    ----------
    data
        The tests of one input.
    """
    found = [one.distortion.shares(one.response, one.sigma) for one in data.responses if one.distortion is not None]
    if not found:
        return {}
    levels = {kind: np.sqrt(np.mean([one[kind] ** 2 for one in found], axis=0)) for kind in KINDS}
    return {name: {kind: float(levels[kind][c]) for kind in KINDS} for c, name in enumerate(data.outputs)}


def write_distortion(tests: Sequence[TestData], path: Path) -> str:
    """Write the distortion of tests with multisines, and return a line for each input with its most distorted channel.

    The text is empty if no test was a multisine.

    Parameters
    ----------
    tests
        The tests of each input.
    path
        The JSON file; not written if no test was a multisine.
    """
    content, lines = {}, []
    for data in tests:
        shares = distortion_shares(data)
        if not shares:
            continue
        worst = max(shares, key=lambda name: (_or_zero(shares[name]["odd"]), _or_zero(shares[name]["even"])))
        stated = ", ".join(f"{kind} {_percent(shares[worst][kind])}" for kind in KINDS)
        lines.append(f"distortion of the response to {data.input}, most in {worst}: {stated}")
        levels = [
            {
                "test": run.source,
                "frequency": (one.omega / (2 * np.pi)).tolist(),
                "noise": dict(zip(one.outputs, one.sigma.T.tolist(), strict=True)),
                "odd": dict(zip(one.outputs, _or_null(one.distortion.odd.T), strict=True)),
                "even": dict(zip(one.outputs, _or_null(one.distortion.even.T), strict=True)),
            }
            for run, one in zip(data.runs, data.responses, strict=True)
            if one.distortion is not None
        ]
        content[data.input] = {
            "shares": {name: dict(zip(row, _or_null(list(row.values())), strict=True)) for name, row in shares.items()},
            "levels": levels,
        }
    if content:
        write_text(path, json.dumps(content, indent=1) + "\n")
    return "\n".join(lines)


def _or_null(values: Any) -> list[Any]:
    """The numbers as nested lists, with None for each that is not finite."""
    return [_or_null(value) if np.ndim(value) else (float(value) if math.isfinite(value) else None) for value in values]


def _or_zero(share: float) -> float:
    return share if math.isfinite(share) else 0.0


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if math.isfinite(share) else "not measured"
