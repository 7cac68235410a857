# SPDX-License-Identifier: Apache-2.0
"""The node check_sensors as a process, with the emulator as the hardware."""

import json
import subprocess

import pytest
from udp_target import CONFIG, device_file

from abrace.processes.group import find_executable


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
