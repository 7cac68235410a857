# SPDX-License-Identifier: Apache-2.0
"""The UDP device over real sockets: what is used, what is dropped and under which name, and what is an error."""

import math
import socket
import threading
import time

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from udp_target import (
    APPLIED,
    ARM,
    CHANNELS,
    CONFIG,
    KINDS,
    LAYOUT,
    PERIOD,
    RIG,
    TABLE,
    UdpTarget,
    device_file,
    free_ports,
    malformed,
    values_of,
)

from abrace_core import AbraceError
from abrace_plant.devices.device import DeviceError, TargetStatus, Wanted
from abrace_plant.devices.udp import LAST_COMMANDS, SLOWER, load


@pytest.fixture
def target(tmp_path):
    with UdpTarget(device_file(tmp_path)) as opened:
        opened.open()
        yield opened


def used(target: UdpTarget) -> float:
    """Counter of the sample that the next exchange gives."""
    reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
    np.testing.assert_allclose(reading.values, values_of(round(reading.values[0])), rtol=1e-15)
    return float(reading.values[0])


def test_a_sample_is_answered_by_a_command_and_the_next_sample_comes(target):
    target.answered()
    for k in range(1, 4):
        expected = target.tick()
        reading = target.device.exchange([100.0 * k], -0.1 * k, Wanted.FOLLOW, ARM)
        assert reading.values.tolist() == values_of(expected)
        assert (reading.clipped, reading.missed) == (0, 0)
        before = target.last.counter
        assert target.answered() == before + 1
        assert target.last.signals == (100.0 * k, -0.1 * k)
        assert (target.last.arm, target.last.state) == (ARM, Wanted.FOLLOW)
        assert reading.target == TargetStatus(ARM, ARM, "", list(APPLIED), TABLE)


def test_samples_that_wait_after_a_hold_up_are_used_one_after_the_other_and_are_late(target):
    waiting = []
    for _ in range(4):
        waiting.append(target.tick())
        time.sleep(1.5e-9 * PERIOD)
    readings = [target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM) for _ in waiting]
    assert [(reading.values[0], reading.missed) for reading in readings] == [(counter, 0) for counter in waiting]
    assert all(reading.age >= 1.5e-9 * PERIOD for reading in readings)
    assert (np.diff([reading.age for reading in readings]) < 0).all()
    assert (np.diff([reading.stamp for reading in readings]) > 0).all()


def test_a_command_that_is_late_or_lost_is_told_once(target):
    """The target's ticks have the second command late, and the fifth never."""
    target.answered()

    def tick(reached: int) -> bool:
        """The target ticks with so many commands; whether the reading says that none is missing."""
        target.counter += 1
        target.send(target.encoded(target.counter, values_of(target.counter), reached))
        reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        commands_in_flight.append(reading.commands_in_flight)
        return reading.command_applied

    first, commands_in_flight = target.last.counter, []
    reached = [1, 1, 3, 4, 4, 6]
    assert [tick(first + one) for one in reached] == [True, False, True, True, False, True]
    # a link that has become slower by a tick
    last = 6 + SLOWER + 3
    assert [tick(first + one) for one in range(6, last)] == [False] * SLOWER + [True] * 3
    assert commands_in_flight == [0] * (6 + SLOWER) + [1] * 3
    # and is quicker from time to time
    assert [tick(first + one) for one in (last + 1, last + 1, last + 2, last + 4)] == [True, False, False, True]
    assert target.device.counters()["commands_late"] == 2 + SLOWER + 1 + 2


def test_after_a_pause_longer_than_the_time_out_the_newest_sample_is_used_and_the_others_are_missed(tmp_path):
    with UdpTarget(device_file(tmp_path, timeout=0.2)) as target:
        target.open()
        time.sleep(0.3)
        target.keep_time()
        for _ in range(3):
            newest = target.tick()
            time.sleep(1.5e-9 * PERIOD)
        reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        assert reading.values[0] == newest


def test_samples_that_were_lost_are_missed(target):
    target.counter += 2
    newest = target.tick()
    reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
    assert (reading.values[0], reading.missed) == (newest, 2)


def test_stamps_are_those_of_the_ticks_and_not_of_the_packets(target):
    stamps = []
    for k in range(50):
        target.tick()
        time.sleep(PERIOD * 1e-9 + 0.001 * (k % 3))
        stamps.append(target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM).stamp)
        assert stamps[-1] <= time.time_ns()
    assert (np.diff(stamps) > 0).all()


def test_a_wall_clock_that_is_set_back_changes_stamps_alone(target, monkeypatch):
    real, back, stamps = time.time_ns, 0, []
    monkeypatch.setattr(time, "time_ns", lambda: real() - back)
    for k in range(40):
        back = 7200 * 10**9 if k >= 20 else 0
        target.tick()
        time.sleep(PERIOD * 1e-9)
        reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        stamps.append(reading.stamp)
        assert 0 <= reading.age < 1.0
    assert stamps[20] - stamps[19] == pytest.approx(-7200e9, rel=1e-3)
    assert np.diff(stamps)[20:] == pytest.approx(PERIOD, abs=20e6)


WRONG = {
    "wrong_length": lambda target: target.sample(target.counter + 1)[:-1],
    "wrong_crc": lambda target: target.sample(target.counter + 1)[:-1] + b"\0",
    "wrong_constant": lambda target: target.samples.sign(b"\0" + target.sample(target.counter + 1)[1:]),
    "not_finite": lambda target: target.sample(target.counter + 1, [math.nan] * len(CHANNELS)),
    "repeated": lambda target: target.sample(target.counter),
    "old": lambda target: target.sample(target.counter - 1),
    "jumping": lambda target: target.sample(target.counter + 10**6),
    "wrong_time": lambda target: target.sample(target.counter + 2, time=(target.counter + 1) * PERIOD),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_bad_packet_is_not_used_and_counted_by_its_name(target, name):
    target.tick()
    used(target)
    before = target.device.dropped.copy()
    target.send(*[WRONG[name](target)] * 3)
    expected = target.tick()
    target.send(WRONG[name](target))
    assert used(target) == expected
    assert target.device.dropped - before == {name: 4}
    assert target.device.counters()[f"dropped_{name}"] == 4


def test_a_packet_of_another_sender_is_not_used_and_counted(target):
    before = target.device.dropped.copy()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(target.sample(target.counter + 1, [1e6] * len(CHANNELS)), target.to)
    expected = target.tick()
    assert used(target) == expected
    assert target.device.dropped - before == {"other_sender": 1}


def test_a_sample_that_comes_late_is_not_used(tmp_path):
    with UdpTarget(device_file(tmp_path, timeout=0.2)) as target:
        target.open()
        time.sleep(0.5)
        target.tick()
        with pytest.raises(DeviceError, match=r"no sample for 200 ms; dropped: 1 stale"):
            target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)


def test_no_sample_is_an_error_that_says_what_came_instead(tmp_path):
    path = device_file(tmp_path, timeout=0.05)
    with UdpTarget(path) as target:
        target.open()
        port, local = target.device.file.port, target.device.file.local_port
        with pytest.raises(DeviceError) as nothing:
            target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        assert str(nothing.value) == (
            f"udp device 127.0.0.1:{port}: no sample for 50 ms; nothing arrived from 127.0.0.1:{port} to port {local}"
        )
        target.send(b"wrong", b"wrong too", target.sample(1)[:-1] + b"\0")
        with pytest.raises(DeviceError) as wrong:
            target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        assert "dropped: 2 wrong length, 1 wrong crc (packets of 144 bytes, 2 ms apart, were expected)" in str(
            wrong.value
        )


def test_after_an_error_a_target_that_begins_anew_is_used_again(tmp_path):
    with UdpTarget(device_file(tmp_path, timeout=0.05)) as target:
        target.open()
        with pytest.raises(DeviceError):
            target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
        target.counter = 5
        target.tick()
        expected = target.tick()
        assert used(target) == expected


def test_a_target_that_takes_no_commands_is_an_error(tmp_path):
    with UdpTarget(device_file(tmp_path, timeout=0.3)) as target:
        target.open()

        def deaf() -> str:
            for _ in range(1000):
                target.counter += 1
                target.send(target.encoded(target.counter, values_of(1), 7))
                try:
                    target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
                except DeviceError as error:
                    return str(error)
                time.sleep(PERIOD * 1e-9)
            return "none"

        assert deaf().endswith("has applied no command for 300 ms")


def test_a_target_that_is_not_there_is_an_error_of_open(tmp_path, monkeypatch):
    monkeypatch.setattr("abrace_plant.devices.udp.OPEN_TIME", 0.1)
    device = load(device_file(tmp_path), RIG)
    with pytest.raises(DeviceError, match=r"no valid samples within 0.1 s; nothing arrived from 127.0.0.1"):
        device.open()


def test_a_port_that_is_taken_is_an_error_of_open(tmp_path):
    device = load(device_file(tmp_path), RIG)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", device.file.local_port))
        with pytest.raises(AbraceError, match=r"cannot receive at 127.0.0.1:.*: Address already in use"):
            device.open()


def test_make_safe_tells_the_target_and_falls_silent_without_a_step(target):
    target.tick()
    target.device.exchange([20e3], 1.0, Wanted.FOLLOW, ARM)
    target.answered()
    before = target.last.counter
    target.device.make_safe()
    for k in range(1, LAST_COMMANDS + 1):
        last = target.commands.decode(target.socket.recv(1024))
        assert last == (before + k, (20e3, 1.0), 0, 0, Wanted.SAFE, 0, 0)
    target.device.close()
    with pytest.raises(DeviceError, match=r"not made safe, the target has to watch the life counter: .* not open"):
        target.device.make_safe()


def test_readings_and_commands_go_through_the_calibration(tmp_path):
    with UdpTarget(device_file(tmp_path, calibrated=True)) as target:
        target.open()
        target.counter += 1
        target.send(target.sample(target.counter, [1.0, -2.0, 0.0, 0.5, 1.0, 2.0, 10.0, -5.0, -4.0, 0.1]))
        reading = target.device.exchange([-5000.0], 2.0, Wanted.FOLLOW, ARM)
        expected = [0.01, -0.02, 0.0, 0.002, 0.6, 1.2, 6.0, -14000.0, -11200.0, 0.015]
        np.testing.assert_allclose(reading.values, expected, rtol=1e-12)
        assert reading.clipped == 1 << CHANNELS.index("a3")
        target.answered()
        np.testing.assert_allclose(target.last.signals, (-2.0, 2.0))


PACKETS = st.lists(
    st.tuples(st.sampled_from(KINDS), st.integers(0, 2**31), st.binary(max_size=200)), min_size=20, max_size=40
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(PACKETS, st.data())
def test_between_thousands_of_malformed_packets_every_sample_is_used_and_no_other(target, packets, data):
    good = data.draw(st.integers(0, len(packets) - 1))
    skipped = target.keep_time()
    for position, (kind, amount, content) in enumerate(packets):
        if position == good:
            target.tick()
        target.send(malformed(target, kind, amount, content))
    reading = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
    assert (reading.values.tolist(), reading.missed) == (values_of(target.counter), skipped)


def test_exchange_runs_in_a_thread_of_its_own(target):
    readings = []
    thread = threading.Thread(target=lambda: readings.append(target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)))
    thread.start()
    time.sleep(0.05)
    expected = target.tick()
    thread.join(5.0)
    assert [reading.values[0] for reading in readings] == [expected]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("timeout: 0.9", "timeout: 0", "timeout: 0, expected"),
        ("life_time: 1.0", "life_time: 2.0", "life_time: 2.0, expected"),
        ("life_time: 1.0", "life_time: 0.5", "as a whole: expected timeout 0.9 below the target's life_time, 0.5"),
        ("address: 127.0.0.1\nport", "address: target\nport", "address: 'target', expected"),
        ("kind: udp", "kind: tcp", "kind: 'tcp', expected"),
        ("layout: ", "lay_out: ", "lay_out: unknown key"),
    ],
)
def test_a_device_file_that_is_wrong_is_refused_by_its_key(tmp_path, old, new, message):
    path = device_file(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(AbraceError, match=f"device file {path}: {message}"):
        load(path, RIG)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "U: {gain: 2.5,",
            "U: {gain: 2.0,",
            "command U: the device puts out at most 20000 N, expected the capacity, 24516.6: widen",
        ),
        (
            "w: {gain: 1.0,",
            "w: {gain: 0.9,",
            "command w: the device puts out at most 9 m/s\\^2, expected the table's peak_acceleration, 10:",
        ),
        (
            "U: {gain: 2.5, unit: kN,",
            "U: {gain: 2.5, unit: kN, offset: 2.0,",
            "command U: the device puts out at most 20000 N, expected the capacity",
        ),
    ],
)
def test_outputs_that_end_before_the_limits_of_the_rig_are_refused(tmp_path, old, new, message):
    path = device_file(tmp_path, calibrated=True)
    own = (CONFIG / "device_parts/calibration.yaml").read_text()
    assert old in own
    (tmp_path / "own.yaml").write_text(own.replace(old, new))
    path.write_text(path.read_text().partition("calibration: ")[0] + "calibration: own.yaml\n")
    with pytest.raises(AbraceError, match=f"device file {path}: {message}"):
        load(path, RIG)


def test_an_output_of_a_type_without_a_sign_is_refused(tmp_path):
    layout = tmp_path / "unsigned.yaml"
    own = LAYOUT.read_text()
    layout.write_text(own.replace("{field: [U, w], type: float64}", "{field: [U, w], type: uint16}"))
    assert layout.read_text() != own
    with pytest.raises(
        AbraceError, match=r"command U: the device puts out at most 0 N, expected the capacity, -24516\.6:"
    ):
        load(device_file(tmp_path, layout=layout), RIG)


def test_a_layout_for_another_rig_is_refused_by_its_file(tmp_path):
    path = device_file(tmp_path)
    layout = tmp_path / "other.yaml"
    layout.write_text("sample: [{field: counter, type: uint8}]\ncommand: []\n")
    path.write_text(
        "\n".join(line if "layout" not in line else "layout: other.yaml" for line in path.read_text().splitlines())
    )
    with pytest.raises(AbraceError, match=f"layout file {layout}: sample: no field constant, time, state, .*, w, "):
        load(path, RIG)


def test_a_time_too_coarse_to_tell_ticks_apart_is_refused(tmp_path):
    layout = tmp_path / "coarse.yaml"
    layout.write_text(LAYOUT.read_text().replace("unit: ns}", "unit: ms}", 1))
    path = device_file(tmp_path, layout=layout)
    with pytest.raises(
        AbraceError, match=f"layout file {layout}: time in steps of 1 ms, expected a unit that distinguishes"
    ):
        load(path, RIG)


def test_a_target_at_another_rate_is_an_error_of_open_that_says_what_was_expected(tmp_path, monkeypatch):
    monkeypatch.setattr("abrace_plant.devices.udp.OPEN_TIME", 0.1)
    with UdpTarget(device_file(tmp_path)) as target:
        packets = [target.sample(k, time=k * PERIOD // 2) for k in range(20)]
        sender = threading.Timer(0.05, lambda: target.send(*packets))
        sender.start()
        with pytest.raises(DeviceError, match=r"dropped: 20 not consecutive \(packets of 144 bytes, 2 ms apart, were"):
            target.device.open()
        sender.join()


def test_the_stamp_of_a_target_that_keeps_the_wall_clock_is_its_own(tmp_path):
    layout = tmp_path / "wall.yaml"
    layout.write_text(LAYOUT.read_text().replace("unit: ns}", "unit: ns, clock: wall}", 1))
    with UdpTarget(device_file(tmp_path, layout=layout)) as target:
        began = time.time_ns()
        target.sample = lambda counter, sample=target.sample: sample(counter, time=began + (counter - 1000) * PERIOD)
        target.open()
        expected = began + (target.tick() - 1000) * PERIOD
        assert target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM).stamp == expected


@pytest.mark.parametrize(
    ("state", "causes", "words"),
    [
        (0, 1, "its program was started"),
        (2, 64 + 4, "no new command for its life time, a limit of its own"),
        (0, 1 << 20, "its own cause 20"),
        (0, 0, "it names no cause"),
    ],
)
def test_a_target_that_does_not_follow_is_told_with_its_causes(target, state, causes, words):
    target.state, target.causes = state, causes
    target.tick()
    found = target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)
    assert found.target == TargetStatus(0, ARM, words, list(APPLIED), TABLE)
    assert (found.command_applied, found.commands_in_flight) == (True, 0)


def test_the_table_need_not_be_measured(tmp_path):
    layout = tmp_path / "unmeasured.yaml"
    layout.write_text("\n".join(line for line in LAYOUT.read_text().splitlines() if "displacement" not in line))
    with UdpTarget(device_file(tmp_path, layout=layout)) as target:
        target.open()
        target.tick()
        assert target.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM).target == (ARM, ARM, "", list(APPLIED), None)


NEEDED = {
    "sample": ("constant", "counter", "time", "state", "causes", "arm", "applied_counter", "applied_U", "fb"),
    "command": ("constant", "counter", "arm", "wanted", "U"),
}


@pytest.mark.parametrize(("kind", "field"), [(kind, field) for kind, fields in NEEDED.items() for field in fields])
def test_a_layout_without_a_field_that_is_needed_is_refused(tmp_path, kind, field):
    content = yaml.safe_load(LAYOUT.read_text())
    entries = content[kind]
    for entry in entries:
        if isinstance(entry["field"], list) and field in entry["field"]:
            entry["field"].remove(field)
    content[kind] = [entry for entry in entries if entry["field"] != field]
    layout = tmp_path / "incomplete.yaml"
    layout.write_text(yaml.safe_dump(content))
    with pytest.raises(AbraceError, match=f"layout file {layout}: {kind}: no field {field}, expected constant, "):
        load(device_file(tmp_path, layout=layout), RIG)


def test_samples_may_come_from_another_port_than_commands_go_to(tmp_path):
    path = device_file(tmp_path)
    path.write_text(path.read_text() + f"source_port: {free_ports(1)[0]}\n")
    with UdpTarget(path) as target, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as commands:
        commands.bind(("127.0.0.1", target.device.file.port))
        commands.settimeout(5.0)
        target.open()
        target.tick()
        target.device.exchange([7.0], 0.0, Wanted.FOLLOW, ARM)
        while (command := target.commands.decode(commands.recv(1024))).signals[0] != 7.0:
            pass
        assert command.state == Wanted.FOLLOW
