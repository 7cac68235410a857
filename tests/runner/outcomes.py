# SPDX-License-Identifier: Apache-2.0
"""What is known of each test after its runs: passed, failed, unsteady, skipped; a test by its name in pytest."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable


@dataclass
class Outcomes:
    """Of the tests of a stage, over all their runs."""

    runs: dict[str, list[str | None]] = field(default_factory=dict)
    """Of each test that was not skipped, in each of its runs: None where it passed, else why it failed."""
    skipped: dict[str, str] = field(default_factory=dict)
    """Why a test was skipped in its last run."""

    def add(self, found: Outcomes) -> None:
        """Add what one more run has found."""
        for test, whys in found.runs.items():
            self.runs.setdefault(test, []).extend(whys)
        self.skipped |= found.skipped

    def split(self, names: Collection[str]) -> tuple[Outcomes, Outcomes]:
        """Without the tests of these names, and those alone."""
        inside = {test: whys for test, whys in self.runs.items() if test in names}
        outside = {test: whys for test, whys in self.runs.items() if test not in names}
        return Outcomes(outside, self.skipped), Outcomes(inside)

    def passed(self) -> set[str]:
        """Tests that passed in at least one run, unsteady ones too."""
        return {test for test, whys in self.runs.items() if None in whys}

    def failed(self) -> dict[str, str]:
        """Tests that passed in none of their runs, with the first failure."""
        return {test: whys[0] for test, whys in self.runs.items() if whys[0] is not None and None not in whys}

    def unsteady(self) -> dict[str, str]:
        """Tests that failed in one run and passed in another, with the first failure."""
        return {
            test: next(why for why in whys if why is not None)
            for test, whys in self.runs.items()
            if None in whys and len(whys) > whys.count(None)
        }

    def reasons(self) -> Counter[str]:
        """How many tests were skipped, by the reason."""
        return Counter(why for test, why in self.skipped.items() if test not in self.runs)


def one(name: str, why: str | None) -> Outcomes:
    """Outcomes of one run of what is no test of pytest's: a command, pytest itself."""
    return Outcomes({name: [why]})


def read_outcomes(file: Path) -> Outcomes:
    """What one run of pytest wrote by `tests/support/outcome_file.py`, as far as it came."""
    found = Outcomes()
    for line in file.read_text().splitlines() if file.exists() else ():
        try:
            report = json.loads(line)
        except ValueError:
            continue  # cut off where pytest was killed
        test, why = report["test"], report["why"]
        if report["outcome"] == "skipped":
            found.skipped[test] = why
        elif report["outcome"] == "failed":  # a test that passed may fail when it is taken down
            found.runs[test] = [why]
        else:
            found.runs.setdefault(test, [None])
    return found


def read_quarantine(file: Path) -> dict[str, str]:
    """The reasons of tests in quarantine: lines `TEST: REASON`, at most ten.

    Raises
    ------
    ValueError
        A line without a reason, a test of a file that is not there, or an eleventh test.
    """
    lines = [line for line in file.read_text().splitlines() if line.strip() and not line.startswith("#")]
    reasons = {}
    for line in lines:
        test, mark, reason = line.partition(": ")
        if not mark or not reason.strip():
            raise ValueError(f"{file}: {line!r}, expected TEST: REASON")
        if not Path(test.split("::")[0]).is_file():
            raise ValueError(f"{file}: {test}: no such file")
        reasons[test] = reason.strip()
    if len(reasons) > 10:
        raise ValueError(f"{file}: {len(reasons)} tests, expected 10 at most: mend one before another is put there")
    return reasons


@dataclass
class Report:
    """All that is known of all stages, for people and for results/tests.json."""

    rows: list[tuple[str, ...]] = field(default_factory=list)
    passed: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    unsteady: dict[str, str] = field(default_factory=dict)
    quarantine: dict[str, str] = field(default_factory=dict)
    skipped: Counter[str] = field(default_factory=Counter)
    seconds: dict[str, int] = field(default_factory=dict)

    def add(self, stage: str, seconds: float, outcomes: Outcomes, quarantine: dict[str, str]) -> None:
        """Add what is known of a stage."""

        def told(tests: dict[str, str]) -> dict[str, str]:
            # the libraries' stage has the same tests
            twice = stage in ("old_processor", "versions")
            return {f"{test} ({stage})" if twice else test: why for test, why in tests.items()}

        here, aside = outcomes.split(quarantine)
        passed, failed, unsteady, skipped = here.passed(), here.failed(), here.unsteady(), here.reasons()
        self.passed += len(passed)
        self.failed |= told(failed)
        self.unsteady |= told(unsteady)
        for test in aside.runs:
            now = (aside.failed() | aside.unsteady()).get(test, "passed")
            self.quarantine |= told({test: f"{first_line(now)} (in quarantine: {quarantine[test]})"})
        self.skipped += skipped
        self.seconds[stage] = round(seconds)
        counts = (round(seconds), len(passed), len(failed), len(unsteady), skipped.total())
        self.rows.append((stage, *map(str, counts)))

    def json(self) -> str:
        """The text of results/tests.json."""
        names = ("passed", "failed", "unsteady", "quarantine", "skipped", "seconds")
        return json.dumps({name: getattr(self, name) for name in names}, indent=1) + "\n"

    def text(self, strict: bool) -> str:
        """For people: a table of the stages, and each test that did not simply pass."""
        lines = [table([("stage", "seconds", "passed", "failed", "unsteady", "skipped"), *self.rows])]
        lines += [f"skipped: {count}: {why}" for why, count in self.skipped.most_common()]
        for word, tests in (("quarantine", self.quarantine), ("unsteady", self.unsteady), ("failed", self.failed)):
            for test, why in tests.items():
                # below how a command ended stand the last lines of its output
                shown = [first_line(why)] if ".py" in test else why.splitlines()
                lines += [f"{word}: {test}", *(f"    {line}" for line in shown)]
        also = len(self.unsteady) if strict else 0
        lines.append(f"{self.passed - also} passed, {len(self.failed) + also} failed")
        return "\n".join(lines)


def first_line(text: str) -> str:
    """The first line of a failure."""
    return next(iter(text.strip().splitlines()), "")


def table(rows: Iterable[tuple[str, ...]]) -> str:
    """Rows as aligned columns, the first one to the left."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.rjust(width) if number else cell.ljust(width) for number, (cell, width) in enumerate(cells))
        for cells in (list(zip(row, widths, strict=True)) for row in rows)
    )
