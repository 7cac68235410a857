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
        By the names in MARGINS; empty: not known.
    profiles
        Of each case.
    """

    name: str
    cases: Mapping[str, Mapping[str, float]]
    margins: Mapping[str, float] = field(default_factory=dict)
    profiles: Mapping[str, Profile] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        name: str,
        found: Mapping[str, tuple[Mapping[str, float], Responses]],
        layout: Layout,
        margins: Mapping[str, float] | None = None,
    ) -> Evaluation:
        """Of the criteria and responses `found` in each case, with a `name`, the building's `layout`, and `margins`."""
        profiles = {case: Profile.of(responses, layout) for case, (_, responses) in found.items()}
        return cls(name, {case: values for case, (values, _) in found.items()}, margins or {}, profiles)

    def worst(self) -> dict[str, float]:
        """The greatest of each criterion over the cases."""
        return {name: max(case[name] for case in self.cases.values()) for name in next(iter(self.cases.values()))}


def worst_table(title: str, evaluations: Sequence[Evaluation]) -> Table:
    """The worst of every criterion, and margins, below a `title`: a column for each of the `evaluations`."""
    rows = _rows([evaluation.worst() for evaluation in evaluations])
    for name, label in MARGINS.items():
        if any(name in evaluation.margins for evaluation in evaluations):
            cells = (
                f"{evaluation.margins[name]:.3g}" if name in evaluation.margins else "-" for evaluation in evaluations
            )
            rows += ((label, *cells),)
    return Table(title, ("greatest of the cases", *(one.name for one in evaluations)), rows, (CAUTION,))


def case_tables(evaluations: Sequence[Evaluation]) -> list[Table]:
    """A table of every case that all `evaluations` have."""
    return [
        Table(case, ("", *(one.name for one in evaluations)), _rows([one.cases[case] for one in evaluations]))
        for case in evaluations[0].cases
        if all(case in one.cases for one in evaluations)
    ]


def _rows(columns: Sequence[Mapping[str, float]]) -> tuple[tuple[str, ...], ...]:
    known = [name for name in MEANINGS if any(name in column for column in columns)]
    return tuple(
        (f"{name} {MEANINGS[name]}", *(f"{column[name]:.4g}" if name in column else "-" for column in columns))
        for name in known
    )
