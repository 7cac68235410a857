# SPDX-License-Identifier: Apache-2.0
"""Recorded tests of a benchmark's rig: what its sensors measured, noise included, and velocities from displacements."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import savgol_filter

from abrace.benchmark.criteria import Responses, criteria, peaks
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from abrace.benchmark.laws import AnyBenchmark
    from abrace_core.run import Run

VELOCITY_SPAN = 0.04
"""Of a cubic through measured displacements, whose slope is their velocity [s]."""


def recorded(benchmark: AnyBenchmark, run: Run) -> Responses:
    """What a recorded test of the benchmark's rig, a `run`, gave.

    Raises
    ------
    AbraceError
        If it is a test of another rig, or a part of it is missing.
    """
    floors, groups = len(benchmark.layout.masses), len(benchmark.layout.storeys)
    if (run.floors, run.groups) != (floors, groups):
        raise AbraceError(
            f"{run.source}: {run.floors} floors and {run.groups} brace groups, expected those of "
            f"{benchmark.definition.name}: {floors} and {groups}"
        )
    if np.any(np.diff(run.sequence.astype(np.int64)) != 1):
        raise AbraceError(f"{run.source}: samples are missing, expected a whole test")
    x = run.outputs[:, :floors]
    span = 2 * round(VELOCITY_SPAN / run.sample_period / 2) + 1
    if len(x) < span:
        raise AbraceError(f"{run.source}: {len(x)} samples, expected {span} or more")
    velocity = savgol_filter(x, span, 3, deriv=1, delta=run.sample_period, axis=0)
    first = floors + groups
    acceleration, force = run.outputs[:, first : first + floors], run.outputs[:, first + floors :]
    return Responses(run.sample_period, x, velocity, acceleration, force)


def of_tests(benchmark: AnyBenchmark, controlled: Run, uncontrolled: Run) -> tuple[dict[str, float], Responses]:
    """Criteria of a `controlled` test beside an `uncontrolled` one of the benchmark's rig, and its responses.

    Raises
    ------
    AbraceError
        If one of them is a test of another rig, or a part of it is missing.
    """
    without = peaks(recorded(benchmark, uncontrolled), benchmark.layout)
    found = recorded(benchmark, controlled)
    return criteria(found, benchmark.layout, without), found
