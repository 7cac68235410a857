# SPDX-License-Identifier: Apache-2.0
"""The sections of a campaign's report, from its results and its bags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace.report.recorded import RecordedTest, rigs_of
from abrace.report.recorded_figures import response_chart
from abrace.report.result import result_table, verdicts
from abrace.report.sections import Listing, Part, Picture, Section, pictures
from abrace.report.table import Table
from abrace.report.tables import (
    event_tables,
    identification_tables,
    interval_tables,
    margin_table,
    one_comparison,
    tables_of_all,
    timing_table,
)
from abrace_core.figures.drawing import captioned
from abrace_core.figures.saving import CHART, save_figure
from abrace_core.files.checksum import file_checksum
from abrace_core.model import signals
from abrace_core.model.response import PAPER_RIG, clipped_sentences, paper_unit, peak_rms
from abrace_plant.rig.characteristics import characterize
from abrace_plant.rig.characteristics_figure import characteristics_figure

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from matplotlib.figure import Figure

    from abrace.report.results import Results
    from abrace.report.units import Units
    from abrace_core.figures.chart import Chart
    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig

FIGURES = "figures"
"""Folder of the figures that the report itself makes."""
FIRST = ("validity", "figure_*", "poles", "confidence", "*")
"""Order of an identification's figures."""


@dataclass(frozen=True)
class Report:
    """A campaign's report: from the results in a directory and the tests that were recorded, in some units."""

    directory: Path
    results: Results
    tests: list[RecordedTest]
    units: Units

    def sections(self) -> list[Section]:
        """The whole content of the report; figures of rig and tests are drawn and saved."""
        found = [
            Section("Result", tuple(self._result())),
            Section("Comparisons", tuple(self._comparisons())),
            Section("Controllers", tuple(self._controllers())),
            Section("Identification", tuple(self._identification())),
            Section("Tests", tuple(self._tests())),
            Section("Warnings", tuple(self._warnings())),
            Section("What was recorded", tuple(self._responses())),
            Section("The rig", tuple(part for rig in rigs_of(self.tests) for part in self._rig(rig))),
            Section("Timing", (timing_table(self.results.timing),)),
            Section("More figures", ()),
            Section("How to make it again", tuple(self._again())),
        ]
        shown = {part.path for section in found for part in section.parts if isinstance(part, Picture)}
        own = self.directory / FIGURES
        rest = [one for one in pictures(self.directory) if one.path not in shown and own not in one.path.parents]
        found = [Section(one.title, tuple(rest)) if one.title == "More figures" else one for one in found]
        return [section for section in found if section.parts]

    def _result(self) -> Iterator[Part]:
        yield from verdicts(self.results)
        if found := result_table(self.results, self.units):
            yield found

    def _rig(self, rig: Rig) -> Iterator[Part]:
        characteristics = characterize(rig)
        yield Table("", ("", "value"), tuple(_rig_rows(rig)))
        pairs = [("bare frame", characteristics.bare), ("zero command", characteristics.zero_command)]
        pairs.append(("further pair", characteristics.extra))
        rows = tuple(
            (f"{name} {i}", f"{frequency:.4g}", f"{frequency / (2 * np.pi):.4g}", f"{100 * ratio:.3g}")
            for name, several in pairs
            for i, (frequency, ratio) in enumerate(several, 1)
        )
        yield Table("Poles, as the rig file has them", ("", "rad/s", "Hz", "damping %"), rows)
        papers = " Grey: the numbers that the paper prints (Figs. 2 and 3)." if rig.name == PAPER_RIG else ""
        caption = (
            f"Rig {rig.name}, computed from its file: an actuator on the bench and in the building, "
            f"poles, and the first mode.{papers}"
        )
        yield self._saved(f"rig_{rig.name}", captioned(characteristics_figure(rig, characteristics), caption))

    def _tests(self) -> Iterator[Part]:
        readable = [(test, test.run) for test in self.tests if test.run is not None]
        if readable:
            names = _worth_a_column(readable[0][1])
            rows = tuple(self._test_row(test, run, names) for test, run in readable)
            peaks = tuple(f"peak {self.units.quantity(name)}" for name in names)
            yield Table("", ("test", "table and commands", "controller", "s", *peaks), rows)
        yield from (f"{test.step}: not read: {test.missing}" for test in self.tests if test.run is None)

    def _test_row(self, test: RecordedTest, run: Run, names: list[str]) -> tuple[str, ...]:
        found = {name: row.peak for name, row in peak_rms(run).items()}
        if signals.GROUND in run.all_names:
            found[signals.GROUND] = float(np.abs(run.ground_acceleration).max())
        cells = (self.units.cell(name, paper_unit(name)[0] * found[name] if name in found else None) for name in names)
        duration = len(run.sequence) * run.sample_period
        return (test.step, test.drive(self.units), str(test.facts.get("controller") or "-"), f"{duration:g}", *cells)

    def _responses(self) -> Iterator[Part]:
        for test in self.tests:
            if test.run is not None:
                yield self._saved(test.step, response_chart(test, test.run, self.units))

    def _identification(self) -> Iterator[Part]:
        yield from identification_tables(self.results)
        yield from interval_tables(self.results)
        for step in dict.fromkeys([*self.results.validity, *self.results.intervals, *self.results.ambient]):
            yield from pictures(self.directory / step, FIRST)

    def _controllers(self) -> Iterator[Part]:
        if self.results.proofs:
            yield margin_table(self.results.proofs)
        for step in self.results.proofs:
            yield from pictures(self.directory / step)

    def _comparisons(self) -> Iterator[Part]:
        yield from tables_of_all(self.results, self.units)
        for step, comparison in self.results.comparisons.items():
            yield from one_comparison(comparison, self.units)
            yield from pictures(self.directory / step)

    def _warnings(self) -> Iterator[Part]:
        yield from event_tables(self.results)
        rows = [
            (
                test.step,
                "; ".join(clipped_sentences(test.run.clipped_samples)) or "none",
                str(test.lost),
                _warnings(test),
            )
            for test in self.tests
            if test.run is not None
        ]
        if rows:
            yield Table(
                "", ("test", "at the end of a sensor's range", "samples lost", "warnings of the bag"), tuple(rows)
            )

    def _again(self) -> Iterator[Part]:
        origin = self.results.origin
        if origin is not None:
            yield f"The campaign, begun {origin.begun}:"
            yield Listing(origin.command)
        folder = self.directory / "nodes"
        commands = [
            f"abrace run {package} {node} --ros-args --params-file {path}"
            for step in self.results.timing.steps
            for package, node in OFFLINE
            if (path := folder / f"{step.name}_{node}.yaml").exists()
        ]
        if commands:
            yield "Its offline steps, again from the same bags:"
            yield Listing("\n".join(commands))
        files = [*self.directory.glob("*/*.json"), *self.directory.glob("*/*.yaml"), self.directory / "poles.json"]
        results = [path for path in sorted(files) if path.parent.name != "nodes" and path.exists()]
        results = [path for path in results if not path.name.endswith(CHART)]
        rows = [(str(test.bag), file_checksum(test.bag)) for test in self.tests if test.run is not None]
        rows += [(path.relative_to(self.directory).as_posix(), file_checksum(path)) for path in results]
        yield Table("Checksums", ("bag or file", "SHA-256"), tuple(rows), (BAG_CHECKSUM,))
        if origin is not None:
            yield Table("Versions", ("", "version"), tuple(origin.versions.items()))
            yield f"The campaign file {origin.campaign_file.path} (SHA-256 {origin.campaign_file.sha256}):"
            yield Listing(origin.campaign_file.text.rstrip())

    def _saved(self, name: str, figure: Figure | Chart) -> Picture:
        path = self.directory / FIGURES / f"{name}.svg"
        save_figure(figure, path)
        return Picture.of(path)


OFFLINE = (
    ("abrace_sysid", "identify"),
    ("abrace_lqg", "design"),
    ("abrace_sysid", "validate"),
    ("abrace_sysid", "ambient"),
)
"""Nodes of the steps between the tests."""
BAG_CHECKSUM = "Of a bag: the SHA-256 of its files' names and checksums, as in steps.json."


def _rig_rows(rig: Rig) -> Iterator[tuple[str, str]]:
    yield "name", rig.name
    yield "floors", str(rig.floors)
    yield "storey height [m]", f"{rig.storey_height:g}"
    yield "masses [kg]", ", ".join(f"{mass:.5g}" for mass in rig.building.masses)
    for number, group in enumerate(rig.braces, 1):
        actuator = group.actuator
        text = f"{group.count} below floor {group.floor}, capacity {actuator.capacity / 1000:.4g} kN each"
        yield f"brace group {number}", text
    yield "sample rate [Hz]", f"{rig.sample_rate:g}"
    if rig.not_measured:
        yield "not measured", ", ".join(rig.not_measured)
    table = rig.table
    limits = (f"{table.peak_acceleration:g} m/s²", f"{table.peak_velocity:g} m/s", f"{table.peak_displacement:g} m")
    yield "table, at most", ", ".join(limits)


def _worth_a_column(run: Run) -> list[str]:
    tops = [[name for name in run.names if name[0] == letter and name[1:].isdigit()][-1:] for letter in "xa"]
    forces = [name for name in run.names if name[0] == "f"][:1]
    return [signals.GROUND, *tops[0], *tops[1], *forces, *run.command_names[:1]]


def _warnings(test: RecordedTest) -> str:
    return "; ".join(test.facts.get("warnings", [])) or "none"
