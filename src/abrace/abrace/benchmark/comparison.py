# SPDX-License-Identifier: Apache-2.0
"""Controllers side by side on a benchmark: criteria of every case, margins, and what the figures show."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from abrace.benchmark.criteria import MEANINGS, storey_quantities
from abrace.report.table import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace.benchmark.criteria import Layout, Responses

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


@dataclass(frozen=True)
class Profile:
    """Greatest values over the height: drift ratios and accelerations (levels,) [m/s^2]."""

    drift: NDArray[np.float64]
    acceleration: NDArray[np.float64]

    @classmethod
    def of(cls, found: Responses, layout: Layout) -> Profile:
        """Of the responses `found` in a run, with the building's `layout`."""
        drift = storey_quantities(found.displacement) / layout.heights
        return cls(np.abs(drift).max(axis=0), np.abs(found.acceleration).max(axis=0))


@dataclass(frozen=True)
class Evaluation:
    """What a controller reached.

    Parameters
    ----------
    name
        Of the controller.
    cases
        Criteria of each case, by its name.
    margins
        By the names in MARGINS; empty: not known, or the loop is not stable.
    profiles
        Of each case.
    stable
        Whether the linear loop is, as far as it is known.
    """

    name: str
    cases: Mapping[str, Mapping[str, float]]
    margins: Mapping[str, float] = field(default_factory=dict)
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    stable: bool = True

    @classmethod
    def of(
        cls,
        name: str,
        found: Mapping[str, tuple[Mapping[str, float], Responses]],
        layout: Layout,
        margins: Mapping[str, float] | None = None,
    ) -> Evaluation:
        """Of the criteria and responses `found` in each case.

        `name` is the controller's, `layout` the building's; `margins` as `margins_of` gives them, None: not known.
        """
        stable = margins is None or bool(margins)
        profiles = {case: Profile.of(responses, layout) for case, (_, responses) in found.items()}
        return cls(name, {case: values for case, (values, _) in found.items()}, margins or {}, profiles, stable)

    def worst(self) -> dict[str, float]:
        """The greatest of each criterion over the cases."""
        return {name: max(case[name] for case in self.cases.values()) for name in next(iter(self.cases.values()))}


def worst_table(title: str, evaluations: Sequence[Evaluation]) -> Table:
    """The worst of every criterion, and margins, below a `title`: a column for each of the `evaluations`."""
    rows = _rows([evaluation.worst() for evaluation in evaluations])
    if any(one.margins or not one.stable for one in evaluations):
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
    if name in evaluation.margins:
        return f"{evaluation.margins[name]:.3g}"
    return "-" if evaluation.stable else "not stable"


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
