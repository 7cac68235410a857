# SPDX-License-Identifier: Apache-2.0
"""References between the steps of a campaign: the tests of an identification, the model of a design."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from abrace.campaign.drives import BandedNoise, Multisine
from abrace.campaign.names import CONTROLLER_FILE, is_path
from abrace.campaign.tasks import (
    Ambient,
    Compare,
    Design,
    Identify,
    OwnController,
    RigTest,
    Task,
    Validate,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

Kind = TypeVar("Kind", RigTest, Identify, Design)

A_MODEL = "an earlier identify step, or a path"


def wrong_references(task: Task, earlier: Mapping[str, Task | None]) -> list[str]:
    """Mistakes in the references of a `task` to `earlier` steps, given by name; None: a step with a mistake itself."""
    return list(_References(earlier).of(task))


class _References:
    """Collects the mistakes of one step."""

    def __init__(self, earlier: Mapping[str, Task | None]) -> None:
        self.earlier = earlier

    def find(
        self, key: str, name: str, kind: type[Kind], expected: str, fits: Callable[[Kind], bool] = lambda _: True
    ) -> Iterator[str]:
        """A mistake unless the step `name` is of this kind and fits; paths are checked later, in `offline`."""
        if is_path(name) or self.unknown(name):
            return
        referred = self.earlier.get(name)
        if not (isinstance(referred, kind) and fits(referred)):
            having = [other for other, task in self.earlier.items() if isinstance(task, kind) and fits(task)]
            yield f"{key}: {name!r}, expected {expected} ({', '.join(having) or 'there is none'})"

    def unknown(self, name: str) -> bool:
        """Whether the step `name` exists, but has a mistake itself."""
        return name in self.earlier and self.earlier[name] is None

    def test(self, name: str) -> RigTest | None:
        """The test `name`; None if it is not in this file."""
        task = self.earlier.get(name)
        return task if isinstance(task, RigTest) else None

    def of(self, task: Task) -> Iterator[str]:
        match task:
            case RigTest():
                yield from self.of_test(task)
            case Identify():
                yield from self.of_identify(task)
            case Design():
                yield from self.find("design.model", task.model, Identify, A_MODEL)
            case Ambient():
                expected = "an earlier test without excitation and controller"
                for key, names in (("test", task.test), ("before", task.before or ())):
                    for name in names:
                        yield from self.find(
                            f"ambient.{key}", name, RigTest, expected, lambda t: not (t.excitation or t.controller)
                        )
                yield from self.same_rig("ambient", (*task.test, *(task.before or ())))
            case Compare():
                yield from self.find("compare.test", task.test, RigTest, "an earlier test")
                yield from self.of_uncontrolled("compare", task.test, task.uncontrolled)
            case Validate():
                yield from self.of_validate(task)

    def of_test(self, test: RigTest) -> Iterator[str]:
        controller = test.controller
        if controller is None:
            return
        if test.excitation is not None:
            yield f"test.controller: {test.controller_name!r} and an excitation, expected one of the two"
        elif not isinstance(controller, OwnController) and not controller.endswith(CONTROLLER_FILE):
            expected = f"an earlier design step or a file that ends in {CONTROLLER_FILE}"
            yield from self.find("test.controller", controller, Design, expected)

    def of_identify(self, task: Identify) -> Iterator[str]:
        of_table = (_moves_table_alone, "an earlier test of the table alone")
        of_command = (_pushes_alone, "an earlier test with excitation alone")
        if task.table == task.command and any((t := self.test(name)) and _moves_both(t) for name in task.table):
            of_table = of_command = (_moves_both, "an earlier test of noise, or multisines, on table and command")
        for key, names, (fits, expected) in (("table", task.table, of_table), ("command", task.command, of_command)):
            for name in names:
                yield from self.find(f"identify.{key}", name, RigTest, expected, fits)
        yield from self.same_rig("identify", (*task.table, *task.command))

    def of_validate(self, task: Validate) -> Iterator[str]:
        yield from self.find("validate.test", task.test, RigTest, "an earlier test")
        yield from self.find("validate.model", task.model, Identify, A_MODEL)
        model, test = self.earlier.get(task.model), self.test(task.test)
        yield from self.same_rig("validate", (task.test, *(model.table if isinstance(model, Identify) else ())))
        if test is not None and task.controller not in (None, test.controller):
            own = isinstance(test.controller, OwnController)
            runs = f"{test.controller!r}, which test {task.test} runs" if test.controller and not own else "none"
            yield f"validate.controller: {task.controller!r}, expected {runs}"
        if task.uncontrolled is not None:
            yield from self.of_uncontrolled("validate", task.test, task.uncontrolled)

    def of_uncontrolled(self, key: str, name: str, uncontrolled: str) -> Iterator[str]:
        """Mistakes unless `uncontrolled` is test `name` without control: same motion, duration, rig and braces."""
        test = self.test(name)
        yield from self.find(
            f"{key}.uncontrolled",
            uncontrolled,
            RigTest,
            f"an earlier test without control and with the ground motion and duration of {name}",
            lambda other: (
                _moves_table_alone(other)
                and (
                    test is None
                    or (
                        (other.ground_motion, other.duration) == (test.ground_motion, test.duration)
                        and _rig(other) == _rig(test)
                    )
                )
            ),
        )

    def same_rig(self, key: str, names: Sequence[str]) -> Iterator[str]:
        """Mistakes unless the tests, which are used together, have the same rig and the same braces connected."""
        tests = {name: test for name in names if (test := self.test(name)) is not None}
        for first, test in tests.items():
            for name, other in tests.items():
                if other.disconnected_braces != test.disconnected_braces:
                    yield (
                        f"{key}: {name} has brace groups {list(other.disconnected_braces)} disconnected, expected "
                        f"{list(test.disconnected_braces)} as {first}"
                    )
                elif _rig(other) != _rig(test):
                    yield f"{key}: {name} has another rig than {first}, expected the same"
            return


def _rig(test: RigTest) -> tuple[object, ...]:
    return test.rig, test.device, test.emulator, test.disconnected_braces


def _moves_table_alone(test: RigTest) -> bool:
    return test.ground_motion is not None and test.excitation is None and test.controller is None


def _pushes_alone(test: RigTest) -> bool:
    return test.excitation is not None and test.ground_motion is None


def _moves_both(test: RigTest) -> bool:
    """Whether noise, or multisines, excite table and braces at once."""
    drives = (test.excitation, test.ground_motion)
    periodic = [isinstance(drive, Multisine) for drive in drives]
    return all(isinstance(drive, BandedNoise) for drive in drives) and periodic[0] == periodic[1]
