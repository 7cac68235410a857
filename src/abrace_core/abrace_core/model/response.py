# SPDX-License-Identifier: Apache-2.0
"""Peak and rms of a test's recorded quantities, in the rows of the paper's Table 1, in its units or in SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.run import Run


class PeakRms(NamedTuple):
    """Greatest magnitude and root mean square of one quantity over a test."""

    peak: float
    rms: float


TABLE_1_EXPERIMENT = {
    "x1": PeakRms(1.104, 0.159),
    "x2": PeakRms(1.969, 0.292),
    "x3": PeakRms(2.488, 0.371),
    "xf": PeakRms(0.885, 0.127),
    "a1": PeakRms(0.106, 0.010),
    "a2": PeakRms(0.127, 0.014),
    "a3": PeakRms(0.196, 0.019),
    "f": PeakRms(1556.0, 195.3),
    "U": PeakRms(1457.0, 185.8),
}
"""The paper's experiment: El Centro at 0.1 g with LQG3 [cm, g, kgf]."""

TABLE_1_SIMULATION = {
    "x1": PeakRms(1.339, 0.166),
    "x2": PeakRms(2.239, 0.319),
    "x3": PeakRms(2.652, 0.384),
    "xf": PeakRms(1.167, 0.154),
    "a1": PeakRms(0.101, 0.013),
    "a2": PeakRms(0.133, 0.017),
    "a3": PeakRms(0.170, 0.021),
    "f": PeakRms(1725.0, 221.0),
    "U": PeakRms(1657.0, 205.8),
}
"""The paper's simulation of the same test [cm, g, kgf]; its `mean_relative_error` from the experiment is 0.136."""

PAPER_RIG = "ncree_three_storey"
"""Name in the rig file of the paper's building; only this rig is compared with the paper's numbers."""

UnitSystem = Literal["paper", "SI"]
"""Units in which quantities are shown: cm, g and kgf, or mm, m/s² and kN."""

_PAPER_UNITS = {"x": (100.0, "cm"), "a": (1 / 9.80665, "g"), "w": (1 / 9.80665, "g")}
_PAPER_FORCE = (1 / 9.80665, "kgf")
_SI_UNITS = {"x": (1000.0, "mm"), "a": (1.0, "m/s²"), "w": (1.0, "m/s²")}
_SI_FORCE = (0.001, "kN")


def paper_unit(name: str) -> tuple[float, str]:
    """The factor from SI units to the paper's unit of the signal `name`, and that unit.

    >>> paper_unit("x3")
    (100.0, 'cm')
    >>> [paper_unit(name)[1] for name in ("xf", "a1", "f", "U", "w")]
    ['cm', 'g', 'kgf', 'kgf', 'g']
    """
    return _PAPER_UNITS.get(name[0], _PAPER_FORCE)


def unit_system(rig: str) -> UnitSystem:
    """The units in which tests of the `rig` of this name are shown.

    >>> unit_system("ncree_three_storey"), unit_system("five_storey")
    ('paper', 'SI')
    """
    return "paper" if rig == PAPER_RIG else "SI"


def shown_unit(name: str, system: UnitSystem) -> tuple[float, str]:
    """The factor from SI base units to that in which a `system` of units shows the signal `name`, and that unit.

    >>> [shown_unit(name, "SI") for name in ("x3", "a1", "U")]
    [(1000.0, 'mm'), (1.0, 'm/s²'), (0.001, 'kN')]
    """
    return paper_unit(name) if system == "paper" else _SI_UNITS.get(name[0], _SI_FORCE)


def peak_rms_of(names: Sequence[str], values: NDArray[np.float64]) -> dict[str, PeakRms]:
    """Peak and rms of each of `values` (samples, names), in the units of `values`."""
    peak = np.abs(values).max(axis=0)
    rms = np.sqrt(np.mean(values**2, axis=0))
    return {name: PeakRms(float(p), float(r)) for name, p, r in zip(names, peak, rms, strict=True)}


def peak_rms(run: Run) -> dict[str, PeakRms]:
    """Peak and rms of a run's recorded quantities and commands, in the rows of Table 1 [SI units]."""
    if not len(run.outputs):
        raise AbraceError(f"{run.source}: no samples, expected at least one")
    return peak_rms_of((*run.names, *run.command_names), np.hstack([run.outputs, run.command]))


def in_paper_units(table: Mapping[str, PeakRms]) -> dict[str, PeakRms]:
    """The same table in cm, g and kgf."""
    return {name: PeakRms(*(value * paper_unit(name)[0] for value in row)) for name, row in table.items()}


def mean_relative_error(table: Mapping[str, PeakRms], reference: Mapping[str, PeakRms]) -> float:
    """Mean absolute relative error over all cells of the reference (18 in Table 1), in the same units.

    >>> round(mean_relative_error(TABLE_1_SIMULATION, TABLE_1_EXPERIMENT), 3)
    0.136

    Raises
    ------
    AbraceError
        If the table has no row that the reference has, or the reference has a zero.
    """
    missing = [name for name in reference if name not in table]
    if missing:
        raise AbraceError(f"peak and rms table: no row {', '.join(missing)}, expected {', '.join(reference)}")
    zero = [name for name, row in reference.items() if 0 in row]
    if zero:
        raise AbraceError(
            f"peak and rms table: the reference is zero in row {', '.join(zero)}, expected numbers above zero"
        )
    errors = [abs(a - b) / abs(b) for name, row in reference.items() for a, b in zip(table[name], row, strict=True)]
    return float(np.mean(errors))


def clipped_sentences(counts: Mapping[str, int | None] | None) -> list[str]:
    """Sentences on the channels at the end of their range, from `Run.clipped_samples` as `counts`.

    >>> clipped_sentences({"a2": 14, "w": 1})
    ['a2: 14 samples at the end of its range', 'w: 1 sample at the end of its range']
    >>> clipped_sentences({}), clipped_sentences({"a17": None, "w": None})
    ([], ['a17, w: unknown whether at the end of the range, not flagged'])
    """
    if counts is None:
        return ["samples at the end of a sensor's range: unknown, its responses have no such flag"]
    found = [f"{name}: {n} sample{'s' if n > 1 else ''} at the end of its range" for name, n in counts.items() if n]
    unknown = [name for name, n in counts.items() if n is None]
    return found + ([f"{', '.join(unknown)}: unknown whether at the end of the range, not flagged"] if unknown else [])
