# SPDX-License-Identifier: Apache-2.0
"""A signal is found by the paper's name and by that of the messages."""

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_core.signals import command_names, positions, response_names


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("x2", 1),
        ("displacement[1]", 1),
        ("displacement_2", 1),
        ("stroke[0]", 3),
        ("acceleration[2]", 6),
        ("f", 7),
        ("command[0]", 8),
        ("ground_acceleration", 9),
    ],
)
def test_a_channel_of_a_run_has_two_names(name, column):
    run = Run(
        "bag", 0.002, np.arange(1, dtype=np.uint64), 3, 1, np.arange(8.0)[None], np.array([9.0]), np.array([[8.0]])
    )
    assert run.channels([name]).tolist() == [[float(column)]]


def test_signals_of_several_groups_are_told_apart():
    known = (*response_names(2, 2), *command_names(2), "w")
    assert positions(["stroke[1]", "command[0]", "xf2", "U1"], known, "") == [3, 8, 3, 8]


def test_known_names_may_be_those_of_messages():
    assert positions(["a1", "w"], ["log_time", "ground_acceleration", "acceleration[0]"], "") == [2, 1]


def test_all_names_that_are_missing_are_told_at_once():
    with pytest.raises(
        AbraceError, match=r"^bag: no channel 'x4', 'force\[0\]', 'displacement\[3\]', it has x1, x2, x3, f$"
    ):
        positions(["x1", "x4", "force[0]", "displacement[3]"], ["x1", "x2", "x3", "f"], "bag: no channel")
