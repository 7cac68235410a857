# SPDX-License-Identifier: Apache-2.0
"""Speed of many closed loops of the paper's rig: what `abrace fragility` does, from models to Parquet files.

linear      100 000 loops of 50 000 steps: 100 models drawn from the identified one, 20 controllers, 50 noises, no
            command at its limit
saturating  100 000 loops of 50 000 steps, a command at its limit in every one: 25 models, 20 controllers, 50 noises, 4
            intensities
short       1 000 000 linear loops of 5 000 steps: 1000 models, 20 controllers, 50 noises; the process gets SIGINT when
            half of the batches are written, and is started again

The loops with zero command, one for twenty others, and the starts and ends of the processes are part of the time, not
of the count. `memory_mb` is the greatest sum over all processes at one time, what they share counted once (PSS).
`few` is the time of `abrace.fragility` for 18 loops of 20 s.

python benchmarks/fragility_speed.py [linear] [saturating] [short] [few]    # all without a name
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from simulation import ONE_THREAD, SOURCE

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_studies.fragility.study import FragilityStudy

PERIOD, CONTROLLERS, NOISES = 0.002, 20, 50
WEAK, STRONG = (0.3,), (8.0, 9.0, 10.0, 11.0)
"""Peak accelerations [m/s^2] at which no loop saturates, and all do."""
SIZES = {"linear": (100, 50_000, WEAK), "saturating": (25, 50_000, STRONG), "short": (1000, 5_000, WEAK)}
"""Models, steps and intensities of each."""
TURNS = 5
LOOK = 0.25
"""Between two looks at the memory of all processes [s]."""


def study(models: int, steps: int, intensities: tuple[float, ...], noises: int = NOISES) -> FragilityStudy:
    """Models drawn about the rig's, controllers about LQG3, and noises."""
    from laboratory import Laboratory

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.model_ensemble import draw_models
    from abrace_core.model.noise import banded_noise
    from abrace_lqg.design import design
    from abrace_lqg.weights import load_weights
    from abrace_plant.rig.file import load_rig
    from abrace_studies.batches.loop_extremes import Motions
    from abrace_studies.exploration.weight_sets import weight_sets
    from abrace_studies.fragility.study import FragilityStudy
    from abrace_sysid.identification import identify

    rig = load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")
    laboratory = Laboratory(rig)
    found = identify(laboratory.multisine_test(True, False), laboratory.multisine_test(False, True))
    assert found.covariance is not None
    drawn = draw_models(found.model, found.covariance, max(1, models - 1), 0)
    spans = {"displacement": (-0.3, 0.3), "acceleration": (-0.3, 0.3)}
    sets = weight_sets(load_weights(SOURCE / "abrace_lqg/config/lqg3.yaml"), spans, CONTROLLERS - 1, 0)
    designed = [design(found.reduced, weights, PERIOD) for weights in sets]
    laws = [
        Controller(f"set {i}", each.controller, each.correction, each.prediction, rig.capacity, "", "", "")
        for i, each in enumerate(designed)
    ]
    grounds = [banded_noise(steps, 1 / PERIOD, (0.1, 10.0), 1.0, seed) for seed in range(noises)]
    return FragilityStudy(
        (found.model, *drawn)[:models],
        tuple(laws),
        (),
        Motions.of(ground / np.abs(ground).max() for ground in grounds),
        tuple(f"noise {seed}" for seed in range(noises)),
        intensities,
        PERIOD,
    )


def loops_of(folder: Path) -> dict[str, int]:
    """Closed loops among the rows of a folder, and those of them with a command at its limit."""
    from abrace_studies.batches.parts import read_parts

    table = read_parts(folder, ["controller", "saturated"]).to_pandas()
    closed = table[table["controller"] != "zero command"]
    return {"loops": len(closed), "saturated_loops": int((closed["saturated"] > 0).sum())}


def run(which: str, folder: Path) -> None:
    """Compute what a folder does not have yet; prints when the study is made."""
    from abrace_studies.batches.compute import compute_missing
    from abrace_studies.fragility.loops import compute_batch

    given = study(*SIZES[which])
    batches = given.batches()
    print(len(batches), flush=True)
    compute_missing(compute_batch, given, batches, folder)


def in_process(which: str, folder: Path, until: float = 1.0) -> dict[str, float]:
    """`run` as a process of its own, interrupted when this share of its files is there; seconds it took."""
    script = Path(__file__).resolve()
    command = [sys.executable, str(script), "run", which, str(folder)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    with subprocess.Popen(command, env=os.environ | ONE_THREAD, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        count = int(process.stdout.readline())
        made = time.perf_counter()
        memory = 0.0
        while process.poll() is None and (until == 1.0 or len(list(folder.glob("part-*"))) < until * count):
            memory = max(memory, _memory_mb(process.pid))
            time.sleep(LOOK)
        if until < 1.0:
            process.send_signal(signal.SIGINT)
            process.wait()
    assert until < 1.0 or process.returncode == 0, process.returncode
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "seconds": time.perf_counter() - made,
        "study_seconds": made - begin,
        "cpu_seconds": used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime,
        "memory_mb": memory,
    }


def _memory_mb(number: int) -> float:
    """Of the process with this `number` and all its descendants, what they share counted once."""
    import psutil

    total = 0
    with contextlib.suppress(psutil.NoSuchProcess):
        main = psutil.Process(number)
        for each in (main, *main.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                total += each.memory_full_info().pss
    return total / 1e6


def whole(which: str) -> dict[str, Any]:
    """One of the runs, `short` interrupted once; the study's own making (identification, designs) is not counted."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "loops"
        turns = [in_process(which, folder, until) for until in ((0.5, 1.0) if which == "short" else (1.0,))]
        size = sum(path.stat().st_size for path in folder.glob("part-*"))
        return {
            **{key: sum(turn[key] for turn in turns) for key in ("seconds", "study_seconds", "cpu_seconds")},
            "memory_mb": max(turn["memory_mb"] for turn in turns),
            "disk_mb": size / 1e6,
            **loops_of(folder),
        }


def few() -> dict[str, float]:
    """Seconds of `abrace.fragility` for 18 loops of 20 s, files and figures included, without its imports."""
    import abrace

    found = []
    with tempfile.TemporaryDirectory() as name:
        for turn in range(TURNS):
            begin = time.perf_counter()
            abrace.fragility(
                "ncree_three_storey",
                limits={"d1": 0.01},
                intensities=[0.5, 1.0, 2.0],
                noise=range(6),
                noise_duration=20.0,
                folder=Path(name) / str(turn),
            )
            found.append(time.perf_counter() - begin)
    return {"seconds_18_loops": min(found[1:])}


def fragility_speed() -> dict[str, Any]:
    """All of it in a process of its own, for bench.json."""
    script = Path(__file__).resolve()
    ran = subprocess.run(
        [sys.executable, str(script), *PARTS],
        env=os.environ | ONE_THREAD,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, Any] = {}
    for line in ran.stdout.splitlines():
        found |= json.loads(line)
    many = {which: found.pop(which) for which in SIZES}
    return {
        "seconds_100000": many["linear"]["seconds"],
        "seconds_100000_saturating": many["saturating"]["seconds"],
        "seconds_million_short": many["short"]["seconds"],
        "memory_mb": max(each["memory_mb"] for each in many.values()),
        "many": many,
        **found.pop("few"),
        **found,
    }


PARTS: dict[str, Callable[[], Any]] = {
    "linear": lambda: whole("linear"),
    "saturating": lambda: whole("saturating"),
    "short": lambda: whole("short"),
    "few": few,
}


def main() -> None:
    """One run in this process, or what the arguments name, a line of JSON each."""
    if sys.argv[1:2] == ["run"]:
        try:
            run(sys.argv[2], Path(sys.argv[3]))
        except KeyboardInterrupt:
            sys.exit(130)
        return
    for name in sys.argv[1:] or PARTS:
        print(json.dumps({name: PARTS[name]()}), flush=True)


if __name__ == "__main__":
    main()
