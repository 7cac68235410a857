# SPDX-License-Identifier: Apache-2.0
"""The Modbus device against pymodbus's own server: LabJack's T7 by its register map."""

import contextlib
import dataclasses
import json
import socket
import struct
import subprocess
import sys
import threading
import time

import hosts
import numpy as np
import pytest
from emulated_target import TICKING, EmulatedTarget
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException
from pymodbus.pdu import ExceptionResponse
from udp_target import CHANNELS, CONFIG, RIG

from abrace_core.errors import AbraceError
from abrace_plant.devices.device import DeviceError
from abrace_plant.devices.file import load_device
from abrace_plant.devices.modbus import RAMP_TIME, SAFE_TIME
from abrace_plant.devices.registers import Block, Register
from abrace_plant.emulator.emulator import Emulator

SLOW = dataclasses.replace(RIG, sample_rate=100.0)
MAP = CONFIG / "device_parts/labjack_t7_registers.yaml"


def device_file(folder, **changes):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    path = folder / "t7.yaml"
    lines = {"kind": "modbus", "address": "127.0.0.1", "port": port, "registers": MAP, "timeout": 0.5}
    lines["calibration"] = CONFIG / "device_parts/labjack_t7_calibration.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in (lines | changes).items()))
    return path


class Running:
    """An emulated T7 in a thread."""

    def __init__(self, path) -> None:
        self.emulator = Emulator(path, SLOW, "127.0.0.1")
        self.stopped = False
        self.thread = threading.Thread(target=lambda: self.emulator.run(lambda: self.stopped))
        self.thread.start()

    def stop(self) -> None:
        self.stopped = True
        self.thread.join()
        self.emulator.close()


@pytest.fixture
def t7(tmp_path):
    path = device_file(tmp_path)
    running = Running(path)
    device = load_device(path, SLOW)
    device.open()
    yield device, running
    device.close()
    running.stop()


def test_readings_are_the_rigs_and_commands_reach_it(t7):
    device, running = t7
    for _ in range(5):
        device.exchange([0.0], 0.0)
    for _ in range(60):
        reading = device.exchange([2000.0], 0.0)
    assert running.emulator.target.following
    assert running.emulator.target.worst_force == pytest.approx(2000.0, rel=1e-5)
    assert reading.values[CHANNELS.index("fb")] == pytest.approx(2000.0, rel=0.1)
    assert reading.clipped == 0


def test_ticks_are_a_sample_period_apart_and_those_that_passed_are_missed(t7):
    device, _ = t7
    stamps, missed = [], 0
    for _ in range(30):
        reading = device.exchange([0.0], 0.0)
        stamps.append(reading.stamp)
        missed += reading.missed
    assert (stamps[-1] - stamps[0]) * 1e-9 == pytest.approx((29 + missed) * 0.01, abs=0.008)
    time.sleep(0.055)
    assert device.exchange([0.0], 0.0).missed >= 5


def test_what_is_set_up_and_the_life_counter_are_written(t7):
    device, running = t7
    registers = running.emulator.port._registers
    for written in range(1, 5):  # `open` has written the first
        reaches(lambda: registers[46180], written)
        device.exchange([0.0], 0.0)
    assert struct.unpack(">f", struct.pack(">2H", *registers[43900:43902])) == (10.0,)


def reaches(value, wanted):
    """Wait until `value()` is `wanted`: the server answers before it has stored what was written."""
    deadline = time.monotonic() + 10.0
    while value() != wanted and time.monotonic() < deadline:
        time.sleep(0.001)
    assert value() == wanted


def test_make_safe_brings_the_outputs_to_zero_without_a_step(t7):
    device, running = t7
    for force in (0.0, 0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)
    step = running.emulator.target.worst_step
    device.make_safe()
    time.sleep(0.05)
    assert output(running) == pytest.approx(2.5)
    assert running.emulator.target.worst_step < max(3 * step, 2000.0)
    assert not running.emulator.target._acting[0]


@pytest.mark.parametrize("kept", [True, False])
def test_after_requests_without_an_answer_the_outputs_go_to_zero_from_where_they_are(t7, monkeypatch, kept):
    """The device has kept its outputs, or has brought them to zero itself."""
    device, running = t7
    for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)

    def no_answer(*_arguments, **_options):
        raise ConnectionException("no answer")

    with monkeypatch.context() as cut:
        cut.setattr(device._client, "write_registers", no_answer)
        for force in (9900.0, 9700.0):
            with pytest.raises(DeviceError, match=r"write registers 1000 to 1003: no answer within 500 ms"):
                device.exchange([force], 0.0)
    if not kept:
        put_output(running, 2.5)
    written = noted_writes(device, monkeypatch)
    written.append(2.5 + 1.0 * kept)
    device.exchange([9000.0], 0.0)
    assert written[-1] == pytest.approx(2.5), "zero, and nothing that was asked for meanwhile"
    assert np.abs(np.diff(written)).max() < 0.035, "half a cosine in 50 samples"
    device.exchange([0.0], 0.0)
    assert device.exchange([100.0], 0.0).missed == 0
    assert written[-1] == pytest.approx(2.51)


def noted_writes(device, monkeypatch):
    """The voltages of the force that are written from now on."""
    written, write = [], device._write

    def noted(block, values):
        written.extend(values[:1] if block.first == 1000 else [])
        write(block, values)

    monkeypatch.setattr(device, "_write", noted)
    return written


def lose_an_answer(device, monkeypatch, request, times=1):
    """The next `times` requests of this kind find no connection; others are answered."""
    answered, lost = getattr(device._client, request), []

    def maybe(*arguments, **options):
        if len(lost) < times:
            lost.append(arguments)
            raise ConnectionException("no answer")
        return answered(*arguments, **options)

    monkeypatch.setattr(device._client, request, maybe)


def output(running):
    """The voltage of the force."""
    return struct.unpack(">f", struct.pack(">2H", *running.emulator.port._registers[1000:1002]))[0]


def put_output(running, volts):
    """The device itself has changed the voltage of the force."""
    running.emulator.port._registers[1000:1002] = struct.unpack(">2H", struct.pack(">f", volts))


def with_unknown_outputs(device, running, monkeypatch):
    """10 kN are commanded, then a write is not answered, and the device brings its output to 0 V."""
    for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)
    reaches(lambda: output(running), pytest.approx(3.5))
    lose_an_answer(device, monkeypatch, "write_registers")
    with pytest.raises(DeviceError, match="no answer"):
        device.exchange([9900.0], 0.0)
    put_output(running, 0.0)


def assert_ramp_from_0_volts(written):
    assert written[-1] == pytest.approx(2.5), "zero force"
    assert np.abs(np.diff([0.0, *written])).max() < 0.085, "half a cosine in 50 samples from 0 V, where the output was"


@pytest.mark.parametrize(("failing", "error"), [("an answer", "no answer"), ("a setting", "43900 .*: refused")])
def test_a_device_that_cannot_be_opened_is_left_without_a_force(t7, monkeypatch, failing, error):
    """It has kept 10 kN; an answer is lost halfway through the ramp to zero, or it refuses a setting before that."""
    device, running = t7
    for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)
    reaches(lambda: output(running), pytest.approx(3.5))
    write, requests = ModbusTcpClient.write_registers, []

    def failed(client, first, values, **options):
        requests.append(first)
        if failing == "an answer" and len(requests) == 60:
            raise ConnectionException("no answer")
        if failing == "a setting" and first == 43900:
            return ExceptionResponse(16, 2)
        return write(client, first, values, **options)

    monkeypatch.setattr(ModbusTcpClient, "write_registers", failed)
    written = noted_writes(device, monkeypatch)
    with pytest.raises(DeviceError, match=error):
        device.open()
    assert device._client is None
    reaches(lambda: output(running), pytest.approx(2.5))
    assert np.abs(np.diff([3.5, *written])).max() < 0.035, "half a cosine in 50 samples, twice where an answer was lost"


def test_no_output_is_written_while_the_read_back_is_not_answered(t7, monkeypatch):
    device, running = t7
    with_unknown_outputs(device, running, monkeypatch)
    written = noted_writes(device, monkeypatch)
    lose_an_answer(device, monkeypatch, "read_holding_registers")
    with pytest.raises(DeviceError, match=r"read registers 1000 to 1003: no answer within 500 ms"):
        device.exchange([9800.0], 0.0)
    assert written == [], "the outputs are not known"
    device.exchange([9700.0], 0.0)
    assert_ramp_from_0_volts(written)


@pytest.mark.parametrize("code", [5, 6, 10, 11])
def test_a_device_that_is_busy_or_not_reached_by_its_gateway_is_read_again_before_outputs_are_written(
    t7, monkeypatch, code
):
    device, running = t7
    with_unknown_outputs(device, running, monkeypatch)
    written = noted_writes(device, monkeypatch)
    with monkeypatch.context() as busy:
        busy.setattr(device._client, "read_holding_registers", lambda *_, **__: ExceptionResponse(3, code))
        with pytest.raises(DeviceError, match=r"read registers 1000 to 1003: not possible now"):
            device.exchange([9800.0], 0.0)
    assert written == [], "the outputs are not known"
    device.exchange([9700.0], 0.0)
    assert_ramp_from_0_volts(written)


def test_make_safe_begins_where_the_outputs_are_after_a_request_without_an_answer(t7, monkeypatch):
    device, running = t7
    with_unknown_outputs(device, running, monkeypatch)
    written = noted_writes(device, monkeypatch)
    device.make_safe()
    assert_ramp_from_0_volts(written)


def test_make_safe_tries_again_and_writes_no_output_before_the_read_back_is_answered(t7, monkeypatch):
    device, running = t7
    with_unknown_outputs(device, running, monkeypatch)
    written = noted_writes(device, monkeypatch)
    lose_an_answer(device, monkeypatch, "read_holding_registers", times=3)
    device.make_safe()
    assert_ramp_from_0_volts(written)


def test_make_safe_reaches_a_device_that_comes_back_meanwhile(t7, monkeypatch, tmp_path):
    """Its server ends with 10 kN at the outputs, and another one with the same outputs begins at the same port."""
    device, running = t7
    for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)
    running.stop()
    calibration = CONFIG / "device_parts/labjack_t7_calibration.yaml"
    begin, key, commands = calibration.read_text().partition("commands:")
    (tmp_path / "calibration.yaml").write_text(begin + key + commands.replace("offset: 2.5", "offset: 3.5"))
    path = tmp_path / "t7.yaml"
    path.write_text(path.read_text().replace(str(calibration), "calibration.yaml"))
    begun: list[Running] = []
    again = threading.Timer(0.3, lambda: begun.append(Running(path)))
    written = noted_writes(device, monkeypatch)
    again.start()
    try:
        device.make_safe()
        reaches(lambda: output(begun[0]), pytest.approx(2.5))
        assert np.abs(np.diff([3.5, *written])).max() < 0.035, "half a cosine in 50 samples"
    finally:
        again.join()
        running.stop = begun[0].stop


def test_make_safe_of_a_device_that_does_not_come_back_is_an_error_within_a_time(t7):
    device, running = t7
    for force in (0.0, 0.0, 100.0):
        device.exchange([force], 0.0)
    running.stop()
    running.stop = lambda: None
    begin = time.monotonic()
    with pytest.raises(
        DeviceError, match=r"not made safe within 2 s, its outputs stay as they are unless it watches the"
    ):
        device.make_safe()
    assert SAFE_TIME <= time.monotonic() - begin < SAFE_TIME + RAMP_TIME + 2 * 0.5


def test_a_device_that_restarts_gives_no_samples_until_it_is_opened_again(t7, tmp_path):
    device, running = t7
    for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
        device.exchange([force], 0.0)
    running.stop()
    with pytest.raises(DeviceError, match="no answer"):
        device.exchange([10e3], 0.0)
    again = Running(tmp_path / "t7.yaml")
    running.stop = again.stop
    put_output(again, 0.0)
    lost = r"register 43900 has 0 instead of 10, register 43903 has 0 instead of 1, register 46181 has 0 instead of 1"
    for _ in range(3):
        with pytest.raises(
            DeviceError, match=rf"modbus device LabJack T7 at .*: has restarted \({lost}\); the next acti"
        ):
            device.exchange([10e3], 0.0)
        reaches(lambda: output(again), pytest.approx(2.5))
    device.make_safe()
    device.open()
    assert np.abs(device.exchange([0.0], 0.0).values[:3]).max() < 0.01


def test_settings_that_a_device_does_not_allow_to_be_read_are_no_restart(t7, monkeypatch):
    device, _ = t7
    read = device._client.read_holding_registers

    def others(first, **options):
        return ExceptionResponse(3, 2) if first > 40000 else read(first, **options)

    device.exchange([0.0], 0.0)
    lose_an_answer(device, monkeypatch, "write_registers")
    monkeypatch.setattr(device._client, "read_holding_registers", others)
    with pytest.raises(DeviceError, match="no answer"):
        device.exchange([0.0], 0.0)
    device.exchange([0.0], 0.0)


def test_outputs_that_a_device_does_not_allow_to_be_read_go_to_zero_from_the_last_command(t7, monkeypatch):
    device, running = t7
    with_unknown_outputs(device, running, monkeypatch)
    written, read = noted_writes(device, monkeypatch), device._client.read_holding_registers

    def inputs_only(first, **options):
        return ExceptionResponse(3, 2) if first == 1000 else read(first, **options)

    monkeypatch.setattr(device._client, "read_holding_registers", inputs_only)
    device.exchange([9800.0], 0.0)
    assert written[-1] == pytest.approx(2.5)
    assert np.abs(np.diff([3.5, *written])).max() < 0.035, "half a cosine in 50 samples from 10 kN"


def test_a_write_without_an_answer_is_not_sent_later(tmp_path):
    """The connection is reset, with what was queued in it, and the next request has a new one."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        device = load_device(device_file(tmp_path, port=server.getsockname()[1], timeout=0.05), SLOW)
        with pytest.raises(DeviceError, match=r"write registers 43900 .*; not made safe within 2 s"):  # nobody answers
            device.open()
        server.settimeout(5.0)
        with server.accept()[0] as connection:
            connection.settimeout(5.0)
            assert len(connection.recv(1000)) < 1000, "the one request that arrived at once"
            with pytest.raises(ConnectionResetError):
                connection.recv(1000)


HALF_OPEN = """
import json, sys, time
import numpy as np
from abrace_plant.devices.device import DeviceError
from abrace_plant.devices.file import load_device
from abrace_plant.rig.file import load_rig

device = load_device(sys.argv[1], load_rig(sys.argv[2]))
device.open()
for force in (0.0, 0.0, *np.linspace(0, 10e3, 50)):
    device.exchange([force], 0.0)
print(json.dumps(["driven", 0.0]), flush=True)
for act in (lambda: device.exchange([10e3], 0.0), device.make_safe, device.make_safe, device.close):
    input()
    begin, error = time.monotonic(), ""
    try:
        act()
    except DeviceError as found:
        error = str(found)
    print(json.dumps([error, time.monotonic() - begin]), flush=True)
"""
"""Drives a device on another host, exchanges another sample, and makes it safe twice, each when a line is read."""


@pytest.mark.skipif(bool(hosts.missing()), reason=f"no two hosts here: {hosts.missing()}")
def test_a_link_that_is_cut_is_an_error_within_the_time_out_and_the_device_is_made_safe_once_it_is_back(tmp_path):
    """TCP itself would wait for minutes: neither host tells the other that the connection is gone."""
    rig, path = tmp_path / "slow.yaml", device_file(tmp_path, address="10.0.0.1", timeout=0.1)
    text = (CONFIG / "ncree_three_storey.yaml").read_text()
    rig.write_text(text.replace("sample_rate: 500.0", "sample_rate: 100.0"))
    emulator = map(str, EmulatedTarget(path, rig).command)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with (
        hosts.two_hosts() as (first, second, control),
        subprocess.Popen([*hosts.on(first), *emulator], **pipes) as target,
        contextlib.ExitStack() as stack,
    ):
        stack.callback(target.terminate)
        assert target.stdout.readline() == f"{TICKING}\n"
        driver = stack.enter_context(
            subprocess.Popen([*hosts.on(second), sys.executable, "-c", HALF_OPEN, path, rig], **pipes)
        )

        def next_step():
            print(file=driver.stdin, flush=True)
            return json.loads(driver.stdout.readline())

        assert json.loads(driver.stdout.readline()) == ["driven", 0.0]
        link = hosts.Link(control)
        link.set(cut=True)
        error, seconds = next_step()
        assert "write registers 1000 to 1003: no answer within 100 ms" in error
        assert seconds < 0.1 + 0.5, "the time-out"
        error, seconds = next_step()
        assert "not made safe within 2 s, its outputs stay as they are" in error
        assert seconds < SAFE_TIME + RAMP_TIME + 0.5
        link.set()
        error, seconds = next_step()
        assert error == "", "it is made safe"
        next_step()
        stack.close()
        report = json.loads(target.stdout.read())
    assert report["worst_force"] == pytest.approx(10e3, rel=0.01)
    assert report["worst_step"] < 2000.0


def test_a_device_that_stops_answering_is_an_error(t7):
    device, running = t7
    device.exchange([0.0], 0.0)
    running.stop()
    running.stop = lambda: None
    where = r"modbus device LabJack T7 at 127.0.0.1:\d+: write registers 1000 to 1003: "
    with pytest.raises(DeviceError, match=where):
        [device.exchange([0.0], 0.0) for _ in range(3)]


def test_a_device_that_is_not_there_is_an_error(tmp_path):
    device = load_device(device_file(tmp_path), SLOW)
    with pytest.raises(DeviceError, match=r"modbus device LabJack T7 at 127.0.0.1:\d+: no connection within 2 s"):
        device.open()


def test_outputs_that_end_before_the_capacity_are_refused(tmp_path):
    registers = tmp_path / "map.yaml"
    registers.write_text(MAP.read_text().replace("U: {register: 1000}", "U: {register: 1000, type: int16}"))
    path = device_file(tmp_path, registers=registers)
    with pytest.raises(
        AbraceError, match=r"U of 24516\.6 N, the capacity, reaches the device as 25000, expected a range"
    ):
        load_device(path, SLOW)


def test_a_rig_that_is_too_fast_is_refused_by_the_devices_name(tmp_path):
    path = device_file(tmp_path)
    with pytest.raises(AbraceError) as refused:
        load_device(path, RIG)
    assert str(refused.value) == (
        f"device file {path}: LabJack T7 takes at most 250 samples/s; the sample_rate of ncree_three_storey is 500 Hz, "
        "expected a rig file with a lower one"
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  x3: {register: 4}\n", "", "inputs: no entry x3, expected x1, x2, x3, xf"),
        ("  x3: {register: 4}", "  x3: {register: 3}", "inputs.x3: register 3 belongs to another signal"),
        ("  x3: {register: 4}", "  x3: {register: 70000}", "inputs.x3.register: 70000, expected"),
        ("  x3: {register: 4}", "  x3: {register: 4, type: double}", "inputs.x3.type: 'double', expected"),
        ("  x3: {register: 4}", "  x3: {register: 4}\n  x9: {register: 90}", "inputs.x9: unknown, expected x1, x2"),
    ],
)
def test_a_register_map_that_is_wrong_is_refused_by_its_key(tmp_path, old, new, message):
    (tmp_path / "map.yaml").write_text(MAP.read_text().replace(old, new))
    with pytest.raises(AbraceError) as refused:
        load_device(device_file(tmp_path, registers="map.yaml"), SLOW)
    assert str(refused.value).startswith(f"register map file {tmp_path / 'map.yaml'}: {message}")


@pytest.mark.parametrize(("word_order", "words"), [("big", [0x3FC0, 0, 0xFFFE, 7]), ("little", [0, 0x3FC0, 0xFFFE, 7])])
def test_registers_hold_values_in_either_order_of_words(word_order, words):
    entries = [
        (0, Register(register=10)),
        (2, Register(register=12, type="int16")),
        (1, Register(register=13, type="uint16")),
    ]
    block = Block(entries, word_order)
    assert block.encode([1.5, -2.4, 7.0]) == words
    assert block.decode(words) == (1.5, -2, 7)
    assert (block.first, block.words, block.positions) == (10, 4, [0, 2, 1])


def test_a_gap_between_signals_is_read_over():
    block = Block([(0, Register(register=0)), (1, Register(register=4))], "big")
    assert block.decode([0x3FC0, 0, 99, 99, 0x4000, 0]) == (1.5, 2.0)
