import numpy as np
import pytest
from n4sid import n4sid_poles

from abrace_core.linear_model import pole_table


def test_subspace_identification_finds_the_building_in_both_tests(rig, table_test, command_test):
    pytest.importorskip("ctrlsys", reason="ctrlsys needs NumPy 2, a sourced ROS 2 Jazzy has NumPy 1.26")
    true = np.array(pole_table(rig.model.poles())[:3])
    for run, name, order in ((table_test, "w", 8), (command_test, "U", 13)):
        poles = n4sid_poles(run, name, order)
        assert len(poles) == order
        found = np.array(pole_table(poles)[:3])
        assert np.abs(found[:, 0] / true[:, 0] - 1).max() < 1e-4, (name, found)
        assert np.abs(found[:, 1] / true[:, 1] - 1).max() < 1e-2, (name, found)
