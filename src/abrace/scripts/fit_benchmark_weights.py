# SPDX-License-Identifier: Apache-2.0
"""Find the weights of `src/abrace_lqg/config/sac_la_20.yaml`: abrace's LQG for the 20-storey benchmark building.

Accelerations, with a taper over the height, and the base shear have weights; each command has one of its own. (Weights
of drifts and displacements gave nothing.) For given weights of the responses those of the commands are adapted until
all devices reach about the same peak, that which the sample controller needs at most. What is left, and the noise, is
found by a random search: the greatest ratio of the worst J1 to J6 to the sample controller's is made small, with
margins as GAIN_MARGIN and DISK_MARGIN. So the weights are fitted to the benchmark's own runs.

    BENCHMARK_DATA=FOLDER python src/abrace/scripts/fit_benchmark_weights.py [TRIALS]

prints each improvement, and writes the weights file.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace.benchmark.criteria import OF_RESPONSE, criteria
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.laws import SAMPLE, sample_of
from abrace.benchmark_command import open_benchmark
from abrace_core.errors import AbraceError
from abrace_core.simulation import simulate
from abrace_lqg.analysis.disk_margin import disk_margin
from abrace_lqg.analysis.margins import common_gain_margin
from abrace_lqg.design import design
from abrace_lqg.loop import closed_loop, sampled
from abrace_lqg.weights import Weights, save_weights
from abrace_plant.frames.model import building_model

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel

OUTPUT = Path(__file__).parents[2] / "abrace_lqg" / "config" / "sac_la_20.yaml"
MODES = 24
"""Excited modes of the model that controllers are tried on."""
ACCELERATION = 1e10
"""Weight of accelerations [s^4/m^2]; those of the commands adapt to it."""
START = (0.4, -2.25, -0.15)
"""log10 of the taper of accelerations, of the weight of the base shear [1/N^2], and of the noise's intensity."""
LARGEST_STEP, LEAST_STEP, SEED = 0.3, 0.02, 1
ADAPTATIONS, FIRST_ADAPTATIONS = 3, 8
SHARE_OF_PEAK, TOLERANCE = 0.985, 1.005
"""Share of the sample controller's peak force that all devices are to reach, and the tolerance above it."""
GAIN_MARGIN, DISK_MARGIN = 7.0, 0.34


class Found(NamedTuple):
    """What some weights give."""

    weights: Weights
    law: LinearModel
    worst: NDArray[np.float64]
    """(6,) J1 to J6, the worst of the cases."""
    peaks: NDArray[np.float64]
    """(commands,) greatest force [N]."""
    commands: NDArray[np.float64]
    """(commands,) log10 of the commands' weights, adapted once more."""


class Trials:
    """Controllers tried on the benchmark's two records, linear and without converters."""

    def __init__(self, benchmark: FrameBenchmark) -> None:
        definition = benchmark.definition
        self.benchmark, self.period = benchmark, definition.sample_period
        model = building_model(benchmark.building, definition.devices.per_storey, MODES)
        self.plant = sampled(model.select([name for name in model.outputs if name[0] != "c"]), self.period)
        self.cases = [case for case in definition.cases if case.intensity == 1.0]
        self.sample, peaks = self.reached(sample_of(benchmark).law)
        self.peak = SHARE_OF_PEAK * peaks.max()

    def reached(self, law: LinearModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Worst J1 to J6, and the greatest force of each command [N]."""
        loop, commands = closed_loop(self.plant, law), len(law.outputs)
        values, peaks = [], []
        for case in self.cases:
            outputs = simulate(loop, self.benchmark.ground(case)[:, None])
            responses = self.benchmark.responses(outputs[:, :-commands], outputs[:, -commands:])
            found = criteria(responses, self.benchmark.layout, self.benchmark.uncontrolled(case))
            values.append([found[name] for name in OF_RESPONSE])
            peaks.append(np.abs(responses.force).max(axis=0))
        return np.max(values, axis=0), np.max(peaks, axis=0)

    def find(self, unknowns: NDArray[np.float64], commands: NDArray[np.float64], adaptations: int) -> Found:
        """Adapt the weights of the commands some times, and try the last controller."""
        for _ in range(adaptations + 1):
            weights = self.weights(unknowns, commands)
            law = design(self.benchmark.design_model, weights, self.period).controller
            worst, peaks = self.reached(law)
            used, commands = commands, commands + np.log10(peaks / self.peak)
        return Found(weights, law, worst, peaks, used)

    def weights(self, unknowns: NDArray[np.float64], commands: NDArray[np.float64]) -> Weights:
        """Weights in SI units."""
        taper, shear, noise = unknowns
        height = np.linspace(-1, 1, len(commands))
        powers = {"a": taper * height, "U": commands}
        relative = {
            f"{kind}{i + 1}": float(f"{10**power:.4g}") for kind, each in powers.items() for i, power in enumerate(each)
        }
        kinds = {
            "displacement": 0.0,
            "stroke": 0.0,
            "acceleration": ACCELERATION,
            "force": 0.0,
            "command": 1.0,
            "base_shear": 10**shear,
        }
        return Weights.model_validate(
            {
                "measured": self.benchmark.definition.measured,
                "weights": {kind: float(f"{weight:.4g}") for kind, weight in kinds.items()},
                "relative": relative,
                "noise_to_excitation": float(f"{10**noise:.4g}"),
                "masses": self.benchmark.layout.masses.tolist(),
            }
        )

    def criterion(self, found: Found) -> float:
        """The greatest ratio to the sample controller's, and the excess of force."""
        ratios = found.worst / self.sample
        return float(ratios.max() + 5 * max(0.0, found.peaks.max() / self.peak - TOLERANCE))


def main() -> None:
    """Search, print, write."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    benchmark = open_benchmark("sac_la_20")
    assert isinstance(benchmark, FrameBenchmark)
    trials, random, step = Trials(benchmark), np.random.default_rng(SEED), LARGEST_STEP / 2
    unknowns = np.array(START)
    best = trials.find(unknowns, np.zeros(len(benchmark.layout.counts)), FIRST_ADAPTATIONS)
    for _ in range(count):
        tried = unknowns + step * random.standard_normal(len(unknowns))
        step = max(LEAST_STEP, 0.97 * step)
        try:
            found = trials.find(tried, best.commands, ADAPTATIONS)
            if trials.criterion(found) >= trials.criterion(best):
                continue
            margin, disk = common_gain_margin(trials.plant, found.law), disk_margin(trials.plant, found.law)
        except AbraceError:  # no controller with these weights, or not a stable one
            continue
        if margin < GAIN_MARGIN or disk.alpha < DISK_MARGIN:
            continue
        unknowns, best, step = tried, found, min(LARGEST_STEP, 1.5 * step)
        ratios = (found.worst / trials.sample).round(4).tolist()
        print(f"{unknowns.round(3).tolist()}: J1 to J6 over {SAMPLE} {ratios}, {margin:.1f} dB, {disk}", flush=True)
    origin = "abrace's LQG for sac_la_20, fitted to the benchmark's runs by src/abrace/scripts/fit_benchmark_weights.py"
    save_weights(best.weights, OUTPUT, origin)


if __name__ == "__main__":
    main()
