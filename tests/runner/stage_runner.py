# SPDX-License-Identifier: Apache-2.0
"""Runs the stages one after another, whatever the ones before gave, and again by itself what failed."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from outcomes import Outcomes, one, read_outcomes
from processes import end_leftovers, left_by_earlier_runs, run, stopping
from stages import PytestStage, Stage

from abrace_node.shared_memory import remove_stale_segments

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

WHOLE = 80 * 60.0
"""Longest time of all stages with what is run again [s]."""
FILE = 900.0
"""Longest time of a file that is run again [s]."""
AGAIN = 2
"""How often a file with a failed test is run again."""
LINES = 20
"""Last lines of a failed command's output that are shown."""


@dataclass
class Runner:
    """Runs stages and keeps what is known of their tests.

    Parameters
    ----------
    output
        Folder of the output of each stage.
    quarantine
        Reasons of the tests that decide nothing.
    whole
        Longest time of everything [s].
    """

    output: Path
    quarantine: dict[str, str] = field(default_factory=dict)
    whole: float = WHOLE
    outcomes: dict[str, Outcomes] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._end = time.monotonic() + self.whole

    def run(self, steps: Iterable[Sequence[Sequence[Stage]]]) -> None:
        """Run the stages of each step, then again what failed in it."""
        for said in left_by_earlier_runs():
            say(said)
        for step in steps:
            with ThreadPoolExecutor() as pool:
                rows = [pool.submit(self._row, row, follow=not number) for number, row in enumerate(step)]
                while wait(rows, timeout=0.5).not_done:
                    pass  # signals are heard between waits, not always within one
            for each in rows:
                each.result()
            for stage in (stage for row in step for stage in row):
                if isinstance(stage, PytestStage):
                    self._timed(stage, partial(self._alone, stage))

    def _row(self, row: Sequence[Stage], follow: bool) -> None:
        for stage in row:
            say(f"{stage.name} begins")
            if isinstance(stage, PytestStage):
                self._timed(stage, partial(self._tests, stage, follow))
            else:
                self._timed(stage, partial(self._command, stage, follow))
            failed = len(self.outcomes[stage.name].failed())
            if failed and not follow:
                print(self._log(stage).read_text(errors="replace") if self._log(stage).exists() else "")
            say(f"{stage.name}: {self.seconds[stage.name]:.0f} s, {failed} failed")

    def _timed(self, stage: Stage, task: partial[None]) -> None:
        start = time.monotonic()
        task()
        self.seconds[stage.name] = self.seconds.get(stage.name, 0.0) + time.monotonic() - start

    def _execute(self, stage: Stage, limit: float, follow: bool, arguments: tuple[str, ...] = ()) -> str:
        """Run a stage's command once, beginning and ending clean; how it ended ("": with 0)."""
        left = self._end - time.monotonic()
        if left <= 0 or stopping.is_set():
            return f"not run: {'interrupted' if stopping.is_set() else f'{self.whole / 60:.0f} minutes are over'}"
        remove_stale_segments()
        command = (*stage.command, *arguments)
        how = run(command, stage.environment, min(limit, left), self._log(stage), stage.name, follow)
        for said in end_leftovers(stage.name):
            say(said)
        return how

    def _log(self, stage: Stage) -> Path:
        return self.output / f"{stage.name}.log"

    def _command(self, stage: Stage, follow: bool) -> None:
        found = self.outcomes[stage.name] = Outcomes()
        for _ in range(stage.runs):
            how = self._execute(stage, stage.limit, follow)
            found.add(one(stage.name, f"{how}\n{last_lines(self._log(stage))}" if how else None))
            if not how or how.startswith("not run"):
                break
            say(f"{stage.name}: {how}")

    def _tests(self, stage: PytestStage, follow: bool) -> None:
        """Run all tests of a stage, again once if pytest itself did not come to an end."""
        found = self.outcomes[stage.name] = Outcomes()
        for _ in range(stage.runs):
            how, of_tests = self._pytest(stage, stage.limit, follow, *stage.whole)
            found.add(of_tests)
            by_itself = how not in ("", "exit code 1") or not of_tests.runs or (how and not of_tests.failed())
            if by_itself:
                found.add(one(f"pytest of stage {stage.name}", f"{how or 'no tests'}\n{last_lines(self._log(stage))}"))
                say(f"{stage.name}: pytest ended by itself: {how or 'no tests'}")
                if not how.startswith("not run"):
                    continue
            elif f"pytest of stage {stage.name}" in found.runs:
                found.add(one(f"pytest of stage {stage.name}", None))
            break

    def _pytest(self, stage: PytestStage, limit: float, follow: bool, *arguments: str) -> tuple[str, Outcomes]:
        """How a run of pytest ended, and what it found."""
        report = self._log(stage).with_suffix(".json").resolve()
        report.unlink(missing_ok=True)
        # the tests of a file that can be read are run, whatever is wrong with another
        options = ("-p", "outcome_file", "--outcomes", str(report), "--continue-on-collection-errors")
        how = self._execute(stage, limit, follow, (*options, *arguments))
        return how, read_outcomes(report)

    def _alone(self, stage: PytestStage) -> None:
        """Run the files of failed tests again, one by one with nothing beside them, until each test has passed once."""
        outcomes = self.outcomes[stage.name]
        for _ in range(AGAIN):
            failed = [test for test in outcomes.failed() if test not in self.quarantine]
            for file in sorted({name for test in failed if (name := test.split("::")[0]).endswith(".py")}):
                say(f"{stage.name}: {file} again, alone")
                how, found = self._pytest(stage, FILE, True, *stage.single, file)
                if not how and file in failed:  # its tests could not be collected: now they could
                    found.add(one(file, None))
                outcomes.add(found)


def say(words: str) -> None:
    """Say something of the run itself."""
    print(f"abrace: {words}", flush=True)


def last_lines(file: Path) -> str:
    """The last lines of a file, without what `make` says of its own."""
    lines = file.read_text(errors="replace").splitlines() if file.exists() else []
    return "\n".join([line for line in lines if line.strip() and not line.startswith("make")][-LINES:])
