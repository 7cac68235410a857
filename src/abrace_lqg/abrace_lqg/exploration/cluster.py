"""The processes that an exploration is spread over: a Dask cluster of this machine's cores, or one that runs already.

A cluster of our own is gone when the block ends, in whatever way; one that was there stays. Dask's own log stays
silent: what goes wrong comes as an AbraceError.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import tempfile
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from distributed import Client, LocalCluster

PATIENCE = 10.0
"""Seconds that a scheduler and its workers have to answer."""

SILENT = logging.CRITICAL + 1

ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    **dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**28)),
    "DASK_LOGGING__DISTRIBUTED": "critical",
}
"""Of each process. Dask would have it give back every freed array of a record's length, which doubles the time."""


@contextlib.contextmanager
def cluster(scheduler: str = "", workers: int | None = None) -> Iterator[Client]:
    """A client of a Dask cluster, while the block runs.

    Parameters
    ----------
    scheduler
        Address of one that runs, such as tcp://127.0.0.1:8786; empty: a cluster of this machine, with one thread a
        process.
    workers
        Processes of this machine's cluster; None: one for each core.

    Raises
    ------
    AbraceError
        If the scheduler does not answer or has no workers.
    """
    from distributed import Client
    from distributed.comm.addressing import resolve_address

    for name in ("distributed", "tornado"):
        for handler in logging.getLogger(name).handlers:
            handler.setLevel(SILENT)
    with contextlib.ExitStack() as stack:
        address = scheduler or stack.enter_context(_local_cluster(workers)).scheduler_address
        try:
            resolve_address(address)
            client = stack.enter_context(Client(address, timeout=PATIENCE, set_as_default=False))
        except (OSError, ValueError) as error:  # a TimeoutError is an OSError
            raise AbraceError(
                f"Dask scheduler {address}: does not answer, expected an address such as tcp://127.0.0.1:8786"
            ) from error
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise AbraceError(f"Dask scheduler {address}: has no workers, expected at least one") from error
        yield client


@contextlib.contextmanager
def _local_cluster(workers: int | None) -> Iterator[LocalCluster]:
    """A cluster of this machine whose processes leave a Ctrl-C at the terminal to us, who then end them."""
    import dask
    from distributed import LocalCluster

    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="abrace_explore_"))
        stack.enter_context(dask.config.set({"distributed.nanny.pre-spawn-environ": ENVIRONMENT}))
        resource_tracker.ensure_running()  # it would unblock signals in the thread that starts it
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:  # threads started now, and the processes that these start, have the signal blocked for good
            running = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                memory_limit=None,
                local_directory=folder,
                silence_logs=logging.CRITICAL,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield stack.enter_context(running)
