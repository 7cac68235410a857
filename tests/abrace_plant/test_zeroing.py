# SPDX-License-Identifier: Apache-2.0
"""Zeroing of a running rig: which readings count, and what it is refused for."""

import re

import numpy as np
import pytest
import yaml

from abrace_core import AbraceError
from abrace_plant.devices.calibration import Calibration, CalibrationFile
from abrace_plant.devices.zeroing import Zeroing, check_names

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
        new, changes = found.result()
        assert [new.file.channels[name].zero for name in ("x1", "a1")] == pytest.approx(expected, abs=0.001)
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


def test_zeroings_one_after_the_other_do_not_add_up_to_more_than_the_limit():
    calibration = CALIBRATION
    for mean, allowed in ((0.004, True), (0.0008, True), (0.0008, False), (-0.009, True)):
        found = Zeroing(calibration, ("x1",), SAMPLES)
        for reading in READINGS - READINGS.mean(axis=0) + [mean, 0.0]:
            found.take(reading, [0.0])
        if allowed:
            calibration = found.result()[0]
        else:
            with pytest.raises(AbraceError, match=r"x1 is 0\.0056 m from its calibrated offset, expected"):
                found.result()


@pytest.mark.parametrize(
    ("readings", "message"),
    [
        (np.outer(np.sin(np.arange(SAMPLES)), [1e-3, 0.0]), "x1 is not at rest (0.000707 m, expected at most 0.0005)"),
        (
            np.outer(np.linspace(0, 0.09, SAMPLES), [0.0, 1.0]),
            "a1 is not at rest (0.0451 m/s^2, expected at most",
        ),
        (np.full((SAMPLES, 2), [0.0, np.nan]), "a1 is not at rest (nan m/s^2"),
    ],
)
def test_a_channel_that_moves_is_not_zeroed_nor_are_the_others(readings, message):
    found = zeroing()
    for reading in readings:
        found.take(reading, [0.0])
    with pytest.raises(AbraceError, match=re.escape(message)):
        found.result()


def test_after_zeroing_readings_have_zero_mean_also_through_sign_and_offset():
    x1 = {"gain": 10.0, "unit": "mm", "range": (-10.0, 10.0), "offset": 0.25}
    a1 = {"gain": 0.5, "unit": "g", "range": (-10.0, 10.0), "sign": -1}
    calibration = Calibration(CalibrationFile(channels={"x1": x1, "a1": a1}, commands={}), ("x1", "a1"), (), 500.0)
    raw = np.random.default_rng(2).normal([0.65, -0.4], 0.001, (SAMPLES, 2))
    found = Zeroing(calibration, (), SAMPLES)
    for row in raw:
        found.take(calibration.measured(row)[0], [0.0])
    new = found.result()[0]
    assert np.abs(np.mean([new.measured(row)[0] for row in raw], axis=0)).max() < 1e-12
    assert new.file.channels["x1"].offset == 0.25, "as calibrated"
    assert new.file.channels["x1"].zero == pytest.approx(0.4, abs=0.001)


def test_a_channel_that_there_is_not_is_named():
    with pytest.raises(AbraceError, match=r"zero_channels: no channel 'a9', expected some of x1, a1"):
        check_names(("x1", "a1"), ("x1", "a9"))
