# SPDX-License-Identifier: Apache-2.0
"""The closed loops of a batch, as a table with a row each.

Without saturation a loop is linear: it is run through once for each motion, and its results are scaled to every
intensity. Only where that would ask for more than a controller's force limit is the saturating loop run, and only where
an interlock's limit is passed, or a sensor fails, is it looked at sample by sample: the first sample at which a limit
has been exceeded for its time ramps the command to zero. Interlocks see what sensors read, failing ones included. All
three give the samples of `abrace_core.simulation`, to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow

from abrace_core.linear_model import takes_models
from abrace_core.loop_extremes import loop_extremes
from abrace_core.response import peak_rms_of
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_core.simulation import simulate, simulate_closed_loop
from abrace_lqg.fragility.study import INTACT, STUCK, ZERO_COMMAND

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.controller_file import Controller
    from abrace_core.linear_model import LinearModel
    from abrace_lqg.fragility.study import Case, Fault, FragilityStudy, Interlock

NO_TRIP = "none"


@dataclass
class _Found:
    """Results of a case: arrays whose first two dimensions are motions and intensities, then the names."""

    names: tuple[str, ...]
    peak: NDArray[np.float64]
    rms: NDArray[np.float64]
    saturated: NDArray[np.int64]
    interlock: NDArray[np.int32]
    trip_time: NDArray[np.float64]


def compute_batch(study: FragilityStudy, batch: Sequence[Case]) -> pyarrow.Table:
    """Run the loops of a batch.

    Parameters
    ----------
    study
        Models, controllers, faults, motions and intensities.
    batch
        Some of its cases.

    Returns
    -------
    pyarrow.Table
        A row for each loop: `model` (number), `controller`, `fault`, `motion`, `intensity`, `saturated` (samples at
        which a command was at its limit), `interlock` (the quantity whose interlock acted), `trip_time` [s] (not a
        number: none acted), and `peak_NAME` and `rms_NAME` of every output and command [SI units].
    """
    number, plant = -1, study.models[0]
    tables = []
    for case in batch:
        if case.model != number:
            number, plant = case.model, study.plant(case.model)
        tables.append(_table(study, case, _run_case(study, plant, case)))
    return pyarrow.concat_tables(tables).combine_chunks()


@takes_models
def faulty(law: LinearModel, fault: Fault) -> LinearModel:
    """The `law` as it acts when one of its sensors has the `fault`."""
    factors = np.array([fault.factor if name == fault.sensor else 1.0 for name in law.inputs])
    return replace(law, b=law.b * factors, d=law.d * factors)


def _run_case(study: FragilityStudy, plant: LinearModel, case: Case) -> _Found:
    chosen = np.arange(case.first, case.last)
    intensities = np.array(study.intensities)
    shape = (len(chosen), len(intensities))
    controller = None if case.controller is None else study.controllers[case.controller]
    law = None if controller is None else controller.law
    if law is not None and case.fault is not None:
        law = faulty(law, study.faults[case.fault])
    unit = loop_extremes(plant, law, study.motions, chosen=chosen)
    found = _Found(
        unit.names,
        unit.peak[:, None] * intensities[:, None],
        unit.rms[:, None] * intensities[:, None],
        np.zeros(shape, dtype=np.int64),
        np.zeros(shape, dtype=np.int32),
        np.full(shape, np.nan),
    )
    if controller is None or law is None:
        return found
    asked = found.peak[..., len(plant.outputs) :]
    motion, level = np.nonzero((asked >= controller.force_limit).any(axis=2))
    if len(motion):
        cut = loop_extremes(
            plant,
            law,
            study.motions,
            controller.force_limit,
            controller.correction,
            chosen=chosen[motion],
            scale=intensities[level],
        )
        found.peak[motion, level], found.rms[motion, level] = cut.peak, cut.rms
        found.saturated[motion, level] = cut.saturated
    _trip(study, plant, replace(controller, law=law), case, found)
    return found


def _trip(study: FragilityStudy, plant: LinearModel, controller: Controller, case: Case, found: _Found) -> None:
    """Run the loops in which an interlock acts again, with the command ramped to zero from there on."""
    if not study.interlocks:
        return
    fault = None if case.fault is None else study.faults[case.fault]
    limits = {each.quantity: each.value for each in study.interlocks}
    over = [found.peak[..., i] > limits[name] for i, name in enumerate(plant.outputs) if name in limits]
    suspects = np.any(over, axis=0) if fault is None and over else np.full(found.saturated.shape, fault is not None)
    for motion, level in np.argwhere(suspects):
        number = case.first + motion
        ground = study.motions.ground[number, : study.motions.samples[number]] * study.intensities[level]
        outputs, commands = simulate_closed_loop(
            plant, controller.law, ground, controller.force_limit, controller.correction
        )
        watched = _watched(study, plant, outputs, fault)
        trips = [
            _first_trip(watched[each.quantity], each) if each.quantity in watched else len(ground)
            for each in study.interlocks
        ]
        sample = min(trips)
        if sample >= len(ground):
            continue
        acted = _ramped(commands, sample, plant.sample_period)
        outputs = simulate(plant, np.column_stack([ground, np.vstack([acted[1:], acted[-1:]])]))
        table = peak_rms_of(found.names, np.hstack([outputs, acted]))
        found.peak[motion, level], found.rms[motion, level] = np.array(list(table.values())).T
        found.saturated[motion, level] = np.count_nonzero((np.abs(acted) >= controller.force_limit).any(axis=1))
        found.interlock[motion, level] = 1 + trips.index(sample)
        found.trip_time[motion, level] = sample * plant.sample_period


def _watched(
    study: FragilityStudy, plant: LinearModel, outputs: NDArray[np.float64], fault: Fault | None
) -> dict[str, NDArray[np.float64]]:
    """What interlocks see of the `outputs` (samples, outputs), by quantity; intact sensors fit each other."""
    seen = dict(zip(plant.outputs, outputs.T, strict=True))
    if fault is None:
        return seen
    error = (fault.factor - 1.0) * seen[fault.sensor]
    seen[fault.sensor] = seen[fault.sensor] + error
    seen[STUCK] = np.full(len(error), float(fault.factor == 0.0))
    if fault.sensor[0] == "x" and fault.sensor[1:].isdigit():
        storey = int(fault.sensor[1:])
        for drift, sign in ((f"d{storey}", 1.0), (f"d{storey + 1}", -1.0)):
            if drift in seen:
                seen[drift] = seen[drift] + sign * error
    if study.implausibility and fault.sensor in study.implausibility.inputs:
        compared = study.implausibility.select(inputs=[fault.sensor])
        seen |= dict(zip(compared.outputs, simulate(compared, error[:, None]).T, strict=True))
    return seen


def _first_trip(values: NDArray[np.float64], interlock: Interlock) -> int:
    """The first sample at which a limit has been exceeded for its time; the number of samples if there is none."""
    over = np.abs(values) > interlock.value
    over[: interlock.settling] = False
    if not over.any():
        return len(values)
    ended = np.flatnonzero(np.convolve(over, np.ones(interlock.samples))[: len(over)] > interlock.samples - 0.5)
    return int(ended[0]) if len(ended) else len(values)


def _ramped(commands: NDArray[np.float64], sample: int, sample_period: float) -> NDArray[np.float64]:
    """The `commands` (samples, commands), in force until each sample, after an interlock acted at a `sample`."""
    steps = round(RAMP_TIME / sample_period)
    after = np.arange(len(commands)) - sample
    share = np.clip(1 - after / steps, 0.0, 1.0)[:, None]
    return np.where((after > 0)[:, None], commands[sample] * share, commands)


def _table(study: FragilityStudy, case: Case, found: _Found) -> pyarrow.Table:
    motions, levels = found.saturated.shape
    count = motions * levels
    controllers = [ZERO_COMMAND, *(controller.name for controller in study.controllers)]
    faults = [INTACT, *(fault.name for fault in study.faults)]
    trips = [NO_TRIP, *(each.quantity for each in study.interlocks)]
    columns = {
        "model": np.full(count, case.model, dtype=np.int32),
        "controller": _words(np.full(count, 0 if case.controller is None else 1 + case.controller), controllers),
        "fault": _words(np.full(count, 0 if case.fault is None else 1 + case.fault), faults),
        "motion": _words(np.repeat(np.arange(case.first, case.last), levels), study.motion_names),
        "intensity": np.tile(study.intensities, motions),
        "saturated": found.saturated.ravel().astype(np.int32),
        "interlock": _words(found.interlock.ravel(), trips),
        "trip_time": found.trip_time.ravel(),
    }
    peak, rms = found.peak.reshape(count, -1), found.rms.reshape(count, -1)
    for j, name in enumerate(found.names):
        columns |= {f"peak_{name}": peak[:, j], f"rms_{name}": rms[:, j]}
    return pyarrow.table(columns)


def _words(numbers: NDArray, names: Sequence[str]) -> pyarrow.DictionaryArray:
    return pyarrow.DictionaryArray.from_arrays(pyarrow.array(numbers, pyarrow.int32()), pyarrow.array(names))
