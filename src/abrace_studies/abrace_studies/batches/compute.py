# SPDX-License-Identifier: Apache-2.0
"""Batches of a long computation, computed where they are missing, in one of three ways that give the same numbers.

A few batches are computed in this process, many by a pool of processes on this machine's cores, and with the address of
a Dask scheduler by its workers. A batch is a second or two of work; linear algebra has one thread in each process, so
that sums do not depend on the way.

The processes of the pool are forked: they begin at once, with what this process has imported, and share its memory.
They ignore Ctrl-C, which this process answers, and end with it, however it ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import signal
import socket
import warnings
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError, RunFailed, __version__
from abrace_core.files.checksum import checksum
from abrace_core.model.one_thread import one_thread
from abrace_studies.batches.parts import Parts

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    import pyarrow

    Work = tuple[Callable[[Any, Any], pyarrow.Table], Any]
    """A function of what all batches need and a batch, and what all need."""
    Running = tuple[dict[Any, int], Iterator[Any]]

FEW = 4
"""Batches up to which this process computes them: some seconds."""

TIMEOUT = 10.0
"""Seconds within which a scheduler and its workers have to answer."""

END_WITH_PARENT = 1
"""Linux's PR_SET_PDEATHSIG: the signal that a process gets when the one that forked it ends."""

_work: Work
"""What a process of the pool works on."""


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
    """Compute the batches that a folder has not yet, and write each when it is done.

    Parameters
    ----------
    function
        Gives the table of a batch; for a scheduler one of a module that its workers can import.
    shared
        What all batches need.
    batches
        All batches, those that are done before included.
    folder
        Folder of the results, as `Parts`.
    scheduler
        Address of a running Dask scheduler, such as tcp://127.0.0.1:8786; empty: this machine computes.
    workers
        Number of this machine's processes, 1: this one; None: this one for up to FEW batches, else one for each core.
    progress
        Called with the numbers of finished batches and of all.

    Raises
    ------
    AbraceError
        If the folder has results of other inputs, the scheduler does not answer or has no workers, or as `function`
        raises it.
    RunFailed
        If a process or the scheduler is lost, or `function` fails otherwise; what is finished stays in the folder.
    """
    inputs = checksum([__version__, function.__qualname__, shared, batches])
    parts = Parts(folder, inputs, len(batches))
    missing = parts.missing()
    done = len(batches) - len(missing)
    progress(done, len(batches))
    if workers is None:
        workers = 1 if len(missing) <= FEW else len(os.sched_getaffinity(0))
    work = function, shared
    numbered = [(number, batches[number]) for number in missing]
    found = iter(_results(work, numbered, scheduler, workers))
    with contextlib.closing(found):
        for number, table in found:
            parts.write(number, table)
            done += 1
            progress(done, len(batches))
    parts.clean()


def _results(
    work: Work, numbered: Sequence[tuple[int, Any]], scheduler: str, workers: int
) -> Generator[tuple[int, pyarrow.Table], None, None]:
    """Numbers and tables of `numbered` batches, as they are done; no table is kept."""
    with contextlib.ExitStack() as stack:
        if scheduler and numbered:
            running, finished = stack.enter_context(_of_dask(scheduler, work, numbered))
        elif min(workers, len(numbered)) > 1:
            running, finished = stack.enter_context(_of_pool(min(workers, len(numbered)), work, numbered))
        else:
            yield from ((number, _carry_out(work, batch)) for number, batch in numbered)
            return
        for future in finished:
            yield running.pop(future), future.result()


def _carry_out(work: Work, batch: Any) -> pyarrow.Table:
    function, shared = work
    try:
        with one_thread():
            return function(shared, batch)
    except AbraceError:
        raise
    except Exception as error:
        raise RunFailed(f"the work failed: {error!r}") from error


@contextlib.contextmanager
def _of_pool(workers: int, work: Work, numbered: Sequence[tuple[int, Any]]) -> Iterator[Running]:
    """The `numbered` batches as futures of forked processes, and these futures as they are finished."""
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), _begin, (work,))
    try:
        running = {pool.submit(_in_pool, batch): number for number, batch in numbered}
        yield running, as_completed(list(running))
    except BrokenExecutor as error:
        raise RunFailed(
            "a process that computed was killed, expected none; the same call goes on after what is finished"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(work: Work) -> None:
    """Make a process of the pool one that only computes."""
    global _work
    _work = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)


def _in_pool(batch: Any) -> pyarrow.Table:
    return _carry_out(_work, batch)


@contextlib.contextmanager
def _of_dask(scheduler: str, work: Work, numbered: Sequence[tuple[int, Any]]) -> Iterator[Running]:
    """The `numbered` batches as futures of a Dask scheduler, and these futures as they are finished."""
    from distributed import Client, as_completed
    from distributed.comm.addressing import get_address_host_port, resolve_address

    for name in ("distributed", "tornado"):  # what fails is raised
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        resolve_address(scheduler)
        socket.create_connection(get_address_host_port(scheduler), TIMEOUT).close()  # Dask would ask for TIMEOUT
        client = Client(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        raise AbraceError(
            f"Dask scheduler {scheduler}: does not answer, expected an address such as tcp://127.0.0.1:8786"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError as error:
            raise AbraceError(f"Dask scheduler {scheduler}: has no workers, expected at least one") from error
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sending large graph")
            # a task, not scattered: whichever process is killed, the scheduler can have it made again
            common = client.submit(_same, work, pure=False)
        running = {client.submit(_carry_out, common, batch, pure=False): number for number, batch in numbered}
        try:
            yield running, as_completed(list(running), loop=client.loop)
        except AbraceError:
            raise
        except Exception as error:  # the scheduler is lost, or a batch killed each worker that computed it
            raise RunFailed(f"Dask scheduler {scheduler}: {error!r}, expected it and its workers to run on") from error


def _same(work: Work) -> Work:
    return work
