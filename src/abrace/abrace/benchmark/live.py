# SPDX-License-Identifier: Apache-2.0
"""A control law of the user's, a node, on a benchmark: each case run in the live graph, in lockstep, and recorded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from abrace.benchmark.definition import record_path
from abrace.benchmark.recorded import of_tests
from abrace.report.recorded import recorded_tests
from abrace_bags import read_run
from abrace_core.errors import AbraceError
from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from abrace.benchmark.criteria import Responses
    from abrace.benchmark.rig_benchmark import RigBenchmark

FREE, CONTROLLED = "free_", "controlled_"


def is_node(given: str) -> bool:
    """Whether a controller that was `given` is a node: PACKAGE/EXECUTABLE, or a Python file."""
    return given.endswith(".py") or re.fullmatch(r"\w+/\w+", given) is not None


def run_live(benchmark: RigBenchmark, node: str, folder: Path) -> dict[str, tuple[Mapping[str, float], Responses]]:
    """Criteria and responses of each case, from the bags of a campaign.

    Parameters
    ----------
    benchmark
        Of a rig.
    node
        PACKAGE/EXECUTABLE, or a Python file.
    folder
        The campaign file is written there.

    Raises
    ------
    AbraceError
        If the node is unknown, or the rig was stopped.
    """
    from abrace.campaign.course import run_campaign  # imports ROS

    definition = benchmark.definition
    name = f"benchmark_{definition.name}"
    run: Any = _resolved(node) if node.endswith(".py") else node.split("/")
    steps: list[dict[str, Any]] = []
    for i, case in enumerate(definition.cases, 1):
        motion = {"record": _resolved(record_path(case.record)), "peak_acceleration": case.peak_acceleration}
        test = {"duration": definition.duration, "ground_motion": motion}
        steps += [
            {"name": f"{FREE}{i}", "test": test},
            {"name": f"{CONTROLLED}{i}", "test": {**test, "controller": {"run": run}}},
        ]
    content = {"name": name, "rig": _resolved(definition.rig), "lockstep": True, "steps": steps}
    path = folder / f"{name}.yaml"
    write_text(path, yaml.safe_dump(content, sort_keys=False))
    outcome = run_campaign(path)
    if outcome.doubts:
        raise AbraceError(f"{node}: not to be trusted: {outcome.doubts[0]}, expected undisturbed tests")
    bags = {test.step: test.bag for test in recorded_tests(outcome.results, [str(step["name"]) for step in steps])}
    return {
        case.name: of_tests(benchmark, read_run(bags[f"{CONTROLLED}{i}"]), read_run(bags[f"{FREE}{i}"]))
        for i, case in enumerate(definition.cases, 1)
    }


def _resolved(name: str) -> str:
    """A file's whole path, as the campaign file stands in another folder; a name as it is."""
    return str(Path(name).resolve()) if Path(name).suffix else name
