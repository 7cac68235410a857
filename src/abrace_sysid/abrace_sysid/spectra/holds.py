# SPDX-License-Identifier: Apache-2.0
"""Behaviour of inputs between samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from abrace_core.discretization import HOLDS
from abrace_sysid.measured_data import MeasuredData

if TYPE_CHECKING:
    from abrace_core.run import Run

InputHold = Literal["zero", "first", "band"]
"""Zero-order hold, linear between samples (first-order hold), or band-limited below half the sample rate and sampled
like the outputs, so that the response is that of the continuous structure."""


def hold_of(run: Run | MeasuredData, name: str) -> InputHold:
    """The hold of the input `name` of a test `run`: for a rig by the kind of input, for measured data their `hold`."""
    return run.hold if isinstance(run, MeasuredData) else HOLDS.get(name, "zero")
