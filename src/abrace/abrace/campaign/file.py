# SPDX-License-Identifier: Apache-2.0
"""The campaign file: YAML that lists tests, identifications, designs and comparisons, one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

import pydantic

from abrace.campaign.names import FOLDER, CampaignName, Flag, Name, NameOrFile, is_step_name
from abrace.campaign.references import wrong_references
from abrace.campaign.tasks import (
    Ambient,
    Compare,
    Design,
    Identify,
    OwnNode,
    OwnRig,
    RigChoice,
    RigTest,
    Task,
    Validate,
)
from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_mapping
from abrace_core.files.config_mistakes import mistakes

TAGGED = ("ground_motion", "excitation", "controller", "rig")
"""Keys to which pydantic appends the kind of their value, which is no key of the file."""


class _Step(Checked):
    name: Name
    test: RigTest | None = None
    identify: Identify | None = None
    design: Design | None = None
    compare: Compare | None = None
    validation: Annotated[Validate | None, pydantic.Field(alias="validate")] = None
    ambient: Ambient | None = None

    def tasks(self) -> list[Task]:
        given = (self.test, self.identify, self.design, self.compare, self.validation, self.ambient)
        return [task for task in given if task is not None]


class _Campaign(Checked):
    name: CampaignName
    rig: RigChoice
    device: NameOrFile | None = None
    emulator: Flag = False
    lockstep: Flag = False
    thread_priority: Annotated[int, pydantic.Field(ge=0, le=98, strict=True)] = 0
    steps: Annotated[list[Any], pydantic.Field(min_length=1)]


@dataclass(frozen=True)
class Step:
    """One step of a campaign: its task, and its name, which its files have as well."""

    name: str
    task: Task


@dataclass(frozen=True)
class RigSetup:
    """The rig of a test, its file or name, and how it is reached.

    By a node of the user's, by a device, or by a device's emulator.
    """

    file: str
    node: OwnNode | None = None
    device: str | None = None
    emulator: bool = False

    @property
    def simulated(self) -> bool:
        """Whether the rig is simulated from the rig file."""
        return self.node is None and (self.device is None or self.emulator)


@dataclass(frozen=True)
class Campaign:
    """A campaign.

    The rig of the tests that name no other, whether tests run in lockstep unless they say otherwise, and the steps in
    their order.
    """

    name: str
    setup: RigSetup
    lockstep: bool
    steps: tuple[Step, ...]
    thread_priority: int = 0
    path: Path = Path("campaign.yaml")

    @property
    def tasks(self) -> dict[str, Task]:
        """The tasks by the steps' names, in order."""
        return {step.name: step.task for step in self.steps}

    @property
    def tests(self) -> dict[str, RigTest]:
        """The tests by name, in order."""
        return {step.name: step.task for step in self.steps if isinstance(step.task, RigTest)}

    def setup_of(self, test: RigTest) -> RigSetup:
        """The rig of a `test`: the test's own keys, and the campaign's for all others."""
        return _setup(test, self.setup)

    def in_lockstep(self, test: RigTest) -> bool:
        """Whether a `test` runs in lockstep."""
        return self.lockstep if test.lockstep is None else test.lockstep


def load_campaign(path: Path | str) -> Campaign:
    """Read and check a campaign file.

    Raises
    ------
    AbraceError
        With a line for each mistake: the file, the step, the key, the value and what was expected.
    """
    campaign, found = read_campaign(path)
    if campaign is None or found:
        refuse(found)
    return campaign


def read_campaign(path: Path | str) -> tuple[Campaign | None, list[str]]:
    """A campaign file as far as it can be read, and a line for each mistake; None: its first keys are wrong.

    Raises
    ------
    AbraceError
        If it is no YAML file.
    """
    content = read_mapping(path, "campaign")
    context = {FOLDER: str(Path(path).parent)}
    found: list[str] = []
    top, campaign = None, None
    try:
        top = _Campaign.model_validate(content, context=context)
    except pydantic.ValidationError as error:
        found += mistakes(error, _Campaign, TAGGED)
    steps = content.get("steps")
    tasks = _read_steps(steps if isinstance(steps, list) else [], context, found)
    if top is not None:
        read = tuple(Step(name, task) for name, task in tasks.items() if task is not None)
        setup = _setup(top, RigSetup(""))
        campaign = Campaign(top.name, setup, top.lockstep, read, top.thread_priority, Path(path))
        found += _wrong_setups(campaign)
    return campaign, [f"campaign file {path}: {mistake}" for mistake in found]


def _read_steps(listed: list[Any], context: dict[str, str], found: list[str]) -> dict[str, Task | None]:
    """The tasks by name, None for a step with a mistake; mistakes are added to `found`."""
    tasks: dict[str, Task | None] = {}
    for number, content in enumerate(listed, 1):
        name = content.get("name") if isinstance(content, dict) else None
        where = f"step {name if isinstance(name, str) and is_step_name(name) else number}"
        try:
            step = _Step.model_validate(content, context=context)
        except pydantic.ValidationError as error:
            found += [f"{where}: {mistake}" for mistake in mistakes(error, _Step, TAGGED)]
            tasks.setdefault(str(name), None)
            continue
        given = step.tasks()
        if step.name in tasks:
            found.append(f"{where}: name: {step.name!r}, expected a name that no earlier step has")
        elif len(given) == 1:
            found += [f"{where}: {mistake}" for mistake in wrong_references(given[0], tasks)]
            tasks[step.name] = given[0]
        else:
            kinds = ", ".join(field.alias or key for key, field in _Step.model_fields.items() if key != "name")
            found.append(f"{where}: {len(given)} tasks, expected exactly one of {kinds}")
            tasks[step.name] = None
    return tasks


def refuse(problems: list[str]) -> NoReturn:
    """Refuse a campaign for all its `problems` at once.

    Raises
    ------
    AbraceError
        With a line for each.
    """
    header = [f"{len(problems)} mistakes, nothing was started"] if len(problems) > 1 else []
    raise AbraceError("\n".join([*header, *problems]))


def _setup(given: RigTest | _Campaign, base: RigSetup) -> RigSetup:
    """The rig of a test or campaign; keys that it does not have are those of `base`."""
    file, node = base.file, base.node
    if isinstance(given.rig, OwnRig):
        file, node = given.rig.file, given.rig
    elif given.rig is not None:
        file, node = given.rig, None
    device, emulator = base.device, base.emulator
    if "device" in given.model_fields_set:
        device, emulator = given.device, False
    return RigSetup(file, node, device, emulator if given.emulator is None else given.emulator)


def _wrong_setups(campaign: Campaign) -> list[str]:
    """Wrong combinations of rig, device, emulator and lockstep, and keys that only a simulated rig takes."""
    found: list[str] = []
    for name, test in campaign.tests.items():
        setup = campaign.setup_of(test)
        own = test.model_fields_set & {"rig", "device", "emulator", "lockstep"}
        where = f"step {name}: test." if own else ""
        found += [f"{where}{wrong}" for wrong in _wrong_setup(setup, campaign.in_lockstep(test))]
        if setup.device is None and setup.node is None:
            continue
        who = "a device: disconnect them by hand" if setup.device else "a rig of your own: use its parameters"
        if test.disconnected_braces:
            found.append(f"step {name}: test.disconnected_braces, expected none with {who}")
        for key in ("sensor_faults", "sensor_seed"):
            if key in test.model_fields_set:
                found.append(f"step {name}: test.{key}, expected only with the simulated rig")
    return list(dict.fromkeys(found))


def _wrong_setup(setup: RigSetup, lockstep: bool) -> list[str]:
    found = []
    if setup.emulator and setup.device is None:
        found.append("emulator: true, expected a device that is emulated")
    if setup.device is not None and setup.node is not None:
        found.append(f"device: {setup.device}, expected none with a rig of your own (rig.run)")
    if lockstep and setup.device is not None:
        found.append("lockstep: true, expected false with a device: hardware has its own sample clock")
    return found
