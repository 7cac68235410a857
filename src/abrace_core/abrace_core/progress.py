# SPDX-License-Identifier: Apache-2.0
"""Progress of long runs on one line: a bar redrawn in place on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import time
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

BAR = 24
"""Characters of the bar."""
REDRAW = 0.1
"""Seconds between two drawings on a terminal, at least."""
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
        self._redraws = stream.isatty() and os.environ.get("TERM") != "dumb"
        if self._redraws:
            self._draw(None)

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
        now = self._clock()
        if now - self._shown < (REDRAW if self._redraws else LOG):
            return
        self._shown = now
        if self._redraws:
            self._draw(fraction)
        else:
            percent = "" if fraction is None else f"{_within(fraction):.0%} in "
            self._write(f"{self._title}: {percent}{self._elapsed()}{self._at_rate()}\n")

    def close(self, outcome: str) -> None:
        """Write the final line of the step: its title and `outcome`."""
        clear = "\r\x1b[K" if self._redraws else ""
        self._write(f"{clear}{self._title}: {outcome} {self._elapsed()}{self._at_rate()}\n")

    def _draw(self, fraction: float | None) -> None:
        bar = ""
        if fraction is not None:
            filled = round(BAR * _within(fraction))
            bar = f"  {'#' * filled}{'.' * (BAR - filled)} {_within(fraction):4.0%}"
        line = f"{self._title}{bar}  {self._elapsed()}{self._at_rate()}"
        width = shutil.get_terminal_size().columns
        self._write(f"\r{line[: width - 1]}\x1b[K")

    def _elapsed(self) -> str:
        seconds = int(self._clock() - self._start)
        return f"{seconds // 60}:{seconds % 60:02d}"

    def _at_rate(self) -> str:
        return f", {self._rate}" if self._rate else ""

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


def _within(fraction: float) -> float:
    return min(max(fraction, 0.0), 1.0)
