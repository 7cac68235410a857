# SPDX-License-Identifier: Apache-2.0
"""The tasks of a campaign's steps: tests of the rig, and the offline steps that use their bags."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import pydantic

from abrace.campaign.drives import Excitation, GroundMotion
from abrace.campaign.names import (
    LAW_FILE,
    Flag,
    Name,
    NameOrFile,
    Positive,
    Tests,
    Text,
    Whole,
    from_folder,
)
from abrace.processes.parameter_file import written
from abrace_core import AbraceError
from abrace_core.files.config_file import Checked
from abrace_lqg.proof.limits import DesignOptions
from abrace_sysid.ambient.modes import AmbientOptions
from abrace_sysid.fitting.options import IdentificationOptions

if TYPE_CHECKING:
    from abrace_core.files.options import Options


def _program(run: object, info: pydantic.ValidationInfo) -> object:
    if isinstance(run, str) and run.endswith(LAW_FILE):
        return (from_folder(run, info),)
    if isinstance(run, tuple) or (isinstance(run, list) and len(run) == 2):
        return run
    raise ValueError(f"[package, executable], or a file that ends in {LAW_FILE}")


def _ros_values(parameters: dict[str, Any]) -> dict[str, Any]:
    for name, value in parameters.items():
        try:
            written(name, value)
        except AbraceError as error:
            raise ValueError(str(error)) from error
    return parameters


Program = Annotated[tuple[Text, ...], pydantic.BeforeValidator(_program)]


class OwnNode(Checked):
    """A user's node: [package, executable], or a Python file; and its parameters."""

    run: Program
    parameters: Annotated[dict[Text, Any], pydantic.AfterValidator(_ros_values)] = {}


class OwnController(OwnNode):
    """A user's node that commands the braces; `name`: its name in tables and bags, by default the executable's."""

    name: Name | None = None

    @property
    def label(self) -> str:
        """Its name in tables and bags."""
        return self.name or Path(self.run[-1]).stem


class OwnRig(OwnNode):
    """A user's node that serves as the rig of a rig file."""

    file: NameOrFile


NAME_OR_NODE = pydantic.Discriminator(lambda content: "name" if isinstance(content, str) else "node")
Named = Annotated[NameOrFile, pydantic.Tag("name")]
Controller = Annotated[Named | Annotated[OwnController, pydantic.Tag("node")], NAME_OR_NODE]
RigChoice = Annotated[Named | Annotated[OwnRig, pydantic.Tag("node")], NAME_OR_NODE]


def _different(groups: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(groups)) < len(groups):
        raise ValueError("every brace group once")
    return tuple(sorted(groups))


class RigTest(Checked):
    """A run of the live graph, recorded to a bag.

    duration [s]; excitation of the braces [N], or a controller: an earlier design step, a controller file, or a user's
    node; disconnected brace groups (1 the first); simulated sensor faults, as `a2=stuck@20.0`, and the seed of the
    simulated sensor noise; greatest force [N] of one brace of each group, and its rate [N/s]; rig, device, emulator and
    lockstep if they differ from the campaign's.
    """

    duration: Positive
    disconnected_braces: Annotated[
        tuple[Annotated[int, pydantic.Field(ge=1, strict=True)], ...], pydantic.AfterValidator(_different)
    ] = ()
    ground_motion: GroundMotion | None = None
    excitation: Excitation | None = None
    controller: Controller | None = None
    force_limit: Annotated[tuple[Positive, ...], pydantic.Field(min_length=1)] | None = None
    rate_limit: Positive | None = None
    sensor_faults: tuple[Text, ...] = ()
    sensor_seed: Whole | None = None
    rig: RigChoice | None = None
    device: NameOrFile | None = None
    emulator: Flag | None = None
    lockstep: Flag | None = None

    @property
    def controller_name(self) -> str:
        """Name of its controller in tables and bags; empty: no controller."""
        if isinstance(self.controller, OwnController):
            return self.controller.label
        return Path(self.controller).stem if self.controller else ""


class Identify(IdentificationOptions):
    """A model from the bags of tests with table motion alone and with commands alone, one or several of each.

    The same tests may be given for both if table and braces were excited at once. All other keys are parameters of the
    node `identify`.
    """

    table: Tests
    command: Tests


class Design(DesignOptions):
    """A controller from a model, with weights given by name or file.

    model: an earlier identify step, the folder of one, or a model file. All other keys are parameters of the node
    `design`; sample period and force limits are the rig's where they are not given.
    """

    model: NameOrFile
    weights: NameOrFile


class Ambient(AmbientOptions):
    """Modes from tests without commands, and whether the building has changed since the tests `before`.

    All other keys are parameters of the node `ambient`.
    """

    test: Tests
    before: Tests | None = None


def given_options(task: Options, options: type[Options]) -> dict[str, Any]:
    """The options that stand in the file for a `task`: parameters of its node."""
    given = task.model_dump(include=task.model_fields_set & set(options.model_fields))
    return {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}


class Compare(Checked):
    """A measured test compared with the same test without control; needs no model."""

    test: NameOrFile
    uncontrolled: NameOrFile


class Validate(Checked):
    """A test compared with its simulation by a model and, if given, with the same test without control.

    The loop is closed as in the test, with its controller's file. A user's node is not simulated: its recorded commands
    drive the model.
    """

    test: NameOrFile
    model: NameOrFile
    uncontrolled: NameOrFile | None = None
    controller: NameOrFile | None = None


Task = RigTest | Identify | Design | Compare | Validate | Ambient
