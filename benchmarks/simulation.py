# SPDX-License-Identifier: Apache-2.0
"""Speed of a closed loop simulated offline, against its peers in one run: 50 000 samples of the paper's rig under LQG3.

linear     `simulate` on the loop as one linear model
saturated  `simulate_closed_loop`, the commands cut at the rig's capacity

Peers, on the linear loop: scipy.signal.lfilter on each mode's second-order section, the fastest way that SciPy has, and
scipy.signal.dlsim, which steps in Python. All run on one thread, in turns of a tenth of a second or one run, and the
best run counts.

python benchmarks/simulation.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
SOURCE = Path(__file__).resolve().parents[1] / "src"
SAMPLES = 50_000
TURNS, TURN = 7, 0.1
LINEAR, SATURATED = 0.05 * 9.80665, 0.4 * 9.80665
"""Peak accelerations of the table [m/s^2] without a cut command, and with more than one in a hundred cut."""

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel


def simulation_speed() -> dict[str, Any]:
    """`measure` in a process of its own, whose BLAS has one thread from the start."""
    script = Path(__file__).resolve()
    ran = subprocess.run([sys.executable, str(script)], env=os.environ | ONE_THREAD, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found


def rig_and_law() -> tuple[LinearModel, LinearModel, NDArray[np.float64]]:
    """The rig's discrete model, LQG3 designed from eight states of it and the command's delay, and the capacities."""
    from abrace_lqg.design import design
    from abrace_lqg.weights import load_weights
    from abrace_plant.rig.file import load_rig
    from abrace_plant.rig.published import INTENSITY
    from abrace_sysid.models.reduction import balanced_truncation, typical_scales

    rig = load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")
    weights = load_weights(SOURCE / "abrace_lqg/config/lqg3.yaml")
    reduced = balanced_truncation(rig.model, 8, typical_scales(rig.model, (0.3, 30.0), INTENSITY)).model
    law = design(reduced, weights, 1 / rig.sample_rate).controller
    return rig.discrete_model(), law, rig.capacity


def el_centro(sample_period: float) -> NDArray[np.float64]:
    """(SAMPLES,) El Centro over and over, with a peak of 1."""
    import numpy as np

    from abrace_plant.records.files import read_record

    record = read_record("el_centro")
    times = np.arange(int((len(record.acceleration) - 1) * record.sample_period / sample_period)) * sample_period
    once = np.interp(times, np.arange(len(record.acceleration)) * record.sample_period, record.acceleration)
    return np.resize(once / np.abs(once).max(), SAMPLES)


def filtered(loop: LinearModel, ground: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outputs (samples, outputs) of a `loop` with distinct poles as the sum of its modes, each by SciPy's lfilter."""
    import numpy as np
    from scipy.signal import lfilter

    poles, vectors = np.linalg.eig(loop.a)
    residues = (loop.c @ vectors) * np.linalg.solve(vectors, loop.b.astype(np.complex128))[:, 0]
    states, combinations = [], []
    for pole, residue in zip(poles, residues.T, strict=True):
        if pole.imag > 0:
            state = lfilter([0.0, 1.0], [1.0, -2 * pole.real, abs(pole) ** 2], ground)
            states += [state, np.append(0.0, state[:-1])]
            combinations += [2 * residue.real, -2 * (residue * pole.conj()).real]
        elif pole.imag == 0:
            states.append(lfilter([0.0, 1.0], [1.0, -pole.real], ground))
            combinations.append(residue.real)
    return np.asarray(np.array(states).T @ np.array(combinations) + ground[:, None] * loop.d[:, 0])


def seconds_of(runs: dict[str, Callable[[], object]]) -> dict[str, float]:
    """The best time of each over several turns, the first not counted; a turn repeats a run for TURN seconds."""
    best = dict.fromkeys(runs, float("inf"))
    for turn in range(1 + TURNS):
        for name, run in runs.items():
            end = time.perf_counter() + TURN
            while (begin := time.perf_counter()) < end:
                run()
                if turn:
                    best[name] = min(best[name], time.perf_counter() - begin)
    return best


def measure() -> dict[str, Any]:
    """Seconds and ratios, and the largest deviation of a channel as a share of its peak; for bench.json."""
    import numpy as np
    from scipy import signal

    from abrace_core.model.simulation import simulate, simulate_closed_loop
    from abrace_lqg.loop import closed_loop

    model, law, capacity = rig_and_law()
    loop = closed_loop(model, law)
    motion = el_centro(model.sample_period)
    ground, strong = LINEAR * motion, SATURATED * motion
    scipy_loop = (loop.a, loop.b, loop.c, loop.d, loop.sample_period)
    assert loop.order >= 24, f"a loop of {loop.order} states, expected 24 or more"

    def deviation(found: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
        return float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())

    best = seconds_of(
        {
            "linear": lambda: simulate(loop, ground[:, None]),
            "saturated": lambda: simulate_closed_loop(model, law, strong, capacity),
            "lfilter": lambda: filtered(loop, ground),
            "dlsim": lambda: signal.dlsim(scipy_loop, ground),
        }
    )
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"{threads} threads, expected one (set {', '.join(ONE_THREAD)} to 1 before Python starts)"
    _, commands = simulate_closed_loop(model, law, strong, capacity)
    fraction = float(np.mean(np.abs(commands) >= capacity))
    assert fraction > 0.01, f"{fraction:.2%} of the commands are cut, expected more than 1 %"
    deviations = {
        "linear": deviation(simulate(loop, ground[:, None]), signal.dlsim(scipy_loop, ground)[1]),
        "lfilter": deviation(filtered(loop, ground), simulate(loop, ground[:, None])),
    }
    assert deviations["lfilter"] < 1e-9, f"lfilter deviates by {deviations['lfilter']:.1e}"
    found: dict[str, Any] = {"samples": SAMPLES, "states": loop.order, "largest_deviation": deviations["linear"]}
    for case in ("linear", "saturated"):
        ratios = {f"ratio_to_{peer}": best[peer] / best[case] for peer in ("lfilter", "dlsim")}
        found[case] = {"seconds": best[case], **ratios}
    found["saturated"]["saturated_fraction"] = fraction
    return found


if __name__ == "__main__":
    print(json.dumps(measure(), indent=1))
