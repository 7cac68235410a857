"""The campaign file: YAML that lists tests, identifications, designs and comparisons, one after the other."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError
from abrace_lqg.proof.files import DRAWS
from abrace_lqg.proof.limits import Limits, Objection

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

Positive = Annotated[float, pydantic.Field(gt=0, strict=True)]
NonNegative = Annotated[float, pydantic.Field(ge=0, strict=True)]
Text = Annotated[str, pydantic.Field(min_length=1)]

Lines = Literal["all", "odd", "even"]

LOWEST = 0.3
"""Hz, from which tests are identified where no band is given: sensors drift, and a table hardly moves below."""

WHITE_NOISE, MULTISINE = "white_noise", "multisine"
CONTROLLER_FILE = ".yaml"
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def _file_name(name: str) -> str:
    if not _FILE_NAME.fullmatch(name):
        raise ValueError("up to 64 letters, digits, _ and -, a letter or digit first")
    return name


Name = Annotated[str, pydantic.AfterValidator(_file_name)]


def _rising(band: tuple[float, float]) -> tuple[float, float]:
    if not band[0] < band[1]:
        raise ValueError("two frequencies in Hz, the lower one first")
    return band


class BandedNoise(Checked):
    """Banded white noise: rms in the unit of what it drives, band [Hz], seed."""

    rms: Positive
    band: Annotated[tuple[NonNegative, NonNegative], pydantic.AfterValidator(_rising)]
    seed: Annotated[int, pydantic.Field(ge=0, strict=True)]


class Multisine(BandedNoise):
    """A periodic multisine: as many whole periods [s] as fit in a test, on "all", "odd" or "even" lines."""

    period: Positive = 32.768
    lines: Lines = "odd"
    slope: Annotated[float, pydantic.Field(strict=True)] = 0.0

    @pydantic.model_validator(mode="after")
    def _above_zero(self) -> Multisine:
        if self.band[0] == 0:
            raise ValueError("a band that begins above 0 Hz: displacement grows with 1 / frequency^2")
        return self


class ExcitationNoise(BandedNoise):
    """Brace commands of banded white noise: rms [N]."""

    signal: Literal["white_noise"] = "white_noise"


class ExcitationMultisine(Multisine):
    """Brace commands of a multisine: rms [N]."""

    signal: Literal["multisine"]


def _signal(content: object) -> object:
    return content.get("signal", WHITE_NOISE) if isinstance(content, dict) else getattr(content, "signal", None)


Excitation = Annotated[
    Annotated[ExcitationNoise, pydantic.Tag(WHITE_NOISE)] | Annotated[ExcitationMultisine, pydantic.Tag(MULTISINE)],
    pydantic.Discriminator(_signal),
]


class WhiteNoise(BandedNoise):
    """A table motion of banded white noise: rms [m/s^2]."""

    record: Literal["white_noise"]


class MultisineMotion(Multisine):
    """A table motion of a multisine: rms [m/s^2]."""

    record: Literal["multisine"]


class Record(Checked):
    """A table motion from a record, which is a name or a file: peak acceleration [m/s^2], 0: as recorded."""

    record: Text
    peak_acceleration: NonNegative = 0.0


def _motion_kind(content: object) -> object:
    record = content.get("record") if isinstance(content, dict) else getattr(content, "record", None)
    return record if record in (WHITE_NOISE, MULTISINE) else "record"


GroundMotion = Annotated[
    Annotated[WhiteNoise, pydantic.Tag(WHITE_NOISE)]
    | Annotated[MultisineMotion, pydantic.Tag(MULTISINE)]
    | Annotated[Record, pydantic.Tag("record")],
    pydantic.Discriminator(_motion_kind),
]


def _different(groups: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(groups)) < len(groups):
        raise ValueError("every brace group once")
    return tuple(sorted(groups))


class RigTest(Checked):
    """A run of the live graph, recorded to a bag.

    duration [s]; excitation of the braces [N], or a controller: an earlier design step or a controller file; brace
    groups (1 the first) that are not connected.
    """

    duration: Positive
    disconnected_braces: Annotated[
        tuple[Annotated[int, pydantic.Field(ge=1, strict=True)], ...], pydantic.AfterValidator(_different)
    ] = ()
    ground_motion: GroundMotion | None = None
    excitation: Excitation | None = None
    controller: Text | None = None


def _listed(value: object) -> object:
    return [value] if isinstance(value, str) else value


Tests = Annotated[tuple[Text, ...], pydantic.Field(min_length=1), pydantic.BeforeValidator(_listed)]


Band = Annotated[tuple[NonNegative, NonNegative], pydantic.AfterValidator(_rising)]
Whole = Annotated[int, pydantic.Field(ge=0, strict=True)]


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
    stabilization: Annotated[bool, pydantic.Field(strict=True)] | None = None
    mat: Annotated[bool, pydantic.Field(strict=True)] | None = None

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
            Those that it names.
        """
        given: tuple[float, float] | None = getattr(self, f"{key}_band")
        drives = [test.ground_motion if key == "table" else test.excitation for test in tests]
        bands = [drive.band for drive in drives if isinstance(drive, BandedNoise)]
        if given is not None or len(bands) < len(drives):
            return given
        return max(LOWEST, *(band[0] for band in bands)), min(band[1] for band in bands)


class Design(Checked):
    """A controller from a model, with weights that are a name or a file.

    limits: what it has to keep, the defaults where nothing is said; accept: objections in spite of which it is written;
    draws and draw_seed: models as likely as the identified one, with which the limits have to be kept as well.
    """

    model: Text
    weights: Text
    limits: Limits = Limits()
    accept: tuple[Objection, ...] = ()
    draws: Annotated[int, pydantic.Field(ge=0, strict=True)] = DRAWS
    draw_seed: Annotated[int, pydantic.Field(ge=0, strict=True)] = 0

    @property
    def refusal(self) -> dict[str, object]:
        """Parameters of the node `design`: limits, models drawn, and the objections that are accepted, if any."""
        drawn = {"draws": self.draws, "draw_seed": self.draw_seed}
        return self.limits.model_dump() | drawn | ({"accept": list(self.accept)} if self.accept else {})


class Ambient(Checked):
    """Modes from tests without commands, and whether the building has changed since others; band [Hz]."""

    test: Tests
    before: Tests | None = None
    band: Annotated[tuple[Positive, Positive], pydantic.AfterValidator(_rising)] = (0.3, 20.0)


class Validate(Checked):
    """A test against its simulation by a model; one with a controller also against the same test without control."""

    test: Text
    model: Text
    uncontrolled: Text | None = None
    controller: Text | None = None


Task = RigTest | Identify | Design | Validate | Ambient


class _Step(Checked):
    name: Name
    test: RigTest | None = None
    identify: Identify | None = None
    design: Design | None = None
    validation: Annotated[Validate | None, pydantic.Field(alias="validate")] = None
    ambient: Ambient | None = None

    def tasks(self) -> list[Task]:
        given = (self.test, self.identify, self.design, self.validation, self.ambient)
        return [task for task in given if task is not None]


class _Campaign(Checked):
    name: Name
    rig: Text
    device: Text | None = None
    emulator: Annotated[bool, pydantic.Field(strict=True)] = False
    lockstep: Annotated[bool, pydantic.Field(strict=True)] = False
    thread_priority: Annotated[int, pydantic.Field(ge=0, le=98, strict=True)] = 0
    steps: Annotated[list[_Step], pydantic.Field(min_length=1)]


@dataclass(frozen=True)
class Step:
    """One step of a campaign: its name, which names its files too, and what is to be done."""

    name: str
    task: Task


@dataclass(frozen=True)
class Campaign:
    """A campaign.

    Parameters
    ----------
    name
        Names the folder of the results.
    rig
        A rig's name or file.
    lockstep
        Whether tests run in lockstep rather than in real time.
    steps
        In the order in which they are made.
    device
        Name or file of the device that the rig is behind; None: the rig is simulated.
    emulator
        Whether the emulator is that device.
    thread_priority
        Of the loops of nodes and emulator; 0: none.
    """

    name: str
    rig: str
    lockstep: bool
    steps: tuple[Step, ...]
    device: str | None = None
    emulator: bool = False
    thread_priority: int = 0

    @property
    def simulated(self) -> bool:
        """Whether the rig is what the rig file says."""
        return self.device is None or self.emulator


def load_campaign(path: Path | str) -> Campaign:
    """Read and check a campaign file.

    Raises
    ------
    AbraceError
        Naming the file, the step, the key, the value and what was expected.
    """
    content = read_config(path, _Campaign, "campaign")
    if content.emulator and content.device is None:
        raise AbraceError(f"campaign file {path}: emulator: true, expected a device that is emulated")
    if content.lockstep and content.device is not None:
        raise AbraceError(
            f"campaign file {path}: lockstep: true, expected false with a device: hardware has a tick of its own"
        )
    earlier: dict[str, Task] = {}
    for step in content.steps:
        where = f"campaign file {path}: step {step.name}"
        if step.name in earlier:
            raise AbraceError(f"{where}: name: {step.name!r}, expected a name that no earlier step has")
        tasks = step.tasks()
        if len(tasks) != 1:
            raise AbraceError(
                f"{where}: {len(tasks)} tasks, expected exactly one of test, identify, design, validate, ambient"
            )
        if isinstance(tasks[0], RigTest) and tasks[0].disconnected_braces and content.device is not None:
            raise AbraceError(
                f"{where}: test.disconnected_braces, expected none with a device: a person disconnects them"
            )
        _check_references(where, tasks[0], earlier)
        earlier[step.name] = tasks[0]
    steps = tuple(Step(name, task) for name, task in earlier.items())
    return Campaign(
        content.name, content.rig, content.lockstep, steps, content.device, content.emulator, content.thread_priority
    )


Kind = TypeVar("Kind", RigTest, Identify, Design)


def _check_references(where: str, task: Task, earlier: dict[str, Task]) -> None:
    def refer(key: str, name: str, kind: type[Kind], expected: str, fits: Callable[[Kind], bool] | None = None) -> Kind:
        referred = earlier.get(name)
        if isinstance(referred, kind) and (fits is None or fits(referred)):
            return referred
        having = [other for other, task in earlier.items() if isinstance(task, kind) and (fits is None or fits(task))]
        raise AbraceError(f"{where}: {key}: {name!r}, expected {expected} ({', '.join(having) or 'there is none'})")

    match task:
        case RigTest(controller=str(controller)):
            if task.excitation is not None:
                raise AbraceError(
                    f"{where}: test.controller: {controller!r} and an excitation, expected one of the two"
                )
            if not controller.endswith(CONTROLLER_FILE):
                expected = f"an earlier design step or a file that ends in {CONTROLLER_FILE}"
                refer("test.controller", controller, Design, expected)
        case Identify():
            of_table = (_moves_table_alone, "an earlier test of the table alone")
            of_command = (_pushes_alone, "an earlier test with excitation alone")
            if task.table == task.command and any(_is_test_that(_moves_both, earlier.get(n)) for n in task.table):
                of_table = of_command = (_moves_both, "an earlier test of noise, or multisines, on table and command")
            for key, names, (fits, expected) in (
                ("table", task.table, of_table),
                ("command", task.command, of_command),
            ):
                for name in names:
                    refer(f"identify.{key}", name, RigTest, expected, fits)
            _check_braces(where, "identify", (*task.table, *task.command), earlier)
        case Design():
            refer("design.model", task.model, Identify, "an earlier identify step")
        case Ambient():
            for key, names in (("test", task.test), ("before", task.before or ())):
                for name in names:
                    expected = "an earlier test without excitation and controller"
                    refer(
                        f"ambient.{key}", name, RigTest, expected, lambda test: not (test.excitation or test.controller)
                    )
            _check_braces(where, "ambient", (*task.test, *(task.before or ())), earlier)
        case Validate():
            test = refer("validate.test", task.test, RigTest, "an earlier test")
            model = refer("validate.model", task.model, Identify, "an earlier identify step")
            _check_braces(where, "validate", (task.test, *model.table), earlier)
            if task.controller != test.controller:
                runs = f"{test.controller!r}, which test {task.test} runs" if test.controller else "none"
                raise AbraceError(f"{where}: validate.controller: {task.controller!r}, expected {runs}")
            if task.uncontrolled is not None:
                refer(
                    "validate.uncontrolled",
                    task.uncontrolled,
                    RigTest,
                    f"an earlier test without control and with the ground motion and duration of {task.test}",
                    lambda other: (
                        _moves_table_alone(other)
                        and (other.ground_motion, other.duration) == (test.ground_motion, test.duration)
                        and other.disconnected_braces == test.disconnected_braces
                    ),
                )


def _check_braces(where: str, key: str, names: tuple[str, ...], earlier: dict[str, Task]) -> None:
    """Tests that are used together have the same braces connected."""
    tests = {name: task for name, task in earlier.items() if name in names and isinstance(task, RigTest)}
    first = tests[names[0]].disconnected_braces
    for name, test in tests.items():
        if test.disconnected_braces != first:
            raise AbraceError(
                f"{where}: {key}: {name} has brace groups {list(test.disconnected_braces)} disconnected, expected "
                f"{list(first)} as {names[0]}"
            )


def _moves_table_alone(test: RigTest) -> bool:
    return test.ground_motion is not None and test.excitation is None and test.controller is None


def _pushes_alone(test: RigTest) -> bool:
    return test.excitation is not None and test.ground_motion is None


def _moves_both(test: RigTest) -> bool:
    """Table and commands at once: noise, or multisines."""
    drives = (test.excitation, test.ground_motion)
    periodic = [isinstance(drive, Multisine) for drive in drives]
    return all(isinstance(drive, BandedNoise) for drive in drives) and periodic[0] == periodic[1]


def _is_test_that(fits: Callable[[RigTest], bool], task: Task | None) -> bool:
    return isinstance(task, RigTest) and fits(task)
