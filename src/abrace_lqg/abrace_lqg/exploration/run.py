# SPDX-License-Identifier: Apache-2.0
"""Batches of a long computation, computed where they are missing; and the sets of weights of an exploration so."""

from __future__ import annotations

from dataclasses import fields
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow

from abrace_core.errors import AbraceError
from abrace_core.response import PeakRms
from abrace_lqg.analysis.margins import Margins
from abrace_lqg.exploration.cluster import cluster, compute
from abrace_lqg.exploration.parts import Parts, checksum, read_parts
from abrace_lqg.exploration.study import Outcome, evaluate, judged

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from abrace_lqg.exploration.study import Study
    from abrace_lqg.weights import Weights

BATCH = 8
"""Sets that a process evaluates at a time: few enough for a progress display, many enough to make files and messages
cheap."""
MARGINS = tuple(each.name for each in fields(Margins))


class _Numbered(NamedTuple):
    number: int
    batch: Any


class _Work(NamedTuple):
    """What the processes of a cluster are sent: a function of `shared` and a batch, which gives a table."""

    function: Callable[[Any, Any], pyarrow.Table]
    shared: Any


def compute_missing(
    function: Callable[[Any, Any], pyarrow.Table],
    shared: Any,
    batches: Sequence[Any],
    folder: Path | str,
    *,
    scheduler: str = "",
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> None:
    """Compute the batches that a folder has not yet, on a Dask cluster, and write each when it is done.

    Parameters
    ----------
    function
        Of a module that the processes can import; gives the table of a batch.
    shared
        What all batches need.
    batches
        All batches, those that are done before included.
    folder
        Of the results, as `Parts`.
    scheduler, workers
        As for `cluster`; nothing is started where nothing is missing.
    progress
        Called with the numbers of finished batches and of all.

    Raises
    ------
    AbraceError
        If the folder has results of other inputs, or as `cluster` and `compute`.
    """
    parts = Parts(folder, checksum(function.__qualname__, shared, batches), len(batches))
    missing = parts.missing()
    done = len(batches) - len(missing)

    def keep(numbered: _Numbered, table: pyarrow.Table) -> None:
        nonlocal done
        parts.write(numbered.number, table)
        done += 1
        progress(done, len(batches))

    progress(done, len(batches))
    if missing:
        with cluster(scheduler, workers) as client:
            numbered = [_Numbered(number, batches[number]) for number in missing]
            compute(client, _carry_out, _Work(function, shared), numbered, keep)


def _carry_out(work: _Work, numbered: _Numbered) -> pyarrow.Table:
    return work.function(work.shared, numbered.batch)


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
        Of the results: a row for each set and record.
    scheduler, workers
        As for `cluster`.
    progress
        Called with the number of evaluated sets, after each batch.

    Returns
    -------
    list
        An outcome for each set, in their order.

    Raises
    ------
    AbraceError
        If the models lack a measured quantity, or as `compute_missing`.
    """
    for weights in sets[:1]:
        unknown = set(weights.measured) - set(study.plant.outputs)
        if unknown or len(set(weights.measured)) < len(weights.measured):
            raise AbraceError(
                f"measured quantities {', '.join(weights.measured)}: expected each once, out of "
                f"{', '.join(study.plant.outputs)}"
            )
    numbered = list(enumerate(sets))
    batches = [tuple(numbered[first : first + BATCH]) for first in range(0, len(sets), BATCH)]
    compute_missing(
        _evaluate_all,
        study,
        batches,
        folder,
        scheduler=scheduler,
        workers=workers,
        progress=lambda done, _all: progress(min(done * BATCH, len(sets))),
    )
    rows = read_parts(folder).to_pylist()
    return [_outcome(study, sets[number], list(each)) for number, each in groupby(rows, lambda row: int(row["set"]))]


def _evaluate_all(study: Study, batch: Sequence[tuple[int, Weights]]) -> pyarrow.Table:
    names = (*study.plant.outputs, *study.plant.inputs[1:])
    numbers = pyarrow.float64()
    schema = [("set", pyarrow.int32()), ("refused", pyarrow.string()), ("record", pyarrow.string())]
    schema += [(name, numbers) for name in MARGINS] + [("saturated", pyarrow.int64())]
    schema += [(f"{what}_{name}", numbers) for name in names for what in PeakRms._fields]
    rows = [row for number, weights in batch for row in _rows(study, evaluate(study, number, weights))]
    return pyarrow.Table.from_pylist(rows, pyarrow.schema(schema))


def _rows(study: Study, outcome: Outcome) -> list[dict[str, Any]]:
    """A row for each record; of a refused set one."""
    if outcome.refused:
        return [{"set": outcome.number, "refused": outcome.refused}]
    whole: dict[str, Any] = {"set": outcome.number, "refused": "", "saturated": outcome.saturated}
    whole |= {name: getattr(outcome.margins, name) for name in MARGINS}
    found = []
    for record, table in zip(study.records, outcome.records, strict=True):
        values = {f"{what}_{name}": getattr(row, what) for name, row in table.items() for what in PeakRms._fields}
        found.append(whole | {"record": record.name} | values)
    return found


def _outcome(study: Study, weights: Weights, rows: Sequence[dict[str, Any]]) -> Outcome:
    first = rows[0]
    if first["refused"]:
        return Outcome(first["set"], weights, refused=first["refused"])
    names = (*study.plant.outputs, *study.plant.inputs[1:])
    tables = [{name: PeakRms(*(row[f"{what}_{name}"] for what in PeakRms._fields)) for name in names} for row in rows]
    margins = Margins(**{name: first[name] for name in MARGINS})
    return judged(study, first["set"], weights, margins, tables, first["saturated"])
