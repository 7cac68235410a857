"""Sets of weights tried in parallel, on a Dask cluster of this machine's cores or on one that runs already.

The processes of this machine's cluster end with the `with` block, whether it succeeds or fails; a cluster that ran
already keeps running. Dask's own log is silenced: failures are raised as AbraceError. An outcome does not depend on the
process that computes it.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import tempfile
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError
from abrace_lqg.exploration.study import evaluate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from distributed import Client, LocalCluster

    from abrace_lqg.exploration.study import Outcome, Study
    from abrace_lqg.weights import Weights

BATCH = 4
"""Sets that a process evaluates at a time: few enough for a progress display, many enough to make messages cheap."""

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
    from distributed.comm.addressing import resolve_address

    for name in ("distributed", "tornado"):
        for handler in logging.getLogger(name).handlers:
            handler.setLevel(SILENT)
    with contextlib.ExitStack() as stack:
        address = scheduler or stack.enter_context(_local_cluster(workers)).scheduler_address
        try:
            resolve_address(address)
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
        stack.enter_context(dask.config.set({"distributed.nanny.pre-spawn-environ": ENVIRONMENT}))
        resource_tracker.ensure_running()  # before signals are blocked, as its start unblocks them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:  # threads started now, and the processes that these start, keep the signal blocked
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


def explore(
    study: Study,
    sets: Sequence[Weights],
    client: Client,
    progress: Callable[[int], None] = lambda _done: None,
) -> list[Outcome]:
    """Evaluate all sets of weights in the processes of a Dask cluster.

    Parameters
    ----------
    study
        Models and records; sent to each process once.
    sets
        Numbered from 0.
    client
        Of the cluster, as `cluster` gives it.
    progress
        Called with the number of evaluated sets, after each batch.

    Returns
    -------
    list
        An outcome for each set, in their order.

    Raises
    ------
    AbraceError
        If the models lack a measured quantity, or a process of the cluster fails.
    """
    from distributed import as_completed

    for weights in sets[:1]:
        unknown = set(weights.measured) - set(study.plant.outputs)
        if unknown or len(set(weights.measured)) < len(weights.measured):
            raise AbraceError(
                f"measured quantities {', '.join(weights.measured)}: expected each once, out of "
                f"{', '.join(study.plant.outputs)}"
            )
    shared = client.scatter(study, broadcast=True, hash=False)
    numbered = list(enumerate(sets))
    batches = [numbered[first : first + BATCH] for first in range(0, len(sets), BATCH)]
    futures = [client.submit(_evaluate_all, shared, batch, pure=False) for batch in batches]
    outcomes: list[Outcome] = []
    for future in as_completed(futures, loop=client.loop):
        if future.status != "finished":
            raise AbraceError(f"exploration: the work failed: {future.exception()!r}")
        outcomes += future.result()
        progress(len(outcomes))
    return sorted(outcomes, key=lambda outcome: outcome.number)


def _evaluate_all(study: Study, sets: Sequence[tuple[int, Weights]]) -> list[Outcome]:
    return [evaluate(study, number, weights) for number, weights in sets]
