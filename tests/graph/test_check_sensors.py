# SPDX-License-Identifier: Apache-2.0
"""The node check_sensors as a process, with the emulator as the hardware and with a bag."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_of_run import write_bag
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
    given = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    command = [str(find_executable("abrace_plant", "check_sensors")), "--ros-args", *given]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_hardware_is_read_at_rest_and_the_channel_that_fails_is_named(hardware, tmp_path):
    ended = check(device=hardware, duration=1.0, output=tmp_path / "check.json")
    assert (ended.returncode, ended.stderr) == (1, "")
    (noisy,) = (line for line in ended.stdout.splitlines() if "noisy: " in line)
    assert noisy.startswith("a3 ")
    assert "not checked, the rig hardly moved" in ended.stdout
    channels = json.loads((tmp_path / "check.json").read_text())["channels"]
    assert [channel["name"] for channel in channels if channel["faults"]] == ["a3"]


def recorded(path: Path, faults: bool) -> Path:
    """A bag of a test with the table; with `faults` the second load cell has the wrong sign, and a2 clips 3 times."""
    run = Laboratory(RIG, 2).table_test(20.0)
    forces = np.repeat(run.outputs[:, -run.groups :], run.braces, axis=1)
    clipped = np.zeros(len(forces), dtype=np.uint64)
    clipped[np.argsort(run.outputs[:, 5])[-3:]] = 1 << 5 if faults else 0
    write_bag(replace(run, forces=forces * [1.0, -1.0 if faults else 1.0], clipped=clipped), path)
    return path


@pytest.mark.parametrize("with_faults", [False, True])
def test_a_bag_is_checked_with_its_flags_and_the_load_cell_of_each_brace(tmp_path, with_faults):
    ended = check(bag=recorded(tmp_path / "bag", with_faults), output=tmp_path / "check.json")
    assert (ended.returncode, ended.stderr) == (int(with_faults), ""), ended.stdout
    channels = json.loads((tmp_path / "check.json").read_text())["channels"]
    assert tuple(channel["name"] for channel in channels) == RIG.channel_names
    faults = {channel["name"]: channel["faults"] for channel in channels if channel["faults"]}
    expected = {
        "a2": ["clipped: 3 samples at the upper end of the range, 6 m/s^2"],
        "fa": ["wrong sign: fa against fb"],
        "fb": ["wrong sign: fb against fa"],
    }
    assert faults == (expected if with_faults else {})


def test_a_bag_of_another_rig_is_refused_with_both_rigs_channels(tmp_path):
    bag = recorded(tmp_path / "bag", faults=False)
    ended = check(bag=bag, rig="single_storey")
    message = f"{bag}: has the channels {', '.join(RIG.channel_names)}, expected those of the rig single_storey: x1, "
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"check_sensors: {message}"), ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "parameters device, bag: expected one of them"),
        ({"device": "none"}, "device 'none': unknown, expected a file ending in .yaml or one of emulator, labjack_t7"),
        ({"device": "none.yaml"}, "device file none.yaml: no such file"),
    ],
)
def test_without_anything_to_read_it_says_so_in_one_line(given, message):
    ended = check(**given)
    assert (ended.returncode, ended.stderr) == (2, f"check_sensors: {message}\n")


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
