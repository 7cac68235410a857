# SPDX-License-Identifier: Apache-2.0
"""Calibration: volts to SI units and back, ranges, filters."""

import math

import numpy as np
import pytest
import yaml
from scipy import signal
from udp_target import CHANNELS, CONFIG, RIG, device_file

from abrace_core import AbraceError
from abrace_plant.devices.calibration import Calibration, CalibrationFile, read_calibration, write_calibration
from abrace_plant.devices.device import DeviceError
from abrace_plant.devices.file import load_device

RATE = 500.0


def calibration(channels: str, commands: str = "{}", rate: float = RATE) -> Calibration:
    content = CalibrationFile(channels=yaml.safe_load(channels), commands=yaml.safe_load(commands))
    return Calibration(content, tuple(content.channels), tuple(content.commands), rate)


def test_a_number_may_carry_its_unit():
    found = calibration(
        "{x1: {gain: 1, unit: um, range: [-9, 9], delay: 0.3 ms, filter: {order: 2, frequency: 0.04 kHz}}}"
    )
    channel = found.file.channels["x1"]
    assert (channel.delay, channel.filter.frequency) == (0.0003, 40.0)
    np.testing.assert_allclose(found.measured(np.array([2.0]))[0], [2e-6], rtol=1e-12)


def test_a_value_is_sign_times_gain_times_raw_less_offset_in_si_units():
    found = calibration("""
        x1: {gain: 10.0, unit: mm, offset: 0.5, range: [-10, 10]}
        a1: {gain: 0.5, unit: g, sign: -1, range: [-10, 10]}
        f: {gain: 2.0, unit: kN, offset: -1.0, range: [-10, 10]}
    """)
    values, clipped = found.measured(np.array([1.5, 2.0, 1.0]))
    np.testing.assert_allclose(values, [0.01, -9.80665, 4000.0], rtol=1e-12)
    assert clipped == 0
    np.testing.assert_allclose(found.raw(values), [1.5, 2.0, 1.0], rtol=1e-12)


def test_commands_become_volts_within_the_outputs_range():
    commands = (
        "{U: {gain: 2.5, unit: kN, sign: -1, offset: 0.1, range: [-10, 10]}, w: {gain: 0.5, unit: g, range: [-5, 5]}}"
    )
    found = calibration("{x1: {gain: 1, unit: m, range: [-1, 1]}}", commands)
    outputs = found.outputs([5000.0, 9.80665])
    np.testing.assert_allclose(outputs, [0.1 - 2.0, 2.0], rtol=1e-12)
    np.testing.assert_allclose(found.commanded(outputs), [5000.0, 9.80665], rtol=1e-12)
    assert found.outputs([-1e9, 1e9]) == [10.0, 5.0]


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_does_not_reach_a_device(wrong):
    with pytest.raises(DeviceError, match=r"commands \[.*\], expected finite numbers"):
        Calibration(None, ("x1", "w"), ("U", "w"), RATE).outputs([wrong, 0.0])


@pytest.mark.parametrize(("raw", "clipped"), [(9.98, 0), (9.9997, 0b10), (10.0, 0b10), (-10.0, 0b10), (1e300, 0b10)])
def test_a_reading_at_the_end_of_its_range_sets_the_channels_bit_and_never_goes_beyond(raw, clipped):
    found = calibration("{x1: {gain: 1, unit: m, range: [-10, 10]}, x2: {gain: 1, unit: m, range: [-10, 10]}}")
    values, bits = found.measured(np.array([0.0, raw]))
    assert bits == clipped
    assert abs(values[1]) <= 10.0


def test_without_a_file_values_pass_as_they_are():
    found = Calibration(None, ("x1", "w"), ("U", "w"), RATE)
    values, clipped = found.measured(np.array([1e300, -3.0]))
    assert (values.tolist(), clipped, found.outputs([25e3, 1.0])) == ([1e300, -3.0], 0, [25e3, 1.0])


@pytest.mark.parametrize("order", [1, 2])
def test_filters_are_scipys_butterworth_channel_by_channel(order):
    found = calibration(f"""
        x1: {{gain: 1, unit: m, range: [-9, 9], filter: {{order: {order}, frequency: 40}}}}
        x2: {{gain: 1, unit: m, range: [-9, 9]}}
    """)
    raw = np.random.default_rng(1).normal(size=(300, 2))
    values = np.array([found.measured(row)[0] for row in raw])
    b, a = signal.butter(order, 40, fs=RATE)
    expected, _ = signal.lfilter(b, a, raw[:, 0], zi=signal.lfilter_zi(b, a) * raw[0, 0])
    np.testing.assert_allclose(values[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(values[:, 1], raw[:, 1])


@pytest.mark.parametrize("order", [1, 2])
def test_the_stated_lag_of_a_filter_is_that_of_slow_signals(order):
    found = calibration(
        f"x1: {{gain: 1, unit: m, range: [-9, 9], delay: 0.001, filter: {{order: {order}, frequency: 50}}}}"
    )
    b, a = signal.butter(order, 50, fs=RATE)
    _, response = signal.freqz(b, a, [0.5], fs=RATE)
    assert found.lag[0] == pytest.approx(0.001 - np.angle(response[0]) / (2 * np.pi * 0.5), rel=0.01)
    assert found.delay == 0.001


def test_a_filter_begins_at_its_first_reading_and_anew_after_a_reset():
    found = calibration("x1: {gain: 1, unit: m, range: [-9, 9], filter: {order: 2, frequency: 20}}")
    for level in (5.0, -3.0):
        found.reset()
        assert [found.measured(np.array([level]))[0][0] for _ in range(4)] == pytest.approx([level] * 4)


@pytest.mark.parametrize("order", [1, 2])
def test_after_a_reading_that_is_no_number_a_filter_begins_anew_and_the_other_channels_go_on(order):
    limits = f"gain: 1, unit: m, range: [-9, 9], filter: {{order: {order}, frequency: 20}}"
    text = f"{{x1: {{{limits}}}, x2: {{{limits}}}, x3: {{gain: 1, unit: m, range: [-9, 9]}}}}"
    found, undisturbed = calibration(text), calibration(text)
    levels = [1.0, 3.0, -2.0, 2.0]
    broken = [np.nan, 3.0, -2.0, 2.0]
    expected = [undisturbed.measured(np.full(3, level))[0] for level in [7.0, *levels]][2:]
    fresh = calibration(text)
    begun = [fresh.measured(np.full(3, level))[0] for level in levels[1:]]
    found.measured(np.full(3, 7.0))
    values = [found.measured(np.array([wrong, level, wrong]))[0] for wrong, level in zip(broken, levels, strict=True)]
    assert np.isnan(values[0]).tolist() == [True, False, True]
    for value, at_first, as_before in zip(values[1:], begun, expected, strict=True):
        assert value == pytest.approx([at_first[0], as_before[1], at_first[2]])


FILE = CalibrationFile(
    channels={
        "x1": {"gain": 10.0, "unit": "mm", "range": (-10.0, 10.0), "offset": 0.25},
        "a1": {"gain": 0.5, "unit": "g", "range": (-10.0, 10.0), "sign": -1},
    },
    commands={},
)


def test_a_written_file_is_read_back_and_its_zero_counts_to_the_range(tmp_path):
    channels = {"x1": FILE.channels["x1"].model_copy(update={"zero": 0.5}), "a1": FILE.channels["a1"]}
    file = FILE.model_copy(update={"channels": channels})
    write_calibration(tmp_path / "new.yaml", file)
    assert read_calibration(tmp_path / "new.yaml") == file
    assert [path.name for path in tmp_path.iterdir()] == ["new.yaml"]
    channels = {**channels, "x1": FILE.channels["x1"].model_copy(update={"zero": 20.0})}
    with pytest.raises(AbraceError, match=r"channels.x1.range: \[-10.0, 10.0\], expected its ends around 20.25"):
        Calibration(FILE.model_copy(update={"channels": channels}), ("x1", "a1"), (), RATE)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("unit: mm", "unit: kN", "channels.x1.unit: 'kN' is another kind of quantity, expected one as m"),
        ("unit: mm", "unit: ''", "channels.x1.unit: '' is no unit, expected a combination of kg"),
        ("x3:", "x4:", "channels: no entry x3; channels.x4: unknown, expected x1, x2, x3, xf"),
        ("range: [-10.0, 10.0]", "range: [1.0, 10.0]", "channels.x1.range: [1.0, 10.0], expected its ends around 0"),
        ("x1: {gain: 10.0", "x1: {gain: 0.0", "channels.x1.gain: 0.0, expected"),
        ("x1: {gain", "x1: {sign: 2, gain", "channels.x1.sign: 2, expected"),
        ("x1: {", "x1: {filter: {order: 2, frequency: 250.0}, ", "channels.x1.filter.frequency: 250 Hz, expected less"),
    ],
)
def test_a_calibration_file_that_is_wrong_is_refused_by_its_key(tmp_path, old, new, message):
    path = device_file(tmp_path, calibrated=True)
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text((CONFIG / "device_parts/calibration.yaml").read_text().replace(old, new, 1))
    path.write_text(path.read_text().replace(f"{CONFIG}/device_parts/calibration.yaml", "wrong.yaml"))
    with pytest.raises(AbraceError) as refused:
        load_device(path, RIG)
    assert str(refused.value).startswith(f"calibration file {wrong}: ")
    assert message in str(refused.value)


def test_the_calibration_of_the_papers_rig_has_the_ranges_of_its_sensors():
    found = Calibration(read_calibration(CONFIG / "device_parts/calibration.yaml"), CHANNELS, ("U", "w"), RATE)
    ends = [(-sensor.range, sensor.range) for sensor in RIG.channel_sensors]
    np.testing.assert_allclose(found.range, ends, rtol=1e-12)


def test_a_range_has_both_ends_in_si_units_whatever_sign_and_offset():
    found = calibration("""
        x1: {gain: 10.0, unit: mm, offset: 1.0, range: [-2, 10]}
        a1: {gain: 0.5, unit: m/s^2, sign: -1, range: [-2, 10]}
    """)
    np.testing.assert_allclose(found.range, [[-0.03, 0.09], [-5.0, 1.0]], rtol=1e-12)
    assert Calibration(None, ("x1",), (), RATE).range.tolist() == [[-math.inf, math.inf]]
