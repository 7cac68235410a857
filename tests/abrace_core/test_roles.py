# SPDX-License-Identifier: Apache-2.0
"""Which input of a model disturbs, and which are commands."""

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.roles import with_roles


def model(*inputs: str, **more: object) -> LinearModel:
    """One state for each input, seen by one output: input i drives state i alone, by i + 1."""
    count = len(inputs)
    drive = np.diag(np.arange(1.0, count + 1))
    return LinearModel(-np.eye(count), drive, np.ones((1, count)), np.zeros((1, count)), inputs, ("tip",), **more)


@pytest.mark.parametrize(
    ("inputs", "commands", "disturbance", "expected"),
    [
        (("w", "U1", "U2"), (), "", ("w", "U1", "U2")),
        (("U", "w"), (), "", ("w", "U")),
        (("shaker", "base"), ("shaker",), "", ("base", "shaker")),
        (("shaker", "base"), (), "base", ("base", "shaker")),
        (("s1", "s2", "base", "wind"), ("s2",), "wind", ("wind", "s2")),
        (("w [g]", "shaker [kN]"), ("shaker",), "", ("w [g]", "shaker [kN]")),
    ],
)
def test_the_disturbance_comes_first_then_the_commands(inputs, commands, disturbance, expected):
    given = model(*inputs)
    found = with_roles(given, commands, disturbance)
    assert found.inputs == expected
    for name in expected:
        np.testing.assert_array_equal(found.b[:, expected.index(name)], given.b[:, inputs.index(name)])


def test_a_model_whose_inputs_have_these_roles_is_returned_itself():
    given = model("w", "U")
    assert with_roles(given) is given


def test_where_every_input_is_a_command_the_disturbance_is_a_force_in_its_place():
    found = with_roles(model("shaker", input_delay=(0.01,), units={"shaker": "kN"}))
    assert found.inputs == ("disturbance", "shaker")
    np.testing.assert_array_equal(found.b, [[1.0, 1.0]])
    assert found.input_delay == (0.01, 0.01)
    assert found.units == {"shaker": "kN", "disturbance": "kN"}
    second = with_roles(model("s1", "s2"), ("s1", "s2"), "s2")
    assert second.inputs == ("disturbance", "s1", "s2")
    np.testing.assert_array_equal(second.b[:, 0], [0.0, 2.0])
    assert second.units == {"disturbance": "N"}


@pytest.mark.parametrize(
    ("commands", "disturbance", "message"),
    [
        ((), "", "inputs s1, s2, base: expected the name of the disturbance, one of s1, s2, base, or of the commands"),
        (("s1",), "", "inputs s1, s2, base: expected the name of the disturbance, one of s2, base$"),
        (("s1", "shake"), "road", "model has no input shake, road, it has s1, s2, base"),
    ],
)
def test_names_that_do_not_say_what_disturbs_are_refused(commands, disturbance, message):
    with pytest.raises(AbraceError, match=message):
        with_roles(model("s1", "s2", "base"), commands, disturbance)
