# SPDX-License-Identifier: Apache-2.0
"""Zeroing of a running rig: which readings count, and what it is refused for."""

import numpy as np
import pytest
import yaml

from abrace_core.errors import AbraceError
from abrace_plant.devices.calibration import Calibration, CalibrationFile
from abrace_plant.devices.zeroing import Zeroing

FILE = CalibrationFile(
    channels=yaml.safe_load("{x1: {gain: 10, unit: mm, range: [-10, 10]}, a1: {gain: 1, unit: m/s^2, range: [-6, 6]}}"),
    commands={},
)
CALIBRATION = Calibration(FILE, ("x1", "a1"), (), 500.0)
SAMPLES = 500
READINGS = np.random.default_rng(1).normal([0.002, 0.1], [1e-5, 1e-3], (SAMPLES, 2))


def zeroing(*which: str) -> Zeroing:
    return Zeroing(CALIBRATION, which, SAMPLES)


def test_all_channels_or_those_named_have_zero_mean_by_the_new_file():
    for which, expected in (((), [0.2, 0.1]), (("a1",), [0.0, 0.1])):
        found = zeroing(*which)
        for k, reading in enumerate(READINGS):
            assert not found.over.is_set(), k
            found.take(reading, [0.0, 0.0])
        assert found.over.is_set()
        file, changes = found.result()
        assert [file.channels[name].zero for name in ("x1", "a1")] == pytest.approx(expected, abs=0.001)
        assert changes.count("a1 0 to 0.0999") == 1
        assert ("x1" in changes) == (not which)


def test_it_is_refused_once_something_acts():
    found = zeroing()
    found.take(READINGS[0], [0.0, 0.0])
    found.take(READINGS[1], [0.0, 0.25])
    assert found.over.is_set(), "nothing more is waited for"
    found.take(READINGS[2], [0.0, 0.0])
    with pytest.raises(AbraceError, match=r"^zeroing: a command acts \(0, 0\.25\)$"):
        found.result()


def test_it_is_refused_without_all_of_the_samples():
    found = zeroing()
    for reading in READINGS[:-1]:
        found.take(reading, [0.0, 0.0])
    with pytest.raises(AbraceError, match=r"^zeroing: only 499 of 500 samples arrived$"):
        found.result()


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (3.0, "x1 is 0.006 m from its calibrated offset, expected at most 0.005"),
        (0.0, ""),
        (-3.0, "x1 is -0.006 m from its calibrated offset, expected at most 0.005"),
    ],
)
def test_a_sensor_further_off_than_a_twentieth_of_half_its_range_is_looked_at_and_not_zeroed(factor, message):
    found = zeroing("x1")
    for reading in READINGS * [factor, 1.0]:
        found.take(reading, [0.0])
    if message:
        with pytest.raises(AbraceError, match=message):
            found.result()
    else:
        assert found.result()[0].channels["x1"].zero == 0.0


def test_zeroings_one_after_the_other_do_not_add_up_to_more_than_the_limit():
    calibration = CALIBRATION
    for mean, allowed in ((0.004, True), (0.0008, True), (0.0008, False), (-0.009, True)):
        found = Zeroing(calibration, ("x1",), SAMPLES)
        for reading in READINGS - READINGS.mean(axis=0) + [mean, 0.0]:
            found.take(reading, [0.0])
        if allowed:
            calibration = Calibration(found.result()[0], ("x1", "a1"), (), 500.0)
        else:
            with pytest.raises(AbraceError, match=r"x1 is 0\.0056 m from its calibrated offset, expected"):
                found.result()


def test_a_channel_that_there_is_not_and_a_device_without_a_file_are_named():
    with pytest.raises(AbraceError, match=r"zero_channels: no channel 'a9', expected some of x1, a1"):
        zeroing("x1", "a9")
    with pytest.raises(AbraceError, match="zeroing: the device has no calibration file"):
        Zeroing(Calibration(None, ("x1",), (), 500.0), (), SAMPLES)
