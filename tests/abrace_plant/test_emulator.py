# SPDX-License-Identifier: Apache-2.0
"""The emulator: what a target has to do by itself, faults of its links, and the program behind a real device."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from udp_target import CHANNELS, CONFIG, RIG, device_file, free_ports, life_time_of

from abrace_core import AbraceError
from abrace_plant.devices.c_target import ARMED, BAD_COMMAND, DISARMED, NO_COMMANDS, OWN_LIMIT
from abrace_plant.devices.device import Device, DeviceError, Wanted
from abrace_plant.devices.file import load_device
from abrace_plant.emulator.emulator import Emulator
from abrace_plant.emulator.link import Link
from abrace_plant.emulator.target import LIFE_TIME, RAMP_TIME, Target

RIG_FILE = CONFIG / "ncree_three_storey.yaml"


class Driver:
    """Commands for a target, one a tick."""

    def __init__(self) -> None:
        self.target = Target(RIG, 0)
        self.counter = 0
        self.arm = self.target.outputs.last_arm + 1

    def command(self, force: float, table: float = 0.0, wanted: Wanted = Wanted.FOLLOW) -> str:
        """Send a command; what it was refused for."""
        self.counter += 1
        return self.target.command(self.counter, np.array([force, table]), self.arm, wanted)

    def step(self, force: float, table: float = 0.0, wanted: Wanted = Wanted.FOLLOW) -> np.ndarray:
        """A command and the tick after it."""
        self.command(force, table, wanted)
        return self.target.step()


def following(force: float, table: float) -> Driver:
    """A target that follows a force [N] and an acceleration of the table [m/s^2], both reached slowly."""
    driver = Driver()
    driver.step(0.0, 0.0, Wanted.HOLD_ZERO)
    for share in np.linspace(0, 1, 100):
        driver.step(share * force, share * table)
    assert driver.target.outputs.state == ARMED
    return driver


def test_a_target_follows_once_it_has_been_armed():
    driver = Driver()
    for force in (0.0, 5e3):
        assert driver.command(force) == "refused"
        driver.target.step()
    assert (driver.target.outputs.state, driver.target.worst_force) == (DISARMED, 0.0)
    driver.step(0.0, 0.0, Wanted.HOLD_ZERO)
    for force in (0.0, 10.0):
        driver.step(force)
    assert driver.target.worst_force == 10.0


def test_a_target_counts_what_it_is_commanded_before_it_limits_that():
    driver = following(1e3, 0.5)
    assert driver.target.worst_command == pytest.approx(0.5 / RIG.table.peak_acceleration)
    driver.step(-2 * RIG.capacity[0], 0.0)
    assert driver.target.worst_command == 2.0
    assert driver.target.worst_step_over_rate_limit > 1.0
    for _ in range(20):
        driver.step(-2 * RIG.capacity[0], 0.0)
    assert driver.target.worst_force == RIG.capacity[0]
    driver.command(0.0, np.nan)
    driver.target.step()
    assert driver.target.worst_command == np.inf
    assert driver.target.outputs.causes == BAD_COMMAND


@pytest.mark.parametrize("told", [False, True])
def test_a_target_brings_force_and_table_to_rest_by_itself(told):
    driver = following(20e3, 0.5)
    target = driver.target
    step = target.worst_step
    assert target._velocity > 0.04
    if told:
        driver.command(20e3, 0.5, Wanted.SAFE)
    for _ in range(round((LIFE_TIME + RAMP_TIME) * RIG.sample_rate) + 2):
        target.step()
    assert (target.stops, target.outputs.applied[0]) == (1, 0.0)
    assert target.worst_seconds_to_zero <= RAMP_TIME + (0 if told else LIFE_TIME) + 2 * target.period + 1e-9
    assert target.worst_step < 1.1 * max(step, np.pi / 2 * 20e3 * target.period / RAMP_TIME)
    for _ in range(1000):
        target.step()
    assert (target.outputs.state, target.outputs.applied[1]) == (DISARMED, 0.0)
    assert abs(target._velocity) < 1e-6


def test_while_the_target_hangs_its_outputs_hold_and_the_rig_goes_on():
    target = following(10e3, 0.0).target
    tick = target.tick
    target.hold(100)
    assert (target.tick, target.outputs.applied[0], target.stops) == (tick + 100, 10e3, 0)
    reading = target.step()
    assert target.stops == 1
    assert reading[CHANNELS.index("fb")] == pytest.approx(10e3, rel=0.1)


def test_a_ramp_in_which_the_target_hangs_goes_on_afterwards_without_a_step():
    target = following(10e3, 0.0).target
    target.outputs.stop(OWN_LIMIT)
    for k in range(100):
        if k == 20:
            target.hold(200)
        target.step()
    assert target.worst_step_over_rate_limit <= 1.0
    assert not target.outputs.applied.any()


def test_the_greatest_step_that_reached_the_actuators_is_kept():
    driver = following(0.0, 0.0)
    driver.step(3e3, 0.7)
    target = driver.target
    assert (target.worst_step, target.worst_table_step, target.worst_force) == (3e3, 0.7, 3e3)
    assert target.worst_step_over_rate_limit == pytest.approx(3e3 / (RIG.rate_limit[0] / 500))


def passed(packets: int = 2000, **faults: float) -> list[int]:
    """Numbers of the packets that leave a link with faults, of one a millisecond."""
    link, left = Link(1), []
    for name, value in faults.items():
        setattr(link.faults, name, value)
    for number in range(packets):
        link.put(number.to_bytes(4, "big"), number * 1e-3)
        left += [int.from_bytes(packet, "big") for packet in link.take(number * 1e-3)]
    return left + [int.from_bytes(packet, "big") for packet in link.take(1e9)]


def test_a_good_link_passes_every_packet_at_once():
    assert passed() == list(range(2000))


@pytest.mark.parametrize(
    ("name", "seen"),
    [
        ("loss", lambda left: 2000 - len(set(left))),
        ("repetition", lambda left: len(left) - len(set(left))),
        ("reordering", lambda left: sum(after < before for before, after in pairwise(left))),
        ("corruption", lambda left: 2000 - len(set(left) & set(range(2000)))),
    ],
)
def test_a_share_of_packets_is_lost_repeated_overtaken_or_corrupted(name, seen):
    assert 140 < seen(passed(**{name: 0.1})) < 260


def test_delayed_packets_leave_when_they_are_due():
    link = Link(1)
    link.faults.delay = 0.005
    link.put(b"x", 1.0)
    assert (link.take(1.0049), link.due) == ([], 1.005)
    assert link.take(1.0051) == [b"x"]


def test_jitter_delays_by_different_times():
    assert passed(jitter=0.01) != sorted(passed(jitter=0.01)) == list(range(2000))


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            "wind=1",
            "stop=0",
            "stop=soon",
            "stop=4294967296",
            "loss=much",
            "loss=-1",
            "other.loss=0.1",
            "a2=broken",
            "delay=1@soon",
            "freeze=nan",
        ),
        *("los=0.1@5", "a2=stuk@5", "loss=much@5", "freeze=@5", "clear@5"),
    ],
)
def test_a_fault_that_there_is_not_is_refused(tmp_path, text):
    emulator = Emulator(device_file(tmp_path), RIG)
    with pytest.raises(AbraceError, match=r"fault '"):
        emulator.cause(text)
    emulator.close()


def test_a_delayed_fault_that_there_is_not_is_refused_before_the_emulator_starts(tmp_path):
    path = device_file(tmp_path)
    with pytest.raises(AbraceError, match="sensor fault 'a2=stuk': expected CHANNEL=KIND"):
        Emulator(path, RIG, faults=["a2=stuk@20"])
    Emulator(path, RIG).close()


def test_a_fault_with_seconds_begins_then_and_not_before(tmp_path):
    emulator = Emulator(device_file(tmp_path), RIG)
    for text in ("sample.loss=0.25@0.4", "a2=zero@0.4"):
        emulator.cause(text)
    links, channel, seen = emulator.port.links, CHANNELS.index("a2"), []
    emulator.run(lambda: False, 0.1)
    seen.append((links["sample"].faults.loss, bool(emulator.target.step()[channel])))
    emulator.run(lambda: False, 0.6)
    seen.append((links["sample"].faults.loss, bool(emulator.target.step()[channel])))
    assert seen == [(0.0, True), (0.25, False)]
    assert links["command"].faults.loss == 0.0
    emulator.close()


def start(folder, *arguments: str) -> tuple[subprocess.Popen, int]:
    """The program, ticking, and its control port."""
    (control,) = free_ports(1)
    command = [sys.executable, "-c", "import sys; from abrace_plant.nodes.emulator import main; sys.exit(main())"]
    command += ["--rig", str(RIG_FILE), "--device", str(folder / "device.yaml"), "--log", str(folder / "log.json")]
    process = subprocess.Popen(
        [*command, "--control", str(control), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "emulator: ticking\n", process.stderr.read()
    return process, control


def ask(port: int, text: str) -> str:
    """The answer of the control port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(10.0)
        asking.sendto(text.encode(), ("127.0.0.1", port))
        return asking.recv(4096).decode()


def exchange(device: Device, times: int) -> None:
    """Command zero."""
    for _ in range(times):
        device.exchange([0.0], 0.0, Wanted.SAFE, 0)


def test_the_program_is_a_rig_with_faults_on_demand_and_stops_by_itself(tmp_path):
    path = device_file(tmp_path, timeout=0.5, calibrated=True)
    process, control = start(tmp_path)
    try:
        device = load_device(path, RIG)
        device.open()
        arm = device.exchange([0.0], 0.0, Wanted.SAFE, 0).target.last_arm + 1
        while not device.exchange([0.0], 0.0, Wanted.HOLD_ZERO, arm).target.armed:
            pass
        for force in [*np.linspace(0, 4e3, 100), *[4e3] * 100]:
            reading = device.exchange([force], 0.0, Wanted.FOLLOW, arm)
        assert reading.target.armed == arm
        assert reading.target.applied[0] == pytest.approx(4e3, rel=0.05)
        assert reading.values[CHANNELS.index("fb")] == pytest.approx(4e3, rel=0.1)

        assert ask(control, "a2=zero") == "ok"
        assert ask(control, "sample.corruption=0.5") == "ok"
        assert ask(control, "wind=1").startswith("fault 'wind=1': expected NAME=VALUE")
        assert ask(control, "los=0.1@0").startswith("fault 'los=0.1@0': expected NAME=VALUE")
        assert ask(control, "a3=stuk@0").startswith("sensor fault 'a3=stuk': expected CHANNEL=KIND")
        readings = [device.exchange([4e3], 0.0, Wanted.FOLLOW, arm) for _ in range(100)]
        assert {reading.values[CHANNELS.index("a2")] for reading in readings[5:]} == {0.0}
        assert device.dropped["wrong_crc"] > 20
        assert sum(reading.missed for reading in readings) >= device.dropped["wrong_crc"] - 5
        assert ask(control, "clear") == "ok"

        assert json.loads(ask(control, "report"))["stops"] == 0
        deadline = time.monotonic() + 10
        while not (report := json.loads(ask(control, "report")))["worst_seconds_to_zero"]:
            assert time.monotonic() < deadline, f"the commands stopped, and the target went on: {report}"
            time.sleep(0.01)
        assert (report["stops"], report["causes"]) == (1, NO_COMMANDS)
        causes = [device.exchange([0.0], 0.0, Wanted.SAFE, 0).target.cause for _ in range(500)]
        assert causes[-1] == "no new command for its life time"  # samples of before may have waited

        assert ask(control, "freeze=0.8") == "ok"
        with pytest.raises(DeviceError, match="no sample for 500 ms"):
            exchange(device, 500)
        device.close()
    finally:
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, "")
    log = json.loads((tmp_path / "log.json").read_text())
    assert json.loads(output) == log
    assert log["worst_force"] == pytest.approx(4e3)
    assert log["worst_step_over_rate_limit"] < 0.5
    assert log["stops"] == 1
    assert 0.1 < log["worst_seconds_to_zero"] < life_time_of(0.5) + 0.2


def test_the_program_needs_no_ros_and_says_what_is_wrong_in_one_line():
    code = "import sys; from abrace_plant.nodes.emulator import main; print(main(), 'rclpy' in sys.modules)"
    command = [sys.executable, "-c", code, "--rig", RIG_FILE, "--device", "none.yaml"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout == "2 False\n"
    assert run.stderr == "emulator: device file none.yaml: No such file or directory\n"


def test_two_emulators_at_one_port_are_refused(tmp_path):
    path = device_file(tmp_path)
    first = Emulator(path, RIG)
    with pytest.raises(AbraceError, match=r"cannot receive at 127.0.0.1:"):
        Emulator(path, RIG)
    first.close()


def test_it_ticks_at_the_rigs_rate(tmp_path):
    emulator = Emulator(device_file(tmp_path), RIG)
    thread = threading.Thread(target=emulator.run, args=(lambda: False, 0.5))
    thread.start()
    thread.join()
    emulator.close()
    assert emulator.report()["ticks"] <= 251
    assert emulator.report()["ticks"] + emulator.report()["late_ticks"] * 10 >= 240


def test_where_the_table_has_a_controller_of_its_own_no_packet_has_a_command_for_it(tmp_path):
    """Samples and commands of the C target have their places all the same, which abrace leaves unused."""
    layout = (CONFIG / "device_parts/udp_layout.yaml").read_text()
    assert "[applied_U, applied_w]" in layout
    assert "[U, w]" in layout
    for pair, one in (("[applied_U, applied_w]", "applied_U"), ("[U, w]", "U")):
        layout = layout.replace(
            f"{{field: {pair}, type: float64}}",
            f"{{field: {one}, type: float64}}\n  - {{field: unused, type: float64}}",
        )
    (tmp_path / "layout.yaml").write_text(layout)
    path, rig = device_file(tmp_path, layout=tmp_path / "layout.yaml"), replace(RIG, table_driven=False)
    with pytest.raises(AbraceError, match=r"sample: no field applied_w, expected"):
        load_device(path, RIG)
    device, emulator, over = load_device(path, rig), Emulator(path, rig), threading.Event()
    thread = threading.Thread(target=emulator.run, args=(over.is_set,))
    thread.start()
    try:
        device.open()
        arm = device.exchange([0.0], 0.0, Wanted.SAFE, 0).target.last_arm + 1
        while not (reading := device.exchange([0.0], 0.0, Wanted.HOLD_ZERO, arm)).target.armed:
            pass
        for _ in range(20):
            reading = device.exchange([1000.0], 5.0, Wanted.FOLLOW, arm)
    finally:
        device.close()
        over.set()
        thread.join()
        emulator.close()
    assert reading.target.applied == [1000.0]
    assert emulator.target.outputs.applied.tolist() == [1000.0, 0.0], "the table is left alone"
