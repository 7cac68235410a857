"""A recorded test against the same test simulated by a model: Fig. 6 and Table 1 of the paper.

The model is driven by the recorded ground acceleration alone where a controller closes the loop, and by the recorded
command as well where none does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.response import PeakRms, peak_rms_of
from abrace_core.simulation import discretize, simulate, simulate_closed_loop
from abrace_sysid.realization import HOLDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_core.run import Run


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
        The recorded quantities and the commands, in the rows of Table 1.
    measured, simulated
        (samples, names), SI units.
    """

    source: str
    time: NDArray[np.float64]
    names: tuple[str, ...]
    measured: NDArray[np.float64]
    simulated: NDArray[np.float64]

    def correlation(self) -> dict[str, float]:
        """Correlation coefficient of each channel; channels that never move (a zero command) are left out."""
        return {name: float(np.corrcoef(self.measured[:, j], self.simulated[:, j])[0, 1]) for j, name in self._moving()}

    def normalised_rms_error(self) -> dict[str, float]:
        """Rms of simulated minus measured over rms of measured; channels that never move are left out."""
        difference = np.sqrt(np.mean((self.simulated - self.measured) ** 2, axis=0))
        size = np.sqrt(np.mean(self.measured**2, axis=0))
        return {name: float(difference[j] / size[j]) for j, name in self._moving()}

    def measured_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as measured [SI units]."""
        return peak_rms_of(self.names, self.measured)

    def simulated_peak_rms(self) -> dict[str, PeakRms]:
        """Peak and rms as simulated [SI units]."""
        return peak_rms_of(self.names, self.simulated)

    def _moving(self) -> list[tuple[int, str]]:
        return [
            (j, name)
            for j, name in enumerate(self.names)
            if np.ptp(self.measured[:, j]) > 0 and np.ptp(self.simulated[:, j]) > 0
        ]


def compare(run: Run, model: LinearModel, controller: LinearModel | None, capacity: NDArray[np.float64]) -> Comparison:
    """Simulate a recorded test and set it beside the record.

    Parameters
    ----------
    run
        The test, from rest.
    model
        Continuous, from the ground acceleration and the commands to the run's quantities.
    controller
        Discrete, from some of those to the commands, as in Eq. (13); None: the recorded command drives the model.
    capacity
        (commands,) greatest command [N].

    Raises
    ------
    AbraceError
        If model, controller and run are not of the same rig, or the record has a gap.
    """
    wanted = (signals.GROUND, *run.command_names)
    missing = [name for name in wanted if name not in model.inputs] + [n for n in run.names if n not in model.outputs]
    if missing:
        raise AbraceError(f"{run.source}: the model has no signal {', '.join(missing)}, expected a model of this rig")
    if len(run.outputs) < 2 or np.any(np.diff(run.sequence.astype(np.int64)) != 1):
        raise AbraceError(f"{run.source}: expected two or more consecutive samples without a gap")
    if len(capacity) != run.groups:
        raise AbraceError(f"{run.source}: {len(capacity)} capacities, expected one for each of {run.groups} commands")
    sampled = discretize(model.select(run.names, wanted), run.sample_period, HOLDS)
    if controller is None:
        command = np.clip(run.command_from_here, -capacity, capacity)
        simulated = simulate(sampled, np.column_stack([run.ground_acceleration, command]))
        commands = run.command
    else:
        unmeasured = [name for name in controller.inputs if name not in run.names]
        if unmeasured:
            raise AbraceError(f"{run.source}: the controller measures {', '.join(unmeasured)}, which the run has not")
        simulated, commands = simulate_closed_loop(sampled, controller, run.ground_acceleration, capacity)
    return Comparison(
        run.source,
        run.time,
        (*run.names, *run.command_names),
        np.hstack([run.outputs, run.command]),
        np.hstack([simulated, commands]),
    )
