# SPDX-License-Identifier: Apache-2.0
"""Figures of a validation: time histories as in Fig. 6."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.figures.chart import Chart, Curve, Panel, below_each_other
from abrace_core.figures.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, last_motion
from abrace_core.model import signals
from abrace_core.model.response import UnitSystem, shown_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.model.run import Run
    from abrace_sysid.validation import Comparison


def time_histories(
    comparison: Comparison,
    channels: Sequence[str] = ("x3", "a1"),
    zoom: tuple[float, float] | None = None,
    units: UnitSystem = "paper",
    tested: str = "",
) -> Chart:
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
    drawn = [comparison.measured[:, comparison.names.index(name)] for name in channels]
    spans = [(float(comparison.time[0]), last_motion(comparison.time, *drawn)), *([zoom] if zoom else [])]
    columns = [_column(comparison, channels, span, units) for span in spans]
    under = f" under {tested}" if tested else ""
    caption = (
        f"{' and '.join(channels)}{under}: measured, simulated by the identified model, and simulated minus measured."
    )
    size = (max(8.0, 7.0 * len(columns)), 3.2 * len(channels))
    return Chart(tuple(zip(*columns, strict=True)), size, caption, (3.0, 1.0) * len(channels))


def _column(
    comparison: Comparison, channels: Sequence[str], span: tuple[float, float], units: UnitSystem
) -> list[Panel]:
    """Of each channel its histories and their difference, within a `span` of time [s]."""
    shown = (comparison.time >= span[0]) & (comparison.time <= span[1])
    time, panels = comparison.time[shown], []
    for name in channels:
        own = signals.unit(name) == "-"
        factor, unit = (1.0, comparison.units.get(name, "-")) if own else shown_unit(name, units)
        j = comparison.names.index(name)
        measured, simulated = factor * comparison.measured[shown, j], factor * comparison.simulated[shown, j]
        histories = (
            Curve(time, measured, "measured", MEASURED, 1.6),
            Curve(time, simulated, "simulated", SIMULATED, 1.0, "--"),
        )
        error = (Curve(time, simulated - measured, "simulated minus measured", ERROR, 0.6),)
        panels += [
            Panel(histories, y_label=f"{name} [{unit}]", x_limits=span),
            Panel(error, x_label="time [s]" if name == channels[-1] else "", y_label=f"error [{unit}]", x_limits=span),
        ]
    panels[0] = replace(panels[0], title=f"{span[0]:g} to {span[1]:.4g} s")
    return panels


def control_effect(
    uncontrolled: Run, controlled: Run, channels: Sequence[str], units: UnitSystem = "paper", tested: str = ""
) -> Chart:
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
    ends = [last_motion(run.time, *run.channels(channels).T) for run in (uncontrolled, controlled)]
    span = float(controlled.time[0]), max(ends)
    panels = []
    for name in channels:
        factor, unit = shown_unit(name, units)
        curves = tuple(
            Curve(run.time, factor * run.channels([name])[:, 0], label, colour, 1.0)
            for run, label, colour in (
                (uncontrolled, "without control", REFERENCE),
                (controlled, "controlled", MEASURED),
            )
        )
        panels.append(Panel(curves, y_label=f"{name} [{unit}]", x_limits=span))
    under = f" under {tested}" if tested else ""
    return below_each_other(panels, 2.6, f"{' and '.join(channels)}{under}, measured without and with control.")
