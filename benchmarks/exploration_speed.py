# SPDX-License-Identifier: Apache-2.0
"""Speed of an exploration: 1000 closed loops of 50 000 steps, saturation included, on this machine's cores.

250 sets of weights, four records of noise at 0.1 g; models identified from the laboratory's tests: 8 states to design
with, the consistent model of 13 for simulation and margins. The time includes designs, margins, peak and rms of every
channel, and sending models and records to the processes; starting and ending the processes is timed separately. A
process loads its modules for its first set: `first_set_seconds` is the time until that is done, part of `seconds_1000`.
Many more loops: `fragility_speed`.

python benchmarks/exploration_speed.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from fragility_speed import fragility_speed
from laboratory import Laboratory
from simulation import ONE_THREAD, SOURCE

SETS, RECORDS, SECONDS, PERIOD = 250, 4, 100.0, 0.002
PEAK = 0.980665
SPANS = {"displacement": (-2.0, 1.0), "acceleration": (-2.0, 1.0), "noise_to_excitation": (-1.0, 1.0)}


def exploration_speed() -> dict[str, Any]:
    """`measure` in a process of its own, whose BLAS has one thread from the start."""
    script = Path(__file__).resolve()
    ran = subprocess.run([sys.executable, str(script)], env=os.environ | ONE_THREAD, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found | fragility_speed()


def measure() -> dict[str, Any]:
    """Seconds; for bench.json."""
    from abrace_lqg.batches.cluster import cluster
    from abrace_lqg.exploration.ensemble import noise_motion
    from abrace_lqg.exploration.run import explore
    from abrace_lqg.exploration.study import Study, evaluate
    from abrace_lqg.exploration.weight_sets import weight_sets
    from abrace_lqg.weights import load_weights
    from abrace_plant.rig.file import load_rig
    from abrace_sysid.identification import identify

    rig = load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")
    laboratory = Laboratory(rig)
    models = identify(laboratory.multisine_test(True, False), laboratory.multisine_test(False, True))
    records = [noise_motion(seed, SECONDS, (0.1, 10.0), PERIOD) for seed in range(RECORDS)]
    study = Study.of(
        models.reduced, [models.model], records, intensities=[PEAK], capacity=rig.capacity, sample_period=PERIOD
    )
    sets = weight_sets(load_weights(SOURCE / "abrace_lqg/config/lqg3.yaml"), SPANS, SETS - 1, 0)

    evaluate(study, 0, sets[0])
    cpu = time.process_time()
    for number in range(10):
        evaluate(study, number, sets[number])
    a_set = (time.process_time() - cpu) / 10

    first: list[float] = []
    started = time.perf_counter()
    with cluster() as client, tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        processes = len(client.ncores())
        address = str(client.scheduler_info()["address"])
        outcomes = explore(
            study,
            sets,
            folder,
            scheduler=address,
            progress=lambda done: first.append(time.perf_counter() - begin) if done else None,
        )
        done = time.perf_counter()
    return {
        "seconds_1000": done - begin,
        "first_set_seconds": first[0],
        "cluster_start_seconds": begin - started,
        "cluster_end_seconds": time.perf_counter() - done,
        "processes": processes,
        "sets": len(outcomes),
        "refused": sum(bool(outcome.refused) for outcome in outcomes),
        "loops": sum(outcome.loops for outcome in outcomes),
        "steps": len(records[0].ground_acceleration),
        "saturated_samples": sum(outcome.saturated for outcome in outcomes),
        "one_set_cpu_ms": 1e3 * a_set,
        "load": float(np.round(os.getloadavg()[0], 2)),
    }


if __name__ == "__main__":
    print(json.dumps(measure(), indent=1))
