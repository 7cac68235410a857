# SPDX-License-Identifier: Apache-2.0
"""The options of a design: limits that a controller has to keep, and the names of the objections if it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import Field

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN, Band, Count, Names, NonNegative, Options
from abrace_core.model import signals
from abrace_core.model.lifting import divisor
from abrace_core.model.linear_model import LinearModel, pole_table, takes_models
from abrace_core.model.roles import with_roles
from abrace_core.model.si_units import in_si_units
from abrace_lqg.analysis.prediction import Excitation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


Objection = Literal[
    "untrusted_model",
    "unstable_with_check_model",
    "small_gain_margin",
    "small_phase_margin",
    "short_delay_margin",
    "small_disk_margin",
    "damping_lost",
]
"""Name of a reason for which a design is refused; each can be accepted by name."""

OBJECTIONS: tuple[Objection, ...] = get_args(Objection)

DRAWS = 30
"""Models drawn from the covariance of each model that has one: the worst is worse than 9 of 10 such models."""

ForceLimit = tuple[Annotated[float, Field(ge=1e-9)], ...]


class Limits(Options):
    """The limits for a controller with every model with which its loop is stable; 0: no limit.

    Margins are of the loop broken at each command; 4 ms of delay are two samples at 500 Hz.
    """

    who: ClassVar[str] = "design"

    gain_margin: NonNegative = Field(default=6.0, description="dB, least gain margin at each command; 0: no limit")
    phase_margin: NonNegative = Field(
        default=30.0, description="degrees, least phase margin at each command; 0: no limit"
    )
    delay_margin: NonNegative = Field(default=0.004, description="s, least delay margin at each command; 0: no limit")
    disk_margin: NonNegative = Field(
        default=0.3, description="least disk margin of all commands and measured quantities at once; 0: no limit"
    )
    damping_kept: NonNegative = Field(
        default=0.8, description="least share of its damping that each mode keeps; 0: no limit"
    )


class DesignOptions(Limits):
    """Options of the design of a controller, and the limits that it has to keep."""

    sample_period: NonNegative = Field(
        default=0.0,
        description="s, sample period of the controller: a whole multiple of that of the rig of the model's tests; 0: "
        "the same",
    )
    force_limit: ForceLimit = Field(
        default=(),
        description="N, greatest force of one brace, of every group or of each (of a command of another unit in its SI "
        "unit); none: that of the rig of the tests",
    )
    accept: tuple[Objection, ...] = Field(
        default=(), description="objections, by name, in spite of which the controller is made"
    )
    draws: Count = Field(
        default=DRAWS, description="models drawn from the covariance of each model that has one; 0: none"
    )
    draw_seed: Count = Field(default=0, description="seed of these models")
    commands: Names = Field(
        default=(), description="names of the inputs that the controller commands; none: all but the disturbance"
    )
    disturbance: str = Field(
        default="",
        description="name of the input that disturbs; empty: w, or the only one that is no command, or the command's "
        "own place",
    )
    excitation_rms: Annotated[float, Field(ge=1e-9)] = Field(
        default=0.25,
        description="m/s^2, rms of the ground acceleration for the predicted responses; of another disturbance in its "
        "own SI unit",
    )
    excitation_band: Band = Field(
        default=NOT_GIVEN,
        description="Hz, lowest and highest frequency of this excitation; 0, 0: 0.3 to 10 Hz, or wider around the "
        "slowest mode, up to half the sample rate",
    )

    @property
    def limits(self) -> Limits:
        """The limits alone."""
        return Limits(**{name: getattr(self, name) for name in Limits.model_fields})

    @takes_models
    def of_model(self, model: LinearModel) -> DesignOptions:
        """The same, with what is not given as a `model` has it: sample period, force limits, excitation.

        Raises
        ------
        AbraceError
            If the model does not have it, or a controller for it cannot have the one that is given.
        """
        period = sample_period_of(model, self.sample_period)
        rig_period_of(model, period)
        found = {
            "sample_period": period,
            "force_limit": tuple(force_limit_of(model, self.force_limit)),
            "excitation_band": self.excitation(model).band,
        }
        return self.model_copy(update=found)

    @takes_models
    def for_control(self, model: LinearModel) -> LinearModel:
        """A `model` in SI units, from the `disturbance` to be rejected and the `commands`, in this order.

        Raises
        ------
        AbraceError
            As in `with_roles` and `in_si_units`.
        """
        model = with_roles(model, self.commands, self.disturbance)
        if any(model.input_delay[:1]):
            # a delay of the disturbance shifts its time alone
            model = replace(model, input_delay=(0.0, *model.input_delay[1:]))
        return in_si_units(model)

    @takes_models
    def excitation(self, model: LinearModel) -> Excitation:
        """The disturbance of a `model` for which responses are predicted."""
        period = self.sample_period or float(model.provenance.get("sample_period") or 0.0)
        return excitation_of(model, self.excitation_rms, self.excitation_band, period)


class Wording(NamedTuple):
    """The wording of a limit: name of the objection, the quantity, factor and unit of the numbers, decimals.

    `of_margins` is the field of `Margins` that is limited; empty: none of them is.
    """

    objection: Objection
    quantity: str
    factor: float = 1.0
    unit: str = ""
    decimals: int = 2
    of_margins: str = ""


WORDING = {
    "gain_margin": Wording("small_gain_margin", "gain margin", unit=" dB", of_margins="gain_db"),
    "phase_margin": Wording("small_phase_margin", "phase margin", unit=" degrees", decimals=1, of_margins="phase_deg"),
    "delay_margin": Wording("short_delay_margin", "delay margin", factor=1e3, unit=" ms", of_margins="delay"),
    "disk_margin": Wording("small_disk_margin", "disk margin"),
    "damping_kept": Wording("damping_lost", "damping kept", factor=100.0, unit=" %", decimals=1),
}
"""By the fields of `Limits`."""


def shortfall(limit: str, value: float, where: str, least: float) -> str:
    """The words for a `value` under its `limit`, a field of `Limits`, found at `where`; `least` was asked for."""
    wording = WORDING[limit]
    found, asked = (wording.factor * number for number in (value, least))
    size = f"{found:.{wording.decimals}f}{wording.unit}"
    return f"{wording.quantity} {size} {where}, expected at least {asked:g}{wording.unit}"


OfRig = TypeVar("OfRig", bound="Options")

AROUND_SLOWEST = (0.5, 4.0)
"""The band of ground motions includes the slowest mode's frequency times these two: most earthquakes move it."""


@takes_models
def sample_period_of(model: LinearModel, given: float = 0.0) -> float:
    """The sample period [s] of a controller for a model: the one that was `given`, or that of the model's tests.

    Raises
    ------
    AbraceError
        If neither is known, or the model's slowest mode cannot be sampled with it.
    """
    found = given or model.provenance.get("sample_period")
    if not found:
        raise AbraceError(
            "sample_period: not given, and the model's file does not have it, expected s, or a rig in Python"
        )
    for frequency, _ in pole_table(model.poles)[:1]:
        most = np.pi / frequency
        if not 0 < float(found) < most:
            raise AbraceError(
                f"sample_period: {float(found):g} s, expected above 0 and below {most:.3g} s, "
                "half the slowest mode's period"
            )
    return float(found)


@takes_models
def rig_period_of(model: LinearModel, sample_period: float) -> float:
    """The sample period [s] of the rig on which a controller of this `sample_period` [s] is to run.

    It is that of the rig of a model, as its tests had it; of another structure the controller's own.

    Raises
    ------
    AbraceError
        If the controller's is no whole multiple of it.
    """
    found = model.provenance.get("sample_period")
    if not found or not model.provenance.get("rig") or "data" in model.provenance:
        return sample_period
    try:
        return sample_period if divisor(sample_period, found) == 1 else float(found)
    except AbraceError as error:
        raise AbraceError(f"sample_period: {str(error).removeprefix('sample period ')}") from error


@takes_models
def force_limit_of(model: LinearModel, given: Sequence[float] = ()) -> list[float]:
    """The force limits (commands,) [N] of a controller: those `given`, or the capacity of the rig of the model's tests.

    A single one is that of every command.

    Raises
    ------
    AbraceError
        If neither is known, or there is not one for each command.
    """
    found = list(given) or model.provenance.get("force_limit")
    commands = ", ".join(model.inputs[1:])
    if found and len(found) == 1:
        found = list(found) * (len(model.inputs) - 1)
    if found and len(found) != len(model.inputs) - 1:
        raise AbraceError(f"force_limit: {found} N, expected one for each command of the model ({commands})")
    if not found:
        units = ", ".join(f"{name} [{model.unit(name)}]" for name in model.inputs[1:])
        raise AbraceError(
            f"force_limit: not given, and the model's file does not have it, expected the greatest of {units}, or a "
            "rig in Python"
        )
    return [float(limit) for limit in found]


@takes_models
def excitation_of(
    model: LinearModel, rms: float = 0.25, band: tuple[float, float] = NOT_GIVEN, sample_period: float = 0.0
) -> Excitation:
    """The disturbance for which a design predicts responses, of a rig the ground acceleration.

    Parameters
    ----------
    model
        Continuous; its first input disturbs.
    rms
        [SI unit of this input].
    band
        [Hz]; NOT_GIVEN: 0.3 to 10 Hz, and wider where the slowest mode is nearer to an end than `AROUND_SLOWEST`.
    sample_period
        Of the controller [s]: a band that is not given ends at half its sample rate; 0: not known.

    Raises
    ------
    AbraceError
        If the rms or the band is not possible.
    """
    disturbance, *_ = model.inputs or (signals.GROUND,)
    unit = model.unit(disturbance)
    if band != NOT_GIVEN:
        return Excitation(rms, band, disturbance, unit)
    low, high = Excitation().band
    for frequency, _ in pole_table(model.poles)[:1]:
        slowest = frequency / (2 * np.pi)
        low, high = min(low, AROUND_SLOWEST[0] * slowest), max(high, AROUND_SLOWEST[1] * slowest)
    if sample_period:
        high = min(high, 0.5 / sample_period)
    return Excitation(rms, (float(low), float(high)), disturbance, unit)


def of_rig(options: OfRig, sample_rate: float, capacity: NDArray[np.float64]) -> OfRig:
    """The same `options` with sample period and force limit of a rig where they are not given.

    Parameters
    ----------
    options
        With `sample_period` and `force_limit`.
    sample_rate, capacity
        Of the rig: [Hz], and (commands,) [N].
    """
    of_known = {"sample_period": 1 / sample_rate, "force_limit": tuple(capacity.tolist())}
    return options.model_copy(update={name: getattr(options, name) or value for name, value in of_known.items()})
