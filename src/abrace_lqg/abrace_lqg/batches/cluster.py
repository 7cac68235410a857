# SPDX-License-Identifier: Apache-2.0
"""Batches of work computed on a Dask cluster, of this machine's cores or one that runs already.

The processes of this machine's cluster end with the `with` block, whether it succeeds or fails; a cluster that ran
already keeps running. Dask's own log is silenced: failures are raised as AbraceError. A batch whose process is killed
is computed again, and no other; what it gives does not depend on the process that computes it.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import signal
import socket
import sys
import tempfile
import warnings
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, TypeVar

from abrace_core.errors import AbraceError, RunFailed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from distributed import Client, Future, LocalCluster

Shared = TypeVar("Shared")
Batch = TypeVar("Batch")
Result = TypeVar("Result")

AHEAD = 3
"""Batches that are handed out for each process: one is computed, the next wait, and memory stays flat."""

KILLED = 20
"""Processes that may be killed over one batch before it is taken for the cause."""

TIMEOUT = 10.0
"""Seconds within which a scheduler and its workers have to answer."""

SILENT = logging.CRITICAL + 1

ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    **dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**28)),
    "DASK_LOGGING__DISTRIBUTED": "critical",
}
"""Of each process. Without these thresholds every freed array of a record's length returns to the system, which doubles
the time."""

CONFIGURATION = {
    "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
    "distributed.scheduler.allowed-failures": KILLED,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
}
"""Settings of this machine's cluster: its profiler's hundred samples a second would cost more than the messages."""


@contextlib.contextmanager
def cluster(scheduler: str = "", workers: int | None = None) -> Iterator[Client]:
    """A client of a Dask cluster, for the duration of a `with` block.

    Parameters
    ----------
    scheduler
        Address of a running scheduler, such as tcp://127.0.0.1:8786; empty: a cluster of this machine is started, one
        thread per process.
    workers
        Number of processes of this machine's cluster; None: one for each core.

    Raises
    ------
    AbraceError
        If the scheduler does not answer or has no workers.
    """
    from distributed import Client
    from distributed.comm.addressing import get_address_host_port, resolve_address

    for name in ("distributed", "tornado"):
        for handler in logging.getLogger(name).handlers:
            handler.setLevel(SILENT)
    with contextlib.ExitStack() as stack:
        address = scheduler or stack.enter_context(_local_cluster(workers)).scheduler_address
        try:
            resolve_address(address)
            socket.create_connection(get_address_host_port(address), TIMEOUT).close()  # Dask would ask for TIMEOUT
            client = stack.enter_context(Client(address, timeout=TIMEOUT, set_as_default=False))
        except (OSError, ValueError) as error:  # a TimeoutError is an OSError
            raise AbraceError(
                f"Dask scheduler {address}: does not answer, expected an address such as tcp://127.0.0.1:8786"
            ) from error
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError as error:
            raise AbraceError(f"Dask scheduler {address}: has no workers, expected at least one") from error
        yield client


@contextlib.contextmanager
def _local_cluster(workers: int | None) -> Iterator[LocalCluster]:
    """A cluster of this machine whose processes ignore Ctrl-C at the terminal; this process ends them."""
    import dask
    from distributed import LocalCluster

    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="abrace_explore_"))
        stack.enter_context(dask.config.set(CONFIGURATION))
        stack.enter_context(_without_main())
        resource_tracker.ensure_running()  # before signals are blocked, as its start unblocks them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:  # threads started now, and the processes that these start, keep the signal blocked
            running = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                memory_limit=None,
                local_directory=folder,
                silence_logs=logging.CRITICAL,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield stack.enter_context(running)


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Keep processes that are started in this block from importing the script that runs, as multiprocessing has it.

    They need nothing of it, and a script without `if __name__ == "__main__":` would run again in each of them.
    """
    main = sys.modules["__main__"]
    hidden: dict[str, Any] = {name: vars(main).pop(name) for name in ("__file__", "__spec__") if name in vars(main)}
    main.__spec__ = None
    try:
        yield
    finally:
        vars(main).update(hidden)


def compute(
    client: Client,
    function: Callable[[Shared, Batch], Result],
    shared: Shared,
    batches: Iterable[Batch],
    done: Callable[[Batch, Result], None],
) -> None:
    """Compute batches in the processes of a Dask cluster.

    Parameters
    ----------
    client
        Of the cluster, as `cluster` gives it.
    function
        Of a module that the processes can import; gives the result of a batch.
    shared
        What all batches need; sent to each process once.
    batches
        As small as messages are; taken one by one.
    done
        Called with a batch and its result, in the order in which they come; the results are not kept.

    Raises
    ------
    AbraceError
        As `function` raises it.
    RunFailed
        If the scheduler is lost, a batch kills every process that computes it, or `function` fails otherwise.
    """
    from distributed import CancelledError, KilledWorker, as_completed

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        # a task, not scattered: whichever process is killed, the scheduler can have it made again
        common = client.submit(_same, shared, pure=False)
    waiting = iter(batches)
    running: dict[Future, tuple[Batch, int]] = {}
    finished = as_completed(loop=client.loop)

    def start(batch: Batch, killed: int = 0) -> None:
        future = client.submit(function, common, batch, pure=False)
        running[future] = batch, killed
        finished.add(future)

    for batch in _first(waiting, AHEAD * max(1, sum(client.ncores().values()))):
        start(batch)
    while running:
        future = next(finished)
        batch, killed = running.pop(future)
        try:
            result = future.result()
        except KilledWorker as error:
            if killed == KILLED:
                raise RunFailed(f"the work killed its process {KILLED} times, expected no fault in it") from error
            start(batch, killed + 1)
            continue
        except AbraceError:
            raise
        except CancelledError as error:
            raise RunFailed("Dask scheduler lost while the work ran") from error
        except Exception as error:
            raise RunFailed(f"the work failed: {error!r}") from error
        done(batch, result)
        for following in _first(waiting, 1):
            start(following)


def _first(waiting: Iterator[Batch], count: int) -> list[Batch]:
    return list(itertools.islice(waiting, count))


def _same(value: Shared) -> Shared:
    return value
