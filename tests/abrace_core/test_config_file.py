# SPDX-License-Identifier: Apache-2.0
"""Files that people write: every mistake in one line, not one a run."""

import pytest

from abrace_core import AbraceError
from abrace_core.files.config_file import MOST_MISTAKES, Checked, expect_entries, read_config, read_mapping


class Brace(Checked):
    count: int
    capacity: float = 0.0


class Laboratory(Checked):
    name: str
    rate: float
    braces: list[Brace] = []


@pytest.fixture
def mistakes(tmp_path):
    def of(text: str) -> str:
        (tmp_path / "rig.yaml").write_text(text)
        with pytest.raises(AbraceError) as error:
            read_config(tmp_path / "rig.yaml", Laboratory, "rig")
        return str(error.value).removeprefix(f"rig file {tmp_path}/rig.yaml: ")

    return of


def test_every_mistake_is_told_in_one_line_unknown_keys_first(mistakes):
    assert mistakes("nome: a\nrate: fast\nbraces: [{count: 2, colour: red}]") == (
        "braces.0.colour: unknown key; nome: unknown key, did you mean name?; rate: 'fast', expected a valid number, "
        "unable to parse string as a number"
    )


def test_a_file_of_nothing_but_mistakes_is_cut_short(mistakes):
    keys = "".join(f"key{i}: 1\n" for i in range(MOST_MISTAKES))
    told = mistakes(keys)
    assert told.endswith("; and 2 more"), "name and rate are missing, too"
    assert told.count(";") == MOST_MISTAKES
    assert mistakes("- 1") == "a list, expected keys and values"
    assert mistakes("") == "empty, expected keys and values"


def test_all_missing_and_unknown_entries_are_named():
    with pytest.raises(AbraceError, match=r"^inputs: no entry x1, a1; inputs\.q: unknown, expected x1, x2, a1$"):
        expect_entries(["x2", "q"], ["x1", "x2", "a1"], "inputs")


def test_powers_of_ten_may_be_written_as_one_likes(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("a: 1e6\nd: [-2.5E-3, 1.e3, 1e3x]\n")
    assert read_mapping(path, "some") == {"a": 1e6, "d": [-2.5e-3, 1e3, "1e3x"]}


@pytest.mark.parametrize("number", ["010", "-007", "1:30", "1:30.5"])
def test_a_number_that_yaml_would_read_as_another_one_is_refused(tmp_path, number):
    """YAML 1.1: 010 is 8, 1:30 is 90."""
    path = tmp_path / "file.yaml"
    path.write_text(f"a: 1\nb: {number}\n")
    with pytest.raises(AbraceError, match=rf"some file .*: line 2: {number}, expected a number without leading zeros"):
        read_mapping(path, "some")
    path.write_text(f"b: '{number}'\n")
    assert read_mapping(path, "some") == {"b": number}
