# SPDX-License-Identifier: Apache-2.0
"""What a step of a campaign does: a test of the rig, or work on its bags."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pydantic

from abrace.campaign.drives import BandedNoise, Excitation, GroundMotion
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

if TYPE_CHECKING:
    from collections.abc import Sequence

LOWEST = 0.3
"""Hz, from which tests are identified where no band is given: sensors drift, and a table hardly moves below."""


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
    """A node of the user's: [package, executable], or a Python file; and its parameters."""

    run: Program
    parameters: Annotated[dict[Text, Any], pydantic.AfterValidator(_ros_values)] = {}


class OwnController(OwnNode):
    """A node that commands the braces; `name` is what tables and bags call it, the executable unless it is given."""

    name: Name | None = None

    @property
    def label(self) -> str:
        """What it is called."""
        return self.name or Path(self.run[-1]).stem


class OwnRig(OwnNode):
    """A node that serves as the rig that a rig file describes."""

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

    duration [s]; excitation of the braces [N], or a controller: an earlier design step, a controller file, or a node of
    the user's; brace groups (1 the first) that are not connected; sensors that fail, as `a2=stuck@20.0`, and the seed
    of the sensors' noise of a simulated rig; greatest force [N] of one brace of each group, and its rate [N/s]; rig,
    device, emulator and lockstep where they are others than the campaign's.
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
        """What tables and bags call its controller; empty: there is none."""
        if isinstance(self.controller, OwnController):
            return self.controller.label
        return Path(self.controller).stem if self.controller else ""


class Identify(Checked):
    """A model from the bags of tests of the table alone, and of the commands alone, one or several of each.

    The same tests for both: table and commands at once. Everything else are parameters of the node `identify`; a band
    that is not given is that in which the tests are excited, from LOWEST Hz on.
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
        """The parameters of the node `identify` that are given, but its tests."""
        given = self.model_dump(exclude_none=True, exclude={"table", "command"})
        return {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}

    def band_of(self, key: str, tests: Sequence[RigTest]) -> tuple[float, float] | None:
        """The band of `table` or `command`: as given, or that in which all its tests are excited; None: not known.

        Parameters
        ----------
        key
            "table" or "command".
        tests
            Those that it names; without any the band is known only if it is given.
        """
        given: tuple[float, float] | None = getattr(self, f"{key}_band")
        drives = [test.ground_motion if key == "table" else test.excitation for test in tests]
        bands = [drive.band for drive in drives if isinstance(drive, BandedNoise)]
        if given is not None or not bands or len(bands) < len(drives):
            return given
        return max(LOWEST, *(band[0] for band in bands)), min(band[1] for band in bands)


class Design(Checked):
    """A controller from a model, with weights that are a name or a file.

    model: an earlier identify step, the folder of one, or a model file; limits: what it has to keep, the defaults where
    nothing is said; accept: objections in spite of which it is written; draws and draw_seed: models as likely as the
    identified one, with which the limits have to be kept as well.
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
    """Modes from tests without commands, and whether the building has changed since others; band [Hz]."""

    test: Tests
    before: Tests | None = None
    band: PositiveBand = (0.3, 20.0)


class Compare(Checked):
    """A test against the same test without control, as measured: no model is needed."""

    test: NameOrFile
    uncontrolled: NameOrFile


class Validate(Checked):
    """A test against its simulation by a model, and against the same test without control where one is given.

    The loop is closed as in the test, by its controller's file; a node of the user's is not simulated, its commands as
    recorded drive the model.
    """

    test: NameOrFile
    model: NameOrFile
    uncontrolled: NameOrFile | None = None
    controller: NameOrFile | None = None


Task = RigTest | Identify | Design | Compare | Validate | Ambient
