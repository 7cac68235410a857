# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.bands import LEAST_PERIODS, LOWEST, common_band, excited_band, slowest_bandwidth


def test_the_band_is_the_one_that_the_test_excites(laboratory_of, rig):
    laboratory, period = laboratory_of(rig, 3), 0.002
    noise = laboratory._noise(120, 12.0, 0.25, 1)
    shaken = laboratory.open_loop("bags/table", noise, 0 * noise)
    shaken = Test.of(shaken)
    low, high = excited_band(shaken, "w")
    assert low < 1.0 / (len(noise) * period) * 2, "noise from 0 Hz"
    assert high == pytest.approx(12.0, rel=0.01)
    assert common_band([shaken], ["w"]) == (pytest.approx(LOWEST * 7.363 / (2 * np.pi), rel=0.02), high)
    assert common_band([shaken.part(0, 10000)], ["w"])[0] == pytest.approx(LEAST_PERIODS / (10000 * period))
    both = Test.of(laboratory.multisine_test(table=True, command=True))
    for name, edge in (("w", 10.0), ("U", 30.0)):
        low, high = excited_band(both, name)
        assert 0.3 <= low < 0.3 + 4 / 32.768, "of the lines of the period, every second, some are left out"
        assert high == pytest.approx(edge, rel=0.01)
    options = IdentificationOptions().of_tests([shaken, both], [both])
    assert options.table_band == excited_band(both, "w"), "the band that all tests of the table excite"
    from_zero = IdentificationOptions(command_band=(0.0, 30.0)).of_tests([shaken], [both]).command_band
    assert from_zero == (1 / (len(both.outputs) * both.sample_period), 30.0), "the mean is not part of a test"
    given = IdentificationOptions(table_band=(1.0, 9.0), command_band=(2.0, 8.0))
    assert given.of_tests([shaken], [both]) == given


def test_the_slowest_resonance_is_the_buildings_first_mode(table_test, command_test):
    for run, band in ((Test.of(table_test), (0.1, 10.0)), (Test.of(command_test), (0.1, 30.0))):
        assert slowest_bandwidth(run, band) == pytest.approx(2 * 0.015 * 7.4, rel=0.05)
        slower = replace(run, sample_period=10 * run.sample_period)
        assert slowest_bandwidth(slower, (band[0] / 10, band[1] / 10)) == pytest.approx(
            slowest_bandwidth(run, band) / 10
        )
