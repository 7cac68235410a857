# SPDX-License-Identifier: Apache-2.0
"""`abrace fragility` and `abrace explore`: many closed loops, by the verbs of these names and their options."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core.files.command_line import given_options

if TYPE_CHECKING:
    import argparse

    from abrace_core.files.command_line import OneLineParser
    from abrace_studies.options import ExploreOptions, FragilityOptions

FRAGILITY = """examples:
  abrace fragility results/demo/model --controllers results/demo/lqg3/lqg3.yaml --records el_centro --noise 1 2 3 4 \\
    --intensities 0.5 1 2 3 4 --limits d1=0.02 a3=4 --output results/fragility
  ... --models 50 --faults a1=0 a3=-1                            50 models, failing sensors
  ... --scheduler tcp://10.0.0.5:8786                            by a Dask scheduler's workers
If it is interrupted, the same command continues after the finished batches."""
EXPLORE = """examples:
  abrace explore results/demo/model --weights my_weights.yaml --noise 1 2 3 4
  abrace explore results/demo/model --models 10 --faults a1=0 --peak-acceleration 0.5 1 2    also uncertain
  abrace explore results/demo/model --pick 7                       the controller of set 7: set_7.yaml, with its proof
If it is interrupted, the same command continues after the finished batches."""


def add_study_parsers(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    """Add `explore` and `fragility` to the command's `commands`."""
    explore = commands.add_parser(
        "explore", help="try many sets of weights: responses, force and margins of each", epilog=EXPLORE
    )
    fragility = commands.add_parser(
        "fragility",
        help="how likely limits are exceeded: models, controllers, failing sensors, records, intensities",
        epilog=FRAGILITY,
    )
    for parser in (explore, fragility):
        parser.add_argument("model", help="model file, an identification's folder, or a rig's name")
        parser.set_defaults(act=study_command)
    explore.add_argument("--simulation-model", metavar="MODEL", help="simulates, and gives the margins (the same)")
    explore.add_argument("--rig", help="its sample rate and the capacity of its braces: a name or a file")
    explore.add_argument("--weights", default="lqg3", help="weights in the middle: a name or a file (lqg3)")
    explore.add_argument(
        "--pick", nargs="+", type=int, metavar="N", help="explore nothing: write these sets of --output as controllers"
    )
    fragility.add_argument(
        "--controllers", nargs="+", default=[], metavar="FILE", help="controller files; zero command is always tried"
    )
    for parser, output in ((explore, "results/exploration"), (fragility, "results/fragility")):
        parser.add_argument(
            "--records", nargs="+", default=[], metavar="NAME", help="ground motions: known names or files"
        )
        parser.add_argument("--output", type=Path, default=Path(output), help=f"folder ({output})")
    explore.late, fragility.late = _explore_options, _fragility_options


def _explore_options() -> type[ExploreOptions]:
    from abrace_studies.options import ExploreOptions

    return ExploreOptions


def _fragility_options() -> type[FragilityOptions]:
    from abrace_studies.options import FragilityOptions

    return FragilityOptions


def study_command(given: argparse.Namespace) -> None:
    """Carry out `abrace explore` or `abrace fragility` with the arguments `given`."""
    from abrace.interactive.studies import explore, fragility
    from abrace_core.files.progress import Progress
    from abrace_studies.exploration.files import write_set
    from abrace_studies.exploration.report import report

    if given.command == "explore" and given.pick:
        for number in given.pick:
            proof, files = write_set(given.output, number)
            print(f"set {number}: {proof.summary()}\nwrote {', '.join(map(str, files))}")
        return
    begin = time.monotonic()
    options: dict[str, Any] = {"records": given.records, "folder": given.output}
    with Progress(1, sys.stdout).step(given.command) as shown:

        def progress(done: int, count: int) -> None:
            shown.update(done / count, f"{done} of {count}")

        if given.command == "explore":
            found = explore(
                given.model,
                given.weights,
                simulation_model=given.simulation_model,
                rig=given.rig,
                progress=progress,
                **(options | given_options(given, _explore_options())),
            )
            text = "\n".join(report(found.outcomes, found.quantile))
        else:
            options |= given_options(given, _fragility_options())
            text = fragility(given.model, given.controllers, progress=progress, **options).text()
    print(f"{text}\nwrote {given.output} ({time.monotonic() - begin:.1f} s)")
