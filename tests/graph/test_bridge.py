# SPDX-License-Identifier: Apache-2.0
"""The node sensor_bridge and its hardware: the emulator, a process of its own, behind real packets."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from emulated_target import TICKING, EmulatedTarget
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from running_graph import SLOW, stamp
from std_srvs.srv import Trigger
from udp_target import CONFIG, device_file, life_time_of

from abrace.processes.group import find_executable
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.emulator.target import RAMP_TIME

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from abrace.processes.group import NodeProcess

DRIVEN = {"rms": 2500.0, "duration": 600.0, "band": [0.5, 5.0], "sample_rate": SLOW}
"""Of a force whose steps trip no interlock where the computer misses samples."""


class Emulator(EmulatedTarget):
    """The hardware of a device file, started."""

    def __init__(self, *files: Path) -> None:
        super().__init__(*files)
        self._process = subprocess.Popen([str(part) for part in self.command], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"{TICKING}\n"

    def close(self) -> None:
        """End it."""
        self._process.send_signal(signal.SIGTERM)
        self._process.communicate(timeout=120)


@pytest.fixture
def emulate() -> Iterator[Callable[..., Emulator]]:
    """Starts emulators and ends them."""
    started: list[Emulator] = []

    def start(*arguments: Any) -> Emulator:
        started.append(Emulator(*arguments))
        return started[-1]

    yield start
    for emulator in started:
        emulator.close()


@pytest.fixture
def rig(graph):
    """The tests' graph, with its samples and commands."""
    graph.slow = graph.slow_rig()
    graph.responses = graph.listen(Response, "response")
    graph.commands = graph.listen(BraceCommand, "brace_command")
    return graph


def runs(graph: Any, bridge: str) -> bool:
    """Whether the rig runs; cleared as a person does, again where this computer has held a node up meanwhile."""
    if graph.responses[-1].state == Response.LATCHED:
        for name in ("excitation", bridge):
            graph.clear_fault(name)
    return graph.responses[-1].state == Response.RUNNING


def drive(graph: Any) -> None:
    """Have the braces driven, everything found before force is on."""
    graph.until(lambda: graph.responses, "samples")
    graph.until(lambda: "excitation" in graph.statuses, "the excitation")
    assert graph.change_state("excitation", "configure")
    graph.until_matched("excitation", response=1, brace_command=2)
    assert graph.change_state("excitation", "activate")
    push(graph)


def push(graph: Any) -> None:
    """Let the rig run, and the signal play, until the braces push."""

    def pushes() -> bool:
        if runs(graph, "sensor_bridge") and not graph.responses[-1].command[0]:
            graph.call(Trigger, "excitation/play", Trigger.Request())  # refused while it plays
        return abs(graph.responses[-1].force[0]) > 2000.0

    graph.until(pushes, "the braces to push")


def provoke(graph: Any, emulator: Emulator, request: str, cause: str) -> dict[str, Any]:
    """Have the target do something while the braces push, again where this computer has stopped the rig before.

    Returns what the target reported before.
    """
    causes = []
    for _ in range(20):
        push(graph)
        before, count = emulator.report(), len(graph.responses)
        assert emulator.ask(request) == "ok"
        graph.until(lambda: graph.responses[-1].state == Response.LATCHED, "all to be at rest")
        causes.append(next(one.cause for one in graph.responses[count:] if one.cause))
        if cause in causes[-1]:
            return before
    raise AssertionError(f"never {cause}: {causes}")


def zero(graph: Any) -> Trigger.Response:
    """Zero the sensors, again until enough samples, and rest, have been measured: a busy machine misses some."""
    answers: list[Trigger.Response] = []

    def answered() -> bool:
        answers.append(graph.call(Trigger, "sensor_bridge/zero_sensors", Trigger.Request()))
        return not answers[-1].message.startswith(("zeroing: only", "zeroing: not yet known"))

    graph.until(answered, "enough samples for zeroing")
    return answers[-1]


def above_the_loop(process: NodeProcess) -> int:
    """How many of its threads have the processors of its main thread, and the next higher priority if that has one."""
    threads = [int(task.name) for task in Path(f"/proc/{process.group}/task").iterdir()]
    given = [(os.sched_getaffinity(each), os.sched_getparam(each).sched_priority) for each in threads]
    priority = os.sched_getparam(process.group).sched_priority
    return given.count((os.sched_getaffinity(process.group), priority + 1 if priority else 0))


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two processors: one for the loop alone")
def test_hardware_that_is_not_there_refuses_the_activation_and_is_taken_at_1_khz_once_it_is(rig, emulate, tmp_path):
    (tmp_path / "none").mkdir()
    missing, rig.by_the_clock = device_file(tmp_path / "none"), True
    command = [
        find_executable("abrace_plant", "sensor_bridge"),
        "--ros-args",
        "-p",
        f"device:={missing}",
        "-p",
        "stop_heartbeat:=600.0",
    ]
    ending = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    device, fast = device_file(tmp_path, timeout=0.9), tmp_path / "fast.yaml"
    rig_file = (CONFIG / "ncree_three_storey.yaml").read_text()
    fast.write_text(rig_file.replace("sample_rate: 500.0", "sample_rate: 1000.0"))
    parameters = {"rig": str(fast), "late_limit": 100, "autostart": False}
    parameters |= {"cpu_affinity": [min(os.sched_getaffinity(0))]}
    bridge = rig.start("sensor_bridge", device=str(device), **parameters)
    assert rig.change_state("sensor_bridge", "configure")
    assert not rig.change_state("sensor_bridge", "activate")
    assert rig.state("sensor_bridge") == "inactive"
    emulate(device, fast)
    before = above_the_loop(bridge)
    assert rig.change_state("sensor_bridge", "activate")
    rig.until(lambda: len(rig.responses) > 1500, "samples")
    assert rig.responses[0].sequence == 0
    steps = np.diff([response.sequence for response in rig.responses])
    stamps = np.array([stamp(response) for response in rig.responses])
    assert (steps > 0).all()
    assert np.median(np.diff(stamps) / steps) == pytest.approx(1e6, rel=0.02)
    states = [response.state for response in rig.responses]
    assert sorted(set(states), key=states.index) == [Response.ARMING, Response.FADING_IN, Response.RUNNING]
    assert above_the_loop(bridge) == before + 1, "samples are taken on the loop's processors, with a higher priority"
    _, errors = ending.communicate(timeout=120)
    assert ending.returncode == 2
    (line,) = errors.splitlines()
    assert line.startswith("sensor_bridge: udp device 127.0.0.1:")
    assert "no valid samples within 2 s; nothing arrived from" in line


def test_hardware_is_zeroed_at_rest_alone_and_a_target_that_freezes_is_a_latched_fault(rig, emulate, tmp_path):
    device = device_file(tmp_path, timeout=0.1, calibrated=True)
    emulator = emulate(device, rig.slow)
    # the bridge's own calibration: sensors that are not at zero, one of them further than may be zeroed
    content = yaml.safe_load((CONFIG / "device_parts/calibration.yaml").read_text())
    for name, offset in (("a1", 0.05), ("x3", 0.45), ("x2", 0.6)):
        content["channels"][name]["offset"] = offset
    calibration = tmp_path / "own.yaml"
    calibration.write_text(yaml.safe_dump(content))
    text = device.read_text()
    device.write_text(text.replace(text.rpartition("calibration: ")[2], "own.yaml\n"))
    rig.start("sensor_bridge", rig=rig.slow, device=str(device), zero_channels=["a1", "x3"])
    rig.start("excitation", autostart=False, **DRIVEN)
    rig.until(lambda: len(rig.responses) > 100, "samples")
    assert np.mean([response.acceleration[0] for response in rig.responses]) == pytest.approx(-0.03, abs=0.002)

    to = "127.0.0.1", yaml.safe_load(device.read_text())["local_port"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for length in range(300):
            stranger.sendto(os.urandom(length), to)
    done = zero(rig)
    assert done.success, done.message
    assert "own.yaml: zero of each channel: a1 0 to -0.0" in done.message
    found = yaml.safe_load(calibration.read_text())["channels"]
    assert found["a1"]["offset"] == 0.05, "as calibrated"
    assert found["a1"]["zero"] == pytest.approx(-0.05, abs=0.001)
    assert found["x2"]["offset"] == 0.6
    names = SetParameters.Request(parameters=[Parameter("zero_channels", value=["a1", "x2"]).to_parameter_msg()])
    assert rig.call(SetParameters, "sensor_bridge/set_parameters", names).results[0].successful
    before = calibration.read_bytes()
    refused = zero(rig)
    assert not refused.success
    assert refused.message.startswith("zeroing: x2 is -0.00")
    calibration.write_text(calibration.read_text().replace("gain: 0.6", "gain: 0.5"))
    names = SetParameters.Request(parameters=[Parameter("zero_channels", value=["a1"]).to_parameter_msg()])
    assert rig.call(SetParameters, "sensor_bridge/set_parameters", names).results[0].successful
    refused = zero(rig)
    assert not refused.success
    assert "own.yaml was changed after the activation" in refused.message, refused.message
    calibration.write_bytes(before)
    rig.until(lambda: abs(np.mean([one.acceleration[0] for one in rig.responses[-200:]])) < 0.002, "readings at zero")
    values = rig.values("sensor_bridge")
    assert values["device dropped_other_sender"] == "300"
    assert values["calibration a1"].startswith("0.6 m/s^2, offset")

    drive(rig)
    refused = zero(rig)
    assert not refused.success, rig.reported()
    assert "brace_command still requests" in refused.message
    assert calibration.read_bytes() == before

    before = provoke(rig, emulator, "freeze=0.3", "no sample for 100 ms; nothing arrived from")
    rig.until_fault("excitation", "no response for")
    report = emulator.report()
    assert report["stops"] == before["stops"] + 1
    assert report["worst_step_over_rate_limit"] <= 1.0
    sequences = np.array([response.sequence for response in rig.responses], dtype=np.int64)
    assert np.diff(sequences).max() > 0.2 * SLOW, "the ticks without a sample are counted"
    rig.until(lambda: runs(rig, "sensor_bridge"), "the rig to run")
    assert emulator.report()["following"]
    assert rig.stop("sensor_bridge") == 0
    rig.until(lambda: not emulator.report()["following"], "the target to be told")


def test_a_killed_bridge_leaves_the_force_to_the_target_and_another_begins_from_zero(rig, emulate, tmp_path):
    device = device_file(tmp_path, timeout=0.1)
    emulator = emulate(device, rig.slow)
    rig.start("sensor_bridge", rig=rig.slow, device=str(device))
    rig.start("excitation", autostart=False, **DRIVEN)
    drive(rig)
    first = rig.responses[-1].run
    before = emulator.report()
    assert before["following"]
    rig.kill("sensor_bridge")
    rig.until(lambda: not emulator.report()["following"], "the target to stop")
    begin = emulator.report()["ticks"]
    rig.until(lambda: emulator.report()["ticks"] > begin + 2 * RAMP_TIME * SLOW, "the target to come to rest")
    report = emulator.report()
    assert report["stops"] == before["stops"] + 1
    assert report["worst_seconds_to_zero"] <= life_time_of(0.1) + RAMP_TIME + 0.01
    assert report["worst_step_over_rate_limit"] <= 1.0
    rig.start("sensor_bridge", name="next", rig=rig.slow, device=str(device))
    rig.until(lambda: rig.responses[-1].run > first, "another run")
    rig.until_matched("excitation", response=1)
    # what commanded the killed one has a fault of its own: with that nothing is armed
    rig.until_fault("next", "no response for")
    count = len(rig.responses)
    rig.until(lambda: runs(rig, "next"), "the rig to run")
    assert emulator.report()["following"]
    assert emulator.report()["last_arm"] > before["last_arm"]
    assert not any(response.command[0] for response in rig.responses[count:]), "a signal does not begin by itself"
    for name in ("next", "excitation"):
        rig.kill(name)  # at the end they would wait for the killed one to acknowledge what they sent


def test_a_target_that_stops_by_itself_is_a_latched_fault_and_follows_no_more_by_a_value(rig, emulate, tmp_path):
    """F1 of the review: commands go on crossing zero, at which a target of before began to follow again."""
    device = device_file(tmp_path)
    emulator = emulate(device, rig.slow)
    rig.start("sensor_bridge", rig=rig.slow, device=str(device))
    rig.start("excitation", autostart=False, **DRIVEN)
    drive(rig)
    before = provoke(rig, emulator, "stop=64", "target not following: a limit of its own")
    count = len(rig.responses)
    rig.until(lambda: len(rig.responses) > count + SLOW, "a second at rest")
    report = emulator.report()
    assert (report["following"], report["last_arm"], report["stops"]) == (
        False,
        before["last_arm"],
        before["stops"] + 1,
    )
    assert report["worst_step_over_rate_limit"] <= 1.0
    rig.until(lambda: runs(rig, "sensor_bridge"), "the rig to run")
    report = emulator.report()
    assert report["following"]
    assert report["last_arm"] > before["last_arm"]


def test_a_target_with_fewer_sensors_is_driven_and_one_without_load_cells_is_refused(rig, emulate, tmp_path):
    there = ["a1", "a3", "fa", "fb", "w"]
    content = yaml.safe_load(Path(rig.slow).read_text())
    del content["sensors"]["displacement"], content["sensors"]["stroke"]
    content["sensors"]["acceleration"]["channels"] = ["a1", "a3"]
    layout = yaml.safe_load((CONFIG / "device_parts/udp_layout.yaml").read_text())
    for field in layout["sample"]:
        field["field"] = there if "a1" in field["field"] else field["field"]
    (tmp_path / "layout.yaml").write_text(yaml.safe_dump(layout, sort_keys=False))
    device, file = device_file(tmp_path, timeout=0.1, layout=tmp_path / "layout.yaml"), tmp_path / "fewer.yaml"
    file.write_text(yaml.safe_dump({**content, "sensors": {**content["sensors"], "force": None}}))
    command = [find_executable("abrace_plant", "sensor_bridge"), "--ros-args", "-p", f"rig:={file}"]
    command += ["-p", f"device:={device}", "-p", "stop_heartbeat:=600.0"]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert refused.returncode == 2
    assert "no load cell fa, fb: rest cannot be measured" in refused.stderr.splitlines()[-1]
    file.write_text(yaml.safe_dump(content))
    emulate(device, file)
    rig.start("sensor_bridge", rig=str(file), device=str(device))
    rig.start("excitation", autostart=False, **DRIVEN)
    drive(rig)
    for response in rig.responses[-100:]:
        assert np.isnan([*response.displacement, *response.stroke, response.acceleration[1]]).all()
        assert np.isfinite([*response.acceleration[::2], *response.force, response.ground_acceleration]).all()
    assert rig.change_state("excitation", "deactivate")
    rig.until(lambda: not any(rig.responses[-1].command), "no command")
    assert not rig.responses[-1].cause
