# SPDX-License-Identifier: Apache-2.0
"""The reference controllers of the benchmarks, and margins of a controller on a benchmark's model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import Controller
from abrace_core.model.verdict import nan_first
from abrace_lqg.analysis.disk_margin import disk_margin
from abrace_lqg.analysis.margins import common_gain_margin, margins
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.proof.limits import excitation_of
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import load_weights
from abrace_studies.benchmark.frame_benchmark import FrameBenchmark
from abrace_studies.benchmark.sample_controller import sample_controller
from abrace_studies.frames.model import building_model

if TYPE_CHECKING:
    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.benchmark.rig_benchmark import RigBenchmark

    AnyBenchmark = FrameBenchmark | RigBenchmark

SAMPLE, OWN = "sample", "abrace"
MODES_OF_MARGINS = 40
"""Excited modes of a frame's model on which margins are found: the others add 0.002 % to the responses."""


def reference_names(benchmark: AnyBenchmark) -> tuple[str, ...]:
    """Names of the reference controllers of a `benchmark`, in their order."""
    return (
        (SAMPLE, OWN) if isinstance(benchmark, FrameBenchmark) else tuple(dict.fromkeys(benchmark.definition.weights))
    )


def references(benchmark: AnyBenchmark) -> dict[str, Controller]:
    """The reference controllers, by name: of a frame the benchmark's sample and abrace's own.

    Raises
    ------
    AbraceError
        If a weights file is wrong.
    """
    if not isinstance(benchmark, FrameBenchmark):
        return {name: designed(benchmark, name) for name in benchmark.definition.weights}
    return {SAMPLE: sample_of(benchmark), OWN: designed(benchmark, benchmark.definition.weights)}


def sample_of(benchmark: FrameBenchmark) -> Controller:
    """The benchmark's sample controller, on our own design model."""
    definition = benchmark.definition
    return sample_controller(
        benchmark.design_model,
        definition.measured,
        definition.sample_period,
        definition.devices.capacity,
        benchmark.building.frames,
    )


def designed(benchmark: AnyBenchmark, weights: str) -> Controller:
    """abrace's LQG with `weights`, a name or file, on the design model of a `benchmark` and with its limits.

    Raises
    ------
    AbraceError
        If the weights are wrong, or give no controller.
    """
    capacity = (
        np.full(len(benchmark.layout.counts), benchmark.definition.devices.capacity)
        if isinstance(benchmark, FrameBenchmark)
        else benchmark.rig.capacity
    )
    model, period = benchmark.design_model, benchmark.plant.sample_period
    given = load_weights(find_file(weights, "abrace_lqg", "config", ".yaml", "weights"))
    given = scaled_weights(model, given, period, capacity.tolist(), excitation_of(model, sample_period=period))
    found = design(model, given, period)
    return Controller(
        name=weights,
        law=found.controller,
        correction=found.correction,
        prediction=found.prediction,
        force_limit=capacity,
        model=f"{benchmark.definition.name}, {benchmark.design_model.order} states",
        weights=weights,
        margins="",
    )


def margins_of(benchmark: AnyBenchmark, controller: Controller) -> dict[str, float]:
    """Margins of a controller on the benchmark's model, by name.

    `gain_margin_db` of each command alone and of all of them together, the least; `phase_margin_deg` of each command
    alone; `disk_margin` of all commands and sensors at once. Empty: the loop is not stable.
    """
    plant = _plant(benchmark)
    try:
        alone = margins(plant, controller.law)
        return {
            "gain_margin_db": min(alone.gain_db, common_gain_margin(plant, controller.law), key=nan_first),
            "phase_margin_deg": alone.phase_deg,
            "disk_margin": disk_margin(plant, controller.law).alpha,
        }
    except AbraceError:
        return {}


def _plant(benchmark: AnyBenchmark) -> LinearModel:
    if not isinstance(benchmark, FrameBenchmark):
        return benchmark.plant
    devices, period = benchmark.definition.devices.per_storey, benchmark.definition.sample_period
    model = building_model(benchmark.building, devices, MODES_OF_MARGINS)
    return sampled(model.select([name for name in model.outputs if name[0] == "a"]), period)
