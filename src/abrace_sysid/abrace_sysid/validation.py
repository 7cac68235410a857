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
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from abrace_core import signals
from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.linear_model import takes_models
from abrace_core.response import PeakRms, peak_rms_of
from abrace_core.sequence import breaks
from abrace_core.simulation import simulate, simulate_closed_loop
from abrace_sysid.nonlinear.motion import simulate_nonlinear
from abrace_sysid.validity.prediction import prediction_finding

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_core.run import Run
    from abrace_sysid.nonlinear.elements import Nonlinearity
    from abrace_sysid.validity.finding import Finding

NOISE_BAND = 0.8
"""Above this share of half the sample rate a record contains only sensor noise."""


@dataclass(frozen=True)
class Comparison:
    """Measured and simulated time histories of one test.

    Parameters
    ----------
    source
        The test.
    time
        (samples,) [s].
    names
        Names of the recorded quantities and the commands, as in the rows of Table 1.
    measured, simulated
        (samples, names), SI units.
    """

    source: str
    time: NDArray[np.float64]
    names: tuple[str, ...]
    measured: NDArray[np.float64]
    simulated: NDArray[np.float64]

    def correlation(self) -> dict[str, float]:
        """Correlation coefficient of measured and simulated, by channel; constant channels are left out."""
        return {
            name: float(np.corrcoef(self.measured[:, j], self.simulated[:, j])[0, 1]) for j, name in self._varying()
        }

    def normalised_rms_error(self) -> dict[str, float]:
        """Rms of simulated minus measured over rms of measured, by channel; constant channels are left out."""
        return self._error_over_size(np.zeros(len(self.names)))

    def noise_free_error(self) -> dict[str, float]:
        """`normalised_rms_error` with the noise power subtracted from the power of the difference, not below zero.

        The denominator is unchanged: nothing is subtracted from the measured rms.
        """
        return self._error_over_size(self.noise())

    def noise(self) -> NDArray[np.float64]:
        """(names,) standard deviation of each channel's sensor noise, estimated from the record; 0 for commands.

        It follows from the median power above NOISE_BAND with a Hann window, which hum and leakage do not affect.
        """
        window = np.hanning(len(self.measured))[:, None]
        power = np.abs(fft.rfft(self.measured * window, axis=0)) ** 2 / np.sum(window**2)
        of_lines = power[int(NOISE_BAND * len(power)) :]
        # an exponential distribution's median is log(2) times its mean
        noise = np.sqrt(np.median(of_lines, axis=0) / np.log(2))
        return np.array([0.0 if name[0] == "U" else float(noise[j]) for j, name in enumerate(self.names)])

    def peak_rms_error(self) -> float:
        """Relative error of the simulated peak and rms, mean of the absolute values over peak, rms and channels."""
        measured, simulated = self.measured_peak_rms(), self.simulated_peak_rms()
        ratios = [
            found / true
            for _, name in self._varying()
            for found, true in zip(simulated[name], measured[name], strict=True)
        ]
        return float(np.mean(np.abs(np.array(ratios) - 1)))

    def measured_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as measured [SI units]."""
        return peak_rms_of(self.names, self.measured)

    def simulated_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as simulated [SI units]."""
        return peak_rms_of(self.names, self.simulated)

    def _error_over_size(self, noise: NDArray[np.float64]) -> dict[str, float]:
        power = np.mean((self.simulated - self.measured) ** 2, axis=0) - noise**2
        error, size = np.sqrt(np.maximum(power, 0.0)), np.sqrt(np.mean(self.measured**2, axis=0))
        return {name: float(error[j] / size[j]) for j, name in self._varying()}

    def _varying(self) -> list[tuple[int, str]]:
        return [
            (j, name)
            for j, name in enumerate(self.names)
            if np.ptp(self.measured[:, j]) > 0 and np.ptp(self.simulated[:, j]) > 0
        ]


@takes_models
def compare(
    run: Run,
    model: LinearModel,
    controller: LinearModel | None,
    capacity: NDArray[np.float64],
    correction: NDArray[np.float64] | None = None,
    not_linear: Nonlinearity | None = None,
) -> Comparison:
    """Simulate a recorded test and compare it with the record.

    Parameters
    ----------
    run
        The test; it begins at rest.
    model
        Continuous, from the ground acceleration and the commands to the run's quantities.
    controller
        Discrete, from some of the run's quantities to the commands, as in Eq. (13); None: the recorded command drives
        the model.
    capacity
        (commands,) greatest command [N].
    correction
        (controller's states, commands): the controller's G_d, as in `simulate_closed_loop`.
    not_linear
        Nonlinear elements that act on the model; None: the linear model alone is simulated.

    Raises
    ------
    AbraceError
        If model, controller and run are not of the same rig, or the record has a gap.
    """
    wanted = (signals.GROUND, *run.command_names)
    missing = [name for name in wanted if name not in model.inputs] + [n for n in run.names if n not in model.outputs]
    if missing:
        raise AbraceError(f"{run.source}: the model has no signal {', '.join(missing)}, expected a model of this rig")
    if len(run.outputs) < 2 or breaks(run.sequence).size:
        raise AbraceError(f"{run.source}: expected two or more consecutive samples without a gap")
    if len(capacity) != run.groups:
        raise AbraceError(f"{run.source}: {len(capacity)} capacities, expected one for each of {run.groups} commands")
    unmeasured = [name for name in controller.inputs if name not in run.names] if controller else []
    if unmeasured:
        raise AbraceError(f"{run.source}: the controller measures {', '.join(unmeasured)}, which the run does not have")
    ground, wanted_model = run.ground_acceleration, model.select(run.names, wanted)
    given = np.clip(run.command_from_here, -capacity, capacity)
    if not_linear is not None:
        law = controller, capacity, correction
        motion = simulate_nonlinear(wanted_model, not_linear, run.sample_period, ground, given, *law)
        simulated, commands = motion.outputs, motion.commands if controller else run.command
    elif controller is None:
        simulated = simulate(discretize(wanted_model, run.sample_period), np.column_stack([ground, given]))
        commands = run.command
    else:
        sampled = discretize(wanted_model, run.sample_period)
        simulated, commands = simulate_closed_loop(sampled, controller, ground, capacity, correction)
    return Comparison(
        run.source,
        run.time,
        (*run.names, *run.command_names),
        np.hstack([run.outputs, run.command]),
        np.hstack([simulated, commands]),
    )


def predicted(comparison: Comparison) -> Finding:
    """The finding of the check "prediction": the error of the worst predicted channel, sensor noise subtracted.

    Parameters
    ----------
    comparison
        The measured and the simulated test; commands do not count.
    """
    return prediction_finding({name: e for name, e in comparison.noise_free_error().items() if name[0] != "U"})
