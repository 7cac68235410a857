# SPDX-License-Identifier: Apache-2.0
"""The tasks of a campaign's steps: tests of the rig, and the offline steps that use their bags."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from abrace.campaign.drives import Excitation, GroundMotion
from abrace.campaign.names import (
    LAW_FILE,
    Band,
    Flag,
    Name,
    NameOrFile,
    NonNegative,
    Positive,
    PositiveBand,
    Tests,
    Text,
    Whole,
    from_folder,
)
from abrace.processes.parameter_file import written
from abrace_core.config_file import Checked
from abrace_core.errors import AbraceError
from abrace_lqg.proof.files import DRAWS
from abrace_lqg.proof.limits import Limits, Objection


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


class Identify(Checked):
    """A model from the bags of tests with table motion alone and with commands alone, one or several of each.

    The same tests may be given for both if table and braces were excited at once. All other keys are parameters of the
    node `identify`.
    """

    table: Tests
    command: Tests
    table_band: Band | None = None
    command_band: Band | None = None
    fit: Literal["maximum_likelihood", "vector_fitting", "sk", "paper"] | None = None
    command_order: Whole | None = None
    reduced_order: Whole | None = None
    servo_lag: NonNegative | None = None
    method: Literal["local_rational", "local_polynomial", "welch"] | None = None
    segment: Whole | None = None
    window: Text | None = None
    overlap: Annotated[float, pydantic.Field(ge=0, le=0.99, strict=True)] | None = None
    estimator: Literal["H1", "H2", "Hv"] | None = None
    order: Whole | None = None
    half_width: Whole | None = None
    stabilization: Flag | None = None
    mat: Flag | None = None

    @property
    def options(self) -> dict[str, Any]:
        """The given parameters of the node `identify`, without its tests."""
        given = self.model_dump(exclude_none=True, exclude={"table", "command"})
        return {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}


class Design(Checked):
    """A controller from a model, with weights given by name or file.

    model: an earlier identify step, the folder of one, or a model file; limits: stability margins and other limits of
    the design, with defaults; accept: objections that do not prevent the design; draws and draw_seed: number and seed
    of models drawn from the uncertainty of the identified one, with which the design also has to meet the limits.
    """

    model: NameOrFile
    weights: NameOrFile
    limits: Limits = Limits()
    accept: tuple[Objection, ...] = ()
    draws: Whole = DRAWS
    draw_seed: Whole = 0

    @property
    def refusal(self) -> dict[str, object]:
        """Parameters of the node `design`: limits, models drawn, and the objections that are accepted, if any."""
        drawn = {"draws": self.draws, "draw_seed": self.draw_seed}
        return self.limits.model_dump() | drawn | ({"accept": list(self.accept)} if self.accept else {})


class Ambient(Checked):
    """Modes from tests without commands, and whether the building has changed since the tests `before`.

    band: [Hz]; without it as the tests show it.
    """

    test: Tests
    before: Tests | None = None
    band: PositiveBand | None = None


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
