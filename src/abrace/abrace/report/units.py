# SPDX-License-Identifier: Apache-2.0
"""The units of a report: cm, g and kgf for the paper's rig, mm, m/s² and kN for every other, or a given system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_core.model import signals
from abrace_core.model.response import UnitSystem, paper_unit, shown_unit

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

    def unit(self, name: str) -> str:
        """The unit of the signal `name`."""
        return shown_unit(name, self.system)[1]

    def motion(self, record: str, peak: float | None) -> str:
        """A `record` with its `peak` acceleration [m/s^2], of which 0 or None is as recorded.

        >>> Units("paper").motion("el_centro", 0.980665), Units("SI").motion("kobe", 0)
        ('el_centro at 0.1 g', 'kobe')
        """
        if not peak:
            return record
        factor, unit = shown_unit(signals.GROUND, self.system)
        return f"{record} at {factor * peak:.3g} {unit}"

    def quantity(self, name: str) -> str:
        """The signal `name` with its unit.

        >>> Units("paper").quantity("x1"), Units("SI").quantity("f")
        ('x1 [cm]', 'f [kN]')
        """
        return f"{name} [{self.unit(name)}]"

    def cell(self, name: str, value: float | None) -> str:
        """A `value` of the signal `name` [cm, g or kgf] as a cell of a table; None: a dash.

        >>> Units("paper").cell("x1", 1.104), Units("SI").cell("x1", 1.104), Units("SI").cell("x1", None)
        ('1.104', '11.04', '-')
        """
        if value is None:
            return "-"
        return format(value * self.factor(name), FORMATS[self.unit(name)])

    def numbers(self, rows: Mapping[str, Cells]) -> dict[str, dict[str, float | None]]:
        """Peak and rms of the `rows`, as numbers; None where they are not known."""
        return {
            name: {key: None if value is None else value * self.factor(name) for key, value in row}
            for name, row in rows.items()
        }
