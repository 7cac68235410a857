# SPDX-License-Identifier: Apache-2.0
"""A signal is found by the paper's name and by that of the messages."""

from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.response import clipped_sentences
from abrace_core.model.run import Run
from abrace_core.model.signals import command_names, positions, response_names


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


def test_channels_beyond_the_64_of_the_flags_are_not_said_to_be_within_their_range():
    names = response_names(32, 1)
    run = Run(
        "bag", 0.002, np.arange(3, dtype=np.uint64), 32, 1, np.zeros((3, len(names))), np.zeros(3), np.zeros((3, 1))
    )
    clipped = replace(run, clipped=np.array([0, 1, 1 << 63], dtype=np.uint64)).clipped_samples
    assert clipped == {"x1": 1, "a31": 1, "a32": None, "f": None, "w": None}
    assert clipped_sentences(clipped) == [
        "x1: 1 sample at the end of its range",
        "a31: 1 sample at the end of its range",
        "a32, f, w: unknown whether at the end of the range, not flagged",
    ]


def test_a_test_is_the_same_by_its_samples_not_by_its_name():
    run = Run("one", 0.002, np.arange(2, dtype=np.uint64), 1, 0, np.zeros((2, 2)), np.zeros(2), np.zeros((2, 0)))
    assert run.is_same(replace(run, source="other", outputs=run.outputs.copy()))
    assert not run.is_same(replace(run, outputs=run.outputs + 1))
    assert not run.is_same(replace(run, ground_acceleration=np.ones(2)))
