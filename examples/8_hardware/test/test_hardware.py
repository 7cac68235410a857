# SPDX-License-Identifier: Apache-2.0
"""The files of a rig behind the bridge: the campaign is whole; a force goes to the target and is measured there."""

import re
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from udp_target import RIG, free_ports

from abrace.campaign.plan import check_campaign
from abrace_plant.devices.device import Wanted
from abrace_plant.devices.file import load_device
from abrace_plant.emulator.emulator import Emulator


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the example that waits longer for a busy machine, at ports of its own."""
    folder = shutil.copytree(Path(__file__).parents[1], tmp_path / "example")
    text = (folder / "device.yaml").read_text()
    for key, value in zip(("port", "local_port", "timeout", "life_time"), (*free_ports(2), 0.9, 1.0), strict=True):
        text, replaced = re.subn(rf"(?m)^{key}: \S+", f"{key}: {value}", text)
        assert replaced == 1
    (folder / "device.yaml").write_text(text)
    return folder


def test_the_campaign_is_whole(folder: Path) -> None:
    text = check_campaign(folder / "campaign.yaml").text()
    for step in ("rest", "first_force", "first_motion"):
        assert step in text


def test_a_force_comes_back_through_layout_and_calibration(folder: Path) -> None:
    path = folder / "device.yaml"
    device, emulator, over = load_device(path, RIG), Emulator(path, RIG), threading.Event()
    thread = threading.Thread(target=emulator.run, args=(over.is_set,))
    thread.start()
    try:
        device.open()
        arm = device.exchange([0.0], 0.0, Wanted.SAFE, 0).target.last_arm + 1
        while not device.exchange([0.0], 0.0, Wanted.HOLD_ZERO, arm).target.armed:
            pass
        forces = [device.exchange([1000.0], 0.0, Wanted.FOLLOW, arm).values[[7, 8]] for _ in range(250)]
    finally:
        device.close()
        over.set()
        thread.join()
        emulator.close()
    assert np.mean(forces[-100:], axis=0) == pytest.approx([1000.0, 1000.0], rel=0.1)
