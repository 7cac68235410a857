# SPDX-License-Identifier: Apache-2.0
"""`abrace fragility`: how likely limits are exceeded, over the intensity of the ground motion."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    import argparse

    from abrace_core.command_line import OneLineParser

EXAMPLES = """examples:
  abrace fragility results/demo/model --controller results/demo/lqg3/lqg3.yaml --record el_centro --noise 1 2 3 4 \\
    --intensity 0.5 1 2 3 4 --limit d1=0.02 a3=4 --output results/fragility
  ... --models 50 --fault a1=0 a3=-1 --rig ncree_three_storey    50 models, failing sensors, interlocks
  ... --scheduler tcp://10.0.0.5:8786                            on a Dask cluster that runs already
If it is interrupted, the same command continues after the finished batches."""


def add_fragility_parser(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    """Add `fragility` to the command's `commands`."""
    parser = commands.add_parser(
        "fragility",
        help="how likely limits are exceeded: models, controllers, failing sensors, records, intensities",
        epilog=EXAMPLES,
    )
    parser.add_argument("model", help="model file, an identification's folder, or a rig's name")
    parser.add_argument(
        "--controller", nargs="+", default=[], metavar="FILE", help="controller files; zero command is always tried"
    )
    parser.add_argument("--record", nargs="+", default=[], metavar="NAME", help="ground motions: known names or files")
    parser.add_argument("--noise", nargs="+", default=[], metavar="SEED", type=int, help="banded noise of these seeds")
    parser.add_argument(
        "--noise-duration", type=float, default=40.0, metavar="S", help="length of each noise motion, s (40)"
    )
    parser.add_argument(
        "--intensity", nargs="+", type=float, required=True, metavar="A", help="peak accelerations, m/s², rising"
    )
    parser.add_argument(
        "--limit",
        nargs="+",
        required=True,
        metavar="NAME=VALUE",
        help="limits of x1, d1 (drift), xf, a1, f, U, in m, m/s², N",
    )
    parser.add_argument(
        "--models",
        type=int,
        default=1,
        metavar="N",
        help="number of models: the given one, and N - 1 drawn from its covariance (1)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the drawn models (0)")
    parser.add_argument(
        "--fault", nargs="+", default=[], metavar="SENSOR=FACTOR", help="reading over true value; 0: dead, -1: reversed"
    )
    parser.add_argument("--rig", default="", help="rig whose interlocks act: a name or a file")
    parser.add_argument(
        "--scheduler", default="", metavar="ADDRESS", help="address of a Dask scheduler (this machine's cores)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes on this machine (one for each core)"
    )
    parser.add_argument("--output", type=Path, default=Path("results/fragility"), help="folder (results/fragility)")


def fragility_command(given: argparse.Namespace) -> None:
    """Carry out `abrace fragility` with the arguments `given`."""
    from abrace.interactive.fragility import fragility
    from abrace_core.progress import Progress
    from abrace_lqg.fragility.study import named_numbers

    if given.workers is not None and given.workers < 1:
        raise AbraceError(f"--workers: {given.workers}, expected 1 or more")
    limits = {}
    for name, values in named_numbers("--limit", given.limit).items():
        if len(values) > 1:
            raise AbraceError(f"--limit: {len(values)} of {name}, expected one of each quantity")
        limits[name] = values[0]
    begin = time.monotonic()
    with Progress(1, sys.stdout).step("fragility") as shown:
        found = fragility(
            given.model,
            given.controller,
            limits=limits,
            intensities=given.intensity,
            records=given.record,
            noise=given.noise,
            noise_duration=given.noise_duration,
            models=given.models,
            faults=named_numbers("--fault", given.fault),
            rig=given.rig or None,
            seed=given.seed,
            folder=given.output,
            scheduler=given.scheduler,
            workers=given.workers,
            progress=lambda done, count: shown.update(done / count, f"{done} of {count} batches"),
        )
    print(found.text())
    print(f"wrote {given.output} ({time.monotonic() - begin:.1f} s)")
