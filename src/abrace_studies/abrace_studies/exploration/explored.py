# SPDX-License-Identifier: Apache-2.0
"""All sets of weights of an exploration evaluated, batch by batch, and what they do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow

from abrace_core.model.tabular import Tabular
from abrace_studies.batches.compute import compute_missing
from abrace_studies.batches.parts import each_part
from abrace_studies.exploration.files import set_rows
from abrace_studies.exploration.study import judged, try_set
from abrace_studies.fragility.study import BATCH_STEPS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import pandas

    from abrace_lqg.weights import Weights
    from abrace_studies.exploration.study import Outcome, Study

BATCH = 8
"""Sets that a process evaluates at a time, at most, as their designs take time too; fewer where one has many loops."""


@dataclass(frozen=True)
class Explored(Tabular):
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
        """The sets that give a controller, by their numbers: the columns of `exploration.csv`."""
        import pandas

        table = pandas.DataFrame(set_rows(self.outcomes)).set_index("set")
        return table[table["refused"] == ""].drop(columns="refused")


def explore(
    study: Study,
    sets: Sequence[Weights],
    folder: Path | str,
    *,
    scheduler: str = "",
    workers: int | None = None,
    progress: Callable[[int], None] = lambda _done: None,
) -> list[Outcome]:
    """Evaluate all sets of weights, but for those that the folder has results of.

    Parameters
    ----------
    study
        Models and records.
    sets
        Numbered from 0.
    folder
        Folder of the results: a row for each loop.
    scheduler, workers
        As for `compute_missing`.
    progress
        Called with the number of evaluated sets, after each batch.

    Returns
    -------
    list
        An outcome for each set, in their order.

    Raises
    ------
    AbraceError
        If the models lack a measured quantity, a fault is of no sensor that is measured, or as `compute_missing`.
    """
    sets = [weights.of(study.plant.outputs, study.plant.inputs[1:]) for weights in sets]
    numbered = list(enumerate(sets))
    size = min(BATCH, max(1, BATCH_STEPS // (study.count * int(study.loops.motions.samples.max()))))
    batches = [tuple(numbered[first : first + size]) for first in range(0, len(sets), size)]
    compute_missing(
        _try_all,
        study,
        batches,
        folder,
        scheduler=scheduler,
        workers=workers,
        progress=lambda done, _all: progress(min(done * size, len(sets))),
    )
    found = []
    for table in each_part(folder):
        numbers = np.asarray(table["set"])
        found += [judged(study, sets[number], table.filter(numbers == number)) for number in np.unique(numbers)]
    return found


def _try_all(study: Study, batch: Sequence[tuple[int, Weights]]) -> pyarrow.Table:
    tables = [try_set(study, number, weights) for number, weights in batch]
    return pyarrow.concat_tables(tables, promote_options="default").unify_dictionaries().combine_chunks()
