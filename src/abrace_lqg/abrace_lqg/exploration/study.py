"""Many weight sets tried on an ensemble of records, the closed loop of each simulated: choosing Q, R and the noise.

Eq. (11) leaves the weights open, and what counts in a test, peaks, saturation and margins, is not what it minimises. So
each set of weights is designed (Eqs. 11 to 13), its margins are taken, and its loop is run through every record with
the commands cut to the braces' capacity. Both with the model that simulates, which need not be the one to design with.

The sets are a given one and quasi-random ones around it (Sobol's sequence, scrambled as by Owen, 1998), even in the
logarithms of the weights. Only ratios of weights count, so the command's stays as it is given.

The first so many sets are the same however many there are, and a set's outcome does not depend on who works it out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import qmc

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.response import PeakRms, peak_rms_of
from abrace_core.simulation import simulate, simulate_closed_loop
from abrace_lqg.analysis.margins import Margins, margins
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights, kind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from distributed import Client
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.exploration.ensemble import Record

BATCH = 4
"""Sets that a process works out at a time: few enough for the progress to be seen, many enough to cost no messages."""


def weight_sets(given: Weights, spans: Mapping[str, tuple[float, float]], count: int, seed: int) -> list[Weights]:
    """The given weights, and `count` quasi-random sets around them.

    Parameters
    ----------
    given
        Set number 0.
    spans
        By name of a weight (of `KindWeights`, or noise_to_excitation): lowest and highest power of ten that it is
        multiplied by. Those that are not named stay as they are given.
    count
        Of further sets.
    seed
        Of the scrambling.

    Raises
    ------
    AbraceError
        If a span is not one, or a weight that is given as zero has one.
    """
    file = given.model_dump()
    start = {**file["weights"], "noise_to_excitation": file["noise_to_excitation"]}
    names = [name for name, span in spans.items() if tuple(span) != (0.0, 0.0)]
    for name in names:
        low, high = spans[name]
        if not low <= high:
            raise AbraceError(f"span of {name}: from {low} to {high}, expected the lower power of ten first")
        if not start[name] > 0:
            raise AbraceError(
                f"span of {name}: the weight is given as 0, which no factor changes, expected more than 0"
            )
    if not names:
        raise AbraceError("spans: all are from 0 to 0, expected a weight that differs from set to set")
    low, high = np.array([spans[name] for name in names]).T
    # drawn by powers of two, as the sequence is balanced there
    drawn = qmc.Sobol(len(names), scramble=True, seed=seed).random_base2((count - 1).bit_length())[:count]
    sets = [given]
    for factors in 10.0 ** (low + (high - low) * drawn):
        values = start | {name: start[name] * float(factor) for name, factor in zip(names, factors, strict=True)}
        noise = values.pop("noise_to_excitation")
        sets.append(Weights.model_validate(file | {"weights": values, "noise_to_excitation": noise}))
    return sets


@dataclass(frozen=True)
class Study:
    """What all sets of weights are tried with; `Study.of` makes it.

    Parameters
    ----------
    model
        To design with, continuous.
    plant
        To simulate with, at the controllers' sample period.
    records
        The ensemble.
    zero_command
        For each record peak and rms of the plant's outputs when the commands are zero [SI units].
    capacity
        (commands,) [N].
    """

    model: LinearModel
    plant: LinearModel
    records: tuple[Record, ...]
    zero_command: tuple[dict[str, PeakRms], ...]
    capacity: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        model: LinearModel,
        simulation_model: LinearModel,
        records: Iterable[Record],
        capacity: NDArray[np.float64],
        sample_period: float,
    ) -> Study:
        """The study of controllers for a rig.

        Parameters
        ----------
        model, simulation_model
            Continuous, to design and to simulate with: from the ground acceleration and the same commands.
        records
            Ground motions at the sample period.
        capacity
            (commands,) [N].
        sample_period
            Of the controllers [s].
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
    """What became of one set of weights.

    Parameters
    ----------
    number
        Of the set; 0 is the given one.
    weights
        The set.
    refused
        Why there is no controller with these weights; empty: there is one.
    margins
        Of the loop with the simulating model.
    relative
        Peak and rms of each response, over those with zero command, mean of the records; without responses that a
        zero command leaves at zero (an ideal actuator's force).
    command
        Peak of all commands in all records, and their rms [N].
    saturated
        Samples at which a command was cut, of all records.
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

    def response(self, of_kind: str) -> float:
        """Rms over that with zero command, mean over the responses of a kind (`of_kind`, as in `kind`) and records."""
        found = [row.rms for name, row in (self.relative or {}).items() if kind(name) == of_kind]
        return float(np.mean(found))


def evaluate(study: Study, number: int, weights: Weights) -> Outcome:
    """Design with one set of weights, take the margins, and run the loop through every record.

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
    tables, saturated = [], 0
    for record in study.records:
        outputs, commands = simulate_closed_loop(
            plant, designed.controller, record.ground_acceleration, study.capacity, designed.correction
        )
        names = designed.controller.outputs
        tables.append(peak_rms_of(plant.outputs, outputs) | peak_rms_of(names, commands))
        saturated += int(np.count_nonzero((np.abs(commands) >= study.capacity).any(axis=1)))
    moving = [name for name in plant.outputs if all(free[name].rms > 0 for free in study.zero_command)]
    relative = {name: _mean_ratio(name, tables, study.zero_command) for name in moving}
    forces = [table[name] for table in tables for name in designed.controller.outputs]
    command = PeakRms(max(row.peak for row in forces), float(np.sqrt(np.mean([row.rms**2 for row in forces]))))
    return Outcome(number, weights, "", found, relative, command, saturated, tuple(tables))


def _mean_ratio(name: str, tables: Sequence[Mapping[str, PeakRms]], free: Sequence[Mapping[str, PeakRms]]) -> PeakRms:
    ratios = [np.array(table[name]) / np.array(without[name]) for table, without in zip(tables, free, strict=True)]
    peak, rms = np.mean(ratios, axis=0)
    return PeakRms(float(peak), float(rms))


def explore(
    study: Study,
    sets: Sequence[Weights],
    client: Client,
    progress: Callable[[int], None] = lambda _done: None,
) -> list[Outcome]:
    """Try all sets, spread over the processes of a Dask cluster.

    Parameters
    ----------
    study
        Models and records; sent to each process once.
    sets
        Numbered from 0.
    client
        Of the cluster, as `cluster` gives it.
    progress
        Told how many sets are done, each time that some are.

    Returns
    -------
    list
        An outcome for each set, in their order.

    Raises
    ------
    AbraceError
        If the measured quantities are not the models', or the cluster's processes died or cannot do the work.
    """
    from distributed import as_completed

    for weights in sets[:1]:
        unknown = set(weights.measured) - set(study.plant.outputs)
        if unknown or len(set(weights.measured)) < len(weights.measured):
            raise AbraceError(
                f"measured quantities {', '.join(weights.measured)}: expected each once, out of "
                f"{', '.join(study.plant.outputs)}"
            )
    shared = client.scatter(study, broadcast=True, hash=False)
    numbered = list(enumerate(sets))
    batches = [numbered[first : first + BATCH] for first in range(0, len(sets), BATCH)]
    futures = [client.submit(_evaluate_all, shared, batch, pure=False) for batch in batches]
    outcomes: list[Outcome] = []
    for future in as_completed(futures, loop=client.loop):
        if future.status != "finished":
            raise AbraceError(f"exploration: the work failed: {future.exception()!r}")
        outcomes += future.result()
        progress(len(outcomes))
    return sorted(outcomes, key=lambda outcome: outcome.number)


def _evaluate_all(study: Study, sets: Sequence[tuple[int, Weights]]) -> list[Outcome]:
    return [evaluate(study, number, weights) for number, weights in sets]
