# SPDX-License-Identifier: Apache-2.0
"""Device files: the kinds that there are, a laboratory's own by its entry point, and the examples of the docs."""

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from udp_target import CONFIG, RIG

from abrace_core import AbraceError
from abrace_plant.devices.card import Card
from abrace_plant.devices.device import Device, DeviceError, Reading, TargetStatus, Wanted, exchange
from abrace_plant.devices.file import DeviceFile, load_device
from abrace_plant.devices.udp import UdpDevice

DOCS = Path(__file__).parents[2] / "docs"


def test_every_device_of_the_configuration_is_one_for_the_papers_rig():
    found = {path.stem: type(load_device(path, RIG)) for path in (CONFIG / "devices").glob("*.yaml")}
    assert found == {"emulator": UdpDevice}


@pytest.mark.usefixtures("laboratory")
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("kind: tcp\n", "kind: 'tcp', expected one of udp, or an entry point in abrace.devices"),
        ("port: 5\n", "kind: key is missing"),
        ("kind: [udp\n", "not YAML"),
        ("kind: broken\n", "kind: broken: no_such_package:load cannot be loaded: No module named 'no_such_package'"),
    ],
)
def test_what_is_no_device_file_is_refused(tmp_path, content, message):
    path = tmp_path / "device.yaml"
    path.write_text(content)
    if "tcp" in content:
        message = message.replace("udp,", "udp, broken, ni_daqmx,")
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
def card(tmp_path, monkeypatch, laboratory):  # noqa: ARG001
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


def armed(card: Device) -> int:
    """The arm number of the card, which is open; it has made two scans."""
    Task.scans += [[0.0] * 10] * 2
    arm = card.exchange([0.0], 0.0, Wanted.SAFE, 0).target.last_arm + 1
    assert card.exchange([0.0], 0.0, Wanted.HOLD_ZERO, arm).target.armed == arm
    return arm


def test_the_card_of_the_docs_is_a_device(card: Device):
    card.open()
    arm = armed(card)
    Task.scans += [[1.0, 0, 0, 0, 0, 0, 0, 0, -1.0, 0.1], [2.0, 0, 0, 0, 0, 0, 0, 0, -10.0, 0.1]]
    reading = card.exchange([5000.0], -0.1, Wanted.FOLLOW, arm)
    np.testing.assert_allclose(reading.values[[0, 8, 9]], [0.01, -2800.0, 0.015])
    assert (reading.clipped, reading.missed) == (0, 0)
    assert reading.target == (arm, arm, "", [5000.0, -0.1], None)
    assert card.exchange([0.0], 0.0, Wanted.FOLLOW, arm).clipped == 1 << 8
    with pytest.raises(DeviceError, match=r"ni_daqmx device .*device.yaml: no scan within 0.02 s"):
        card.exchange([0.0], 0.0, Wanted.FOLLOW, arm)
    card.make_safe()
    card.close()
    assert Task.written[:4] == [[0.0, 0.0]] * 3 + [[2.0, -0.1]]
    assert Task.written[-1] == [0.0, 0.0]


def test_a_card_follows_nothing_without_the_arm_number_and_never_by_a_value(card: Device):
    card.open()
    arm = armed(card)
    Task.scans += [[0.0] * 10] * 300
    Task.written.clear()
    assert card.exchange([2000.0], 0.0, Wanted.FOLLOW, arm - 1).target.cause == "a command with another arm number"
    for force in 5000.0 * np.sin(np.arange(250) / 10):
        found = card.exchange([force], 0.0, Wanted.FOLLOW, arm).target
    assert found.armed == 0
    assert not np.any(Task.written)
    assert card.exchange([0.0], 0.0, Wanted.HOLD_ZERO, arm + 1).target.armed == arm + 1


def in_full(card: Device) -> None:
    """Let the card put out 20 kN."""
    arm = armed(card)
    for force in np.linspace(0.0, 20000.0, 50):
        Task.scans.append([0.0] * 10)
        card.exchange([force], 0.1, Wanted.FOLLOW, arm)


def ramps(volts: np.ndarray) -> None:
    """No step of the force beyond its ramp of a tenth of a second, none of the table beyond its jerk."""
    steps = np.abs(np.diff(volts, axis=0)).max(axis=0)
    assert steps[0] < 1.05 * np.pi / 2 * 8.0 / 50, "no step"
    assert steps[1] <= RIG.table.peak_jerk / RIG.sample_rate + 1e-9
    assert volts[-1].tolist() == [0.0, 0.0]


def test_a_card_ramps_its_outputs_to_zero_after_an_error_at_full_force(card: Device):
    card.open()
    in_full(card)
    with pytest.raises(DeviceError, match="no scan"):
        card.exchange([20000.0], 0.1, Wanted.FOLLOW, 1)
    begin = len(Task.written) - 1
    card.make_safe()
    volts = np.array(Task.written)[begin:]
    assert volts[0, 0] == pytest.approx(8.0, abs=0.1)
    ramps(volts)


def test_a_card_that_is_not_asked_for_long_stops_by_itself(card: Device):
    card.open()
    in_full(card)
    Task.scans += [[0.0] * 10] * 2
    card._missed = 100
    assert card.exchange([20000.0], 0.1, Wanted.FOLLOW, 1).target.armed == 0


def test_a_card_begins_where_another_program_has_left_its_outputs(card: Device):
    Task.standing = [8.0, -0.1]
    card.open()
    ramps(np.array([Task.standing, *Task.written]))


@pytest.mark.parametrize("standing", [[0.1], 0.1, [0.1, 0.1, 0.1]])
def test_a_card_writes_nothing_where_it_does_not_know_each_output(card: Device, standing):
    Task.standing = standing
    with pytest.raises(DeviceError, match=r"ni_daqmx device .*: cannot reshape array of size [13] into shape \(2,\)"):
        card.open()
    assert Task.written == []


def test_a_card_says_where_it_was_not_made_safe(card: Device):
    card.open()
    Task.fails = True
    with pytest.raises(DeviceError, match="not made safe, the outputs keep their values: the card is gone"):
        card.make_safe()
    with pytest.raises(
        DeviceError, match=r"ni_daqmx device .*: not made safe, the outputs keep their values: the card"
    ):
        card.open()


NAMES = ("x1", "xf", "a1", "f", "w")
RIGHT = Reading(np.zeros(5), 10**18, 0, 0, TargetStatus(0, 0, "", [0.0, 0.0]))


class Driver:
    """A device of one's own that gives what it is told to."""

    def __init__(self, reading: object) -> None:
        self.reading = reading

    def exchange(self, *_):
        return self.reading


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        (RIGHT._replace(values=np.zeros(4)), "4 values, expected 5: x1, xf, a1, f, w"),
        (RIGHT._replace(values=np.zeros(6)), "6 values, expected 5: x1, xf, a1, f, w"),
        (RIGHT._replace(values=np.zeros((1, 5))), "values of shape (1, 5), expected 5: x1, xf, a1, f, w"),
        (RIGHT._replace(values=[0.0] * 5), "values [0.0, 0.0, 0.0, 0.0, 0.0], expected a NumPy array of numbers"),
        (RIGHT._replace(values=np.array(["0"] * 5)), "expected a NumPy array of numbers"),
        (None, "exchange gave None, expected a Reading"),
        (tuple(RIGHT), "expected a Reading"),
        (np.zeros(5), "exchange gave array([0., 0., 0., 0., 0.]), expected a Reading"),
        (RIGHT._replace(stamp=1.7e9), "stamp 1700000000.0, expected a whole number, at least 0"),
        (RIGHT._replace(missed=-1), "missed -1, expected a whole number, at least 0"),
        (RIGHT._replace(clipped=None), "clipped None, expected a whole number, at least 0"),
        (RIGHT._replace(target=None), "target None, expected a TargetStatus"),
    ],
)
def test_what_is_no_reading_of_the_rigs_channels_is_one_clear_line(reading, message):
    with pytest.raises(AbraceError) as refused:
        exchange(Driver(reading), NAMES, [0.0], 0.0, Wanted.SAFE, 0)
    assert not isinstance(refused.value, DeviceError), "its program is wrong: it is not asked again"
    assert str(refused.value).startswith("driver: ")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_reading_of_the_rigs_channels_is_passed_on():
    for reading in (RIGHT, RIGHT._replace(values=np.zeros(5, np.float32), clipped=np.int64(3))):
        assert exchange(Driver(reading), NAMES, [0.0], 0.0, Wanted.SAFE, 0) is reading


def test_a_card_that_reads_another_number_of_channels_is_named(tmp_path):
    class Short(Card):
        def connect(self):
            return None

        def write(self, outputs):
            pass

        def read(self):
            return [0.0] * 4, 0

        def disconnect(self):
            pass

    path = tmp_path / "device.yaml"
    path.write_text("kind: short\n")
    card = Short(path, DeviceFile(kind="short"), RIG)
    card.open()
    with pytest.raises(AbraceError, match=r"^short device .*: read gave 4 values, expected 10: x1, x2, x3, xf, a1, "):
        card.exchange([0.0], 0.0, Wanted.SAFE, 0)
