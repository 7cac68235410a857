# SPDX-License-Identifier: Apache-2.0
"""Tables of a benchmark: criteria and margins of several controllers, and what criteria are divided by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace.report.table import Table
from abrace_studies.benchmark.criteria import MEANINGS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_studies.benchmark.comparison import Evaluation

MARGINS = {
    "gain_margin_db": "gain margin [dB]",
    "phase_margin_deg": "phase margin [degrees]",
    "disk_margin": "disk margin",
}
QUANTITIES = {
    "d_max": "greatest drift ratio",
    "xdd_max": "greatest acceleration [m/s²]",
    "F_max": "greatest base shear [N]",
    "d_max_norm": "rms drift ratio",
    "xdd_max_norm": "rms acceleration [m/s²]",
    "F_max_norm": "rms base shear [N]",
    "x_max": "greatest displacement [m]",
    "xd_max": "greatest velocity [m/s]",
    "phi_max": "greatest curvature over yield",
    "phi_max_norm": "rms curvature over yield",
}
"""Of `criteria.peaks`, in words."""
YIELDS = "Curvature over yield above 1: without control members of the building would yield, here it stays elastic."
CAUTION = "Criteria are best small; the worst is the greatest of the cases."


def worst_table(title: str, evaluations: Sequence[Evaluation]) -> Table:
    """The worst of every criterion, and margins, below a `title`: a column for each of the `evaluations`."""
    rows = _rows([evaluation.worst() for evaluation in evaluations])
    rows += tuple((label, *(_margin(one, name) for one in evaluations)) for name, label in MARGINS.items())
    return Table(title, ("greatest of the cases", *(one.name for one in evaluations)), rows, (CAUTION,))


def case_tables(evaluations: Sequence[Evaluation]) -> list[Table]:
    """A table of every case that all `evaluations` have."""
    return [
        Table(case, ("", *(one.name for one in evaluations)), _rows([one.cases[case] for one in evaluations]))
        for case in evaluations[0].cases
        if all(case in one.cases for one in evaluations)
    ]


def _margin(evaluation: Evaluation, name: str) -> str:
    return f"{evaluation.margins[name]:.3g}" if name in evaluation.margins else "not stable"


def uncontrolled_table(values: Mapping[str, Mapping[str, float]]) -> Table:
    """What the criteria are divided by: a column for each case, its `values` by the names of `criteria.peaks`."""
    known = [name for name in QUANTITIES if all(name in case for case in values.values())]
    rows = tuple((QUANTITIES[name], *(f"{case[name]:.4g}" for case in values.values())) for name in known)
    yields = any(case.get("phi_max", 0.0) > 1 for case in values.values())
    return Table("Without control", ("criteria are divided by", *values), rows, (YIELDS,) if yields else ())


def _rows(columns: Sequence[Mapping[str, float]]) -> tuple[tuple[str, ...], ...]:
    known = [name for name in MEANINGS if any(name in column for column in columns)]
    return tuple(
        (f"{name} {MEANINGS[name]}", *(f"{column[name]:.4g}" if name in column else "-" for column in columns))
        for name in known
    )
