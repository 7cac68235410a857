# SPDX-License-Identifier: Apache-2.0
"""Closed loops under uncertainty: how likely limits are exceeded."""

from __future__ import annotations

import re
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace.interactive.given import controller_of, model_of, rig_of, several, warn
from abrace.interactive.models import covariance_of
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel
from abrace_core.loop_extremes import Motions
from abrace_core.noise import banded_noise
from abrace_core.signals import meaning, response_names
from abrace_lqg.fragility.assessment import run_study
from abrace_lqg.fragility.study import STUCK, FragilityStudy, Interlock, ensemble, faults_of, with_drifts
from abrace_plant.records.files import read_record
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import BAND_LIMIT, Treatment, prepare
from abrace_plant.rig.detectors import Detectors, detectors, sensor_noise
from abrace_plant.rig.limits import group_limits, limit_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace.interactive.given import AnyController, AnyModel, AnyRig
    from abrace_lqg.fragility.assessment import Fragility

NOISE_BAND = (0.1, 10.0)
"""[Hz], as the node `explore` has it."""
WATCHED = {"drift": r"d\d+", "displacement": r"x\d+", "stroke": r"xf\d*", "acceleration": r"a\d+", "force": r"f\d*"}
"""Interlocks of a rig that a linear model has the quantities of, and how these are named."""
SETTLES = "implausible_acceleration"
COMPARED = (SETTLES, "implausible_stroke")
"""Interlocks that compare sensors with each other."""


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
    kept in the folder, batch by batch: the same call continues where it was interrupted.

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
        Whose interlocks act on what sensors read: drift, displacement, stroke, acceleration, force; and with a failing
        sensor implausible_acceleration, implausible_stroke, stuck. None: none. Those of quantities that the model does
        not have cannot act: they are given as a warning.
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
    tried = tuple(controller_of(each) for each in several(controllers))
    period = sample_period or (tried[0].law.sample_period if tried else 0.002)
    grounds = ground_motions(records, noise, noise_duration, period)
    drawn = ensemble(model_of(model), covariance_of(model), models, seed, str(model))
    acting = interlocks_of(drawn[0], rig, period)
    warn(acting.warnings)
    study = FragilityStudy(
        drawn,
        tried,
        faults_of(faults or {}),
        Motions.of(_unit(name, ground) for name, ground in grounds),
        tuple(name for name, _ in grounds),
        tuple(float(each) for each in intensities),
        acting.interlocks,
        period,
        acting.implausibility,
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
    seeds = several(noise)
    for seed in seeds:
        if not isinstance(seed, (int, np.integer)) or seed < 0:
            raise AbraceError(f"noise {seed!r}: expected seeds, whole numbers from 0 on")
    if not isinstance(noise_duration, Real) or not 0 < noise_duration < np.inf:
        raise AbraceError(f"noise_duration {noise_duration!r}: expected seconds above 0")
    count = round(noise_duration / period)
    made = [(f"noise {seed}", banded_noise(count, 1 / period, NOISE_BAND, 1.0, int(seed))) for seed in seeds]
    return [_recorded(each, period) for each in several(records)] + made


def _recorded(given: Record | Path | str, period: float) -> tuple[str, NDArray[np.float64]]:
    record = given if isinstance(given, Record) else read_record(given)
    return record.name, prepare(record, 1 / period, Treatment(band_limit=BAND_LIMIT))


def _unit(name: str, ground: NDArray[np.float64]) -> NDArray[np.float64]:
    peak = np.abs(ground).max(initial=0.0)
    if not peak > 0:
        raise AbraceError(f"record {name}: the ground does not move, expected an earthquake")
    return np.asarray(ground / peak)


class Acting(NamedTuple):
    """Interlocks of a rig, what they need to compare sensors, and warnings of those that cannot act."""

    interlocks: tuple[Interlock, ...]
    implausibility: LinearModel | None
    warnings: tuple[str, ...]


def interlocks_of(model: LinearModel, given: AnyRig | None, period: float) -> Acting:
    """The interlocks of a rig that act in simulations of a model.

    Parameters
    ----------
    model
        Whose outputs are watched.
    given
        The rig; None: no interlocks.
    period
        Of the samples [s].
    """
    if given is None:
        return Acting((), None, ())
    rig = replace(rig_of(given), sample_rate=1 / period)
    found = detectors(rig)
    noise = found.noise(sensor_noise(rig))
    table = {kind: each for kind, each in limit_table(rig, noise).items() if each.action == "stop"}
    of_forces = {}
    if "force" in table and rig.groups:
        of_groups = group_limits(rig, table["force"], noise["force"])
        of_forces = {meaning(f"f{i}"): limit for i, limit in enumerate(of_groups.tolist(), 1)}

    def interlock(kind: str, quantity: str, value: float, settling: int = 0) -> Interlock:
        return Interlock(quantity, value, max(1, int(np.ceil(table[kind].time / period - 1e-9))), settling)

    watched = {kind: pattern for kind, pattern in WATCHED.items() if kind in table}
    names = with_drifts(model).outputs
    of_rig = (*(f"d{i + 1}" for i in range(rig.floors)), *response_names(rig.floors, rig.groups))
    known = {meaning(name) for name in names}
    missing = [
        name
        for pattern in watched.values()
        for name in of_rig
        if re.fullmatch(pattern, name) and meaning(name) not in known
    ]
    acting = [
        interlock(kind, name, of_forces.get(meaning(name), table[kind].value))
        for kind, pattern in watched.items()
        for name in names
        if re.fullmatch(pattern, name)
    ]
    rows = [i for i, each in enumerate(found.quantities) if each.interlock in COMPARED and each.interlock in table]
    for row in rows:
        kind, name = found.quantities[row].interlock, found.quantities[row].name
        acting.append(interlock(kind, name, table[kind].value, found.settling if kind == SETTLES else 0))
    if "stuck" in table and all(sensor.noise >= sensor.step for sensor in rig.channel_sensors):
        acting.append(interlock("stuck", STUCK, 0.5))
    warnings = (
        (f"rig {rig.name}: no interlocks of {', '.join(missing)}, which the model does not have",) if missing else ()
    )
    return Acting(tuple(acting), _comparison(found, rows, rig.channel_names, period) if rows else None, warnings)


def _comparison(found: Detectors, rows: list[int], channels: tuple[str, ...], period: float) -> LinearModel:
    """The filters of these `rows` of a rig's detectors, from its `channels`; `period` [s]."""
    states = len(found.at_rest)
    a, b = found.step[:states, :states], found.step[:states, states : states + len(channels)]
    c, d = found.step[states:][rows, :states], found.step[states:][rows, states : states + len(channels)]
    seen = np.any(c, axis=0)
    while np.any(grown := np.any(a[seen], axis=0) & ~seen):
        seen |= grown
    names = tuple(found.quantities[row].name for row in rows)
    return LinearModel(a[np.ix_(seen, seen)], b[seen], c[:, seen], d, channels, names, period)
