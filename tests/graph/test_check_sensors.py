# SPDX-License-Identifier: Apache-2.0
"""The node check_sensors as a process, with the emulator as the hardware and with a bag."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_of_run import write_bag
from forked import run_node
from laboratory import Laboratory
from udp_target import CONFIG, RIG, device_file

from abrace.processes.group import find_executable
from abrace_plant.devices.device import DeviceError
from abrace_plant.nodes.check_sensors import read_at_rest


@pytest.fixture
def hardware(tmp_path):
    """A device file, and the emulator behind it, whose third accelerometer is an open input."""
    path = device_file(tmp_path, calibrated=True)
    rig = CONFIG / "ncree_three_storey.yaml"
    command = [find_executable("abrace_plant", "emulator"), "--rig", rig, "--device", path, "--fault", "a3=noise"]
    with subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "emulator: ticking\n"
        yield path
        process.terminate()
        output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert json.loads(output)["worst_force"] == 0.0


def check(**parameters: object) -> subprocess.CompletedProcess:
    return run_node("abrace_plant", "check_sensors", **parameters)


def test_the_hardware_is_read_at_rest_and_the_channel_that_fails_is_named(hardware, tmp_path):
    ended = check(device=hardware, duration=1.0, output=tmp_path / "check.json")
    assert (ended.returncode, ended.stderr) == (1, "")
    (noisy,) = (line for line in ended.stdout.splitlines() if "noisy: " in line)
    assert noisy.startswith("a3 ")
    assert "not checked, the rig hardly moved" in ended.stdout
    channels = json.loads((tmp_path / "check.json").read_text())["channels"]
    assert [channel["name"] for channel in channels if channel["faults"]] == ["a3"]


def recorded(path: Path) -> Path:
    """A bag of a test with the table; the second load cell has the wrong sign, and a2 clips 3 times."""
    run = Laboratory(RIG, 2).table_test(20.0)
    forces = np.repeat(run.outputs[:, -run.groups :], run.braces, axis=1)
    clipped = np.zeros(len(forces), dtype=np.uint64)
    clipped[np.argsort(run.outputs[:, 5])[-3:]] = 1 << 5
    write_bag(replace(run, forces=forces * [1.0, -1.0], clipped=clipped), path)
    return path


def test_a_bag_is_checked_with_its_flags_and_each_load_cell_and_only_by_its_own_rig(tmp_path):
    ended = check(bag=recorded(tmp_path / "bag"), output=tmp_path / "check.json")
    assert (ended.returncode, ended.stderr) == (1, ""), ended.stdout
    channels = json.loads((tmp_path / "check.json").read_text())["channels"]
    assert tuple(channel["name"] for channel in channels) == RIG.channel_names
    faults = {channel["name"]: channel["faults"] for channel in channels if channel["faults"]}
    assert faults == {
        "a2": ["clipped: 3 samples at the upper end of the range, 6 m/s^2"],
        "fa": ["wrong sign: fa against fb"],
        "fb": ["wrong sign: fb against fa"],
    }
    ended = check(bag=tmp_path / "bag", rig="single_storey")
    message = f"has the channels {', '.join(RIG.channel_names)}, expected those of the rig single_storey: x1, "
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"check_sensors: {tmp_path / 'bag'}: {message}"), ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("fails", [("exchange", "make_safe"), ("make_safe",)])
def test_a_device_that_fails_is_closed_and_every_reason_is_said(fails):
    class Failing:
        closed = False

        def open(self):
            self.closed = False

        def exchange(self, *_):
            return self.answer("exchange")

        def make_safe(self):
            self.answer("make_safe")

        def close(self):
            self.closed = True

        def answer(self, name):
            if name in fails:
                raise DeviceError(f"{name} fails")

    device = Failing()
    with pytest.raises(DeviceError, match="; ".join(f"{name} fails" for name in fails)):
        read_at_rest(device, RIG, 1)
    assert device.closed
