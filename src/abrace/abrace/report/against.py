# SPDX-License-Identifier: Apache-2.0
"""Comparison of two campaigns: poles, validity, margins, measured peaks and rms, timing, and their differences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace.report.page import page
from abrace.report.results import read_results
from abrace.report.sections import Part, Picture, Section
from abrace.report.summary import nearest_pole, poles_by_test, timing_summary
from abrace.report.table import Table
from abrace.report.units import Units
from abrace_core.drawing import MEASURED, SIMULATED, captioned, save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.response import PAPER_RIG, UnitSystem, unit_system

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace.report.results import Comparison, LeastMargins, Results


def compare_campaigns(directory: Path, other: Path, system: UnitSystem | None = None) -> str:
    """Write against_OTHER.html into the `directory` of a campaign's results; returns its tables as text.

    Parameters
    ----------
    directory, other
        Of the results; differences are those of `directory` from `other`.
    system
        Units; None: the paper's if both have its rig alone, else SI units.

    Raises
    ------
    AbraceError
        If a file of the results is missing or malformed, or the two have nothing in common; nothing is written then.
    """
    directory, other = Path(directory), Path(other)
    if directory.resolve() == other.resolve():
        raise AbraceError(f"--against {other}: the same campaign, expected another one")
    these, those = read_results(directory), read_results(other)
    units = Units(system or unit_system(PAPER_RIG if these.rigs | those.rigs == {PAPER_RIG} else ""))
    names = (directory.resolve().name, other.resolve().name)
    if names[0] == names[1]:
        names = (str(directory), str(other))
    title = f"{names[0]} against {names[1]}"
    pair = _Pair(these, those, names, units)
    tables = {"Identification": list(pair.identification()), "Controllers": list(pair.controllers())}
    tables |= {"Responses": list(pair.responses()), "Timing": list(pair.timing())}
    if not any(tables[name] for name in ("Identification", "Controllers", "Responses")) and not _same_steps(pair):
        raise AbraceError(f"{directory} and {other}: no step, test or model in common, expected two of like campaigns")
    folder = f"against_{other.resolve().name}"
    pictures: list[Part] = []
    for step in pair.common:
        path = directory / "figures" / folder / f"{step}.png"
        save_figure(pair.figure(step), path)
        pictures.append(Picture(path))
    sections = [Section(name, tuple(several)) for name, several in tables.items() if several]
    sections.insert(0, Section("Peaks and rms over those of " + names[1], tuple(pictures)))
    sections = [section for section in sections if section.parts]
    write_text(directory / f"{folder}.html", page(title, f"Differences: {names[0]} minus {names[1]}.", sections))
    return "\n\n".join(table.text() for several in tables.values() for table in several)


def _same_steps(pair: _Pair) -> bool:
    mine, theirs = ({step.name for step in one.timing.steps} for one in (pair.these, pair.those))
    return bool(mine & theirs)


class _Pair:
    """Two campaigns' results, with their `names`.

    Parameters
    ----------
    these, those
        Results; differences are those of the first from the second.
    names
        Of the campaigns.
    units
        In which numbers are shown.
    """

    def __init__(self, these: Results, those: Results, names: tuple[str, str], units: Units) -> None:
        self.these, self.those, self.names, self.units = these, those, names, units
        self.common = [step for step in these.comparisons if step in those.comparisons]

    def identification(self) -> Iterator[Table]:
        """Poles and verdicts."""
        if self.these.poles and self.those.poles:
            pairs = zip(poles_by_test(self.these.poles), poles_by_test(self.those.poles), strict=True)
            for (test, mine), (_, theirs) in pairs:
                rows = []
                for number, pole in enumerate(mine.identified, 1):
                    match = nearest_pole(theirs.identified, pole.frequency)
                    frequency, damping = (match.frequency, 100 * match.damping_ratio) if match else (None, None)
                    cells = self._cells(pole.frequency, frequency, ".3f")
                    cells += self._cells(100 * pole.damping_ratio, damping, ".3f")
                    rows.append((str(number), *cells))
                header = ("", f"rad/s: {self.names[0]}", *self._rest, f"damping %: {self.names[0]}", *self._rest)
                yield Table(f"Poles from the {test} test", header, tuple(rows))
        both = [step for step in self.these.validity if step in self.those.validity]
        if both:
            verdicts = tuple((s, self.these.validity[s].verdict, self.those.validity[s].verdict) for s in both)
            yield Table("Validity", ("model", *self.names), verdicts)

    def controllers(self) -> Iterator[Table]:
        """Margins of controllers that both have designed."""
        keys = (
            ("gain", "gain margin [dB]", 1.0),
            ("phase", "phase margin [deg]", 1.0),
            ("delay", "delay margin [ms]", 1e3),
            ("sensitivity_peak", "sensitivity peak", 1.0),
        )

        def value(margins: LeastMargins, key: str, factor: float) -> float | None:
            found = getattr(margins, key)
            return None if found is None else factor * found

        for step in self.these.proofs:
            if step in self.those.proofs:
                both = (self.these.proofs[step].margins, self.those.proofs[step].margins)
                rows = tuple(
                    (title, *self._cells(value(both[0], key, factor), value(both[1], key, factor), ".2f"))
                    for key, title, factor in keys
                )
                yield Table(f"Margins of {step}", ("", self.names[0], *self._rest), rows)

    def responses(self) -> Iterator[Table]:
        """Measured peaks and rms of steps that both have."""
        for step in self.common:
            mine, theirs = self.these.comparisons[step], self.those.comparisons[step]
            rows = []
            for name in (one for one in mine.measured if one in theirs.measured):
                row = [self.units.quantity(name)]
                for key in ("peak", "rms"):
                    values = (getattr(mine.measured[name], key), getattr(theirs.measured[name], key))
                    row += [*(self.units.cell(name, one) for one in values), _difference(*values)]
                rows.append(tuple(row))
            header = ("", f"peak: {self.names[0]}", *self._rest, f"rms: {self.names[0]}", *self._rest)
            yield Table(f"Measured in {step}: {_tested(mine)}{_other(mine, theirs)}", header, tuple(rows))

    def timing(self) -> Iterator[Table]:
        """Wall times of steps that both have."""
        mine, theirs = (timing_summary(one.timing)["wall_seconds"] for one in (self.these, self.those))
        rows = tuple((name, *self._cells(mine[name], theirs[name], ".1f")) for name in mine if name in theirs)
        if rows:
            yield Table("Wall time [s]", ("step", self.names[0], *self._rest), rows)

    def figure(self, step: str) -> Figure:
        """Ratios of measured peaks and rms of a `step`."""
        mine, theirs = self.these.comparisons[step].measured, self.those.comparisons[step].measured
        names = [name for name in mine if name in theirs]
        figure = Figure(figsize=(9.0, 3.0), layout="constrained")
        axis = figure.subplots()
        for shift, key, colour in ((-0.2, "peak", MEASURED), (0.2, "rms", SIMULATED)):
            ratios = [getattr(mine[name], key) / (getattr(theirs[name], key) or np.nan) for name in names]
            axis.bar(np.arange(len(names)) + shift, ratios, 0.4, color=colour, label=key)
        axis.axhline(1.0, color="k", lw=0.8)
        axis.set_xticks(range(len(names)), names)
        axis.set_ylabel("ratio [-]")
        axis.grid(axis="y", alpha=0.3)
        axis.legend(ncols=2, fontsize="small")
        subject = _tested(self.these.comparisons[step])
        return captioned(figure, f"{step}, {subject}: peaks and rms of {self.names[0]} over those of {self.names[1]}.")

    @property
    def _rest(self) -> tuple[str, str]:
        return self.names[1], "difference %"

    def _cells(self, mine: float | None, theirs: float | None, form: str) -> tuple[str, ...]:
        shown = tuple("-" if value is None else format(value, form) for value in (mine, theirs))
        return shown[0], shown[1], _difference(mine, theirs)


def _difference(mine: float | None, theirs: float | None) -> str:
    """In percent of the second; a dash where either is missing or that is zero."""
    return "-" if mine is None or not theirs else f"{100 * (mine / theirs - 1):+.1f}"


def _tested(comparison: Comparison) -> str:
    facts = comparison.test
    peak = f" at {facts.peak_acceleration / 9.80665:.3g} g" if facts.peak_acceleration else ""
    return f"{facts.controller or 'zero command'}, {facts.record or 'no motion'}{peak}"


def _other(mine: Comparison, theirs: Comparison) -> str:
    """What the other campaign tested, if it is different."""
    return "" if mine.test == theirs.test else f" (against {_tested(theirs)}, {theirs.test.rig})"
