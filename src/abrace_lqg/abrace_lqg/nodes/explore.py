# SPDX-License-Identifier: Apache-2.0
"""The node `explore`: many sets of weights tried on ground motions and models, and any of them written as a controller.

abrace run abrace_lqg explore --ros-args -p model:=results/model/reduced.json -p output:=results/exploration
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from abrace_bags import read_run
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_covariance, load_model
from abrace_core.node import AbraceNode, Parameter, find_file, run
from abrace_core.progress import Progress
from abrace_lqg.exploration.ensemble import Record, noise_motion, recorded_motion
from abrace_lqg.exploration.figure import robust_figure, trade_off
from abrace_lqg.exploration.files import save_exploration, write_set
from abrace_lqg.exploration.report import report
from abrace_lqg.exploration.run import explore
from abrace_lqg.exploration.study import Study
from abrace_lqg.exploration.weight_sets import SPANS, weight_sets
from abrace_lqg.fragility.study import Interlock, ensemble, faults_of, named_numbers
from abrace_lqg.of_model import excitation_of, force_limit_of, sample_period_of
from abrace_lqg.proof.files import distrusted
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import load_weights

INTERLOCK_TIME = 0.01
"""For which a limit has to be exceeded [s]: that of a rig's drift, displacement, stroke, acceleration and force."""
FACTORS = "lowest and highest power of ten that this weight is multiplied by"

PARAMETERS = [
    Parameter("model", "", "model file (JSON) to design with"),
    Parameter("simulation_model", "", "model file (JSON) for simulation and margins"),
    Parameter("weights", "lqg3", "weights to vary: a name in the package's configuration or a file"),
    Parameter("measured", [], "names of the measured quantities; []: as in the weights", element=str),
    *(Parameter(name, list(span), FACTORS, minimum=-12.0, maximum=12.0) for name, span in SPANS.items()),
    Parameter("sets", 256, "number of sets that are tried in addition to the given weights", minimum=1),
    Parameter("seed", 0, "seed of the quasi-random sets and of the models drawn", minimum=0),
    Parameter("bags", [], "bags of tests whose ground motion is simulated", element=str),
    Parameter("noise", [], "seeds of banded noise, a record for each", element=int, minimum=0),
    Parameter("noise_band", [0.1, 10.0], "Hz, lowest and highest frequency of the noise", minimum=0.0),
    Parameter("noise_duration", 100.0, "s, of each noise", minimum=2.0),
    Parameter(
        "peak_acceleration", [0.980665], "m/s^2, one or several, to each of which records are scaled", minimum=1e-6
    ),
    Parameter("models", 1, "number of models: the simulation model, the others drawn from its covariance", minimum=1),
    Parameter("faults", [], "failing sensors, such as a1=0: reading over true value; one at a time", element=str),
    Parameter("interlocks", [], "limits, such as d1=0.04 (SI): the command ends when exceeded for 10 ms", element=str),
    Parameter(
        "quantile", 0.9, "share of the loops that respond no more than the robust response", minimum=0.0, maximum=1.0
    ),
    Parameter("sample_period", 0.0, "s, of the controllers; 0: that of the model's tests", minimum=0.0),
    Parameter(
        "force_limit",
        [],
        "N, greatest force of one brace of each group; []: as the model's file says",
        element=float,
        minimum=1.0,
    ),
    Parameter("scheduler", "", "address of a Dask scheduler; empty: a cluster of this machine's cores"),
    Parameter("output", "", "folder for the results", required=True),
    Parameter(
        "pick",
        [],
        "numbers of sets of an exploration in `output` to write as weights and controller; nothing is explored",
        element=int,
        minimum=0,
    ),
]


class Explore(AbraceNode):
    """Tries many sets of weights, or writes some of them as controllers, and ends."""

    def __init__(self) -> None:
        super().__init__("explore", PARAMETERS)

    def work(self) -> None:
        """Explore, or write the picked sets."""
        if not self.parameters.pick:
            self.explore()
            return
        for number in self.parameters.pick:
            proof, files = write_set(self.parameters.output, number)
            print(f"set {number}: {proof.summary()}")
            print(f"wrote {', '.join(map(str, files))}")

    def explore(self) -> None:
        """Try all sets and write the results."""
        given = self.parameters
        for name in ("model", "simulation_model"):
            if not getattr(given, name):
                raise AbraceError(f"parameter {name}: not given, expected -p {name}:=FILE, a model file (JSON)")
        distrust = distrusted([given.model, given.simulation_model])
        for reason in distrust:
            self.get_logger().warning(f"{reason}: no set becomes a controller")
        weights_file = find_file(given.weights, "abrace_lqg", "config", ".yaml", "weights")
        weights = load_weights(weights_file)
        if given.measured:
            weights = weights.model_copy(update={"measured": given.measured})
        model, simulation_model = load_model(given.model), load_model(given.simulation_model)
        period, limit = sample_period_of(model, given.sample_period), force_limit_of(model, given.force_limit)
        weights = scaled_weights(model, weights, period, limit, excitation_of(model))
        spans = {name: _pair(name, getattr(given, name)) for name in SPANS}
        sets = weight_sets(weights, spans, given.sets, given.seed)
        covariance = load_covariance(given.simulation_model)
        study = Study.of(
            model,
            ensemble(simulation_model, covariance, given.models, given.seed, given.simulation_model),
            self.records(period),
            intensities=given.peak_acceleration,
            capacity=np.array(limit),
            sample_period=period,
            faults=faults_of(named_numbers("parameter faults:", given.faults)),
            interlocks=self.interlocks(period),
            quantile=given.quantile,
        )
        print(
            f"{len(sets)} sets of weights, {study.count} loops each: {len(sets) * study.count} closed loops", flush=True
        )
        begin = time.monotonic()
        output = Path(given.output)
        with Progress(1, sys.stdout).step("exploration") as shown:
            outcomes = explore(
                study,
                sets,
                output / "loops",
                scheduler=given.scheduler,
                progress=lambda done: shown.update(done / len(sets), f"{done} of {len(sets)} sets"),
            )
        made_from = {
            "model": given.model,
            "simulation_model": given.simulation_model,
            "weights": str(weights_file),
            "spans": spans,
            "seed": given.seed,
        }
        save_exploration(output, study, outcomes, simulation_model, made_from, covariance, distrust)
        print("\n".join(report(outcomes, study.quantile)))
        if any(not outcome.refused for outcome in outcomes):
            save_figure(trade_off(outcomes), output / "trade_off.png")
            save_figure(robust_figure(outcomes, study.quantile), output / "robust.png")
        print(f"wrote {output} ({time.monotonic() - begin:.1f} s)")

    def interlocks(self, sample_period: float) -> list[Interlock]:
        """The given limits as interlocks."""
        samples = max(1, round(INTERLOCK_TIME / sample_period))
        limits = named_numbers("parameter interlocks:", self.parameters.interlocks)
        return [Interlock(name, value, samples) for name, values in limits.items() for value in values]

    def records(self, sample_period: float) -> list[Record]:
        """The ground motions, not yet scaled."""
        given = self.parameters
        band = _pair("noise_band", given.noise_band)
        found = []
        for bag in given.bags:
            recorded = read_run(bag)
            for warning in recorded.facts.get("warnings", []):
                self.get_logger().warning(warning)
            found.append(recorded_motion(recorded, sample_period))
        return found + [noise_motion(seed, given.noise_duration, band, sample_period) for seed in given.noise]


def _pair(name: str, value: list[float]) -> tuple[float, float]:
    if len(value) != 2:
        raise AbraceError(f"parameter {name}: {value}, expected two numbers")
    return value[0], value[1]


def main() -> int:
    """Entry point."""
    return run(Explore)
