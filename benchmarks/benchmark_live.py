# SPDX-License-Identifier: Apache-2.0
"""The 20-storey benchmark building in the live graph, under our LQG, beside the offline runs: `make verify`.

The rig is the frame condensed to its levels, its sensors have the benchmark's noise and converters. Bags have what
sensors measured: the offline responses, of the whole frame, get the accelerometers' noise before criteria are taken.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from isolation import isolated

from abrace.benchmark.criteria import OF_RESPONSE, criteria, peaks
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.live import run_live
from abrace.report.table import Table
from abrace_core.controller_file import save_controller

if TYPE_CHECKING:
    from abrace.benchmark.criteria import Responses
    from abrace_core.controller_file import Controller

CASE = 1
"""Of the benchmark's: El Centro as recorded."""
SEEDS = range(1, 9)
"""Of the noise of offline runs, whose mean counts."""
TOLERANCE, TOLERANCE_J3 = 0.05, 0.12
"""J3 is a peak of the sum of twenty accelerometers, whose noise alone scatters it by some 5 %."""


def verify_live(benchmark: FrameBenchmark, law: Controller) -> tuple[dict[str, Any], list[Claim], Table]:
    """Values, claims and the table of a `law` in the live graph beside its runs offline."""
    measured, offline = measured_live(benchmark, law), as_measured(benchmark, law)
    exact, _ = benchmark.evaluate(law, benchmark.definition.cases[CASE : CASE + 1])[_name(benchmark)]
    errors = {name: abs(measured[name] / offline[name] - 1) for name in OF_RESPONSE}
    j3 = errors.pop("J3")
    worst = max(errors.values())
    values: dict[str, Any] = {name: measured[name] for name in OF_RESPONSE}
    values |= {"offline": offline, "worst": worst, "error_J3": j3}
    title = "20-storey building, live graph"
    claims = [
        Claim(f"{title}: worst of J1, J2, J4, J5, J6", worst, TOLERANCE, "offline"),
        Claim(f"{title}: J3", j3, TOLERANCE_J3, "offline"),
    ]
    rows = tuple((name, *(f"{one[name]:.4g}" for one in (measured, offline, exact))) for name in OF_RESPONSE)
    return values, claims, Table(title, (_name(benchmark), "bags", "offline, measured", "offline, exact"), rows)


def measured_live(benchmark: FrameBenchmark, law: Controller) -> dict[str, float]:
    """Criteria from the bags of a campaign in lockstep: the case without control and with a `law`."""
    with isolated():
        save_controller(law, Path("law.yaml"))
        case = benchmark.definition.cases[CASE]
        ((values, _),) = run_live(benchmark, "law.yaml", Path(), [case]).values()
    return dict(values)


def as_measured(benchmark: FrameBenchmark, law: Controller) -> dict[str, float]:
    """Criteria of a `law` offline, as the accelerometers see responses: the mean over noise of several seeds."""
    case = benchmark.definition.cases[CASE]
    found = []
    for seed in SEEDS:
        noisy = FrameBenchmark(benchmark.definition, seed)
        _, responses = noisy.evaluate(law, [case])[case.name]
        random = np.random.default_rng((seed, 1))
        free = _with_noise(noisy, benchmark.without_control(case), random)
        found.append(criteria(_with_noise(noisy, responses, random), benchmark.layout, peaks(free, benchmark.layout)))
    return {name: float(np.mean([values[name] for values in found])) for name in OF_RESPONSE}


def _with_noise(benchmark: FrameBenchmark, responses: Responses, random: np.random.Generator) -> Responses:
    noise = benchmark.definition.sensors.noise * random.standard_normal(responses.acceleration.shape)
    return replace(responses, acceleration=responses.acceleration + noise)


def _name(benchmark: FrameBenchmark) -> str:
    return benchmark.definition.cases[CASE].name
