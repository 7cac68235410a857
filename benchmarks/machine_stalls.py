# SPDX-License-Identifier: Apache-2.0
"""Stalls of the machine itself: times at which a processor ran no program, not even one above all others.

A virtual machine's processors are taken away by its host now and then, for milliseconds; and a kernel without
PREEMPT_RT is not interrupted within a long system call of any program. No priority prevents either. A process on each
processor, with the greatest real-time priority, sleeps half a millisecond at a time and notes when it woke late; it
ends with the process that began it. Where that priority is not allowed nothing is noted: its own delays would count.

What is lost within a sample period is added: two stalls of 0.6 ms delay an answer as one of 1.2 ms does.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from types import TracebackType

SLEEP = 0.5e-3
NOTED = 0.2e-3
"""Seconds by which a process woke late that are noted: 7 times the usual ones."""
PERIOD = 2e-3
"""Sample period [s] at 500 Hz."""
STALL = PERIOD / 2
"""Seconds lost within a sample period that are a stall."""
HIGHEST = 99


class MachineStalls:
    """Notes the stalls while it is open; a context manager."""

    def __enter__(self) -> Self:
        self._folder = tempfile.TemporaryDirectory()
        self._notes = [Path(self._folder.name) / str(processor) for processor in sorted(os.sched_getaffinity(0))]
        for notes in self._notes:
            notes.touch()
        self._watches = [subprocess.Popen([sys.executable, __file__, str(notes)]) for notes in self._notes]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for watch in self._watches:
            watch.kill()
            watch.wait()
        self._folder.cleanup()

    def since(self, moment: float, end: float = float("inf")) -> list[float]:
        """Seconds lost in each stall since a `moment` of time.monotonic, or from it to an `end`."""
        found: list[float] = []
        for notes in self._notes:
            late = np.array(notes.read_text(encoding="utf-8").split(), float).reshape(-1, 2)
            when, seconds = late[(moment < late[:, 0]) & (late[:, 0] < end)].T
            total = np.concatenate([[0.0], np.cumsum(seconds)])
            lost = total[1:] - total[np.searchsorted(when, when - PERIOD, side="right")]
            found += lost[lost >= STALL].tolist()
        return found


def watch(notes: Path) -> None:
    """Write when this process woke late, on the processor that the file `notes` is named after, and by how much."""
    os.sched_setaffinity(0, {int(notes.name)})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(HIGHEST))
    except PermissionError:
        return
    gc.disable()
    parent = os.getppid()
    with notes.open("a", encoding="utf-8", buffering=1) as file:
        last = time.monotonic()
        while os.getppid() == parent:
            time.sleep(SLEEP)
            now = time.monotonic()
            if now - last > SLEEP + NOTED:
                file.write(f"{now} {now - last - SLEEP}\n")
                now = time.monotonic()
            last = now


if __name__ == "__main__":
    watch(Path(sys.argv[1]))
