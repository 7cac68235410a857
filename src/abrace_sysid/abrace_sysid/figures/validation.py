# SPDX-License-Identifier: Apache-2.0
"""Figures of a validation: time histories as in Fig. 6."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from abrace_core.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned, last_motion, legend_above
from abrace_core.errors import AbraceError
from abrace_core.response import UnitSystem, shown_unit
from abrace_sysid.figures.symbols import symbol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from abrace_core.run import Run
    from abrace_sysid.validation import Comparison


def time_histories(
    comparison: Comparison,
    channels: Sequence[str] = ("x3", "a1"),
    zoom: tuple[float, float] | None = None,
    units: UnitSystem = "paper",
    tested: str = "",
) -> Figure:
    """Measured and simulated responses and their difference, until the building is at rest: Fig. 6.

    Parameters
    ----------
    comparison
        Measured and simulated test.
    channels
        One row each.
    zoom
        Begin and end [s] of the part enlarged in the second column.
    units
        The system of units of the figure.
    tested
        Record and controller, for the caption.
    """
    missing = [name for name in channels if name not in comparison.names]
    if missing:
        raise AbraceError(
            f"figure of {comparison.source}: no channel {', '.join(missing)}, expected any of "
            f"{', '.join(comparison.names)}"
        )
    columns = 1 if zoom is None else 2
    figure = Figure(figsize=(7.0 * columns, 3.2 * len(channels)), layout="constrained")
    rows = 2 * len(channels)
    axes = figure.subplots(rows, columns, squeeze=False, sharex="col", height_ratios=[3, 1] * len(channels))
    for i, name in enumerate(channels):
        factor, unit = shown_unit(name, units)
        j = comparison.names.index(name)
        for above, below in zip(axes[2 * i], axes[2 * i + 1], strict=True):
            _history(above, below, comparison, j, factor)
        axes[2 * i, 0].set_ylabel(f"{symbol(name)} [{unit}]")
        axes[2 * i + 1, 0].set_ylabel(f"error [{unit}]")
    legend_above(figure, axes[0, 0], 2)
    drawn = [comparison.measured[:, comparison.names.index(name)] for name in channels]
    axes[0, 0].set_xlim(comparison.time[0], last_motion(comparison.time, *drawn))
    if zoom is not None:
        axes[0, 1].set_xlim(*zoom)
        axes[0, 1].set_title(f"{zoom[0]:g} to {zoom[1]:g} s", fontsize="medium")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    named = " and ".join(channels)
    under = f" under {tested}" if tested else ""
    caption = f"{named}{under}: measured, simulated by the identified model, and simulated minus measured."
    return captioned(figure, caption)


def control_effect(
    uncontrolled: Run, controlled: Run, channels: Sequence[str], units: UnitSystem = "paper", tested: str = ""
) -> Figure:
    """The same test measured without and with control, until the building is at rest.

    Parameters
    ----------
    uncontrolled, controlled
        Runs of one rig.
    channels
        One row each.
    units
        The system of units of the figure.
    tested
        Record and controller, for the caption.
    """
    figure = Figure(figsize=(7.0, 2.6 * len(channels)), layout="constrained")
    axes = figure.subplots(len(channels), 1, squeeze=False, sharex=True)[:, 0]
    for axis, name in zip(axes, channels, strict=True):
        factor, unit = shown_unit(name, units)
        for run, label, colour in ((uncontrolled, "uncontrolled", REFERENCE), (controlled, "controlled", MEASURED)):
            axis.plot(run.time, factor * run.channels([name])[:, 0], color=colour, lw=1.0, label=label)
        axis.set_ylabel(f"{symbol(name)} [{unit}]")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=2)
    ends = [last_motion(run.time, *run.channels(channels).T) for run in (uncontrolled, controlled)]
    axes[-1].set_xlim(controlled.time[0], max(ends))
    axes[-1].set_xlabel("time [s]")
    named = " and ".join(channels)
    return captioned(figure, f"{named}{f' under {tested}' if tested else ''}, measured without and with control.")


def _history(above: Axes, below: Axes, comparison: Comparison, j: int, factor: float) -> None:
    measured, simulated = factor * comparison.measured[:, j], factor * comparison.simulated[:, j]
    above.plot(comparison.time, measured, color=MEASURED, lw=1.6, label="measured")
    above.plot(comparison.time, simulated, color=SIMULATED, lw=1.0, ls="--", label="simulated")
    below.plot(comparison.time, simulated - measured, color=ERROR, lw=0.6, label="simulated minus measured")
    for axis in (above, below):
        axis.grid(alpha=0.3)
