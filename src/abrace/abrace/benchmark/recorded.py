# SPDX-License-Identifier: Apache-2.0
"""Recorded tests of a benchmark's rig: what its sensors measured, noise included.

Velocities come from displacements, rates from strokes, and the curvatures of a frame from its levels' displacements,
which its nodes follow statically.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import savgol_filter

from abrace.benchmark.criteria import Responses, criteria, peaks
from abrace.benchmark.definition import RecordedCase
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from abrace.benchmark.laws import AnyBenchmark
    from abrace_core.linear_model import LinearModel
    from abrace_core.run import Run

VELOCITY_SPAN = 0.04
"""Of a cubic through measured displacements, whose slope is their velocity [s]."""
TOLERANCES = {
    "sample period [s]": 0.001,
    "number of samples": 0.01,
    "peak table acceleration [m/s^2]": 0.05,
    "rms table acceleration [m/s^2]": 0.05,
}
"""By which two tests of one motion may differ, as a share of the greater: noise and a real table change its peaks."""


def recorded(benchmark: AnyBenchmark, run: Run) -> Responses:
    """What a recorded test of the benchmark's rig, a `run`, gave: forces and strokes of each device.

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
    if run.braces and run.braces != benchmark.layout.counts:
        raise AbraceError(
            f"{run.source}: braces in its groups {', '.join(map(str, run.braces))}, expected those of "
            f"{benchmark.definition.name}: {', '.join(map(str, benchmark.layout.counts))}"
        )
    if np.any(np.diff(run.sequence.astype(np.int64)) != 1):
        raise AbraceError(f"{run.source}: samples are missing, expected a whole test")
    x = run.outputs[:, :floors]
    span = 2 * round(VELOCITY_SPAN / run.sample_period / 2) + 1
    if len(x) < span:
        raise AbraceError(f"{run.source}: {len(x)} samples, expected {span} or more")
    stroke = np.repeat(run.outputs[:, floors : floors + groups], benchmark.layout.counts, axis=1)
    velocity, stroke_rate = (
        savgol_filter(measured, span, 3, deriv=1, delta=run.sample_period, axis=0) for measured in (x, stroke)
    )
    first = floors + groups
    acceleration, mean_force = run.outputs[:, first : first + floors], run.outputs[:, first + floors :]
    force = np.repeat(mean_force, benchmark.layout.counts, axis=1) if run.forces is None else run.forces
    curvature = x @ benchmark.static_curvature.T if isinstance(benchmark, FrameBenchmark) else np.zeros((len(x), 0))
    known = curvature if curvature.shape[1] else None
    return Responses(run.sample_period, x, velocity, acceleration, force, known, stroke, stroke_rate)


def recorded_case(benchmark: AnyBenchmark, run: Run, name: str) -> RecordedCase:
    """The motion of the table in a recorded test, a `run`, as a case of the `benchmark` with this `name`.

    Raises
    ------
    AbraceError
        If the test has another sample period than the benchmark.
    """
    period = benchmark.plant.sample_period
    if abs(run.sample_period - period) > TOLERANCES["sample period [s]"] * period:
        raise AbraceError(
            f"{run.source}: sampled every {run.sample_period:g} s, expected the {period:g} s of "
            f"{benchmark.definition.name}"
        )
    return RecordedCase(name, run.ground_acceleration)


def of_tests(
    benchmark: AnyBenchmark, controlled: Run, uncontrolled: Run, law: LinearModel | None = None
) -> tuple[dict[str, float], Responses]:
    """Criteria of a `controlled` test relative to an `uncontrolled` one of the benchmark's rig, and its responses.

    J16 and J17 are the inputs and states of the test's control `law`; None: it is not known, they are left out.

    Raises
    ------
    AbraceError
        If one of them is a test of another rig, a part of it is missing, or the table did not move alike in both.
    """
    free, found = recorded(benchmark, uncontrolled), recorded(benchmark, controlled)
    compared = zip(TOLERANCES.items(), _motion(controlled), _motion(uncontrolled), strict=True)
    for (what, tolerance), here, there in compared:
        if abs(here - there) > tolerance * max(here, there):
            raise AbraceError(
                f"{controlled.source} and {uncontrolled.source}: {what} {here:.6g} and {there:.6g}, "
                f"expected tests with the same motion of the table, within {100 * tolerance:g} %"
            )
    sensors, states = (len(law.inputs), law.order) if law else (0, 0)
    layout = benchmark.layout.of_each_device()
    return criteria(found, layout, peaks(free, layout), sensors, states), found


def _motion(run: Run) -> tuple[float, ...]:
    """What TOLERANCES names, of a `run`."""
    ground = run.ground_acceleration
    return run.sample_period, len(ground), float(np.abs(ground).max()), float(np.sqrt(np.mean(ground**2)))
