# SPDX-License-Identifier: Apache-2.0
"""Progress of long runs: a bar of rich's on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import rich.progress

LOG = 10.0
"""Seconds between two lines in a log, at least."""


class Progress:
    """Shows how far a run of several steps is.

    Parameters
    ----------
    steps
        Number of steps.
    stream
        Output; standard error by default.
    clock
        Gives seconds.

    Examples
    --------
    >>> progress = Progress(2, sys.stdout, clock=lambda: 0.0)
    >>> with progress.step("table_noise") as step:
    ...     step.update(0.5, "6.3 x real time")
    [1/2] table_noise: done in 0:00, 6.3 x real time
    """

    def __init__(self, steps: int, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._steps = steps
        self._stream = stream or sys.stderr
        self._clock = clock
        self._number = 0

    def kept(self, name: str) -> None:
        """Report that the step `name` was completed before, and is kept."""
        self._number += 1
        self._stream.write(f"[{self._number}/{self._steps}] {name}: complete, kept\n")
        self._stream.flush()

    @contextlib.contextmanager
    def step(self, name: str) -> Iterator[Step]:
        """Show a step called `name` while the block runs, and at its end whether it was done, stopped or failed."""
        self._number += 1
        step = Step(f"[{self._number}/{self._steps}] {name}", self._stream, self._clock)
        try:
            yield step
        except Exception:
            step.close("failed after")
            raise
        except BaseException:
            step.close("stopped after")
            raise
        step.close("done in")


class Step:
    """The step that is running; `Progress.step` makes it."""

    def __init__(self, title: str, stream: TextIO, clock: Callable[[], float]) -> None:
        self._title = title
        self._stream = stream
        self._clock = clock
        self._start = self._shown = clock()
        self._rate = ""
        self._bar = _bar(title, stream, clock) if stream.isatty() and os.environ.get("TERM") != "dumb" else None

    def update(self, fraction: float | None, rate: str = "") -> None:
        """Report progress; may be called at any rate.

        Parameters
        ----------
        fraction
            From 0 to 1; None if unknown.
        rate
            How fast, for example "6.3 x real time".
        """
        self._rate = rate or self._rate
        done = None if fraction is None else min(max(fraction, 0.0), 1.0)
        if self._bar is not None:
            (task,) = self._bar.task_ids
            self._bar.update(task, total=None if done is None else 1.0, completed=done, rate=self._rate)
        elif self._clock() - self._shown >= LOG:
            self._shown = self._clock()
            self._write("" if done is None else f"{done:.0%} in")

    def close(self, outcome: str) -> None:
        """Write the final line of the step: its title and `outcome`."""
        if self._bar is not None:
            self._bar.stop()
        self._write(outcome)

    def _write(self, outcome: str) -> None:
        seconds = int(self._clock() - self._start)
        took = f"{outcome} {seconds // 60}:{seconds % 60:02d}".strip()
        self._stream.write(f"{self._title}: {took}{self._rate and f', {self._rate}'}\n")
        self._stream.flush()


def _bar(title: str, stream: TextIO, clock: Callable[[], float]) -> rich.progress.Progress:
    """A bar that is drawn in place from now on until it is stopped, which clears it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    words = (TextColumn(f"{{task.{what}}}", markup=False) for what in ("description", "fields[rate]"))
    columns = (next(words), BarColumn(24), TaskProgressColumn(), TimeElapsedColumn(), next(words))
    bar = Progress(*columns, console=Console(file=stream), get_time=clock, transient=True)
    bar.add_task(title, total=None, rate="")
    bar.start()
    return bar


def printed_steps() -> Callable[[str, float], None]:
    """A function that prints the share done, the step that begins and the seconds since now."""
    begin = time.monotonic()

    def progress(step: str, fraction: float) -> None:
        print(f"{fraction:4.0%} {step} ({time.monotonic() - begin:.1f} s)", flush=True)

    return progress
