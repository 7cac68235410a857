# SPDX-License-Identifier: Apache-2.0
"""Many closed loops: sets of weights tried; how likely limits are exceeded under uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, model_of, rig_of, several, takes, weights_of
from abrace.interactive.models import covariance_of, distrust_of
from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_lqg.proof.limits import DesignOptions, excitation_of, force_limit_of, of_rig, sample_period_of
from abrace_lqg.scaling import scaled_weights
from abrace_studies.batches.loop_extremes import Motions
from abrace_studies.exploration.explored import Explored
from abrace_studies.exploration.explored import explore as explore_sets
from abrace_studies.exploration.files import save_exploration
from abrace_studies.exploration.study import Study
from abrace_studies.exploration.weight_sets import weight_sets
from abrace_studies.fragility.assessment import run_study
from abrace_studies.fragility.study import FragilityStudy, ensemble, faults_of
from abrace_studies.ground_motions import ground_motions
from abrace_studies.options import ExploreOptions, FragilityOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace.interactive.given import AnyController, AnyModel, AnyRig, AnyWeights
    from abrace_core.model.linear_model import LinearModel
    from abrace_plant.records.record import Record
    from abrace_studies.fragility.assessment import Fragility
    from abrace_studies.ground_motions import GroundMotion
    from abrace_studies.options import StudyOptions

PERIOD = 0.002
"""Sample period without a controller [s]."""


@takes(FragilityOptions)
def fragility(
    model: AnyModel,
    controllers: AnyController | Sequence[AnyController] = (),
    *,
    records: Record | Path | str | Sequence[Record | Path | str] = (),
    rig: AnyRig | None = None,
    folder: Path | str = "results/fragility",
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Fragility:
    """Run closed loops of every model, controller, fault, record and intensity, and fit fragility curves.

    The zero command is always among the controllers. Commands are cut at each controller's force limit. Results are
    kept in the folder, batch by batch: the same call continues where it was interrupted.

    Parameters
    ----------
    model
        To simulate with, with inputs and outputs of any names; it is converted to SI units.
    controllers
        To try.
    records
        Known names, files, bags, or Records.
    rig
        Whose braces' capacity limits a law of one's own; None: what the model knows of it.
    folder
        For the results.
    progress
        Called with the numbers of finished batches and of all; None: nothing is.
    **options
        As `FragilityOptions` has them.

    Raises
    ------
    AbraceError
        If something given does not fit, or the folder has results of another study.
    """
    checked = FragilityOptions.of(options)
    linear = model_of(model)
    limit = linear.provenance.get("force_limit", ()) if rig is None else rig_of(rig).capacity
    tried = tuple(controller_of(each, limit) for each in several(controllers))
    period = checked.sample_period or (tried[0].law.sample_period if tried else PERIOD)
    roles = DesignOptions(commands=tried[0].law.outputs if tried else (), disturbance=checked.disturbance)
    drawn = ensemble(linear, covariance_of(model), checked.models, checked.seed, str(model))
    models = tuple(roles.for_control(each) for each in drawn)
    motions = [motion.scaled(1.0) for motion in _motions(models[0], several(records), checked, period)]
    study = FragilityStudy(
        models,
        tried,
        faults_of(checked.faults),
        Motions.of(motion.ground_acceleration for motion in motions),
        tuple(motion.name for motion in motions),
        checked.intensities,
        period,
    )
    return run_study(
        study,
        {name: value for name, (value,) in checked.limits.items()},
        folder,
        scheduler=checked.scheduler,
        workers=checked.workers or None,
        progress=progress or (lambda _done, _all: None),
    )


@takes(ExploreOptions)
def explore(
    model: AnyModel,
    weights: AnyWeights = "lqg3",
    *,
    simulation_model: AnyModel | None = None,
    records: Record | Path | str | Sequence[Record | Path | str] = (),
    rig: AnyRig | None = None,
    folder: Path | str = "results/exploration",
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Explored:
    """Design and simulate many sets of weights around given ones.

    The loops are kept in `loops` of the folder, batch by batch: the same call continues where it was interrupted.

    Parameters
    ----------
    model
        To design with, with inputs and outputs of any names. Of an identification that is its reduced model, and the
        full one simulates.
    weights
        In the middle: weights, their keys and values, their file, or the name of some.
    simulation_model
        To simulate with, and for the margins; None: the same.
    records
        Ground motions, as for `fragility`.
    rig
        As for `design`.
    folder
        For the results: `exploration.json`, `exploration.csv` and the models.
    progress
        Called with the numbers of sets that are done, and of all; None: nothing is.
    **options
        As `ExploreOptions` has them.

    Raises
    ------
    AbraceError
        If something given does not fit, or the folder has results of another exploration.
    """
    given = simulation_model or model
    middle, name = weights_of(weights)
    checked, read = ExploreOptions.of(options), (model_of(model, design=True), model_of(given))
    roles = DesignOptions(commands=checked.commands, disturbance=checked.disturbance)
    designs = roles.for_control(read[0])
    if rig is not None:
        known = rig_of(rig)
        checked = of_rig(checked, known.sample_rate, known.capacity)
    period, limit = sample_period_of(designs, checked.sample_period), force_limit_of(designs, checked.force_limit)
    if checked.measured:
        middle = middle.model_copy(update={"measured": list(checked.measured)})
    excitation = excitation_of(designs, checked.excitation_rms, sample_period=period)
    middle = scaled_weights(designs, middle, period, limit, excitation)
    spans, covariance = checked.spans(middle, designs.outputs), covariance_of(given)
    tried = weight_sets(middle, spans, checked.sets, checked.seed)
    study = Study.of(
        designs,
        [roles.for_control(each) for each in ensemble(read[1], covariance, checked.models, checked.seed, str(given))],
        _motions(designs, several(records), checked, period),
        intensities=checked.peak_acceleration,
        capacity=np.array(limit),
        sample_period=period,
        faults=faults_of(checked.faults),
        quantile=checked.quantile,
    )
    outcomes = explore_sets(
        study,
        tried,
        Path(folder) / "loops",
        scheduler=checked.scheduler,
        workers=checked.workers or None,
        progress=lambda done: progress(done, len(tried)) if progress else None,
    )
    made_from = {"model": str(model), "simulation_model": str(given), "weights": name}
    facts = {**made_from, "spans": spans, "seed": checked.seed}
    distrust = [*dict.fromkeys([*distrust_of(model), *distrust_of(given)])]
    named = checked.model_dump(include={"commands", "disturbance"})
    save_exploration(folder, study, outcomes, read, facts, covariance, distrust, named)
    return Explored(tuple(outcomes), checked.quantile)


def _motions(
    model: LinearModel, records: Sequence[Record | Path | str], options: StudyOptions, sample_period: float
) -> list[GroundMotion]:
    """The motions that drive a `model`; records, which are accelerations, only where its first input may be one."""
    name, unit = model.inputs[0], model.unit(model.inputs[0])
    if records and unit not in ("-", signals.unit(signals.GROUND)):
        raise AbraceError(f"records of an acceleration for {name} [{unit}], expected noise")
    return ground_motions(records, options, sample_period)
