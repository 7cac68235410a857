# SPDX-License-Identifier: Apache-2.0
"""A benchmark for other programs: model, ground motions, reference controllers and values without control as files."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.benchmark.laws import references
from abrace_core.controller_file import save_controller
from abrace_core.files import write_atomically, write_text
from abrace_core.linear_model import export_mat, save_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace.benchmark.laws import AnyBenchmark


def write_ground(path: Path, ground: NDArray[np.float64], sample_period: float) -> None:
    """Write a ground motion, `ground` (samples,) [m/s^2] every `sample_period` [s], as CSV to a `path`."""
    time = np.arange(len(ground)) * sample_period
    with write_atomically(path) as temporary:
        np.savetxt(temporary, np.column_stack([time, ground]), "%.9g", ",", header="time [s],acc [m/s^2]", comments="")


def export_benchmark(benchmark: AnyBenchmark, folder: Path) -> list[Path]:
    """Write a benchmark's files into a `folder`; returns their paths.

    `model.json` and `model.mat`: the continuous model, `discrete.mat`: sampled, with which criteria are found;
    `ground_1.csv` ...: each case's motion, sample by sample; `benchmark.json`: what the criteria need; a controller
    file and a `.mat` file of each reference controller.

    Raises
    ------
    AbraceError
        If a record is missing, or the folder cannot be written to.
    """
    written = [folder / name for name in ("model.json", "model.mat", "discrete.mat", "benchmark.json")]
    save_model(benchmark.model, written[0])
    export_mat(benchmark.model, written[1])
    export_mat(benchmark.plant, written[2])
    cases = []
    known: Sequence[Any] = benchmark.definition.cases
    for i, case in enumerate(known, 1):
        ground = benchmark.ground(case)
        path = folder / f"ground_{i}.csv"
        write_ground(path, ground, benchmark.plant.sample_period)
        written.append(path)
        without = benchmark.uncontrolled(case)
        cases.append({"name": case.name, "ground": path.name, "uncontrolled": dict(without)})
    layout = benchmark.layout
    content = {
        "name": benchmark.definition.name,
        "sample_period": benchmark.plant.sample_period,
        "masses": layout.masses.tolist(),
        "heights": layout.heights.tolist(),
        "weight": layout.weight,
        "devices": {"storeys": layout.storeys, "counts": layout.counts, "cosines": layout.cosines},
        "cases": cases,
    }
    write_text(written[3], json.dumps(content, indent=1) + "\n")
    for name, controller in references(benchmark).items():
        file = folder / f"{name}.yaml"
        save_controller(replace(controller, name=name), file)
        export_mat(controller.law, file.with_suffix(".mat"))
        written += [file, file.with_suffix(".mat")]
    return written
