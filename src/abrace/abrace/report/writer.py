# SPDX-License-Identifier: Apache-2.0
"""The report of a campaign: report.html, summary.json and the tables that the campaign prints.

Made from the files in the directory of the results (`abrace.report.results`) and the bags of the tests.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from abrace.report.content import Report
from abrace.report.page import page
from abrace.report.recorded import recorded_tests
from abrace.report.result import result_table, verdicts
from abrace.report.results import read_results
from abrace.report.summary import summarise
from abrace.report.tables import tables
from abrace.report.units import Units
from abrace_core.files.writing import write_json, write_text
from abrace_core.model.response import PAPER_RIG, UnitSystem, unit_system

if TYPE_CHECKING:
    from abrace.report.results import Results


def make_report(directory: Path | str, system: UnitSystem | None = None) -> str:
    """Write report.html and summary.json into the directory of a campaign; returns tables as text.

    Parameters
    ----------
    directory
        Of the results. Figures (SVG) below it are in the report.
    system
        Units; None: the paper's if every test was made with its rig, else SI units.

    Raises
    ------
    AbraceError
        If a file of the results is missing or malformed; nothing is written then.
    """
    directory = Path(directory)
    results = read_results(directory)
    tests = recorded_tests(directory, (step.name for step in results.timing.steps))
    rigs = results.rigs | {str(test.facts["rig"]) for test in tests if "rig" in test.facts}
    units = Units(system or unit_system(PAPER_RIG if rigs == {PAPER_RIG} else ""))
    title, sections = directory.resolve().name, Report(directory, results, tests, units).sections()
    write_json(directory / "summary.json", summarise(results, units))
    write_text(directory / "report.html", page(title, _subtitle(results, rigs), sections))
    shown = [*tables(results, units), result_table(results, units)]
    return "\n\n".join([*(table.text() for table in shown if table), "\n".join(verdicts(results))]).rstrip()


def _subtitle(results: Results, rigs: set[str]) -> str:
    parts = [f"Rig {', '.join(sorted(rigs))}"] if rigs else []
    if results.origin is not None:
        parts.append(f"begun {results.origin.begun}, abrace {results.origin.versions.get('abrace', '')}")
    parts += [f"{step}: {one.verdict.words}" for step, one in results.validity.items()]
    return "; ".join(parts)
