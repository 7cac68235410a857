# SPDX-License-Identifier: Apache-2.0
"""The units of a report: cm, g and kgf for the paper's rig, mm, m/s² and kN for every other, or a given system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_core.response import UnitSystem, paper_unit, shown_unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from abrace.report.results import Cells

FORMATS = {"cm": ".3f", "g": ".4f", "kgf": ".1f", "mm": ".2f", "m/s²": ".3f", "kN": ".3f"}


@dataclass(frozen=True)
class Units:
    """Shows numbers of the results, which are in the paper's units, in those of a `system`."""

    system: UnitSystem

    def factor(self, name: str) -> float:
        """From the paper's unit of the signal `name` to the one that is shown."""
        return shown_unit(name, self.system)[0] / paper_unit(name)[0]

    def quantity(self, name: str) -> str:
        """The signal `name` with its unit.

        >>> Units("paper").quantity("x1"), Units("SI").quantity("f")
        ('x1 [cm]', 'f [kN]')
        """
        return f"{name} [{shown_unit(name, self.system)[1]}]"

    def cell(self, name: str, value: float | None) -> str:
        """A `value` of the signal `name` [cm, g or kgf] as a cell of a table; None: a dash.

        >>> Units("paper").cell("x1", 1.104), Units("SI").cell("x1", 1.104), Units("SI").cell("x1", None)
        ('1.104', '11.04', '-')
        """
        if value is None:
            return "-"
        return format(value * self.factor(name), FORMATS[shown_unit(name, self.system)[1]])

    def numbers(self, rows: Mapping[str, Cells]) -> dict[str, dict[str, float]]:
        """Peak and rms of the `rows`, as numbers."""
        return {
            name: {"peak": row.peak * self.factor(name), "rms": row.rms * self.factor(name)}
            for name, row in rows.items()
        }
