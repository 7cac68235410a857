# SPDX-License-Identifier: Apache-2.0
"""An animation of the building as a GIF, from the bag of any test, alone or next to that of another test.

Floors are drawn at their heights, moved by their measured displacements relative to the table, enlarged; below them the
displacement of the top floor over time. The picture states the enlargement.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from abrace_bags.run import read_runs
from abrace_core.drawing import MEASURED, REFERENCE
from abrace_core.errors import AbraceError
from abrace_core.files import write_atomically
from abrace_core.response import shown_unit, unit_system
from abrace_plant.rig.file import recorded_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    from abrace_core.run import Run

FRAMES_PER_SECOND = 15
DOTS_PER_INCH = 80
SHOWN, BEFORE = 12.0, 2.0
"""Seconds that are drawn where none are given, and how many of them before the greatest motion."""
SWAY = 0.6
"""Greatest displacement that is drawn, in storey heights."""
ENDS = np.linspace(0.0, 1.0, 12)
COLUMN = 3 * ENDS**2 - 2 * ENDS**3
"""Shape of a column that is clamped in both floors, from 0 below to 1 above."""
STOREY, WIDTH = 3.0, 4.5
"""Height of a storey where the bag does not say, and breadth of the frame [m]."""


def animate(
    bags: Sequence[Path], path: Path, start: float = 0.0, duration: float = 0.0, exaggeration: float = 0.0
) -> float:
    """Draw the building of each of the `bags` side by side into the GIF file `path`.

    Parameters
    ----------
    bags
        Of tests, one or two; the first is drawn grey where there are two.
    path
        Ends in .gif.
    start, duration
        Seconds of the test; 0 and 0: those about the greatest motion.
    exaggeration
        Factor by which displacements are enlarged; 0: chosen to fit.

    Returns
    -------
    float
        The exaggeration.

    Raises
    ------
    AbraceError
        If a bag has no test, the tests are of different buildings, or there is nothing to draw in that time.
    """
    if path.suffix != ".gif":
        raise AbraceError(f"animation {path}: expected a name that ends in .gif")
    runs = [read_runs(bag)[0] for bag in bags]
    if len({run.floors for run in runs}) > 1:
        found = " and ".join(f"{run.floors} floors in {run.source}" for run in runs)
        raise AbraceError(f"animation: {found}, expected tests of one building")
    floors = [run.channels([f"x{floor + 1}" for floor in range(run.floors)]) for run in runs]
    begin, end = _span(runs, floors, start, duration)
    largest = max(float(np.abs(x).max()) for x in floors)
    height = _storey_height(runs[0])
    scale = exaggeration or _round_below(SWAY * height / largest if largest else 1.0)
    scenes = _Scenes(runs, floors, height, scale, (begin, end))
    frames = max(2, round((end - begin) * FRAMES_PER_SECOND))
    scenes.draw(0)
    scenes.figure.draw_without_rendering()
    scenes.figure.set_layout_engine("none")
    moving = FuncAnimation(scenes.figure, scenes.draw, frames=frames, blit=False)
    with write_atomically(path) as temporary:
        moving.save(temporary, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=DOTS_PER_INCH)
    return scale


class _Scenes:
    """The figure, and how it is at each frame.

    Parameters
    ----------
    runs, floors
        Tests and their displacements (samples, floors) [m].
    height
        Of a storey [m].
    scale
        Exaggeration.
    span
        Seconds that are drawn.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        floors: Sequence[NDArray[np.float64]],
        height: float,
        scale: float,
        span: tuple[float, float],
    ) -> None:
        self.runs, self.floors, self.scale, self.begin = runs, floors, scale, span[0]
        self.levels = height * np.arange(runs[0].floors + 1)
        self.figure = Figure(figsize=(3.6 * max(len(runs), 1) + 0.6, 5.2), layout="constrained")
        grid = self.figure.add_gridspec(2, len(runs), height_ratios=(3.2, 1.0))
        colours = [MEASURED] if len(runs) == 1 else [REFERENCE, MEASURED]
        trace = self.figure.add_subplot(grid[1, :])
        factor, unit = shown_unit("x", unit_system(str(runs[0].facts.get("rig", ""))))
        self.updates: list[Callable[[float], None]] = []
        for column, (run, x, colour) in enumerate(zip(runs, floors, colours, strict=True)):
            axis = self.figure.add_subplot(grid[0, column])
            axis.set_title(str(run.facts.get("controller", "") or "zero command"), color=colour, fontsize="medium")
            self.updates.append(self._building(axis, run, x, colour))
            trace.plot(run.time, factor * x[:, -1], color=colour, lw=1.0)
        (self.now,) = trace.plot([], [], color="k", lw=0.8)
        self.trace = trace
        trace.set(xlim=span, xlabel="time [s]", ylabel=f"x{runs[0].floors} [{unit}]")
        trace.grid(alpha=0.3)
        record = runs[0].facts.get("record", "") or "measured"
        self.figure.suptitle(f"{record}: displacements {scale:g} times as large", fontsize="medium")

    def _building(self, axis: Axes, run: Run, x: NDArray[np.float64], colour: str) -> Callable[[float], None]:
        """Draw a building at rest; the function that moves it."""
        reach = WIDTH / 2 + 1.1 * self.scale * max(float(np.abs(one).max()) for one in self.floors)
        axis.set(xlim=(-reach, reach), ylim=(-0.3, self.levels[-1] + 0.6), aspect="equal")
        axis.set_axis_off()
        axis.axhline(0.0, color="k", lw=2.0)
        style: dict[str, Any] = {"color": colour, "solid_capstyle": "butt"}
        slabs = [axis.plot([], [], lw=4.0, **style)[0] for _ in self.levels[1:]]
        columns = [axis.plot([], [], lw=1.6, **style)[0] for _ in self.levels[1:] for _ in (0, 1)]

        def move(time: float) -> None:
            sample = min(int(np.searchsorted(run.time, time)), len(x) - 1)
            moved = self.scale * np.concatenate([[0.0], x[sample]])
            for level, slab in enumerate(slabs, 1):
                _lay(slab, moved[level] + np.array([-WIDTH / 2, WIDTH / 2]), np.full(2, self.levels[level]))
            for number, column in enumerate(columns):
                level, side = number // 2, (-1, 1)[number % 2]
                sway = moved[level] + (moved[level + 1] - moved[level]) * COLUMN
                heights = self.levels[level] + ENDS * (self.levels[level + 1] - self.levels[level])
                _lay(column, side * WIDTH / 2 + sway, heights)

        return move

    def draw(self, frame: int) -> Sequence[Line2D]:
        """Set all lines as they are at a `frame`."""
        time = self.begin + frame / FRAMES_PER_SECOND
        for update in self.updates:
            update(time)
        _lay(self.now, np.full(2, time), np.array(self.trace.get_ylim()))
        return [self.now]


def _lay(line: Line2D, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    line.set_data(x, y)


def _span(
    runs: Sequence[Run], floors: Sequence[NDArray[np.float64]], start: float, duration: float
) -> tuple[float, float]:
    last = max(float(run.time[-1]) for run in runs)
    if not start and not duration:
        peaks = [float(run.time[np.argmax(np.abs(x[:, -1]))]) for run, x in zip(runs, floors, strict=True)]
        begin = min(max(float(runs[0].time[0]), min(peaks) - BEFORE), max(0.0, last - SHOWN))
        return begin, min(last, begin + SHOWN)
    end = min(last, start + duration if duration else last)
    if not start < end:
        raise AbraceError(f"animation: nothing from {start:g} s on, expected a time within the {last:g} s of the test")
    return start, end


def _storey_height(run: Run) -> float:
    """The storey height from the rig file in the bag [m], of a frame the mean."""
    content = yaml.safe_load(str(run.facts.get("rig_file", ""))) or {}
    building = content.get("building", {})
    rig = recorded_rig(run.facts) if "frame" in building else None
    return rig.storey_height if rig else float(building.get("storey_height", STOREY))


def _round_below(value: float) -> float:
    """The greatest 1, 2 or 5 times a power of ten that is not above the `value`.

    >>> _round_below(87.0), _round_below(5.0), _round_below(0.3)
    (50.0, 5.0, 0.2)
    """
    decade = 10.0 ** math.floor(math.log10(value))
    return round(max(part * decade for part in (1, 2, 5) if part * decade <= value * 1.0001), 10)
