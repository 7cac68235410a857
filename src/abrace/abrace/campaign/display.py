# SPDX-License-Identifier: Apache-2.0
"""The live display of a campaign on a terminal: the step, time left, peaks, force against capacity, state of each node.

Without a terminal `abrace_core.files.progress` prints plain lines; both have the same methods.
"""

from __future__ import annotations

import contextlib
import time
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from typing import Self

    from rich.console import RenderableType

    from abrace.report.node_table import NodeReport

REFRESH = 4.0
"""Updates of the display per second [Hz]."""
PEAKS = {
    "drift": ("drift", 100.0, "cm"),
    "displacement": ("displacement", 100.0, "cm"),
    "table_displacement": ("table", 100.0, "cm"),
    "acceleration": ("acceleration", 1.0, "m/s²"),
}
"""By entry of the rig's diagnostics: label, factor from SI units, unit; those of one unit follow each other."""
BAR = 10
"""Characters of the bar: with it the first line fits into 80 columns."""


class Graph(NamedTuple):
    """The reports of a test's nodes; its peaks by quantity in SI units; the least capacity of the brace groups [N]."""

    reports: Mapping[str, NodeReport]
    peaks: Mapping[str, float]
    capacity: float


def peaks_of(values: Mapping[str, str]) -> dict[str, float]:
    """The greatest values so far, by quantity, from the `values` of the rig's diagnostics; texts are left out."""
    found = {}
    for key, value in values.items():
        if key.startswith("peak "):
            with contextlib.suppress(ValueError):
                found[key.removeprefix("peak ")] = float(value)
    return found


class Display:
    """Shows the progress of the campaign `name`, redrawn in place; a context manager.

    `seconds`: estimated, of each step.
    """

    def __init__(
        self,
        name: str,
        seconds: Sequence[float],
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._name, self._seconds, self._clock = name, seconds, clock
        self._steps, self._took, self._estimated = len(seconds), 0.0, 0.0
        self._console = console or Console(stderr=True)
        self._number = 0
        self._step: DisplayedStep | None = None
        self._live = Live(
            get_renderable=self.drawing, console=self._console, refresh_per_second=REFRESH, transient=True
        )

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def kept(self, name: str) -> None:
        """Print that the step `name` was completed in an earlier run, and is kept."""
        self._number += 1
        self._print(f"[{self._number}/{self._steps}] {name}: complete, kept")

    @contextlib.contextmanager
    def step(self, name: str) -> Iterator[DisplayedStep]:
        """Show the step `name` while the block runs, and at its end whether it is done, was stopped or failed."""
        self._number += 1
        step = self._step = DisplayedStep(f"[{self._number}/{self._steps}] {name}", self._clock)
        outcome = "stopped after"
        try:
            yield step
            outcome = "done in"
        except Exception:
            outcome = "failed after"
            raise
        finally:
            self._step = None
            self._took += step.elapsed
            self._estimated += self._seconds[self._number - 1]
            self._print(f"{step.title}: {outcome} {clock_time(step.elapsed)}{step.rate and f', {step.rate}'}")

    def see(self, graph: Graph) -> None:
        """Show the reports of the test's nodes, `graph`; may be called at any rate."""
        if self._step is not None:
            self._step.graph = graph

    def drawing(self) -> RenderableType:
        """The present content of the terminal."""
        step = self._step
        if step is None:
            return Text(self._name)
        return Group(*step.lines(self._name), Text(f"all steps: about {clock_time(self._left(step))} left"))

    def _left(self, step: DisplayedStep) -> float:
        """Seconds left for all steps: estimates of the plan, by how right they were for the steps that are done."""
        factor = self._took / self._estimated if self._estimated else 1.0
        present, *later = self._seconds[self._number - 1 :]
        known = step.left
        return (max(factor * present - step.elapsed, 0.0) if known is None else known) + factor * sum(later)

    def _print(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False)


class DisplayedStep:
    """The step that is running; `Display.step` makes it."""

    def __init__(self, title: str, clock: Callable[[], float]) -> None:
        self.title, self.rate = title, ""
        self.graph: Graph | None = None
        self._clock = clock
        self._start = clock()
        self._first: tuple[float, float] | None = None
        self._last = (self._start, 0.0)

    @property
    def elapsed(self) -> float:
        """Seconds since the step began."""
        return self._clock() - self._start

    def update(self, fraction: float | None, rate: str = "") -> None:
        """Report progress, at any rate: `fraction` and `rate` as in `abrace_core.files.progress`."""
        self.rate = rate or self.rate
        if fraction is not None:
            self._last = (self._clock(), min(max(fraction, 0.0), 1.0))
            self._first = self._first or self._last

    def lines(self, name: str) -> list[RenderableType]:
        """The lines to draw for this step of the campaign `name`."""
        head = Table.grid(padding=(0, 2))
        fraction = self._last[1]
        cells: list[RenderableType] = [Text(name, style="bold"), Text(self.title)]
        if self._first is not None:
            cells += [ProgressBar(total=1.0, completed=fraction, width=BAR), Text(f"{fraction:.0%}")]
        left = "" if self.left is None else f", {clock_time(self.left)} left"
        cells.append(Text(f"{clock_time(self.elapsed)}{left}{self.rate and f', {self.rate}'}"))
        head.add_row(*cells)
        drawn: list[RenderableType] = [head]
        if self.graph is not None:
            drawn += [*_peak_lines(self.graph), _node_table(self.graph.reports, self._clock())]
        return drawn

    @property
    def left(self) -> float | None:
        """Seconds left for this step, by its progress; None: nobody knows yet."""
        if self._first is None or self._last[1] <= self._first[1]:
            return None
        (began, before), (now, fraction) = self._first, self._last
        return max((now - began) / (fraction - before) * (1 - fraction) - (self._clock() - now), 0.0)


def clock_time(seconds: float) -> str:
    """Minutes and seconds.

    >>> clock_time(83.2)
    '1:23'
    """
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def _peak_lines(graph: Graph) -> list[RenderableType]:
    shown = [(key, *label) for key, label in PEAKS.items() if key in graph.peaks]
    found = [
        ", ".join(f"{called} {graph.peaks[key] * factor:.3g}" for key, called, factor, _ in alike) + f" {unit}"
        for unit, alike in groupby(shown, key=lambda each: each[-1])
    ]
    lines: list[RenderableType] = [Text(f"peaks: {', '.join(found)}")] if found else []
    if "force" in graph.peaks:
        force, share = graph.peaks["force"], graph.peaks["force"] / graph.capacity
        style = "bold red" if share >= 1 else "yellow" if share > 0.8 else ""
        lines.append(
            Text(f"force: {force / 1000:.3g} of {graph.capacity / 1000:.3g} kN, {share:.0%} of capacity", style=style)
        )
    return lines


def _node_table(reports: Mapping[str, NodeReport], now: float) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for header, justify in (("node", "left"), ("samples/s", "right"), ("lost", "right"), ("state", "left")):
        table.add_column(header, justify=justify)  # type: ignore[arg-type]
    for name, report in sorted(reports.items()):
        style = "bold red" if report.failed else "yellow" if report.stale(now) or report.lost else ""
        rate = "-" if report.rate is None else f"{report.rate:.0f}"
        table.add_row(
            name, rate, "-" if report.lost is None else str(report.lost), Text(report.words(now)), style=style
        )
    return table
