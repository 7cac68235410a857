# SPDX-License-Identifier: Apache-2.0
"""Batches of a long computation, computed where they are missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from abrace_lqg.batches.cluster import cluster, compute
from abrace_lqg.batches.parts import Parts, checksum

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import pyarrow


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
    parts.clean()


def _carry_out(work: _Work, numbered: _Numbered) -> pyarrow.Table:
    return work.function(work.shared, numbered.batch)
