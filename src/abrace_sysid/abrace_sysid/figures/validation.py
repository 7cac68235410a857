"""Figures of a validation: time histories in the paper's units, as in Fig. 6."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED
from abrace_core.errors import AbraceError
from abrace_core.response import paper_unit
from abrace_sysid.figures.symbols import symbol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from abrace_core.run import Run
    from abrace_sysid.validation import Comparison


def time_histories(
    comparison: Comparison, channels: Sequence[str] = ("x3", "a1"), zoom: tuple[float, float] | None = None
) -> Figure:
    """Measured against simulated responses in the paper's units: Fig. 6.

    Parameters
    ----------
    comparison
        What to draw.
    channels
        One row each.
    zoom
        Seconds to show enlarged in a second column.
    """
    missing = [name for name in channels if name not in comparison.names]
    if missing:
        raise AbraceError(
            f"figure of {comparison.source}: no channel {', '.join(missing)}, expected any of "
            f"{', '.join(comparison.names)}"
        )
    columns = 1 if zoom is None else 2
    figure = Figure(figsize=(7.0 * columns, 2.6 * len(channels)), layout="constrained")
    axes = figure.subplots(len(channels), columns, squeeze=False, sharex="col")
    for i, name in enumerate(channels):
        factor, unit = paper_unit(name)
        j = comparison.names.index(name)
        for axis in axes[i]:
            _history(axis, comparison, j, factor)
        axes[i, 0].set_ylabel(f"{symbol(name)} [{unit}]")
    axes[0, 0].legend(loc="upper right", ncols=2)
    axes[0, 0].set_xlim(comparison.time[0], comparison.time[-1])
    if zoom is not None:
        axes[0, 1].set_xlim(*zoom)
        axes[0, 1].set_title(f"{zoom[0]:g} to {zoom[1]:g} s")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure


def control_effect(uncontrolled: Run, controlled: Run, channels: Sequence[str]) -> Figure:
    """The same test measured without and with control, in the paper's units.

    Parameters
    ----------
    uncontrolled, controlled
        Runs of one rig.
    channels
        One row each.
    """
    figure = Figure(figsize=(7.0, 2.6 * len(channels)), layout="constrained")
    axes = figure.subplots(len(channels), 1, squeeze=False, sharex=True)[:, 0]
    for axis, name in zip(axes, channels, strict=True):
        factor, unit = paper_unit(name)
        for run, label, colour in ((uncontrolled, "uncontrolled", REFERENCE), (controlled, "controlled", MEASURED)):
            axis.plot(run.time, factor * run.channels([name])[:, 0], color=colour, lw=1.0, label=label)
        axis.set_ylabel(f"{symbol(name)} [{unit}]")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=2)
    axes[-1].set_xlim(controlled.time[0], controlled.time[-1])
    axes[-1].set_xlabel("time [s]")
    return figure


def _history(axis: Axes, comparison: Comparison, j: int, factor: float) -> None:
    axis.plot(comparison.time, factor * comparison.measured[:, j], color=MEASURED, lw=1.6, label="measured")
    axis.plot(comparison.time, factor * comparison.simulated[:, j], color=SIMULATED, lw=1.0, ls="--", label="simulated")
    axis.grid(alpha=0.3)
