# SPDX-License-Identifier: Apache-2.0
"""Draws the building of the README: `python docs/drawings/building.py UNCONTROLLED CONTROLLED`, bags of the demo."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from PIL import Image, ImageSequence

from abrace_bags import Bag
from abrace_core.figures.drawing import MEASURED, REFERENCE

if TYPE_CHECKING:
    from matplotlib.artist import Artist

PATH = Path(__file__).parents[1] / "figures/building.gif"
BEGIN, END, FRAMES_PER_SECOND = 1.0, 13.0, 12  # s
SCALE, STOREY, WIDTH = 20.0, 3.0, 4.5  # enlargement of displacements; height of a storey and breadth of the frame, m
ENDS = np.linspace(0.0, 1.0, 12)
COLUMN = 3 * ENDS**2 - 2 * ENDS**3
"""Shape of a column that is clamped in both floors, from 0 below to 1 above."""


def draw(bags: list[str]) -> None:
    """Draw the tests in the `bags` side by side, and the top floor's displacement below."""
    runs = [Bag(bag).tests()[0] for bag in bags]
    floors = runs[0].floors
    moved = [run.channels([f"x{floor + 1}" for floor in range(floors)]) for run in runs]
    figure = Figure(figsize=(7.8, 5.2), layout="constrained")
    grid = figure.add_gridspec(2, len(runs), height_ratios=(3.2, 1.0))
    trace = figure.add_subplot(grid[1, :], xlim=(BEGIN, END), xlabel="time [s]", ylabel=f"x{floors} [cm]")
    trace.grid(alpha=0.3)
    reach = WIDTH / 2 + 1.1 * SCALE * max(np.abs(x).max() for x in moved)
    lines = []
    for number, (run, x, colour) in enumerate(zip(runs, moved, (REFERENCE, MEASURED), strict=True)):
        axis = figure.add_subplot(grid[0, number], xlim=(-reach, reach), ylim=(-0.3, STOREY * floors + 0.6))
        axis.set(title=str(run.facts.get("controller", "") or "zero command"), aspect="equal")
        axis.set_axis_off()
        axis.axhline(0.0, color="k", lw=2.0)
        lines.append([axis.plot([], [], color=colour, lw=width)[0] for width in (4.0, 1.6, 1.6) for _ in range(floors)])
        trace.plot(run.time, 100 * x[:, -1], color=colour, lw=1.0)
    now = trace.axvline(BEGIN, color="k", lw=0.8)

    def move(frame: int) -> list[Artist]:
        time = BEGIN + frame / FRAMES_PER_SECOND
        now.set_xdata([time, time])
        for run, x, drawn in zip(runs, moved, lines, strict=True):
            at = SCALE * np.concatenate([[0.0], x[np.searchsorted(run.time, time)]])
            for level in range(floors):
                slab, *columns = drawn[level::floors]
                slab.set_data(at[level + 1] + np.array([-WIDTH / 2, WIDTH / 2]), np.full(2, STOREY * (level + 1)))
                for side, column in zip((-1, 1), columns, strict=True):
                    sway = at[level] + (at[level + 1] - at[level]) * COLUMN
                    column.set_data(side * WIDTH / 2 + sway, STOREY * (level + ENDS))
        return [now]

    frames = round((END - BEGIN) * FRAMES_PER_SECOND)
    FuncAnimation(figure, move, frames=frames).save(PATH, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=70)
    with Image.open(PATH) as drawn:  # few colours: half the size
        shades = [frame.convert("RGB").quantize(8, dither=Image.Dither.NONE) for frame in ImageSequence.Iterator(drawn)]
    duration = round(1000 / FRAMES_PER_SECOND)
    shades[0].save(PATH, save_all=True, append_images=shades[1:], loop=0, duration=duration, optimize=True)


if __name__ == "__main__":
    draw(sys.argv[1:])
