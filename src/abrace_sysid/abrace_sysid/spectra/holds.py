# SPDX-License-Identifier: Apache-2.0
"""How inputs move between samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from abrace_core.discretization import HOLDS
from abrace_sysid.measured_data import MeasuredData

if TYPE_CHECKING:
    from abrace_core.run import Run

InputHold = Literal["zero", "first", "band"]
"""Held at a sample's value; linear to the next one; or sampled alike with the outputs, with nothing above half the
sample rate, so that the response is that of the continuous structure."""


def hold_of(run: Run | MeasuredData, name: str) -> InputHold:
    """Of the input `name` of a test `run`: the rig's own, or that of the data."""
    return run.hold if isinstance(run, MeasuredData) else HOLDS.get(name, "zero")
