# SPDX-License-Identifier: Apache-2.0
"""The plan of a campaign: its steps, the predicted peaks of its tests, duration, and files that it writes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.campaign.check import CheckedCampaign
from abrace.campaign.file import read_campaign, refuse
from abrace.campaign.folders import unwritable
from abrace.campaign.forecast import COMMAND, UNITS, Forecaster
from abrace.campaign.tasks import Ambient, Compare, Design, Identify, RigTest, Validate
from abrace.report.table import Table

if TYPE_CHECKING:
    from collections.abc import Sized

    from abrace.campaign.forecast import Peak
    from abrace.campaign.tasks import Task

BYTES_OF_A_NUMBER = 13
"""Compressed size in a bag of one channel or command at one sample; 10 to 13 in the demo's bags."""
BYTES_OF_FACTS = 200_000
"""Size of a bag's facts, attachments and diagnostics."""
BYTES_OF_REPORT, BYTES_OF_FIGURES = 3_000_000, 1_500_000
"""Size of the report, and of the figures of a test, in it and as files; about 5 MB for two tests of five storeys."""
STARTING = 3.0
"""Seconds that a test takes in addition to its run."""
LOCKSTEP = 8.0
"""Speed of lockstep on two cores, times real time; slower if the machine is busy."""
OFFLINE = {Identify: 8.0, Design: 4.0, Compare: 4.0, Validate: 5.0, Ambient: 6.0}
"""Typical seconds of the other steps."""
SMALLEST = {"m": (1e3, "mm"), "N": (1e-3, "kN")}
"""Factors and units in which peaks are printed."""


def check_campaign(path: Path | str) -> Plan:
    """Check a whole campaign file; returns its plan.

    Raises
    ------
    AbraceError
        With a line for each mistake.
    """
    campaign, mistakes = read_campaign(path)
    if campaign is None:
        refuse(mistakes)
    plan = Plan(CheckedCampaign(campaign, mistakes))
    problems = plan.forecaster.refusals()
    free, bags, results = shutil.disk_usage(".").free, plan.bytes_of_bags(), plan.bytes_of_results()
    if bags + results > free:
        needed = f"bags of about {_size(bags)} and results of about {_size(results)}"
        problems.append(f"{needed}, expected less than the {_size(free)} free in {Path.cwd()}")
    problems += unwritable()
    if problems:
        refuse([f"campaign file {path}: {problem}" for problem in problems])
    return plan


class Plan:
    """The plan of a campaign; `cares`: predicted problems that are no reason to refuse it, a line each."""

    def __init__(self, checked: CheckedCampaign) -> None:
        self.checked = checked
        self.forecaster = Forecaster(checked)
        self.cares = self.forecaster.cares()
        self._before = _seconds_before(Path("results") / checked.campaign.name / "timing.json")

    def seconds(self, name: str, task: Task) -> float:
        """Estimated duration of the step `name` with this `task` [s].

        Of an offline step that of its last run, if there was one.
        """
        if not isinstance(task, RigTest):
            return self._before.get(name, OFFLINE[type(task)])
        if not self.checked.campaign.in_lockstep(task):
            return STARTING + task.duration
        return STARTING + task.duration / LOCKSTEP

    def bytes_of_bags(self) -> int:
        """Estimated size of all bags [bytes]."""
        found = 0.0
        for test in self.checked.campaign.tests.values():
            rig = self.checked.laboratories.of(test).rig
            numbers = len(rig.channel_names) + rig.groups
            found += BYTES_OF_FACTS + BYTES_OF_A_NUMBER * numbers * test.duration * rig.sample_rate
        return round(found)

    def bytes_of_results(self) -> int:
        """Estimated size of report and figures [bytes]."""
        return BYTES_OF_REPORT + BYTES_OF_FIGURES * len(self.checked.campaign.tests)

    def text(self) -> str:
        """The plan as text: steps, predicted peaks, predicted problems, duration and files."""
        campaign = self.checked.campaign
        tests = campaign.tests
        steps = Table(
            f"{campaign.name}: {_count(campaign.steps, 'step')}, {_count(tests, 'test')}",
            ("step", "what", "about s"),
            tuple(
                (one.name, self._what(one.task), f"{self.seconds(one.name, one.task):.0f}") for one in campaign.steps
            ),
        )
        total = sum(self.seconds(name, task) for name, task in campaign.tasks.items())
        folder = Path("results") / campaign.name
        bags = f"bags/{campaign.name}/TIME/ with {_count(tests, 'bag')}, about {_size(self.bytes_of_bags())}"
        replaced = " (replaces the existing one)" if folder.exists() else ""
        written = [
            f"time: about {_duration(total)}",
            *([f"writes: {bags}"] if tests else []),
            f"writes: {folder}/ with the report, summary.json and a folder for each other step{replaced}",
        ]
        tables = [steps.text()] + ([self._peaks().text()] if tests else [])
        return "\n\n".join([*tables, "\n".join([*written, *(f"care: {care}" for care in self.cares)])])

    def _what(self, task: Task) -> str:
        if not isinstance(task, RigTest):
            return type(task).__name__.lower()
        how = "lockstep" if self.checked.campaign.in_lockstep(task) else "real time"
        setup = self.checked.laboratories.of(task).setup
        own = " ".join(setup.node.run) if setup.node else None
        where = own or (f"{Path(setup.device).stem}, emulated" if setup.emulator and setup.device else setup.device)
        what = [f"test of {task.duration:g} s in {how}", Path(setup.file).stem, *([where] if where else [])]
        return ", ".join([*what, *([task.controller_name] if task.controller else [])])

    def _peaks(self) -> Table:
        kinds = (*UNITS, COMMAND)
        rows, notes = [], []
        for name in self.checked.campaign.tests:
            found = self.forecaster.of(name)
            rows.append((name, *(_shown(found.peaks.get(kind)) for kind in kinds)))
            if found.note:
                notes.append(f"{name}: {found.note}")
        title = "Predicted peaks, and their share of table, sensors' range or interlock, and force limit"
        return Table(title, ("", *kinds), tuple(rows), tuple(notes))


def _shown(peak: Peak | None) -> str:
    if peak is None:
        return "-"
    factor, unit = SMALLEST.get(peak.unit, (1.0, peak.unit))
    return f"{factor * peak.value:.3g} {unit} ({100 * peak.share:.0f} %)"


def _count(things: Sized, word: str) -> str:
    return f"{len(things)} {word}{'' if len(things) == 1 else 's'}"


def _size(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _seconds_before(path: Path) -> dict[str, float]:
    """Seconds that each step took in the last campaign of this name, from its timing.json; empty without that file."""
    try:
        steps = json.loads(path.read_text(encoding="utf-8"))["steps"]
        return {step["name"]: float(step["wall_seconds"]) for step in steps}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
