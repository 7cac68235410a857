# SPDX-License-Identifier: Apache-2.0
"""Comparison of a recorded test with its simulation by a model: Fig. 6 and Table 1 of the paper.

With a controller the loop is simulated, driven by the recorded ground acceleration. Without one the model is driven by
the recorded ground acceleration and the recorded commands.

A record contains sensor noise, a simulation does not. The noise power is estimated from the top fifth of the record's
spectrum. There the rig does not respond, and what is left is noise, assumed white. If an anti-alias filter attenuates
that part, the estimate is too low and the model's error comes out too large, never too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import name_and_unit_of, takes_models
from abrace_core.model.response import PeakRms, peak_rms_of
from abrace_core.model.si_units import in_si_units
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_sysid.examination import require_rig
from abrace_sysid.recorded.series import hann_power
from abrace_sysid.recorded.test import given_tests
from abrace_sysid.validity.finding import prediction_finding
from abrace_sysid.validity.motion import noise_between

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.recorded.test import AnyTest
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
        Names of the recorded quantities that the model has, and of the commands, as in the rows of Table 1.
    measured, simulated
        (samples, names), SI units.
    left_out
        Names of the recorded quantities that the model does not have.
    """

    source: str
    time: NDArray[np.float64]
    names: tuple[str, ...]
    measured: NDArray[np.float64]
    simulated: NDArray[np.float64]
    left_out: tuple[str, ...] = ()

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
        return np.where([name[0] == "U" for name in self.names], 0.0, noise)

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
        One test of a rig; it begins at rest.
    model
        Continuous, from the ground acceleration and the commands to some of the test's quantities; the others are not
        compared. What has another unit, here or in the test, is converted to SI units.
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
        If there is not one test, it has a gap, model, controller and test are not of the same rig, or a signal has a
        unit that cannot be converted.
    """
    test, *more = given_tests(given)
    if more:
        raise AbraceError(f"{test.source}: {1 + len(more)} tests, expected one")
    require_rig(test)
    forces = [name for name in model.inputs if name_and_unit_of(name)[0] != signals.GROUND]
    test, model = test.in_si_units(), in_si_units(model, forces)
    controller = in_si_units(controller) if controller else None
    wanted, shared = (signals.GROUND, *test.commands), tuple(n for n in test.names if n in model.outputs)
    missing = [name for name in wanted if name not in model.inputs] or ([] if shared else test.names)
    if missing:
        raise AbraceError(f"{test.source}: the model has no signal {', '.join(missing)}, expected a model of this rig")
    if len(test.outputs) < 2:
        raise AbraceError(f"{test.source}: {len(test.outputs)} samples, expected two or more")
    capacity = np.full(test.groups, np.inf) if capacity is None else capacity
    if len(capacity) != test.groups:
        raise AbraceError(f"{test.source}: {len(capacity)} capacities, expected one for each of {test.groups} commands")
    for who, has in (("test", test.names), ("model", shared)):
        unmeasured = [name for name in controller.inputs if name not in has] if controller else []
        if unmeasured:
            lacks = f"which the {who} does not have"
            raise AbraceError(f"{test.source}: the controller measures {', '.join(unmeasured)}, {lacks}")
    ground, wanted_model = test.channel(signals.GROUND), model.select(shared, wanted)
    from_here = test.channels(test.commands)
    # as recorded with each sample: the command that acts until it
    until = np.vstack([np.zeros((1, test.groups)), from_here[:-1]])
    driving = np.clip(from_here, -capacity, capacity)
    sampled = discretize(wanted_model, test.sample_period)
    if controller is None:
        simulated, commands = simulate(sampled, np.column_stack([ground, driving])), until
    else:
        simulated, commands = simulate_closed_loop(sampled, controller, ground, capacity, correction)
    return Comparison(
        test.source,
        np.arange(len(ground), dtype=np.float64) * test.sample_period,
        (*shared, *test.commands),
        np.hstack([test.channels(shared), until]),
        np.hstack([simulated, commands]),
        tuple(name for name in test.names if name not in shared),
    )


def predicted(comparison: Comparison) -> Finding:
    """The finding of the check "prediction": the error of the worst predicted channel, sensor noise subtracted.

    Parameters
    ----------
    comparison
        The measured and the simulated test; commands do not count.
    """
    reasons = {name: why for name, why in comparison.unjudged().items() if name[0] != "U"}
    errors = {name: error for name, error in comparison.noise_free_error().items() if name[0] != "U"}
    # a sensor that misses all of the simulated motion is off by that motion
    return prediction_finding(errors | {name: 1.0 if why == STILL else nan for name, why in reasons.items()}, reasons)
