# SPDX-License-Identifier: Apache-2.0
"""A controller on a benchmark in the live graph: each case run in lockstep, and recorded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from abrace.benchmark.definition import record_path
from abrace.benchmark.export import write_ground
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.recorded import of_tests
from abrace.processes.group import find_executable
from abrace.report.recorded import recorded_tests
from abrace_bags import read_run
from abrace_core.controller_file import load_controller
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.installed import find_file
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace.benchmark.criteria import Responses
    from abrace.benchmark.laws import AnyBenchmark

FREE, CONTROLLED = "free_", "controlled_"


def is_node(given: str) -> bool:
    """Whether a controller that was `given` is a node: PACKAGE/EXECUTABLE, or a Python file."""
    return given.endswith(".py") or re.fullmatch(r"\w+/\w+", given) is not None


def run_live(
    benchmark: AnyBenchmark, controller: str, folder: Path, cases: Sequence[Any] | None = None
) -> dict[str, tuple[Mapping[str, float], Responses]]:
    """Criteria and responses of each case, from the bags of a campaign.

    Parameters
    ----------
    benchmark
        Of a rig, or of a frame that has one (`live`).
    controller
        PACKAGE/EXECUTABLE, a Python file, or a controller file.
    folder
        The campaign file is written there, and a frame's ground motions.
    cases
        Which; None: the benchmark's.

    Raises
    ------
    AbraceError
        If the benchmark has no rig, the node is unknown, or the rig was stopped.
    """
    from abrace.campaign.course import run_campaign  # imports ROS

    definition = benchmark.definition
    if isinstance(benchmark, FrameBenchmark) and benchmark.definition.live is None:
        raise AbraceError(
            f"--controller {controller}: a node, expected a benchmark of a rig, or of a frame with `live`"
        )
    _check_node(controller)
    name = f"benchmark_{definition.name}"
    known: Sequence[Any] = definition.cases if cases is None else cases
    if isinstance(benchmark, FrameBenchmark):
        motions, rig, more = _of_frame(benchmark, known, folder)
    else:
        motions = [
            {"record": _resolved(record_path(case.record)), "peak_acceleration": case.peak_acceleration}
            for case in known
        ]
        rig, more = benchmark.definition.rig, {}
    run: Any = _resolved(controller)
    if is_node(controller):
        run = {"run": run if controller.endswith(".py") else controller.split("/")}
    steps: list[dict[str, Any]] = []
    for i, motion in enumerate(motions, 1):
        test = {"duration": definition.duration, "ground_motion": motion}
        steps += [
            {"name": f"{FREE}{i}", "test": test},
            {"name": f"{CONTROLLED}{i}", "test": {**test, "controller": run, **more}},
        ]
    content = {"name": name, "rig": _resolved(rig), "lockstep": True, "steps": steps}
    path = folder / f"{name}.yaml"
    write_text(path, yaml.safe_dump(content, sort_keys=False))
    outcome = run_campaign(path)
    if outcome.doubts:
        raise AbraceError(f"{controller}: cannot be trusted: {outcome.doubts[0]}, expected undisturbed tests")
    bags = {test.step: test.bag for test in recorded_tests(outcome.results, [str(step["name"]) for step in steps])}
    law = None if is_node(controller) else load_controller(controller).law
    return {
        case.name: of_tests(benchmark, read_run(bags[f"{CONTROLLED}{i}"]), read_run(bags[f"{FREE}{i}"]), law)
        for i, case in enumerate(known, 1)
    }


def _check_node(controller: str) -> None:
    """Refuse a node that there is not, before anything is written; a controller file has been read."""
    if not is_node(controller):
        return
    try:
        if not controller.endswith(".py"):
            find_executable(*controller.split("/"))
        elif not Path(controller).is_file():
            raise AbraceError("no such file")
    except AbraceError as error:
        raise AbraceError(f"--controller {controller}: {error}") from error


def _of_frame(
    benchmark: FrameBenchmark, cases: Sequence[Any], folder: Path
) -> tuple[list[dict[str, Any]], str, dict[str, Any]]:
    """Ground motions, the rig, and the commands' rate limit, which is that of its devices."""
    live = benchmark.definition.live
    assert live is not None
    motions: list[dict[str, Any]] = []
    for i, case in enumerate(cases, 1):
        path = folder / f"ground_{i}.csv"
        write_ground(path, benchmark.ground(case), benchmark.definition.sample_period)
        motions.append({"record": str(path.resolve()), "low_cut": live.low_cut, "band_limit": 0.0})
    rig = load_rig(find_file(live.rig, "abrace_plant", "config", ".yaml", "rig"))
    return motions, live.rig, {"rate_limit": min(group.actuator.rate_limit for group in rig.braces)}


def _resolved(name: str) -> str:
    """A file's whole path, because the campaign file is in another folder; a name unchanged."""
    return str(Path(name).resolve()) if Path(name).suffix else name
