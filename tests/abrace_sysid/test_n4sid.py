# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from n4sid import n4sid_poles

from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table

pytest.importorskip("ctrlsys", reason="ctrlsys needs NumPy 2, a sourced ROS 2 Jazzy has NumPy 1.26")


def test_subspace_identification_finds_the_building_in_both_tests(rig, table_test, command_test):
    true = np.array(pole_table(rig.model.poles())[:3])
    for run, name, limit in ((table_test, "w", 1e-3), (command_test, "U", 3e-3)):
        found = np.array(pole_table(n4sid_poles(run, name))[:3])
        assert np.abs(found[:, 0] / true[:, 0] - 1).max() < 1e-4, (name, found)
        assert np.abs(found[:, 1] / true[:, 1] - 1).max() < limit, (name, found)


def test_the_order_is_read_off_the_data(rig, table_test, command_test):
    # the command shows all six pairs and the servo's slow pole; the table the building, that pole and a local mode
    assert len(pole_table(n4sid_poles(command_test, "U"))) == rig.floors + 3
    assert rig.floors <= len(pole_table(n4sid_poles(table_test, "w"))) <= rig.floors + 1


@pytest.mark.parametrize("seed", [1, 7, 9])
def test_a_multisine_that_has_nothing_above_its_band_is_decimated_further(rig, laboratory_of, seed):
    """At FILL it excites none of the block rows, and no pole of the building is found."""
    true = np.array(pole_table(rig.model.poles()))
    found = np.array(pole_table(n4sid_poles(laboratory_of(rig, seed).multisine_test(False, True), "U")))
    nearest = found[[np.argmin(np.abs(found[:, 0] - frequency)) for frequency in true[:, 0]]]
    assert np.abs(nearest[:, 0] / true[:, 0] - 1).max() < 1e-3


def test_an_input_of_a_few_lines_is_refused(rig, laboratory):
    time = np.arange(60_000) / rig.sample_rate
    command = sum(1000 * np.sin(2 * np.pi * frequency * time) for frequency in (1.2, 3.6, 6.0, 9.0, 16.7))
    run = laboratory.open_loop("bags/lines", 0 * time, command)
    with pytest.raises(AbraceError, match="bags/lines: U does not excite 30 block rows"):
        n4sid_poles(run, "U")
