# SPDX-License-Identifier: Apache-2.0
"""The rig of a test: reading its file, checking its device, and finding the user's node."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.campaign.tasks import Design, Identify, RigTest
from abrace.processes.group import find_executable
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_plant.devices.file import load_device
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from abrace.campaign.file import Campaign, RigSetup
    from abrace.campaign.tasks import OwnNode, Task
    from abrace_plant.rig.model import Rig


@dataclass(frozen=True)
class Laboratory:
    """The rig of a test with its files; `device_file` is None without a device."""

    setup: RigSetup
    rig: Rig
    rig_file: Path
    device_file: Path | None


class Laboratories:
    """The laboratories of a campaign, each read once."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._known: list[Laboratory] = []

    def of(self, test: RigTest | None = None) -> Laboratory:
        """The laboratory of a `test`; None: the campaign's own.

        Raises
        ------
        AbraceError
            If the rig's or the device's file is wrong.
        """
        setup = self._campaign.setup if test is None else self._campaign.setup_of(test)
        for known in self._known:
            if known.setup == setup:
                return known
        rig_file = find_file(setup.file, "abrace_plant", "config", ".yaml", "rig").resolve()
        rig, device_file = load_rig(rig_file), None
        if setup.device is not None:
            device_file = find_file(setup.device, "abrace_plant", "config/devices", ".yaml", "device").resolve()
            load_device(device_file, rig)
        self._known.append(Laboratory(setup, rig, rig_file, device_file))
        return self._known[-1]

    def behind(self, task: Task) -> tuple[Laboratory, RigTest | None]:
        """The laboratory of an identification and the first test that it uses; of a design, those of its model.

        For tests of another campaign, and for every other kind of `task`: the campaign's own laboratory and None.
        """
        steps = self._campaign.tasks
        if isinstance(task, Design):
            task = steps.get(task.model, task)
        names = (*task.table, *task.command) if isinstance(task, Identify) else ()
        test = next((one for name in names if isinstance(one := steps.get(name), RigTest)), None)
        return self.of(test), test


def program_of(node: OwnNode) -> list[str | Path]:
    """The command that starts a user's `node`, without its arguments.

    Raises
    ------
    AbraceError
        If there is no such executable or file.
    """
    if len(node.run) == 2:
        return [find_executable(*node.run)]
    if not Path(node.run[0]).is_file():
        raise AbraceError(f"{node.run[0]}: no such file, expected a Python program")
    return [sys.executable, node.run[0]]
