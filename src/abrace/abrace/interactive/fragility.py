# SPDX-License-Identifier: Apache-2.0
"""Closed loops under uncertainty: how likely limits are exceeded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace.interactive.given import controller_of, model_of, rig_of
from abrace.interactive.identification import Identified
from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_covariance
from abrace_core.loop_extremes import Motions
from abrace_core.model_ensemble import draw_models
from abrace_core.noise import banded_noise
from abrace_lqg.fragility.assessment import run_study
from abrace_lqg.fragility.study import Fault, FragilityStudy, Interlock
from abrace_plant.records.files import read_record
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import BAND_LIMIT, Treatment, prepare
from abrace_plant.rig.limits import limit_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace.interactive.given import AnyController, AnyModel, AnyRig
    from abrace_core.linear_model import LinearModel
    from abrace_lqg.fragility.assessment import Fragility

NOISE_BAND = (0.1, 10.0)
"""[Hz], as the node `explore` has it."""
WATCHED = {"drift": r"d\d+", "displacement": r"x\d+", "stroke": r"xf\d*", "acceleration": r"a\d+", "force": r"f\d*"}
"""Interlocks of a rig that a linear model has the quantities of, and how these are named."""


def fragility(
    model: AnyModel,
    controllers: Sequence[AnyController] = (),
    *,
    limits: Mapping[str, float],
    intensities: Sequence[float],
    records: Sequence[Record | Path | str] = (),
    noise: Sequence[int] = (),
    noise_duration: float = 40.0,
    models: int = 1,
    faults: Mapping[str, float | Sequence[float]] | None = None,
    rig: AnyRig | None = None,
    sample_period: float | None = None,
    seed: int = 0,
    folder: Path | str = "results/fragility",
    scheduler: str = "",
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fragility:
    """Run closed loops of every model, controller, fault, record and intensity, and fit fragility curves.

    The zero command is always among the controllers. Commands are cut at each controller's force limit. Results are
    kept in the folder, batch by batch: the same call goes on where it was interrupted.

    Parameters
    ----------
    model
        To simulate with.
    controllers
        To try.
    limits
        That shall not be exceeded, by quantity: outputs of the model, drifts d1, d2, ... between floors, commands
        [SI unit].
    intensities
        Peak ground accelerations to which every record is scaled [m/s^2], rising.
    records
        Known names, files, or Records.
    noise
        Seeds of banded noise (0.1 to 10 Hz), a record each.
    noise_duration
        [s].
    models
        How many: the model itself, and models drawn from the covariance of its parameters.
    faults
        Reading over truth of a failing sensor, by its name: 0 is dead, -1 turned around; several are tried one by one.
    rig
        Whose interlocks act: drift, displacement, stroke, acceleration, force; None: none.
    sample_period
        [s]; None: that of the controllers, or 0.002.
    seed
        Of the drawn models.
    folder
        For the results.
    scheduler
        Address of a Dask scheduler; empty: the cores of this machine.
    workers
        Number of processes of this machine; None: one for each core.
    progress
        Called with the numbers of finished batches and of all; None: nothing is.

    Raises
    ------
    AbraceError
        If something given does not fit, or the folder has results of another study.
    """
    tried = tuple(controller_of(each) for each in controllers)
    period = sample_period or (tried[0].law.sample_period if tried else 0.002)
    grounds = ground_motions(records, noise, noise_duration, period)
    ensemble = _ensemble(model, models, seed)
    study = FragilityStudy(
        ensemble,
        tried,
        tuple(Fault(name, float(factor)) for name, given in (faults or {}).items() for factor in np.atleast_1d(given)),
        Motions.of(_unit(name, ground) for name, ground in grounds),
        tuple(name for name, _ in grounds),
        tuple(float(each) for each in intensities),
        _interlocks(ensemble[0], rig, period),
        period,
    )
    return run_study(
        study, limits, folder, scheduler=scheduler, workers=workers, progress=progress or (lambda _done, _all: None)
    )


def ground_motions(
    records: Sequence[Record | Path | str], noise: Sequence[int], noise_duration: float, period: float
) -> list[tuple[str, NDArray[np.float64]]]:
    """Names of ground motions, and their accelerations (samples,) [m/s^2].

    Parameters
    ----------
    records, noise, noise_duration
        As for `fragility`.
    period
        Of the samples [s].
    """
    count = round(noise_duration / period)
    made = [(f"noise {seed}", banded_noise(count, 1 / period, NOISE_BAND, 1.0, seed)) for seed in noise]
    return [_recorded(each, period) for each in records] + made


def _recorded(given: Record | Path | str, period: float) -> tuple[str, NDArray[np.float64]]:
    record = given if isinstance(given, Record) else read_record(given)
    return record.name, prepare(record, 1 / period, Treatment(band_limit=BAND_LIMIT))


def _unit(name: str, ground: NDArray[np.float64]) -> NDArray[np.float64]:
    peak = np.abs(ground).max(initial=0.0)
    if not peak > 0:
        raise AbraceError(f"record {name}: the ground does not move, expected an earthquake")
    return np.asarray(ground / peak)


def _ensemble(given: AnyModel, count: int, seed: int) -> tuple[LinearModel, ...]:
    """The model, and others drawn from the covariance of its parameters."""
    if count < 1:
        raise AbraceError(f"models {count}: expected 1 (the model alone) or more")
    model = model_of(given)
    if count == 1:
        return (model,)
    covariance = given.found.covariance if isinstance(given, Identified) else None
    if isinstance(given, (str, Path)):
        path = Path(given) / "model.json" if Path(given).is_dir() else Path(given)
        covariance = load_covariance(path) if path.suffix == ".json" else None
    if covariance is None:
        raise AbraceError(
            f"models {count}: {given} has no covariance to draw models from, expected 1, or one of identify"
        )
    return (model, *draw_models(model, covariance, count - 1, seed))


def _interlocks(model: LinearModel, given: AnyRig | None, period: float) -> tuple[Interlock, ...]:
    if given is None:
        return ()
    table = limit_table(rig_of(given), {})
    floors = [name for name in model.outputs if re.fullmatch(r"x\d+", name)]
    names = [*model.outputs, *(f"d{i + 1}" for i in range(len(floors)))]
    return tuple(
        Interlock(name, table[kind].value, max(1, int(np.ceil(table[kind].time / period - 1e-9))))
        for kind, pattern in WATCHED.items()
        for name in names
        if re.fullmatch(pattern, name) and table[kind].action == "stop"
    )
