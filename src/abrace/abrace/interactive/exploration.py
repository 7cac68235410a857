# SPDX-License-Identifier: Apache-2.0
"""Many sets of weights tried: what response, force and margins each would have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.controllers import of_rig
from abrace.interactive.fragility import ground_motions, interlocks_of
from abrace.interactive.given import model_of, warn, weights_of
from abrace.interactive.models import covariance_of
from abrace_core.errors import AbraceError
from abrace_core.tables import data_frame
from abrace_lqg.exploration.ensemble import Record as Motion
from abrace_lqg.exploration.figure import robust_figure, trade_off
from abrace_lqg.exploration.report import ranked
from abrace_lqg.exploration.run import explore as run_exploration
from abrace_lqg.exploration.study import Study
from abrace_lqg.exploration.weight_sets import SPANS, weight_sets
from abrace_lqg.fragility.study import ensemble, faults_of
from abrace_lqg.of_model import excitation_of
from abrace_lqg.scaling import scaled_weights

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.given import AnyModel, AnyRig
    from abrace_lqg.exploration.study import Outcome
    from abrace_lqg.weights import Weights
    from abrace_plant.records.record import Record


@dataclass(frozen=True)
class Explored:
    """What the sets of weights of an exploration do.

    Parameters
    ----------
    outcomes
        Of all sets; set 0 is the given weights. `outcomes[17].weights` is what `design` takes.
    quantile
        Share of the loops that respond no more than a set's robust response.
    """

    outcomes: tuple[Outcome, ...]
    quantile: float

    def __repr__(self) -> str:
        refused = sum(bool(outcome.refused) for outcome in self.outcomes)
        return f"<Explored: {len(self.outcomes)} sets of weights, {refused} without a controller>"

    def to_pandas(self) -> pandas.DataFrame:
        """The sets that give a controller: rms over that with zero command, rms command [N], margins, rank.

        The rank is the place of the robust response among sets that take no more force than the given weights; not a
        number: one takes more.
        """
        found = [outcome for outcome in self.outcomes if outcome.command and outcome.margins]
        ranks = {outcome.number: rank for rank, outcome in enumerate(ranked(self.outcomes), 1)}
        columns: dict[str, list[Any]] = {
            "displacement": [outcome.response("displacement") for outcome in found],
            "acceleration": [outcome.response("acceleration") for outcome in found],
            "robust displacement": [outcome.robust["displacement"] for outcome in found],
            "robust acceleration": [outcome.robust["acceleration"] for outcome in found],
            "rank": [ranks.get(outcome.number, np.nan) for outcome in found],
            "command [N]": [outcome.command.rms for outcome in found if outcome.command],
            "saturated": [outcome.saturated for outcome in found],
            "gain margin [dB]": [outcome.margins.gain for outcome in found if outcome.margins],
            "phase margin [deg]": [outcome.margins.phase for outcome in found if outcome.margins],
            "delay margin [s]": [outcome.margins.delay for outcome in found if outcome.margins],
        }
        return data_frame(columns, "set", [outcome.number for outcome in found])

    def plot(self, what: str = "trade_off", picked: Sequence[int] = ()) -> Figure:
        """A figure.

        Parameters
        ----------
        what
            "trade_off" (response against force, coloured by margins) or "robust" (robust responses against mean ones).
        picked
            Numbers of sets to mark in the trade-off.

        Raises
        ------
        AbraceError
            If it is neither of these, or no set gave a controller.
        """
        if what == "robust":
            return robust_figure(self.outcomes, self.quantile)
        if what != "trade_off":
            raise AbraceError(f"figure {what!r} of an exploration: expected trade_off or robust")
        return trade_off(self.outcomes, picked)


def explore(
    model: AnyModel,
    weights: Weights | Path | str = "lqg3",
    *,
    simulation_model: AnyModel | None = None,
    records: Sequence[Record | Path | str] = (),
    noise: Sequence[int] = (),
    noise_duration: float = 40.0,
    peak_acceleration: float | Sequence[float] = 0.980665,
    models: int = 1,
    faults: Mapping[str, float | Sequence[float]] | None = None,
    quantile: float = 0.9,
    sets: int = 256,
    spans: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    rig: AnyRig | None = None,
    sample_period: float | None = None,
    force_limit: float | Sequence[float] | None = None,
    folder: Path | str = "results/exploration",
    scheduler: str = "",
    workers: int | None = None,
) -> Explored:
    """Design and simulate many sets of weights around given ones.

    The loops are kept in `loops` of the folder, batch by batch: the same call continues where it was interrupted.

    Parameters
    ----------
    model
        To design with. Of an identification that is its reduced model, and the full one simulates.
    weights
        In the middle: weights, their file, or the name of some.
    simulation_model
        To simulate with, and for the margins; None: the same.
    records, noise, noise_duration
        Ground motions, as for `fragility`.
    peak_acceleration
        To which each is scaled, one or several, rising [m/s^2].
    models, faults
        As for `fragility`; the models are drawn about the one to simulate with.
    quantile
        Share of the loops that respond no more than a set's robust response, by which sets are ranked.
    sets
        How many sets are tried in addition to the given one.
    spans
        Lowest and highest power of ten that a weight is multiplied by, by its name; None: those of the node `explore`.
    seed
        Of the quasi-random sets and of the models drawn.
    rig, sample_period, force_limit
        As for `design`; the rig's interlocks act, as for `fragility`.
    folder
        For the results.
    scheduler
        Address of a Dask scheduler; empty: the cores of this machine.
    workers
        Number of processes of this machine; None: one for each core.

    Raises
    ------
    AbraceError
        If something given does not fit, or the folder has results of another exploration.
    """
    designed_with, simulated = model_of(model, design=True), model_of(simulation_model or model)
    period, limit = of_rig(designed_with, rig, sample_period, force_limit)
    middle = scaled_weights(designed_with, weights_of(weights)[0], period, limit, excitation_of(designed_with))
    tried = weight_sets(middle, {**SPANS, **(spans or {})}, sets, seed)
    motions = [Motion(name, ground) for name, ground in ground_motions(records, noise, noise_duration, period)]
    acting = interlocks_of(simulated, rig, period)
    warn(acting.warnings)
    given = simulation_model or model
    study = Study.of(
        designed_with,
        ensemble(simulated, covariance_of(given), models, seed, str(given)),
        motions,
        intensities=[float(each) for each in np.atleast_1d(peak_acceleration)],
        capacity=np.array(limit),
        sample_period=period,
        faults=faults_of(faults or {}),
        interlocks=acting.interlocks,
        implausibility=acting.implausibility,
        quantile=quantile,
    )
    found = run_exploration(study, tried, Path(folder) / "loops", scheduler=scheduler, workers=workers)
    return Explored(tuple(found), quantile)
