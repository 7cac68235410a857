# SPDX-License-Identifier: Apache-2.0
"""Launch arguments are all checked before the first node is started, and every mistake is named."""

import pytest

from abrace_bringup.arguments import read_arguments
from abrace_bringup.graphs import CLOSED_LOOP, IDENTIFICATION
from abrace_core import AbraceError

TABLES = {graph.name: graph.arguments for graph in (CLOSED_LOOP, IDENTIFICATION)}


@pytest.fixture
def texts(tmp_path) -> dict[str, str]:
    """Valid texts of the closed loop's arguments."""
    controller = tmp_path / "lqg3.yaml"
    controller.write_text("/**:\n  ros__parameters: {name: lqg3}\n")
    return {"controller": str(controller), "bag": str(tmp_path / "bag")}


def mistakes(texts: dict[str, str], given=(), table=CLOSED_LOOP.arguments) -> list[str]:
    with pytest.raises(AbraceError) as raised:
        read_arguments(table, texts, given)
    return str(raised.value).splitlines()[1:]


def test_valid_arguments_have_their_types(texts):
    given = {**texts, "duration": "20", "plant": "False", "namespace": "/lab/rig"}
    values = read_arguments(CLOSED_LOOP.arguments, given)
    assert (values["duration"], values["plant"], values["namespace"]) == (20.0, False, "/lab/rig")
    assert values["controller"] == texts["controller"]


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_argument_has_a_description_and_only_what_has_to_be_given_a_default_that_is_refused(table):
    assert all(argument.description for argument in table)
    lines = mistakes({}, table=table)
    refused = {line.partition(":=")[0] for line in lines}
    assert refused == {argument.name for argument in table if "required" in argument.description}


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("duration", "5x", "a number of 0 or more"),
        ("peak_acceleration", "nan", "a number of 0 or more"),
        ("free_decay", "-1", "a number of 0 or more"),
        ("plant", "no", "true or false"),
        ("namespace", "2rig", "a ROS namespace"),
        ("enclaves", "abrace", "a folder of enclaves such as /abrace"),
        ("rig", "", "the name of a rig or a file"),
        ("rig", "none.yaml", "none of this name"),
        ("record", "./none", "none of this name"),
        ("controller", "my_laws/", "or PACKAGE/EXECUTABLE of a node of your own"),
        ("controller", "none.yaml", "No such file"),
        ("controller", "/", "a folder, expected a file"),
        ("parameters", "none.yaml", "No such file"),
        ("bag", "", "a new directory"),
        ("bag", "/", "exists already"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(texts, name, text, expected):
    (line,) = mistakes({**texts, name: text})
    assert line.startswith(f"{name}:={text}, expected ")
    assert expected in line


@pytest.mark.parametrize("content", ["", "a: [", "a: 1", "[1, 2]", "plant:\n  rig: x", "\0"])
def test_a_file_without_parameters_is_refused(texts, tmp_path, content):
    file = tmp_path / "parameters.yaml"
    file.write_text(content)
    (line,) = mistakes({**texts, "parameters": str(file)})
    assert "expected a ROS parameter file: " in line


def test_all_mistakes_are_named_at_once_names_as_well(texts):
    lines = mistakes({**texts, "duration": "x", "plant": "x"}, ["recrod", "duration", "zzz"])
    assert [line.partition(":")[0] for line in lines] == ["recrod", "zzz", "duration", "plant"]
    names = sorted(argument.name for argument in CLOSED_LOOP.arguments)
    assert lines[0] == f"recrod: unknown, expected one of {', '.join(names)}, did you mean record?"
