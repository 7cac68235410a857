# SPDX-License-Identifier: Apache-2.0
"""Checks, before the first test, of what identifications, designs and comparisons need of rigs, tests and files."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.campaign.demands import check_controller
from abrace.campaign.drives import BandedNoise, ExcitationMultisine, Multisine, MultisineMotion
from abrace.campaign.names import CONTROLLER_FILE, MODEL_FILE, is_path
from abrace.campaign.tasks import Ambient, Compare, Design, Identify, RigTest, Validate
from abrace_bags import Bag
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.files.options import NOT_GIVEN
from abrace_core.model.controller_file import load_controller
from abrace_core.model.linear_model import load_model
from abrace_core.model.signals import GROUND
from abrace_lqg.proof.limits import of_rig
from abrace_lqg.weights import load_weights
from abrace_sysid.examination import LEAST_SECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from abrace.campaign.tasks import Task
    from abrace_plant.rig.model import Rig

MODELS = ("model", "reduced", "superposed")
"""Files that an identify step writes."""


def wrong_offline(task: Task, tests: Mapping[str, RigTest], rig: Rig) -> Iterator[str]:
    """Mistakes because of which a `task`, an identification, a design or a comparison, cannot succeed.

    `tests`: the campaign's; `rig`: that of the tests that the task uses.
    """
    match task:
        case Identify():
            yield from _wrong_bags("identify.table", task.table)
            yield from _wrong_bags("identify.command", task.command)
            yield from _wrong_identify(task, tests, rig)
        case Design():
            wrong = list(_wrong_model("design.model", task.model, ("reduced",)))
            yield from wrong
            model = rig.measured_model
            try:
                if task.model.endswith(MODEL_FILE) and not wrong:
                    model = load_model(task.model)
                model = task.for_control(model)
                of_rig(task, rig.sample_rate, rig.capacity).of_model(model)
            except AbraceError as error:
                yield f"design.{error}"
            try:
                weights = load_weights(find_file(task.weights, "abrace_lqg", "config", ".yaml", "weights"))
                weights.of(model.outputs, model.inputs[1:])
            except AbraceError as error:
                yield f"design.weights: {error}"
        case Ambient():
            yield from _wrong_bags("ambient.test", task.test)
            yield from _wrong_bags("ambient.before", task.before or ())
            try:
                task.require_possible((*rig.recorded_names, GROUND), rig.sample_rate)
            except AbraceError as error:
                yield f"ambient: {error}"
        case Compare() | Validate():
            kind = type(task).__name__.lower()
            yield from _wrong_bags(f"{kind}.test", (task.test,))
            yield from _wrong_bags(f"{kind}.uncontrolled", (task.uncontrolled,) if task.uncontrolled else ())
            if isinstance(task, Validate):
                yield from _wrong_model("validate.model", task.model, MODELS)
                if task.controller and task.controller.endswith(CONTROLLER_FILE):
                    try:
                        check_controller(load_controller(task.controller), rig, task.controller)
                    except AbraceError as error:
                        yield f"validate.controller: {error}"


def _wrong_identify(task: Identify, tests: Mapping[str, RigTest], rig: Rig) -> Iterator[str]:
    try:
        task.require_possible(rig.floors, rig.groups)
    except AbraceError as error:
        yield f"identify: {error}"
    for key, names, band in (
        ("table", task.table, task.table_band),
        ("command", task.command, task.command_band),
    ):
        own = {name: tests[name] for name in names if name in tests}
        drives = [test.ground_motion if key == "table" else test.excitation for test in own.values()]
        if len({isinstance(drive, Multisine) for drive in drives if isinstance(drive, BandedNoise)}) > 1:
            yield f"identify.{key}: some of {', '.join(own)} are noise and some multisines, expected one kind"
        bands = [drive.band for drive in drives if isinstance(drive, BandedNoise)]
        if bands and max(low for low, _ in bands) >= min(high for _, high in bands):
            yield f"identify.{key}: the bands of {', '.join(own)} do not overlap"
        for name, test in own.items():
            if test.duration < LEAST_SECONDS:
                yield f"identify.{key}: {name} has {test.duration:g} s, expected {LEAST_SECONDS:g} s at least"
            drive = test.ground_motion if key == "table" else test.excitation
            if not isinstance(drive, BandedNoise):
                continue
            low, high = drive.band if band == NOT_GIVEN else band
            if not drive.band[0] <= low < high <= drive.band[1]:
                yield (
                    f"identify.{key}_band: {low:g} to {high:g} Hz, expected within the {drive.band[0]:g} to "
                    f"{drive.band[1]:g} Hz of {name}"
                )
        if len(own) == len(names) and not any(isinstance(drive, Multisine) for drive in drives):
            seconds = {name: test.duration for name, test in own.items()}
            lows, highs = zip((0.0, inf), *(bands if band == NOT_GIVEN else [band]), strict=True)
            lines = (min(highs) - max(lows)) * min(seconds.values()) + 1
            try:
                task.require_samples({name: round(one * rig.sample_rate) for name, one in seconds.items()}, lines)
            except AbraceError as error:
                yield f"identify.{key}: {error}"
    yield from _wrong_groups(task.command, tests, rig.groups)
    for name in task.table:
        if name in tests:
            yield from _wrong_lines(name, tests[name])


def _wrong_groups(names: tuple[str, ...], tests: Mapping[str, RigTest], groups: int) -> Iterator[str]:
    """Brace groups that no command test drives, or that are driven together with others in one test and not in another.

    Bags of earlier days among the tests may have what is missing in this campaign.
    """
    sets: dict[int, tuple[frozenset[int], str]] = {}
    for name in names:
        drive = tests[name].excitation if name in tests else None
        if drive is None or len(drive.rms) not in (1, groups):
            continue
        rms = drive.rms
        driven = frozenset(group for group in range(groups) if rms[group if len(rms) > 1 else 0])
        for group in sorted(driven):
            known, other = sets.setdefault(group, (driven, name))
            if known != driven:
                yield (
                    f"identify.command: brace group {group + 1} is driven with other groups in {name} than in {other}, "
                    "expected every group alone, or always with the same ones"
                )
                return
    missing = [str(group + 1) for group in range(groups) if group not in sets]
    if sets and missing and all(name in tests for name in names):
        yield f"identify.command: no test drives brace group {' and '.join(missing)}, expected one of every group"


def _wrong_lines(name: str, test: RigTest) -> Iterator[str]:
    """Multisines on table and braces at once that have no lines of their own."""
    table, braces = test.ground_motion, test.excitation
    if not (isinstance(table, MultisineMotion) and isinstance(braces, ExcitationMultisine)):
        return
    if table.period != braces.period:
        yield f"identify.table: {name} has multisines of {table.period:g} and {braces.period:g} s, expected one period"
    apart = table.band[1] < braces.band[0] or braces.band[1] < table.band[0]
    if not apart and ("all" in (table.lines, braces.lines) or table.lines == braces.lines):
        yield (
            f"identify.table: {name} has {table.lines} lines on the table and {braces.lines} lines on the braces, "
            "expected odd ones on one and even ones on the other"
        )


def _wrong_bags(key: str, names: tuple[str, ...]) -> Iterator[str]:
    """Mistakes of the paths of bags among `names`: bags that cannot be read, or are not of a test."""
    for name in filter(is_path, names):
        try:
            if not any(topic.endswith("/response") for topic in Bag(name).topics):
                yield f"{key}: bag {name} has no topic response, expected the bag of a test"
        except AbraceError as error:
            yield f"{key}: {error}"


def _wrong_model(key: str, model: str, names: tuple[str, ...]) -> Iterator[str]:
    """The files of a `model`, given by its path, that cannot be read."""
    if not is_path(model):
        return
    path = Path(model)
    for file in [path] if model.endswith(MODEL_FILE) else [path / f"{name}{MODEL_FILE}" for name in names]:
        try:
            load_model(file)
        except AbraceError as error:
            yield f"{key}: {error}"
