# SPDX-License-Identifier: Apache-2.0
"""One set of weights tried: designed, its margins computed, and its closed loop run through every record.

Eq. (11) leaves the weights open, and does not minimise what matters in a test: peaks, saturation and margins. So each
set is judged by simulation, with the commands limited to the braces' capacity. Margins and simulation have a model of
their own, which may differ from the one to design with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.linear_model import takes_models
from abrace_core.loop_extremes import Motions, loop_extremes
from abrace_core.response import PeakRms, peak_rms_of
from abrace_core.simulation import simulate
from abrace_lqg.analysis.margins import Margins, margins
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights, signal_kind

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.exploration.ensemble import Record


@dataclass(frozen=True)
class Study:
    """Models, ground motions and limits common to all sets of weights; `Study.of` makes it.

    Parameters
    ----------
    model
        To design with, continuous.
    plant
        To simulate with, at the controllers' sample period.
    records
        Ground motions.
    zero_command
        For each record peak and rms of the plant's outputs with zero command [SI units].
    capacity
        (commands,) [N]; commands are limited to it.
    """

    model: LinearModel
    plant: LinearModel
    records: tuple[Record, ...]
    zero_command: tuple[dict[str, PeakRms], ...]
    capacity: NDArray[np.float64]

    @cached_property
    def motions(self) -> Motions:
        """The records' ground motions."""
        return Motions.of(record.ground_acceleration for record in self.records)

    @classmethod
    @takes_models
    def of(
        cls,
        model: LinearModel,
        simulation_model: LinearModel,
        records: Iterable[Record],
        *,
        capacity: NDArray[np.float64],
        sample_period: float,
    ) -> Study:
        """Check that models, records and limits fit each other, and simulate the records with zero command.

        Parameters
        ----------
        model, simulation_model
            Continuous, to design and to simulate with; both from the ground acceleration and the same commands.
        records
            Ground motions at the sample period.
        capacity
            (commands,) [N].
        sample_period
            Of the controllers [s].

        Raises
        ------
        AbraceError
            If there are no records, or signals and force limits of the models differ.
        """
        records = tuple(records)
        if not records:
            raise AbraceError("no records, expected a recorded test or noise")
        commands = model.inputs[1:]
        if simulation_model.inputs != model.inputs or set(model.outputs) - set(simulation_model.outputs):
            raise AbraceError(
                f"the simulation model takes {', '.join(simulation_model.inputs)} and gives "
                f"{', '.join(simulation_model.outputs)}, expected those of the design model: "
                f"{', '.join(model.inputs)} and {', '.join(model.outputs)}"
            )
        if capacity.shape != (len(commands),):
            raise AbraceError(f"{len(capacity)} force limits, expected one for each of {', '.join(commands)}")
        plant = sampled(simulation_model, sample_period)
        undriven = plant.select(inputs=[signals.GROUND])
        free = [peak_rms_of(plant.outputs, simulate(undriven, each.ground_acceleration[:, None])) for each in records]
        return cls(model, plant, records, tuple(free), capacity)


@dataclass(frozen=True)
class Outcome:
    """Result of one set of weights.

    Parameters
    ----------
    number
        Of the set; 0 is the given one.
    weights
        The set.
    refused
        Why these weights give no controller; empty: they give one.
    margins
        Of the loop with the simulation model.
    relative
        Peak and rms of each response over those with zero command, mean of the records; without responses that are zero
        with zero command (an ideal actuator's force).
    command
        Peak and rms of all commands in all records [N].
    saturated
        Number of samples of all records at which a command was limited.
    records
        For each record peak and rms of the responses and commands [SI units].
    """

    number: int
    weights: Weights
    refused: str = ""
    margins: Margins | None = None
    relative: Mapping[str, PeakRms] | None = None
    command: PeakRms | None = None
    saturated: int = 0
    records: tuple[Mapping[str, PeakRms], ...] = ()

    def response(self, kind: str) -> float:
        """Rms over that with zero command, mean over records and responses of a `kind` (as in `signal_kind`)."""
        return float(np.mean([row.rms for name, row in (self.relative or {}).items() if signal_kind(name) == kind]))


def evaluate(study: Study, number: int, weights: Weights) -> Outcome:
    """Design with one set of weights, compute the margins, and simulate the loop under every record.

    Parameters
    ----------
    study
        Models and records.
    number, weights
        The set.
    """
    plant = study.plant
    try:
        designed = design(study.model, weights, plant.sample_period)
        found = margins(plant, designed.controller)
    except AbraceError as error:
        return Outcome(number, weights, refused=str(error))
    loops = loop_extremes(plant, designed.controller, study.motions, study.capacity, designed.correction)
    tables = [
        {name: PeakRms(float(p), float(r)) for name, p, r in zip(loops.names, peak, rms, strict=True)}
        for peak, rms in zip(loops.peak, loops.rms, strict=True)
    ]
    return judged(study, number, weights, found, tables, int(loops.saturated.sum()))


def judged(
    study: Study,
    number: int,
    weights: Weights,
    found: Margins,
    tables: Sequence[Mapping[str, PeakRms]],
    saturated: int,
) -> Outcome:
    """The outcome of a set that gives a controller.

    Parameters
    ----------
    study
        Models and records.
    number, weights
        The set.
    found
        Its margins.
    tables
        For each record peak and rms of the responses and commands [SI units].
    saturated
        Samples of all records at which a command was limited.
    """
    moving = [name for name in study.plant.outputs if all(free[name].rms > 0 for free in study.zero_command)]
    relative = {name: _mean_ratio(name, tables, study.zero_command) for name in moving}
    forces = [table[name] for table in tables for name in study.plant.inputs[1:]]
    command = PeakRms(max(row.peak for row in forces), float(np.sqrt(np.mean([row.rms**2 for row in forces]))))
    return Outcome(number, weights, "", found, relative, command, saturated, tuple(tables))


def _mean_ratio(name: str, tables: Sequence[Mapping[str, PeakRms]], free: Sequence[Mapping[str, PeakRms]]) -> PeakRms:
    ratios = [np.array(table[name]) / np.array(without[name]) for table, without in zip(tables, free, strict=True)]
    peak, rms = np.mean(ratios, axis=0)
    return PeakRms(float(peak), float(rms))
