# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.response import (
    TABLE_1_EXPERIMENT,
    TABLE_1_SIMULATION,
    in_paper_units,
    mean_relative_error,
    peak_rms,
)


def test_rows_are_those_of_table_1(command_test):
    assert list(peak_rms(command_test)) == list(TABLE_1_EXPERIMENT) == list(TABLE_1_SIMULATION)


def test_peak_is_the_greatest_magnitude_and_rms_of_a_sine_its_amplitude_over_root_two(plain_run):
    time = np.arange(5000) * 0.002
    table = peak_rms(plain_run(-0.03 * np.sin(2 * np.pi * time), command=np.full(5000, -980.665)))
    assert table["x1"] == pytest.approx((0.03, 0.03 / np.sqrt(2)), rel=1e-4)
    paper = in_paper_units(table)
    assert paper["x1"].peak == pytest.approx(3.0, rel=1e-4)
    assert paper["a1"].peak == pytest.approx(0.03 / 9.80665, rel=1e-4)
    assert paper["U"] == pytest.approx((100.0, 100.0))


def test_the_paper_s_own_simulation_is_13_6_percent_off():
    assert mean_relative_error(TABLE_1_SIMULATION, TABLE_1_EXPERIMENT) == pytest.approx(0.136, abs=5e-4)
    assert mean_relative_error(TABLE_1_EXPERIMENT, TABLE_1_EXPERIMENT) == 0


def test_tables_that_cannot_be_compared_are_refused(plain_run):
    with pytest.raises(AbraceError, match="no row x2, x3, a2, a3, expected x1"):
        mean_relative_error(peak_rms(plain_run(np.ones(10))), TABLE_1_EXPERIMENT)
    with pytest.raises(AbraceError, match="zero in row U"):
        mean_relative_error(TABLE_1_EXPERIMENT, {**TABLE_1_EXPERIMENT, "U": TABLE_1_EXPERIMENT["U"]._replace(peak=0)})
    with pytest.raises(AbraceError, match="bags/plain: no samples"):
        peak_rms(replace(plain_run(np.ones(10)), outputs=np.empty((0, 4))))
