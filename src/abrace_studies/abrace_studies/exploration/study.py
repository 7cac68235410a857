# SPDX-License-Identifier: Apache-2.0
"""One set of weights tried: designed, its margins computed, and its closed loops run.

Eq. (11) leaves the weights open, and does not minimise what matters in a test: peaks, saturation and margins. So each
set is judged by simulation, under every record at every intensity, with every model of an ensemble, with intact sensors
and each fault: the loops of a fragility study with its controller. Two numbers come of them: the mean response of the
simulation model itself, and a quantile over all loops, which a set reaches that is robust.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pyarrow

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller
from abrace_core.model.linear_model import takes_models
from abrace_core.model.response import PeakRms
from abrace_lqg.analysis.margins import Margins, margins
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights, is_of_kind, signal_kind
from abrace_studies.batches.loop_extremes import Motions, loop_extremes
from abrace_studies.fragility.loops import compute_batch
from abrace_studies.fragility.study import INTACT, FragilityStudy

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.fragility.study import Fault
    from abrace_studies.ground_motions import GroundMotion

MARGINS = ("gain_db", "phase_deg", "delay", "sensitivity_peak")
"""Fields of `Margins`, columns of the results."""
RANKED = ("displacement", "acceleration")
"""Kinds of responses by which sets are ranked, with those that have a weight by name."""


@dataclass(frozen=True)
class Study:
    """Models, ground motions and limits common to all sets of weights; `Study.of` makes it.

    Parameters
    ----------
    model
        To design with, continuous.
    loops
        Models to simulate with, the first for margins and the mean response, ground motions, intensities; no
        controllers.
    faults
        Faults of sensors that the sets measure.
    capacity
        (commands,) [N]; commands are limited to it.
    quantile
        Share of the loops that respond no more than a set's robust response.
    zero_command
        (2, models, motions, outputs) peak and rms with zero command at 1 m/s^2 [SI units].
    """

    model: LinearModel
    loops: FragilityStudy
    faults: tuple[Fault, ...]
    capacity: NDArray[np.float64]
    quantile: float
    zero_command: NDArray[np.float64]

    @cached_property
    def plant(self) -> LinearModel:
        """The first model to simulate with, at the controllers' sample period."""
        return sampled(self.loops.models[0], self.loops.sample_period)

    @property
    def count(self) -> int:
        """Number of closed loops of a set."""
        tried = len(self.loops.models) * (1 + len(self.faults))
        return tried * len(self.loops.motion_names) * len(self.loops.intensities)

    @classmethod
    @takes_models
    def of(
        cls,
        model: LinearModel,
        simulation_models: Sequence[LinearModel],
        records: Iterable[GroundMotion],
        *,
        intensities: Sequence[float],
        capacity: NDArray[np.float64],
        sample_period: float,
        faults: Sequence[Fault] = (),
        quantile: float = 0.9,
    ) -> Study:
        """Check that models, records and limits fit each other, and simulate the records with zero command.

        Parameters
        ----------
        model, simulation_models
            Continuous, to design and to simulate with; all from the ground acceleration and the same commands.
        records
            Ground motions at the sample period.
        intensities
            Peak accelerations to which each is scaled [m/s^2], rising.
        capacity
            (commands,) [N].
        sample_period
            Sample period of the controllers [s].
        faults
            As for `FragilityStudy`.
        quantile
            Above 0, up to 1: the worst loop.

        Raises
        ------
        AbraceError
            If there are no records, or signals, force limits or numbers do not fit.
        """
        records = [record.scaled(1.0) for record in records]
        if not records:
            raise AbraceError("no records, expected a recorded test or noise")
        if not 0 < quantile <= 1:
            raise AbraceError(f"quantile {quantile:g}, expected a share of the loops above 0, up to 1")
        commands, first = model.inputs[1:], simulation_models[0]
        if first.inputs != model.inputs or set(model.outputs) - set(first.outputs):
            raise AbraceError(
                f"the simulation model takes {', '.join(first.inputs)} and gives "
                f"{', '.join(first.outputs)}, expected those of the design model: "
                f"{', '.join(model.inputs)} and {', '.join(model.outputs)}"
            )
        if capacity.shape != (len(commands),):
            raise AbraceError(f"{len(capacity)} force limits, expected one for each of {', '.join(commands)}")
        loops = FragilityStudy(
            tuple(simulation_models),
            (),
            (),
            Motions.of(record.ground_acceleration for record in records),
            tuple(record.name for record in records),
            tuple(float(each) for each in intensities),
            sample_period,
        )
        free = [loop_extremes(sampled(each, sample_period), None, loops.motions) for each in loops.models]
        count = len(first.outputs)
        zero = np.stack([[each.peak[:, :count] for each in free], [each.rms[:, :count] for each in free]])
        return cls(model, loops, tuple(faults), capacity, float(quantile), zero)


@dataclass(frozen=True)
class Outcome:
    """Result of one set of weights.

    Parameters
    ----------
    number
        Number of the set; 0 is the given one.
    weights
        The set.
    refused
        Why these weights give no controller; empty: they give one.
    margins
        Margins of the loop with the first simulation model.
    relative
        Peak and rms of each response over those with zero command, mean over records and intensities, with the first
        simulation model and intact sensors; without responses that are zero with zero command (an ideal actuator's
        force).
    robust
        By kind of response (`response_kind`) the quantile over all loops of its rms over that with zero command.
    command
        Peak and rms of all commands in all loops [N].
    saturated
        Number of samples of all loops at which a command was limited.
    loops
        Number of loops.
    """

    number: int
    weights: Weights
    refused: str = ""
    margins: Margins | None = None
    relative: Mapping[str, PeakRms] = field(default_factory=dict)
    robust: Mapping[str, float] = field(default_factory=dict)
    command: PeakRms | None = None
    saturated: int = 0
    loops: int = 0

    def response(self, kind: str) -> float:
        """Rms over that with zero command, mean over records and responses of a `kind` (as in `response_kind`)."""
        return float(np.mean([row.rms for name, row in self.relative.items() if response_kind(name) == kind]))

    @property
    def ranked_kinds(self) -> tuple[str, ...]:
        """The kinds of responses by which sets are ranked; with weights by name only those that have a weight."""
        by_name = self.weights.signals
        own = [kind for kind in RANKED if not by_name or getattr(self.weights.weights, kind)]
        kinds = [*own, *(response_kind(name) for name, weight in by_name.items() if weight)]
        return tuple(kind for kind in dict.fromkeys(kinds) if kind in self.robust)

    @property
    def robust_response(self) -> float:
        """By which sets are ranked: mean of the robust responses of the ranked kinds."""
        return float(np.mean([self.robust[kind] for kind in self.ranked_kinds]))


def response_kind(name: str) -> str:
    """The kind of a response: that of its weight (`signal_kind`), of one that is no rig's its own `name`."""
    return signal_kind(name) if is_of_kind(name) else name


def try_set(study: Study, number: int, weights: Weights) -> pyarrow.Table:
    """Design with the set `number`, these `weights`, in a `study`; compute the margins, and run all loops.

    Returns
    -------
    pyarrow.Table
        A row for each loop, as from `compute_batch`, with the set's number and margins; of a set that gives no
        controller one row with the reason in `refused`.
    """
    try:
        designed = design(study.model, weights, study.loops.sample_period)
        found = margins(study.plant, designed.controller)
        controller = Controller(
            f"set {number}", designed.controller, designed.correction, designed.prediction, study.capacity, "", "", ""
        )
    except AbraceError as error:
        return _with_columns(None, set=number, refused=str(error))
    own = replace(study.loops, controllers=(controller,), faults=study.faults)
    loops = compute_batch(own, [case for case in own.cases() if case.controller is not None])
    return _with_columns(loops, set=number, refused="", **{name: getattr(found, name) for name in MARGINS})


def _with_columns(table: pyarrow.Table | None, **values: float | str) -> pyarrow.Table:
    """The `table` behind columns of one value each; None: one row of these alone."""
    count = 1 if table is None else len(table)
    found = pyarrow.table({name: [value] * count for name, value in values.items()})
    for name, column in zip(table.column_names, table.columns, strict=True) if table is not None else ():
        if name != "controller":  # it is the set
            found = found.append_column(name, column)
    return found


def judged(study: Study, weights: Weights, rows: pyarrow.Table) -> Outcome:
    """The outcome of a set of `weights` in a `study`, from its `rows` as `try_set` gives them."""
    number, refused = rows["set"][0].as_py(), rows["refused"][0].as_py()
    if refused:
        return Outcome(number, weights, refused=refused)
    outputs, commands = study.plant.outputs, study.plant.inputs[1:]
    models, intensity = np.asarray(rows["model"]), np.asarray(rows["intensity"])
    motions = np.array([study.loops.motion_names.index(name) for name in rows["motion"].to_pylist()])
    intact = np.array([name == INTACT for name in rows["fault"].to_pylist()])
    free = study.zero_command[:, models, motions] * intensity[:, None]
    moving = [i for i in range(len(outputs)) if study.zero_command[1, :, :, i].all()]
    ratio = {
        outputs[i]: np.stack([_column(rows, what, outputs[i]) for what in PeakRms._fields]) / free[:, :, i]
        for i in moving
    }
    own = intact & (models == 0)
    kinds: dict[str, list[NDArray[np.float64]]] = {}
    for name, (_, rms) in ratio.items():
        kinds.setdefault(response_kind(name), []).append(rms)
    force = np.stack([_column(rows, "rms", name) for name in commands])
    return Outcome(
        number,
        weights,
        margins=Margins(**{name: rows[name][0].as_py() for name in MARGINS}),
        relative={name: PeakRms(*values[:, own].mean(axis=1).tolist()) for name, values in ratio.items()},
        robust={
            kind: float(np.quantile(np.mean(values, axis=0), study.quantile, method="inverted_cdf"))
            for kind, values in kinds.items()
        },
        command=PeakRms(
            float(max(_column(rows, "peak", name).max() for name in commands)), float(np.sqrt(np.mean(force**2)))
        ),
        saturated=int(np.asarray(rows["saturated"]).sum()),
        loops=len(rows),
    )


def _column(rows: pyarrow.Table, what: str, name: str) -> NDArray[np.float64]:
    return np.asarray(rows[f"{what}_{name}"])


def evaluate(study: Study, number: int, weights: Weights) -> Outcome:
    """The outcome of the set `weights` with this `number` in a `study`, all its loops run here."""
    return judged(study, weights, try_set(study, number, weights))
