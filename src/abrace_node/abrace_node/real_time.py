# SPDX-License-Identifier: Apache-2.0
"""Real-time settings of the loop's thread: scheduling priority, processor affinity, locked memory, awake processors.

The parameters have the names of `ros2_control`. A setting that the machine does not allow is a warning with
instructions; the node still runs, with the delays of an ordinary process.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from abrace_core import AbraceError
from abrace_node.parameters import Parameter

PARAMETERS = (
    Parameter(
        "thread_priority",
        0,
        "SCHED_FIFO priority of the loop, a rig's samples have one more; processors stay awake; 0: normal scheduling",
        minimum=0,
        maximum=98,
    ),
    Parameter("cpu_affinity", [], "processors on which the loop runs, by number; empty: all", element=int, minimum=0),
    Parameter("lock_memory", False, "keep all of the node's memory in RAM"),
)

_LIMITS = "as root: echo '@realtime - {limit}' >> /etc/security/limits.d/realtime.conf (docs/computers.md)"
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_CAP_IPC_LOCK = 1 << 14

_WAKE_LATENCY = Path("/dev/cpu_dma_latency")
"""Takes the longest time [us] in which the machine's processors may wake; it applies while the file is open."""

GARBAGE_PERIOD = 60.0
"""Seconds between collections of new garbage, in the second thread. The loop makes no garbage, services little."""


def collect_garbage() -> None:
    """Collect all garbage, and leave the remaining objects out of later collections; up to 0.1 s, so at rest only."""
    gc.unfreeze()
    collect_unfrozen_garbage()


def collect_unfrozen_garbage() -> None:
    """Collect garbage except among objects frozen earlier, and freeze the remaining ones as well."""
    gc.collect()
    gc.freeze()


def collect_new_garbage() -> None:
    """Collect the youngest generation; the duration depends on the number of objects made since the last collection."""
    gc.collect(0)


def _threads() -> Iterator[int]:
    """Numbers of this process's threads: the caller's, and the middleware's, which deliver messages to the loop."""
    return (int(thread.name) for thread in Path("/proc/self/task").iterdir())


def apply(given: Any, warn: Callable[[str], object]) -> None:
    """Apply the parameters to all existing threads, before the first sample.

    Parameters
    ----------
    given
        Values of PARAMETERS, as attributes.
    warn
        Called with a line for each setting that this machine does not allow.

    Raises
    ------
    AbraceError
        If there is no such processor.
    """
    if given.cpu_affinity:
        have = os.sched_getaffinity(0)
        if not have.issuperset(given.cpu_affinity):
            expected = f"out of {', '.join(map(str, sorted(have)))}"
            raise AbraceError(f"parameter cpu_affinity: {given.cpu_affinity}, expected processors {expected}")
        for thread in _threads():
            os.sched_setaffinity(thread, given.cpu_affinity)
    if given.lock_memory:
        _lock_memory(warn)
    if given.thread_priority:
        try:
            for thread in _threads():
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(given.thread_priority))
        except PermissionError:
            limit = _LIMITS.format(limit=f"rtprio {given.thread_priority + 1}")
            warn(f"thread_priority {given.thread_priority} is not allowed, samples may be late; {limit}")
        keep_processors_awake(warn)


def keep_processors_awake(warn: Callable[[str], object]) -> None:
    """Let no processor of the machine sleep until this process ends.

    The loop waits between two samples. A processor that sleeps meanwhile wakes late: by some 0.1 ms on a computer, by
    up to 9 ms on a virtual one, whose host gives an idle processor to others. `warn`: called with a line if this is not
    allowed.
    """
    try:
        os.write(os.open(_WAKE_LATENCY, os.O_WRONLY), struct.pack("i", 0))
    except OSError as error:
        warn(
            f"thread_priority: processors may sleep between samples, which may delay them; {_WAKE_LATENCY}: "
            f"{error.strerror}, expected write access (docs/computers.md)"
        )


def _lock_memory(warn: Callable[[str], object]) -> None:
    """Lock present and future memory in RAM; only if unlimited, since a limit would let the node fail later."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    rights = int(status.partition("CapEff:")[2].split()[0], 16)
    unlimited = rights & _CAP_IPC_LOCK or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if not unlimited or ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE):
        warn(f"lock_memory is not allowed, samples may be late; {_LIMITS.format(limit='memlock unlimited')}")


def above_the_loops(given: Any) -> None:
    """Give the calling thread the loop's processors and the priority next above it, from `given`, if allowed.

    For the thread that takes a rig's samples by the clock. With the same priority it waits for its own node's and
    other nodes' loops that work off messages, for example of a controller that had been held up.
    """
    if given.cpu_affinity:
        os.sched_setaffinity(0, given.cpu_affinity)
    if given.thread_priority:
        for priority in (given.thread_priority, given.thread_priority + 1):
            with contextlib.suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def beside_the_loop(processors: set[int]) -> None:
    """Give the calling thread, the node's second one, these `processors` and the priority next below the loop's.

    An ordinary priority is too low: the loop waits for this thread while it holds Python's interpreter lock.
    """
    os.sched_setaffinity(0, processors)
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        priority = max(1, os.sched_getparam(0).sched_priority - 1)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
