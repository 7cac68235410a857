# SPDX-License-Identifier: Apache-2.0
"""The reference controllers of the benchmarks, and margins of a controller on a benchmark's model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.sample_controller import sample_controller
from abrace_core.controller_file import Controller
from abrace_core.errors import AbraceError
from abrace_core.installed import find_file
from abrace_lqg.analysis.disk_margin import disk_margin
from abrace_lqg.analysis.margins import common_gain_margin, margins
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import load_weights
from abrace_plant.frames.model import building_model

if TYPE_CHECKING:
    from abrace.benchmark.rig_benchmark import RigBenchmark
    from abrace_core.linear_model import LinearModel

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


def designed(benchmark: AnyBenchmark, weights: str, command_factor: float = 1.0) -> Controller:
    """abrace's LQG on the benchmark's design model.

    Parameters
    ----------
    benchmark
        Its force limits are the controller's.
    weights
        By name or file.
    command_factor
        On the weights of all commands.

    Raises
    ------
    AbraceError
        If the weights are wrong, or give no controller.
    """
    given = load_weights(find_file(weights, "abrace_lqg", "config", ".yaml", "weights"))
    kinds = given.weights.model_copy(update={"command": command_factor * given.weights.command})
    given = given.model_copy(update={"weights": kinds})
    period = benchmark.plant.sample_period
    found = design(benchmark.design_model, given, period)
    capacity = (
        np.full(len(benchmark.layout.counts), benchmark.definition.devices.capacity)
        if isinstance(benchmark, FrameBenchmark)
        else benchmark.rig.capacity
    )
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
            "gain_margin_db": min(alone.gain, common_gain_margin(plant, controller.law)),
            "phase_margin_deg": alone.phase,
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
