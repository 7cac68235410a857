# SPDX-License-Identifier: Apache-2.0
"""The closed loops of a batch, as a table with a row each.

Without saturation a loop is linear: it is run through once for each motion, and its results are scaled to every
intensity. Only where that would ask for more than a controller's force limit is the saturating loop run. Both give the
samples of `abrace_core.model.simulation`, to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow

from abrace_core.model.linear_model import takes_models
from abrace_studies.batches.loop_extremes import loop_extremes
from abrace_studies.fragility.study import INTACT, ZERO_COMMAND

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.fragility.study import Fault, FragilityStudy, LoopCase


@dataclass
class _Found:
    """Results of a case: arrays whose first two dimensions are motions and intensities, then the names."""

    names: tuple[str, ...]
    peak: NDArray[np.float64]
    rms: NDArray[np.float64]
    saturated: NDArray[np.int64]


def compute_batch(study: FragilityStudy, batch: Sequence[LoopCase]) -> pyarrow.Table:
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
        which a command was at its limit), and `peak_NAME` and `rms_NAME` of every output and command [SI units].
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


def _run_case(study: FragilityStudy, plant: LinearModel, case: LoopCase) -> _Found:
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
    return found


def _table(study: FragilityStudy, case: LoopCase, found: _Found) -> pyarrow.Table:
    motions, levels = found.saturated.shape
    count = motions * levels
    controllers = [ZERO_COMMAND, *(controller.name for controller in study.controllers)]
    faults = [INTACT, *(fault.name for fault in study.faults)]
    columns = {
        "model": np.full(count, case.model, dtype=np.int32),
        "controller": _words(np.full(count, 0 if case.controller is None else 1 + case.controller), controllers),
        "fault": _words(np.full(count, 0 if case.fault is None else 1 + case.fault), faults),
        "motion": _words(np.repeat(np.arange(case.first, case.last), levels), study.motion_names),
        "intensity": np.tile(study.intensities, motions),
        "saturated": found.saturated.ravel().astype(np.int32),
    }
    peak, rms = found.peak.reshape(count, -1), found.rms.reshape(count, -1)
    for j, name in enumerate(found.names):
        columns |= {f"peak_{name}": peak[:, j], f"rms_{name}": rms[:, j]}
    return pyarrow.table(columns)


def _words(numbers: NDArray, names: Sequence[str]) -> pyarrow.DictionaryArray:
    return pyarrow.DictionaryArray.from_arrays(pyarrow.array(numbers, pyarrow.int32()), pyarrow.array(names))
