# SPDX-License-Identifier: Apache-2.0
"""Comparison of a recorded test with its simulation by a model: Fig. 6 and Table 1 of the paper.

With a controller the loop is simulated, driven by the recorded ground acceleration. Without one the model is driven by
the recorded ground acceleration and the recorded commands.

A model of measured data is driven in the same way by the inputs of another record, under its own names. Such a record
may begin in motion and have offsets: the initial state is fitted to it (with a controller the loop begins at rest),
and means are subtracted.

A record contains sensor noise, a simulation does not. The noise power is estimated from the top fifth of the record's
spectrum. There the rig does not respond, and what is left is noise, assumed white. If an anti-alias filter attenuates
that part, the estimate is too low and the model's error comes out too large, never too small.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import nan
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from abrace_core import AbraceError
from abrace_core.files.options import Names  # noqa: TC001 - pydantic reads the annotation
from abrace_core.model import signals
from abrace_core.model.discretization import HOLDS, discretize, holds_of
from abrace_core.model.linear_model import name_and_unit_of, takes_models
from abrace_core.model.response import PeakRms, peak_rms_of
from abrace_core.model.roles import DISTURBANCE, with_roles
from abrace_core.model.run import Run
from abrace_core.model.si_units import in_si_units
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_sysid.data_identification import predicted as response_to
from abrace_sysid.examination import require_every_sample
from abrace_sysid.recorded.series import hann_power
from abrace_sysid.recorded.test import TableOptions, given_tests, is_table
from abrace_sysid.validity.finding import prediction_finding
from abrace_sysid.validity.motion import noise_between

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.discretization import Hold
    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.recorded.test import AnyTest, Test
    from abrace_sysid.validity.finding import Finding

STILL = "did not move, against the simulation"
"""Why no error can be computed of a channel whose sensor is dead, or which the model predicts wrongly."""

NOISE_BAND = 0.8
"""Above this share of half the sample rate a record contains only sensor noise."""


@dataclass(frozen=True)
class Agreement:
    """How well one channel is simulated: what `Comparison` has methods for."""

    correlation: float
    normalised_rms_error: float
    noise_free_error: float


@dataclass(frozen=True)
class Comparison:
    """Measured and simulated time histories of one test.

    Parameters
    ----------
    time
        (samples,) [s].
    names
        Names of the recorded quantities that the model has, and of the `commands`, as in the rows of Table 1.
    measured, simulated
        (samples, names), SI units.
    left_out
        Names of the recorded quantities that the model does not have.
    commands
        Of a rig its commands, of another structure those of the controller.
    units
        SI units of quantities that are no rig's, by name, as far as they are known.
    """

    source: str
    time: NDArray[np.float64]
    names: tuple[str, ...]
    measured: NDArray[np.float64]
    simulated: NDArray[np.float64]
    left_out: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def correlation(self) -> dict[str, float]:
        """Correlation coefficient of measured and simulated, by channel, of those that move in both."""
        return {
            name: float(np.corrcoef(self.measured[:, j], self.simulated[:, j])[0, 1])
            for j, name in self._judged()
            if np.ptp(self.simulated[:, j]) > 0
        }

    def normalised_rms_error(self) -> dict[str, float]:
        """Rms of simulated minus measured over rms of measured, by channel.

        Channels that did not move, or have a value that is not finite, are left out.
        """
        return self._error_over_size(np.zeros(len(self.names)))

    def noise_free_error(self) -> dict[str, float]:
        """`normalised_rms_error` with the noise power subtracted from the power of the difference, not below zero.

        The denominator is unchanged: nothing is subtracted from the measured rms.
        """
        return self._error_over_size(self.noise())

    def agreement(self) -> dict[str, Agreement]:
        """All three, of the channels that move in both."""
        error, noise_free = self.normalised_rms_error(), self.noise_free_error()
        return {name: Agreement(value, error[name], noise_free[name]) for name, value in self.correlation().items()}

    def noise(self) -> NDArray[np.float64]:
        """(names,) standard deviation of each sensor's noise, from the record above NOISE_BAND; 0: a command."""
        lines = len(self.measured) // 2 + 1
        finite = np.where(np.isfinite(self.measured), self.measured, 0.0)
        noise = noise_between(hann_power(finite), (int(NOISE_BAND * lines), lines))
        return np.where([name in self.commands for name in self.names], 0.0, noise)

    def peak_rms_error(self) -> float | None:
        """Relative error of the simulated peak and rms, mean of the absolute values over peak, rms and channels.

        None: no channel can be judged.
        """
        measured, simulated = self.measured_peak_rms(), self.simulated_peak_rms()
        ratios = [
            found / true
            for _, name in self._judged()
            for found, true in zip(simulated[name], measured[name], strict=True)
        ]
        return float(np.mean(np.abs(np.array(ratios) - 1))) if ratios else None

    def measured_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as measured [SI units]."""
        return peak_rms_of(self.names, self.measured)

    def simulated_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as simulated [SI units]."""
        return peak_rms_of(self.names, self.simulated)

    def _error_over_size(self, noise: NDArray[np.float64]) -> dict[str, float]:
        found = {}
        for j, name in self._judged():
            power = np.mean((self.simulated[:, j] - self.measured[:, j]) ** 2) - noise[j] ** 2
            found[name] = float(np.sqrt(max(power, 0.0) / np.mean(self.measured[:, j] ** 2)))
        return found

    def unjudged(self) -> dict[str, str]:
        """The recorded quantities of which no error can be computed, each with the reason."""
        found = {}
        for j, name in enumerate(self.names):
            if not np.isfinite(self.measured[:, j]).all():
                found[name] = "has values that are not finite"
            elif not np.isfinite(self.simulated[:, j]).all():
                found[name] = "is not finite in the simulation"
            elif not np.ptp(self.measured[:, j]):
                found[name] = STILL if np.ptp(self.simulated[:, j]) else "did not move, nor in the simulation"
        return found | dict.fromkeys(self.left_out, "is not in the model")

    def _judged(self) -> list[tuple[int, str]]:
        unjudged = self.unjudged()
        return [(j, name) for j, name in enumerate(self.names) if name not in unjudged]


class ValidateOptions(TableOptions):
    """Options of a comparison with a test that is a table."""

    who: ClassVar[str] = "validation"

    outputs: Names = Field(default=(), description="of a table: columns to compare; none: all outputs of the model")
    hold: Literal["", "band", "zero"] = Field(
        default="",
        description="of a table: inputs band-limited, or held between samples (zero); empty: as for the "
        "identification, band where the model's file does not say",
    )


@takes_models
def read_test(given: Any, model: LinearModel, options: ValidateOptions) -> tuple[Test, ...]:
    """The tests that were `given`; of a file with columns, a DataFrame or arrays by name the columns of the `model`.

    Times or sample rate are read as for the identification if the `options` have neither. A column that states no unit
    has the model's. Outputs that were late in the identification are moved in time, but those of a simulated Run.
    """
    inputs, outputs = ({name_and_unit_of(name)[0]: name for name in names} for names in (model.inputs, model.outputs))
    asked = {"time": options.time, "sample_rate": options.sample_rate}
    if not any(asked.values()):
        asked |= {name: value for name, value in model.provenance.get("options", {}).items() if name in asked}
    hold = options.hold or model.provenance.get("hold", "band")
    columns = {"inputs": tuple(inputs), "outputs": options.outputs or tuple(outputs), "hold": hold, **asked}
    tests = given_tests(given, columns)
    units = {name: model.units.get(label, name_and_unit_of(label)[1]) for name, label in (inputs | outputs).items()}
    if not is_table(given):
        units = {name: unit for name, unit in units.items() if signals.unit(name) == "-"}
    found = []
    for test in tests:
        own = {name: unit for name, unit in units.items() if unit and name in (*test.inputs, *test.names)}
        if test.hold != "rig":
            test = replace(test, units=own | dict(test.units))
            test = test if isinstance(given, Run) else test.in_time(model.provenance.get("output_delays", {}))
        found.append(test)
    return tuple(found)


@takes_models
def compare(
    given: AnyTest | Sequence[AnyTest],
    model: LinearModel,
    controller: LinearModel | None = None,
    capacity: NDArray[np.float64] | None = None,
    correction: NDArray[np.float64] | None = None,
) -> Comparison:
    """Simulate a recorded test and compare it with the record.

    Parameters
    ----------
    given
        One test. Of a rig it begins at rest; of another structure its means are subtracted.
    model
        Continuous, from the ground acceleration and the commands, of another structure from the test's inputs, to some
        of the test's quantities; the others are not compared. What has another unit, here or in the test, is converted
        to SI units.
    controller
        Discrete, from some of the test's quantities to the commands, as in Eq. (13); None: the recorded command drives
        the model.
    capacity
        (commands,) greatest command [N]; None: any.
    correction
        (controller's states, commands): the controller's G_d, as in `simulate_closed_loop`.

    Raises
    ------
    AbraceError
        If there is not one test, it has a gap or not every sample, model, controller and test are not of the same
        structure, or a signal has a unit that cannot be converted.
    """
    test, *more = given_tests(given)
    if more:
        raise AbraceError(f"{test.source}: {1 + len(more)} tests, expected one")
    require_every_sample(test)
    of_rig = test.hold == "rig"
    controller = in_si_units(controller) if controller else None
    if not of_rig:
        model = _of_test(model, test, controller)
    test, model = test.in_si_units(), in_si_units(model)
    commands = test.commands if of_rig else (controller.outputs if controller else ())
    wanted = (signals.GROUND, *commands) if of_rig else model.inputs
    shared = tuple(name for name in test.names if name in model.outputs)
    missing = [name for name in (*wanted, *test.inputs) if name not in model.inputs] or ([] if shared else test.names)
    if missing:
        structure = "rig" if of_rig else "structure"
        lacking = ", ".join(dict.fromkeys(missing))
        raise AbraceError(f"{test.source}: the model has no signal {lacking}, expected a model of this {structure}")
    for name in (*wanted, *shared):
        units = test.units.get(name, ""), model.units.get(name, "")
        if all(units) and units[0] != units[1]:
            raise AbraceError(f"{test.source}: {name} in {units[0]}, expected {units[1]}, as in the model")
    if len(test.outputs) < 2:
        raise AbraceError(f"{test.source}: {len(test.outputs)} samples, expected two or more")
    capacity = np.full(len(commands), np.inf) if capacity is None else capacity
    if len(capacity) != len(commands):
        raise AbraceError(
            f"{test.source}: {len(capacity)} capacities, expected one for each of {len(commands)} commands"
        )
    for who, has in (("test", test.names), ("model", shared)):
        unmeasured = [name for name in controller.inputs if name not in has] if controller else []
        if unmeasured:
            lacks = f"which the {who} does not have"
            raise AbraceError(f"{test.source}: the controller measures {', '.join(unmeasured)}, {lacks}")
    inputs, both = len(wanted), len(wanted) + len(shared)
    driving, measured, from_here = np.split(test.channels((*wanted, *shared, *commands)), [inputs, both], axis=1)
    # as recorded with each sample: the command that acts until it
    until = np.vstack([np.zeros((1, len(commands))), from_here[:-1]])
    if of_rig:
        driving[:, 1:] = np.clip(from_here, -capacity, capacity)
    elif test.hold == "band":
        driving -= driving.mean(axis=0)
    sampled = discretize(model.select(shared, wanted), test.sample_period, _holds(test, model))
    if controller is not None:
        simulated, in_force = simulate_closed_loop(sampled, controller, driving[:, 0], capacity, correction)
    else:
        simulated, in_force = simulate(sampled, driving), until
        moving = np.flatnonzero(np.ptp(measured, axis=0) > 0)  # and finite
        if not of_rig and len(moving):
            seen = [shared[j] for j in moving]
            simulated[:, moving] = response_to(model.select(seen), test)
    if not of_rig:
        measured, simulated = (each - each.mean(axis=0) for each in (measured, simulated))
    return Comparison(
        test.source,
        np.arange(len(driving), dtype=np.float64) * test.sample_period,
        (*shared, *commands),
        np.hstack([measured, until]),
        np.hstack([simulated, in_force]),
        tuple(name for name in test.names if name not in shared),
        commands,
        model.units,
    )


def _of_test(model: LinearModel, test: Test, controller: LinearModel | None) -> LinearModel:
    """The `model` of a structure from what drives it in a `test`; the disturbance is first where commands are known."""
    commands = controller.outputs if controller else ()
    others = [name for name in model.inputs if name_and_unit_of(name)[0] not in commands]
    if controller and len(others) > 1:
        raise AbraceError(
            f"{test.source}: inputs {', '.join(others)} that the controller does not command, expected one at most"
        )
    in_place = DISTURBANCE in test.inputs and DISTURBANCE not in model.inputs
    return with_roles(model, commands or model.inputs) if controller or in_place else model


def _holds(test: Test, model: LinearModel) -> Mapping[str, Hold]:
    """How the inputs that drive a `model` move between the samples of a `test`; those of a delay are held."""
    if test.hold != "band":
        return holds_of(model) if test.hold == "zero" else HOLDS
    return {name: "first" for name, delay in zip(model.inputs[:1], model.input_delay, strict=False) if not delay}


def predicted(comparison: Comparison) -> Finding:
    """The finding of the check "prediction": the error of the worst predicted channel, sensor noise subtracted.

    Parameters
    ----------
    comparison
        The measured and the simulated test; commands do not count.
    """
    reasons = {name: why for name, why in comparison.unjudged().items() if name not in comparison.commands}
    found = comparison.noise_free_error().items()
    errors = {name: error for name, error in found if name not in comparison.commands}
    # a sensor that misses all of the simulated motion is off by that motion
    return prediction_finding(errors | {name: 1.0 if why == STILL else nan for name, why in reasons.items()}, reasons)
