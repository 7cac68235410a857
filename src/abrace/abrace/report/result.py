# SPDX-License-Identifier: Apache-2.0
"""The result of a campaign, on the first screen of its report and as the last lines that it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace.report.events import warnings_of
from abrace.report.summary import error_vs_paper
from abrace.report.table import Table, reduction
from abrace.report.tables import PAPER_ERROR

if TYPE_CHECKING:
    from collections.abc import Mapping

    from abrace.report.results import Cells, ComparedTest, Results
    from abrace.report.units import Units
    from abrace_core.model.response import PeakRms

WORSE = 0.01
"""Share by which a displacement has to be greater with control to be worse: sensors' noise is less."""


def verdicts(results: Results) -> list[str]:
    """Sentences of `results`: what ended the campaign early, which models, tests and laws cannot be trusted."""
    failed, trusted = results.timing.failed, results.validity.items()
    found = [f"Step {failed.step} failed: {failed.cause}"] if failed else []
    found += [
        f"Models of step {step}: {one.verdict.words}" + (f" ({', '.join(one.causes)})" if one.causes else "")
        for step, one in trusted
    ]
    errors = {step: error_vs_paper(one, one.measured) for step, one in results.comparisons.items()}
    found += [
        f"{step}: {100 * error:.1f} % mean error to Table 1's experiment (paper's own: {100 * PAPER_ERROR:.1f} %)"
        for step, error in errors.items()
        if error is not None
    ]
    found += [
        f"Care: {step}: {one.test.controller} makes the motion worse than no control: {worse}"
        for step, one in results.comparisons.items()
        if one.uncontrolled and one.test.controller and (worse := worse_than_none(one.uncontrolled, one.measured))
    ]
    warnings = [f"Not to be trusted: {warning}" for warning in warnings_of(results.timing)]
    has_tests = any(step.samples for step in results.timing.steps)
    return found + (warnings or ["Every test can be trusted"] * has_tests)


def worse_than_none(before: Mapping[str, Cells | PeakRms], after: Mapping[str, Cells | PeakRms]) -> str:
    """What of the floors' greatest displacement is more `after` than `before`, of rows by name; empty: nothing.

    >>> from abrace_core.model.response import PeakRms
    >>> worse_than_none({"x1": PeakRms(1.0, 0.5), "a1": PeakRms(1.0, 1.0)}, {"x1": PeakRms(1.5, 0.4)})
    'peak of the greatest displacement 50 % greater'
    """
    found = []
    for key in ("peak", "rms"):
        floors = ([getattr(rows[x], key) for x in rows if x[0] == "x" and x[1:].isdigit()] for rows in (before, after))
        without, controlled = (max((value or 0.0 for value in values), default=0.0) for values in floors)
        if without and not controlled / without <= 1 + WORSE:
            found.append(f"{key} of the greatest displacement {100 * (controlled / without - 1):.0f} % greater")
    return ", ".join(found)


def result_table(results: Results, units: Units) -> Table | None:
    """Peaks of the top floor without and with each controller, and its command, of `results` in `units`; None: none."""
    compared = [one for one in results.comparisons.items() if one[1].uncontrolled and one[1].test.controller]
    if not compared:
        return None
    rows = [(step, one.test.controller, units.motion(*one.test.motion), *_cells(one, units)) for step, one in compared]
    header: tuple[str, ...] = ("test", "law", "motion")
    for letter in "xa":
        header += (f"{letter} [{units.unit(letter)}] without", "with", "less %")
    header += (f"U [{units.unit('U')}]",)
    note = "x: displacement, a: acceleration, U: command of a brace"
    return Table("Peaks of the top floor without and with control", header, tuple(rows), (note,))


def _cells(comparison: ComparedTest, units: Units) -> list[str]:
    before: Mapping[str, Cells] = comparison.uncontrolled or {}
    cells = []
    for letter in "xa":
        floors = [name for name in comparison.measured if name[0] == letter and name[1:].isdigit()]
        top = max(floors, key=lambda name: int(name[1:]), default=None)
        if top is None:
            cells += ["-", "-", "-"]
            continue
        without, controlled = before[top].peak, comparison.measured[top].peak
        cells += [units.cell(top, without), units.cell(top, controlled), reduction(without, controlled)]
    commands = [name for name in comparison.measured if name[0] == "U"]
    strongest = max(commands, key=lambda name: comparison.measured[name].peak or 0.0, default=None)
    return [*cells, units.cell(strongest, comparison.measured[strongest].peak) if strongest else "-"]
