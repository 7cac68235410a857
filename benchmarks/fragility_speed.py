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
`kernel` is the processor time of one loop in this process, without Dask and files; `cost` the same over steps, states
and loops, and the time of several processes. Its `exponents` are those of power laws fitted to it, 1 is linear;
`last_exponents` are those between the two greatest numbers. `dask_share` is what Dask and files cost: processor seconds
of all processes over those of the plain kernel in them, less one.

python benchmarks/fragility_speed.py [linear] [saturating] [short] [kernel] [cost] [dask]    # all without a name
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
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from simulation import ONE_THREAD, SOURCE

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_lqg.fragility.study import FragilityStudy

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

    from abrace_core.controller_file import Controller
    from abrace_core.loop_extremes import Motions
    from abrace_core.model_ensemble import draw_models
    from abrace_core.noise import banded_noise
    from abrace_lqg.design import design
    from abrace_lqg.exploration.weight_sets import weight_sets
    from abrace_lqg.fragility.study import FragilityStudy
    from abrace_lqg.weights import load_weights
    from abrace_plant.rig.file import load_rig
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
        (),
        PERIOD,
    )


def loops_of(folder: Path) -> dict[str, int]:
    """Closed loops among the rows of a folder, and those of them with a command at its limit."""
    from abrace_lqg.batches.parts import read_parts

    table = read_parts(folder, ["controller", "saturated"]).to_pandas()
    closed = table[table["controller"] != "zero command"]
    return {"loops": len(closed), "saturated_loops": int((closed["saturated"] > 0).sum())}


def run(which: str, folder: Path) -> None:
    """Compute what a folder does not have yet; prints when the study is made."""
    from abrace_lqg.batches.missing import compute_missing
    from abrace_lqg.fragility.loops import compute_batch

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


def cpu_of_loops(given: FragilityStudy, loops: int) -> float:
    """Processor milliseconds of a loop, the least of several turns of the plain kernel."""
    from abrace_lqg.fragility.loops import compute_batch
    from abrace_lqg.fragility.study import Case

    motions = max(1, loops // len(given.intensities))
    batch = (Case(0, 0, None, 0, motions),)
    compute_batch(given, batch)
    found = []
    for _ in range(TURNS):
        begin = time.process_time()
        compute_batch(given, batch)
        found.append(time.process_time() - begin)
    return 1e3 * min(found) / (motions * len(given.intensities))


def kernel() -> dict[str, float]:
    """Processor milliseconds of a loop of each kind."""
    return {
        "linear_ms": cpu_of_loops(study(1, 50_000, WEAK), 50),
        "saturating_ms": cpu_of_loops(study(1, 50_000, STRONG), 40),
        "short_ms": cpu_of_loops(study(1, 5_000, WEAK), 50),
    }


def cost() -> dict[str, list[tuple[float, float]]]:
    """Processor milliseconds over steps, over states, and of so many loops."""
    given = study(1, 50_000, WEAK)
    steps: list[tuple[float, float]] = []
    for count in (2500, 5000, 10_000, 20_000, 50_000):
        shorter = replace(given.motions, samples=np.full(NOISES, count))
        steps.append((count, cpu_of_loops(replace(given, motions=shorter), 10)))
    loops = [(float(count), count * cpu_of_loops(given, count)) for count in (1, 2, 5, 10, 20, 50)]
    states: list[tuple[float, float]] = []
    for extra in (0, 10, 20, 40, 80):
        states.append((extra + given.models[0].order, cpu_of_loops(replace(given, models=(_larger(given, extra),)), 5)))
    return {"steps": steps, "loops": loops, "states": states}


def _larger(given: FragilityStudy, extra: int) -> Any:
    """The study's model with further states that nothing excites."""
    model = given.models[0]
    a = np.zeros((model.order + extra, model.order + extra))
    a[: model.order, : model.order] = model.a
    a[range(model.order, len(a)), range(model.order, len(a))] = -np.linspace(1.0, 50.0, extra)
    b = np.vstack([model.b, np.zeros((extra, model.b.shape[1]))])
    return replace(model, a=a, b=b, c=np.hstack([model.c, np.zeros((len(model.c), extra))]))


def exponents(costs: dict[str, list[tuple[float, float]]]) -> dict[str, float]:
    """Of power laws fitted to `costs`: 1 is in proportion; -1, of the time over workers, in inverse proportion."""
    found = {name: np.log(np.array(points)).T for name, points in costs.items()}
    return {name: float(np.polyfit(x, y, 1)[0]) for name, (x, y) in found.items()}


def drawn_cost(path: Path) -> dict[str, Any]:
    """Cost over loops, steps, states and workers, drawn, with its exponents."""
    from matplotlib.figure import Figure

    from abrace_core.drawing import MEASURED, REFERENCE, save_figure

    found = cost() | {"workers": workers()}
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    fitted = exponents({name: points for name, points in found.items() if len(points) > 1})
    for axis, (name, points) in zip(figure.subplots(1, 4), found.items(), strict=True):
        x, y = np.array(points).T
        axis.loglog(x, y, "o-", color=MEASURED)
        axis.loglog(x, y[0] * (x / x[0]) ** (-1 if name == "workers" else 1), "--", color=REFERENCE)
        axis.set(
            xlabel=name,
            ylabel="s" if name == "workers" else "processor ms",
            title=f"exponent {fitted.get(name, 0):.2f}",
        )
        axis.grid(alpha=0.3)
    save_figure(figure, path)
    last = exponents({name: points[-2:] for name, points in found.items() if len(points) > 1})
    return {**found, "exponents": fitted, "last_exponents": last}


def dask_share() -> dict[str, float]:
    """What Dask and files cost for batches of a second: processor time outside `compute_batch` over that inside."""
    from abrace_lqg.batches.cluster import cluster, compute
    from abrace_lqg.batches.parts import Parts

    given = study(8, 50_000, WEAK)
    batches = given.batches()
    inside: list[float] = []
    worker: list[float] = []
    client_and_scheduler: list[float] = []
    with tempfile.TemporaryDirectory() as name, cluster(workers=1) as client:
        parts = Parts(name, "inputs", len(batches))

        def note(numbered: tuple[int, Any], result: tuple[Any, float, float]) -> None:
            parts.write(numbered[0], result[0])
            inside.append(result[1])
            worker.append(result[2])
            client_and_scheduler.append(time.process_time())

        compute(client, _timed_batch, given, list(enumerate(batches)), note)
    # from the first batch on: without the start of the process, its imports, and the sending of the study
    spent = sum(each[-1] - each[0] for each in (worker, client_and_scheduler))
    worked = sum(inside[1:])
    return {"batches": len(batches), "cpu_seconds_a_batch": worked / len(inside[1:]), "dask_share": spent / worked - 1}


def _timed_batch(given: FragilityStudy, numbered: tuple[int, Any]) -> tuple[Any, float, float]:
    """The table of a batch, the processor seconds of this thread for it, and those of this process at its end."""
    from abrace_lqg.fragility.loops import compute_batch

    begin = time.thread_time()
    table = compute_batch(given, numbered[1])
    return table, time.thread_time() - begin, time.process_time()


def workers() -> list[tuple[float, float]]:
    """Seconds of a thousand linear loops by the number of processes of this machine."""
    from abrace_lqg.batches.cluster import cluster, compute
    from abrace_lqg.fragility.loops import compute_batch

    given = study(1, 50_000, WEAK)
    found = []
    for count in range(1, 1 + (os.cpu_count() or 1)):
        with cluster(workers=count) as client:
            halves = [tuple(case for case in given.cases() if case.controller is not None)[i::4] for i in range(4)]
            compute(client, compute_batch, given, halves, lambda _batch, _table: None)  # imports, and the study
            begin = time.perf_counter()
            compute(client, compute_batch, given, halves, lambda _batch, _table: None)
            found.append((float(count), time.perf_counter() - begin))
    return found


def fragility_speed() -> dict[str, Any]:
    """All of it in a process of its own, for bench.json; draws results/exploration_cost.png."""
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
        **found.pop("dask"),
        **found,
    }


PARTS: dict[str, Callable[[], Any]] = {
    "linear": lambda: whole("linear"),
    "saturating": lambda: whole("saturating"),
    "short": lambda: whole("short"),
    "kernel": kernel,
    "cost": lambda: drawn_cost(Path("results/exploration_cost.png")),
    "dask": dask_share,
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
