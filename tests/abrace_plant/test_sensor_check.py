# SPDX-License-Identifier: Apache-2.0
"""Sensors judged by their records: at rest, and in the paper's tests with faults planted."""

from dataclasses import fields, replace

import numpy as np
import pytest
from laboratory import Laboratory
from udp_target import CHANNELS, RIG

from abrace_core import AbraceError
from abrace_core.model.noise import banded_noise
from abrace_core.model.signals import unit
from abrace_plant.devices.calibration import Calibration, CalibrationFile
from abrace_plant.devices.sensor_check import check_sensors
from abrace_plant.rig.model import Rig
from abrace_plant.rig.sensors import Measurement, Sensor, parse_fault

SAMPLES = 12_000


@pytest.fixture(scope="module")
def at_rest() -> np.ndarray:
    sensors = Measurement(RIG.channel_sensors, 1, 1 / RIG.sample_rate)
    return sensors.record(np.zeros((SAMPLES, len(CHANNELS))))


@pytest.fixture(scope="module")
def shaken() -> np.ndarray:
    ground = banded_noise(SAMPLES, RIG.sample_rate, (0.3, 10.0), 0.15, seed=3)
    run = Laboratory(RIG, 2).open_loop("shaken", ground, np.zeros(SAMPLES))
    return np.column_stack([run.outputs[:, RIG.measured_outputs], run.ground_acceleration])


def faults(readings: np.ndarray) -> dict[str, tuple[str, ...]]:
    """The channels with a fault, and the first words of each."""
    return {
        channel.name: tuple(text.partition(":")[0] for text in channel.faults)
        for channel in check_sensors(RIG, readings).channels
        if channel.faults
    }


def test_nothing_is_wrong_with_a_rig_at_rest_and_it_says_what_cannot_be_judged(at_rest):
    found = check_sensors(RIG, at_rest)
    assert found.well
    assert not found.judged
    assert "not checked, the rig hardly moved" in found.text()
    for channel, sensor in zip(found.channels, RIG.channel_sensors, strict=True):
        assert channel.noise == pytest.approx(sensor.noise, rel=0.05)
        assert channel.expected_noise == pytest.approx(np.hypot(sensor.noise, sensor.step / np.sqrt(12)), rel=1e-9)
        assert abs(channel.mean) < 0.1 * sensor.noise


def test_nothing_is_wrong_with_a_rig_that_is_shaken(shaken):
    found = check_sensors(RIG, shaken)
    assert found.judged
    assert found.well, found.text()


def with_fault(shaken: np.ndarray, fault: str) -> np.ndarray:
    sensors = Measurement(RIG.channel_sensors, 1, 1 / RIG.sample_rate)
    sensors.faults = (parse_fault(fault, CHANNELS, 1 / RIG.sample_rate),)
    return sensors.record(shaken)


@pytest.mark.parametrize("channel", ["x1", "xf", "a2", "fb", "w"])
@pytest.mark.parametrize(("kind", "name"), [("stuck@20", "dead"), ("zero", "dead"), ("noise", "noisy")])
def test_a_sensor_that_failed_is_named(shaken, channel, kind, name):
    found = faults(with_fault(shaken, f"{channel}={kind}"))
    assert name in found[channel]
    assert not {other for other, texts in found.items() if other != channel and name in texts}


def test_a_table_at_rest_is_not_judged_by_the_noise_of_a_floor():
    noisy = CHANNELS.index("a3")
    for seed in range(40):  # a second each: few lines, which by chance may agree
        readings = Measurement(RIG.channel_sensors, seed, 1 / RIG.sample_rate).record(np.zeros((500, len(CHANNELS))))
        readings[:, noisy] += np.random.default_rng(seed).normal(0.0, 0.3, 500)
        assert faults(readings) == {"a3": ("noisy",)}


def test_a_channel_that_reaches_its_end_is_named(at_rest):
    readings = at_rest.copy()
    readings[700:703, 4] = RIG.sensors.acceleration.range
    (found,) = (channel for channel in check_sensors(RIG, readings).channels if channel.faults)
    assert found.faults == ("clipped: 3 samples at the upper end of the range, 6 m/s^2", *found.faults[1:])
    assert found.range_use == pytest.approx(1.0)


def test_a_channel_of_an_asymmetric_range_is_named_with_the_end_at_which_it_is(at_rest):
    """Of a converter of -2 to 10 V that reads 0.6 m/s^2 a volt, as its device reports its ends."""
    entries = {name: {"gain": 1.0, "unit": unit(name), "range": (-30e3, 30e3)} for name in CHANNELS} | {
        "a2": {"gain": 0.6, "unit": "m/s^2", "range": (-2.0, 10.0)}
    }
    calibration = Calibration(CalibrationFile(channels=entries, commands={}), CHANNELS, (), RIG.sample_rate)
    channel = CHANNELS.index("a2")
    np.testing.assert_allclose(calibration.range[channel], [-1.2, 6.0])
    raw = at_rest.copy()
    raw[:, channel] /= 0.6
    raw[700:703, channel], raw[800, channel], raw[900, channel] = -2.0, 9.9999, 4.0
    read = [calibration.measured(row) for row in raw]
    values, clipped = np.array([one for one, _ in read]), [bits for _, bits in read]
    found = check_sensors(RIG, values, clipped, calibration.range)
    assert [one.name for one in found.channels if one.faults] == ["a2"]
    assert found.channels[channel].faults[:2] == (
        "clipped: 3 samples at the lower end of the range, -1.2 m/s^2",
        "clipped: 1 sample at the upper end of the range, 6 m/s^2",
    )
    assert found.channels[channel].range_use == pytest.approx(1.0)
    recorded = check_sensors(RIG, values, clipped)
    assert "3 samples at the lower end" in recorded.channels[channel].faults[0], "of a bag, which has no ranges"


@pytest.mark.parametrize(
    ("pair", "named"),
    [(("a1", "a2"), {"a1", "a2"}), (("a1", "a3"), {"a1", "a3"}), (("x2", "x3"), {"a2", "a3"})],
)
def test_swapped_sensors_are_named_displacements_by_their_floors(shaken, pair, named):
    readings = shaken.copy()
    one, other = (CHANNELS.index(name) for name in pair)
    readings[:, [one, other]] = readings[:, [other, one]]
    found = faults(readings)
    assert {name for name, texts in found.items() if "swapped" in texts} == named, found


@pytest.mark.parametrize(
    ("channel", "factor", "fault"),
    [
        *((name, -1.0, "wrong sign") for name in ("a1", "a2", "a3", "xf", "w")),
        *((name, factor, "gain") for name in ("a2", "w") for factor in (0.8, 1.25)),
    ],
)
def test_a_wrong_sign_or_gain_is_named(shaken, channel, factor, fault):
    readings = shaken.copy()
    readings[:, CHANNELS.index(channel)] *= factor
    assert faults(readings) == {channel: (fault,)}


UNITS = [("a2", 1 / 9.80665, "g"), ("x3", 1000.0, "mm"), ("a1", -100.0, "cm/s^2"), ("w", 1 / 9.80665, "g")]


@pytest.mark.parametrize(("channel", "factor", "unit"), UNITS)
def test_a_channel_in_another_unit_is_named_with_the_unit(shaken, channel, factor, unit):
    readings = shaken.copy()
    readings[:, CHANNELS.index(channel)] *= factor
    texts = [text for one in check_sensors(RIG, readings).channels for text in one.faults if text.startswith("unit")]
    assert [text.partition(",")[0] for text in texts] == [f"unit: {channel} reads as if in {unit}"]


def test_all_accelerometers_in_another_unit_are_named(shaken):
    readings = shaken.copy()
    names = [name for name in CHANNELS if name == "w" or name.startswith("a")]
    readings[:, [CHANNELS.index(name) for name in names]] /= 9.80665
    assert faults(readings) == dict.fromkeys(names, ("unit",))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda force: -force, "wrong sign: fb against fa"),
        (lambda force: 1.25 * force, "gain: 1.25 times that of fa"),
        (lambda force: force[::-1], "apart: does not follow fa of the same brace group"),
    ],
)
def test_a_load_cell_is_compared_with_the_other_of_its_group(shaken, change, said):
    readings, channel = shaken.copy(), CHANNELS.index("fb")
    readings[:, channel] = change(readings[:, channel])
    found = {one.name: one.faults for one in check_sensors(RIG, readings).channels if one.faults}
    assert set(found) == {"fa", "fb"}
    assert found["fb"] == (said,)


def without_noise(bits: int = 16) -> Rig:
    quiet = {
        field.name: replace(getattr(RIG.sensors, field.name), noise=0.0, bits=bits)
        for field in fields(RIG.sensors)
        if isinstance(getattr(RIG.sensors, field.name), Sensor)
    }
    return replace(RIG, sensors=replace(RIG.sensors, **quiet))


@pytest.mark.parametrize("bits", [16, 900])
def test_sensors_without_noise_are_compared_by_their_steps_and_may_rest_at_one_reading(shaken, bits):
    rig = without_noise(bits)
    sensors = Measurement(rig.channel_sensors, 1, 1 / rig.sample_rate)
    found = check_sensors(rig, sensors.record(np.zeros((SAMPLES, len(CHANNELS)))))
    assert (found.well, found.judged) == (True, False), found.text()
    steps = np.array([sensor.step for sensor in rig.channel_sensors]) if bits == 16 else np.zeros(len(CHANNELS))
    expected = np.array([channel.expected_noise for channel in found.channels])
    np.testing.assert_allclose(expected, steps / np.sqrt(12), rtol=1e-9, atol=1e-11 * rig.sensors.force.range)
    assert (expected > 0).all()
    readings = shaken.copy()
    one, other = CHANNELS.index("a1"), CHANNELS.index("a3")
    readings[:, [one, other]] = readings[:, [other, one]]
    swapped = {one.name for one in check_sensors(rig, readings).channels if "swapped" in " ".join(one.faults)}
    assert swapped == {"a1", "a3"}
    readings = shaken.copy()
    readings[3000:, one] = readings[3000, one]
    assert "dead" in check_sensors(rig, readings).channels[one].faults[0], "while the other accelerometers moved"


def test_drift_is_the_change_over_the_record(at_rest):
    readings = at_rest.copy()
    readings[:, 0] += np.linspace(0, 0.002, SAMPLES)
    assert check_sensors(RIG, readings).channels[0].drift == pytest.approx(0.002, rel=0.01)


@pytest.mark.parametrize("shape", [(99, 10), (200, 9), (1000,)])
def test_a_record_that_does_not_fit_is_refused(shape):
    with pytest.raises(AbraceError, match="expected at least 100 samples of 10 channels"):
        check_sensors(RIG, np.zeros(shape))
