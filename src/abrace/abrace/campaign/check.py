# SPDX-License-Identifier: Apache-2.0
"""The check of a whole campaign before anything moves: every file, every name, every limit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace.campaign.demands import Signals, wrong_test
from abrace.campaign.file import refuse
from abrace.campaign.laboratory import Laboratories, program_of
from abrace.campaign.offline import wrong_offline
from abrace.campaign.tasks import Design, RigTest
from abrace_core import AbraceError
from abrace_core.model.lifting import divisor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace.campaign.file import Campaign
    from abrace.campaign.tasks import Task


class CheckedCampaign:
    """A campaign, as far as it could be read, that has passed every check that is possible before the first test.

    `mistakes` of reading it are refused with those found here.

    Raises
    ------
    AbraceError
        With a line for each mistake: the file, the step, the key and what was expected.
    """

    def __init__(self, campaign: Campaign, mistakes: Sequence[str] = ()) -> None:
        self.campaign = campaign
        self.laboratories = Laboratories(campaign)
        self.signals = Signals()
        found = self._wrong_rigs()
        if not found:
            for step in campaign.steps:
                found += [f"step {step.name}: {problem}" for problem in self._wrong_step(step.task)]
        if found or mistakes:
            refuse([*mistakes, *(f"campaign file {campaign.path}: {problem}" for problem in found)])

    def _wrong_rigs(self) -> list[str]:
        """Mistakes in rigs, devices and the user's rig nodes; nothing else can be checked without these."""
        found: dict[str, None] = {}
        rates: dict[float, None] = {}
        for test in (None, *self.campaign.tests.values()):
            try:
                laboratory = self.laboratories.of(test)
                if laboratory.setup.node is not None:
                    program_of(laboratory.setup.node)
            except AbraceError as error:
                found[f"rig: {error}"] = None
            else:
                rates[laboratory.rig.sample_rate] = None
        if len(rates) > 1:
            shown = " and ".join(f"{rate:g}" for rate in rates)
            found[f"rig: sample rates of {shown} Hz, expected one for all tests"] = None
        return list(found)

    def _wrong_step(self, task: Task) -> Iterator[str]:
        campaign = self.campaign
        if isinstance(task, RigTest):
            laboratory = self.laboratories.of(task)
            yield from wrong_test(task, laboratory, campaign.in_lockstep(task), self.signals)
            design, rate = campaign.tasks.get(str(task.controller)), laboratory.rig.sample_rate
            if isinstance(design, Design) and design.sample_period:
                try:
                    divisor(design.sample_period, 1 / rate)
                except AbraceError as error:
                    yield f"test.controller: {task.controller}: {error}"
        else:
            yield from wrong_offline(task, campaign.tests, self.laboratories.behind(task)[0].rig)
