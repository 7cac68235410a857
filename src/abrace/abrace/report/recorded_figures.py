# SPDX-License-Identifier: Apache-2.0
"""The chart of a recorded test: the table's motion, and the response of building and braces."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core.figures.chart import Panel, below_each_other, beside
from abrace_core.model import signals
from abrace_core.model.response import shown_unit

if TYPE_CHECKING:
    from abrace.report.recorded import RecordedTest
    from abrace.report.units import Units
    from abrace_core.figures.chart import Chart
    from abrace_core.model.run import Run


def response_chart(test: RecordedTest, run: Run, units: Units) -> Chart:
    """The table's motion and the response in a `test`: displacements, accelerations, forces with commands.

    `run` is read from its bag; numbers are in these `units`. Of many floors three are drawn.
    """
    rows = [[name for name in run.all_names if name == signals.GROUND]]
    for letter in "xa":
        floors = [name for name in run.names if name[0] == letter and name[1:].isdigit()]
        drawn = {0, (len(floors) - 1) // 2, len(floors) - 1} if floors else set()
        rows.append([floors[i] for i in sorted(drawn, reverse=True)])
    rows.append([name for name in run.names if name[0] == "f"] + list(run.command_names))
    panels = []
    for names in filter(None, rows):
        factor, unit = shown_unit(names[0], units.system)
        curves = beside(run.time, dict(zip(names, factor * run.channels(names).T, strict=True)))
        panels.append(Panel(curves, y_label=f"[{unit}]", x_limits=(float(run.time[0]), float(run.time[-1]))))
    controller = f", controller {test.facts['controller']}" if test.facts.get("controller") else ""
    shown = "acceleration of the table, displacements relative to it, absolute accelerations"
    shown += ", forces and commands of the braces" if run.groups else ""
    return below_each_other(panels, 1.9, f"Test {test.step} ({test.drive(units)}{controller}): {shown}.")
