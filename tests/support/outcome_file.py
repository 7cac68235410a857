# SPDX-License-Identifier: Apache-2.0
"""A plugin of pytest that writes each test's outcome at once, so that it is known also of a run that was killed.

`python -m pytest -p outcome_file --outcomes FILE ...`: a line of JSON a report, with `test`, `outcome` (passed, failed,
skipped) and `why`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest


class OutcomeFile:
    """Writes what pytest reports to the end of a file."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a test's outcome: its call, and whatever else did not pass."""
        if report.when == "call" or not report.passed:
            self._write(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Write why a file has no tests."""
        if not report.passed:
            self._write(report)

    def _write(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        expected = hasattr(report, "wasxfail")
        outcome = "passed" if expected and report.skipped else report.outcome
        line = {"test": report.nodeid, "outcome": outcome, "why": _why(report)}
        with self._file.open("a") as file:
            file.write(json.dumps(line) + "\n")


def _why(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Why a test did not pass: the place and the message of its exception."""
    if report.passed:
        return ""
    if isinstance(report.longrepr, tuple):  # skipped: file, line, reason
        return str(report.longrepr[2]).removeprefix("Skipped: ")
    crash = getattr(report.longrepr, "reprcrash", None)
    text = f"{Path(crash.path).name}:{crash.lineno}: {crash.message}" if crash is not None else report.longreprtext
    return str(text).strip()[:2000]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the file."""
    parser.addoption("--outcomes", metavar="FILE", help="each test's outcome, a line of JSON each")


def pytest_configure(config: pytest.Config) -> None:
    """Write from pytest itself, which hears of all tests, not from the workers that it distributes them to."""
    if (name := config.getoption("outcomes")) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(OutcomeFile(Path(name)))
