# SPDX-License-Identifier: Apache-2.0
"""Device files: the kinds that there are, a laboratory's own by its entry point, and the examples of the docs."""

import dataclasses
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest
from udp_target import CONFIG, RIG

from abrace_core.errors import AbraceError
from abrace_plant.devices.device import Device, DeviceError
from abrace_plant.devices.file import load_device
from abrace_plant.devices.modbus import ModbusDevice
from abrace_plant.devices.udp import UdpDevice

DOCS = Path(__file__).parents[2] / "docs"


def test_every_device_of_the_configuration_is_one_for_the_papers_rig():
    slow = dataclasses.replace(RIG, sample_rate=250.0)
    found = {path.stem: type(load_device(path, slow)) for path in (CONFIG / "devices").glob("*.yaml")}
    assert found == {"emulator": UdpDevice, "labjack_t7": ModbusDevice}


@pytest.mark.usefixtures("laboratory")
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("kind: tcp\n", "kind: 'tcp', expected one of udp, modbus, or an entry point in abrace.devices"),
        ("port: 5\n", "kind: key is missing"),
        ("kind: [udp\n", "not YAML"),
        ("kind: broken\n", "kind: broken: no_such_package:load cannot be loaded: No module named 'no_such_package'"),
    ],
)
def test_what_is_no_device_file_is_refused(tmp_path, content, message):
    path = tmp_path / "device.yaml"
    path.write_text(content)
    if "tcp" in content:
        message = message.replace("modbus,", "modbus, broken, ni_daqmx,")
    with pytest.raises(AbraceError) as refused:
        load_device(path, RIG)
    assert str(refused.value).startswith(f"device file {path}: ")
    assert message in str(refused.value)


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    """An installed package with entry points of its own, as the page says: the card, and one that is broken."""
    site = tmp_path / "site"
    (site / "my_laboratory").mkdir(parents=True)
    (site / "my_laboratory/ni_daqmx.py").write_text((DOCS / "ni_daqmx.py").read_text())
    (site / "my_laboratory-1.dist-info").mkdir()
    (site / "my_laboratory-1.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: my_laboratory\nVersion: 1\n")
    entry = next(
        line for line in (DOCS / "bridge.md").read_text().splitlines() if "my_laboratory.ni_daqmx:load" in line
    )
    point = entry.partition('["')[2].partition('"]')[0]
    (site / "my_laboratory-1.dist-info/entry_points.txt").write_text(
        f"[abrace.devices]\n{point}\nbroken = no_such_package:load\n"
    )
    monkeypatch.syspath_prepend(site)


class Task:
    """As much of nidaqmx.Task as the example uses; a task whose channels are read once reads the outputs."""

    standing: list[float] = []
    written: list[list[float]] = []
    scans: list[list[float]] = []
    fails = False

    def __init__(self) -> None:
        self.ao_channels = self.ai_channels = self.timing = self.in_stream = self
        self.avail_samp_per_chan = 0

    def __getattr__(self, name):
        return lambda *_, **__: None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def write(self, values):
        if Task.fails:
            raise RuntimeError("the card is gone")
        Task.written.append(values)

    def read(self, count=None, timeout=None):
        if count is None:
            return Task.standing
        if len(Task.scans) < count:
            raise RuntimeError(f"no scan within {timeout} s")
        found = Task.scans[:count]
        del Task.scans[:count]
        return np.array(found).T.tolist()


@pytest.fixture
def card(tmp_path, monkeypatch):
    module = types.ModuleType("nidaqmx")
    module.Task = Task
    module.constants = types.ModuleType("nidaqmx.constants")
    module.constants.AcquisitionType = types.SimpleNamespace(CONTINUOUS=1)
    monkeypatch.setitem(sys.modules, "nidaqmx", module)
    monkeypatch.setitem(sys.modules, "nidaqmx.constants", module.constants)
    monkeypatch.setattr(Task, "standing", [0.0, 0.0])
    monkeypatch.setattr(Task, "written", [])
    monkeypatch.setattr(Task, "fails", False)
    monkeypatch.setattr(Task, "scans", [])
    text = (DOCS / "bridge.md").read_text().partition("    kind: ni_daqmx\n")
    path = tmp_path / "device.yaml"
    lines = [line.strip() for line in (text[1] + text[2]).partition("\n\n")[0].splitlines()]
    path.write_text("\n".join(lines).replace("calibration.yaml", str(CONFIG / "device_parts/calibration.yaml")))
    return load_device(path, RIG)


@pytest.mark.usefixtures("laboratory")
def test_the_card_of_the_docs_is_a_device(card: Device):
    card.open()
    Task.scans += [[1.0, 0, 0, 0, 0, 0, 0, 0, -1.0, 0.1], [2.0, 0, 0, 0, 0, 0, 0, 0, -10.0, 0.1]]
    reading = card.exchange([5000.0], -1.0)
    np.testing.assert_allclose(reading.values[[0, 8, 9]], [0.01, -2800.0, 0.015])
    assert (reading.clipped, reading.missed) == (0, 0)
    assert card.exchange([0.0], 0.0).clipped == 1 << 8
    with pytest.raises(DeviceError, match=r"NI-DAQmx Dev1/ai0:9: no scan within 0.02 s"):
        card.exchange([0.0], 0.0)
    card.make_safe()
    card.close()
    assert Task.written == [[0.0, 0.0], [2.0, -1.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]


@pytest.mark.usefixtures("laboratory")
def test_the_card_of_the_docs_ramps_its_outputs_to_zero_after_an_error_at_full_force(card: Device):
    card.open()
    with pytest.raises(DeviceError):
        card.exchange([20000.0], -1.0)
    begin = time.monotonic()
    card.make_safe()
    assert time.monotonic() - begin >= 0.45
    volts = np.array(Task.written)[1:]
    assert volts[0].tolist() == [8.0, -1.0]
    assert (np.diff(np.abs(volts), axis=0) <= 0).all()
    assert np.abs(np.diff(volts, axis=0)).max() < 0.05, "no step"
    assert volts[-1].tolist() == [0.0, 0.0]


@pytest.mark.usefixtures("laboratory")
def test_the_card_of_the_docs_begins_where_another_program_has_left_its_outputs(card: Device):
    Task.standing = [8.0, -1.0]
    card.open()
    volts = np.array(Task.written)
    assert np.abs(np.diff([[8.0, -1.0], *volts], axis=0)).max() < 0.05, "no step"
    assert volts[-1].tolist() == [0.0, 0.0]


@pytest.mark.usefixtures("laboratory")
@pytest.mark.parametrize("standing", [[0.1], 0.1, [0.1, 0.1, 0.1]])
def test_the_card_of_the_docs_writes_nothing_where_it_does_not_know_each_output(card: Device, standing):
    Task.standing = standing
    with pytest.raises(
        DeviceError, match=r"Dev1/ao0:1, read by Dev1/_ao0_.*: cannot reshape array of size [13] into shape \(2,\)"
    ):
        card.open()
    assert Task.written == []


@pytest.mark.usefixtures("laboratory")
def test_the_card_of_the_docs_says_where_it_was_not_made_safe(card: Device):
    card.open()
    Task.fails = True
    with pytest.raises(DeviceError, match="not made safe, the outputs keep their voltage: the card is gone"):
        card.make_safe()
    with pytest.raises(
        DeviceError, match=r"NI-DAQmx Dev1/ao0:1, .*: not made safe, the outputs keep their voltage: the card"
    ):
        card.open()


def test_the_card_of_the_docs_has_the_lines_that_the_page_says():
    lines = [line.strip() for line in (DOCS / "ni_daqmx.py").read_text().splitlines()]
    assert sum(1 for line in lines if line and not line.startswith(('"""', "#"))) <= 60
