# SPDX-License-Identifier: Apache-2.0
"""What is checked: the command of each stage, its longest time, and which stages run at the same time."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Stage:
    """A command that passes or fails as a whole."""

    name: str
    command: tuple[str, ...]
    limit: float
    """Longest time of one run [s]."""
    runs: int = 2
    """How often it is run until it passes."""
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PytestStage(Stage):
    """Tests: `command` is pytest."""

    whole: tuple[str, ...] = ()
    """pytest's arguments that select and distribute all tests of the stage."""
    single: tuple[str, ...] = ()
    """pytest's arguments before a file that is run again by itself."""


def _make(target: str, limit: float, name: str = "", runs: int = 2) -> Stage:
    return Stage(name or target, ("make", "--no-print-directory", target), limit, runs)


def _at_once(number: int) -> tuple[str, ...]:
    # conftest.py puts the longest modules first
    return ("--numprocesses", str(number), "--dist", "loadfile", "--no-loadscope-reorder")


_PYTEST = 'source ros2_ws/setup.bash && unset PYTHONDONTWRITEBYTECODE && exec python -m pytest "$@"'
_IN_WORKSPACE = ("bash", "-c", _PYTEST, "pytest")
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_OLD_PROCESSOR = {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"}
# some tests wait: one more at a time than there are processors
_FILLED = _at_once((os.cpu_count() or 1) + 1)

_COMPUTING = {
    "abrace_core": "linear_model model_ensemble multisine simulation",
    "abrace_plant": "building characteristics",
    "abrace_sysid": "ambient identification maximum_likelihood paper realization reduction several_groups uncertainty "
    "validity vector_fitting",
    "abrace_lqg": "control_systems design disk_margin export margins own_algebra scaling",
    "abrace_studies": "frame loop_extremes",
}
"""By package the tests of what a processor, or the BLAS for it, may compute otherwise: fits, eigenvalues."""
_VERSIONS = {
    "project": "packages",
    "abrace_core": "chart compiled controller_file drawing linear_model quantity reading wire",
    "abrace_bags": "reader writer",
    "abrace_sysid": "figures",
    "abrace": "report campaign_file",
}
"""The tests of what another Python, NumPy, Matplotlib or pydantic may read, write or draw otherwise."""


def _files(names: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(f"tests/{package}/test_{name}.py" for package, several in names.items() for name in several.split())


def _tests(
    name: str,
    limit: float,
    whole: tuple[str, ...],
    single: tuple[str, ...] = (),
    command: tuple[str, ...] = _IN_WORKSPACE,
    environment: Mapping[str, str] | None = None,
) -> PytestStage:
    return PytestStage(name, command, limit, 2, {**_ONE_THREAD, **(environment or {})}, whole, single)


STAGES: dict[str, Stage] = {
    stage.name: stage
    for stage in (
        _make("demo", 1500),
        _make("test-pip", 900, "pip"),
        _make(".sourced/.made", 1200, "ubuntu"),
        _make("lint", 900, runs=1),
        _tests("libraries", 1500, (*_FILLED, "--ignore", "tests/graph")),
        _tests("graph", 1500, (*_at_once(3), "-m", "not alone", "tests/graph"), ("-m", "not alone")),
        _tests("alone", 900, ("-m", "alone", "tests/graph"), ("-m", "alone")),
        _make("docs", 600),
        _tests("old_processor", 900, (*_FILLED, *_files(_COMPUTING)), environment=_OLD_PROCESSOR),
        Stage("sourced", (".ci/sourced",), 1800),
        _tests("versions", 900, (*_FILLED, *_files(_VERSIONS)), command=(".ci/sourced", *_IN_WORKSPACE)),
    )
}
"""All stages by their names."""

STEPS: tuple[tuple[tuple[str, ...], ...], ...] = (
    # the demo keeps one processor busy: what is mostly downloaded at the same time
    (("demo",), ("pip", "ubuntu")),
    (("lint",),),
    (("libraries",),),
    (("graph",),),
    (("alone",),),
    # nothing here is judged by the clock, and set-up and demo keep one processor busy
    (("sourced", "versions"), ("docs", "old_processor")),
)
"""In this order; the rows of names in a step run at the same time."""
