# SPDX-License-Identifier: Apache-2.0
"""Libyaml's parser is quick, PyYAML's own says what is wrong: people must not notice which one has read their file."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml

from abrace_core import AbraceError
from abrace_core.files import reading
from abrace_core.files.reading import DEEPEST, parse_yaml, read_json

FILES = sorted((Path(__file__).parents[2] / "src").rglob("*.yaml"))
TYPED = (
    *("\t", "\n", " ", ": ", ":", "- ", "[", "]", "{", "}", ",", "#", "'", '"', "&a", "*a", "!", "|", ">", "%", "@"),
    *("`", "?", "? ", "---\n", "...\n", "\u0085", "\u2028", "\ufeff", "ä", "😀", "\x00", "\r", "~", "<<: ", "010"),
    *("1e5", "1:30", "0x1F", "null", "\t- ", "a: b: c", "key:\tvalue", "\n\tkey: 1\n"),
)
"""What a hand may type in a wrong place."""
MISTYPED = 400


def outcome(text: str) -> object:
    """Content or error."""
    try:
        return repr(parse_yaml(text, "rig file x.yaml"))
    except AbraceError as error:
        return error


def mistyped(text: str, chance: random.Random) -> str:
    """Some lines of a file, in which something is typed, missing or repeated."""
    lines = text.splitlines(keepends=True)
    first = chance.randrange(len(lines))
    text = "".join(lines[first : first + chance.randrange(1, 12)])
    for _ in range(chance.randrange(1, 4)):
        place, other = chance.randrange(len(text) + 1), chance.randrange(len(text) + 1)
        typed = chance.choice((chance.choice(TYPED), chance.choice(TYPED), text[other : other + 10], ""))
        text = text[:place] + typed + text[place + chance.randrange(2) :]
    return text


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML without libyaml has only its own parser")
def test_both_parsers_take_the_same_for_right_and_see_the_same_in_it(monkeypatch):
    texts = [path.read_text(encoding="utf-8") for path in FILES]
    chance = random.Random(1)
    texts += [mistyped(chance.choice(texts), chance) for _ in range(MISTYPED)]
    found = [outcome(text) for text in texts]
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    own = [outcome(text) for text in texts]
    wrong = [one for one in own if isinstance(one, AbraceError)]
    assert MISTYPED / 4 < len(wrong) < MISTYPED * 3 / 4
    for text, one, other in zip(texts, found, own, strict=True):
        assert str(one) == str(other), text


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML without libyaml has only its own parser")
def test_right_files_are_read_by_the_quick_parser(monkeypatch):
    """A controller in use reads its next file beside the loop."""
    monkeypatch.setattr(reading, "_Loader", None)
    for path in FILES:
        assert parse_yaml(path.read_text(encoding="utf-8"), str(path))


def test_a_lone_half_of_a_character_is_an_error():
    with pytest.raises(AbraceError, match="x: not YAML: a character that YAML does not allow"):
        parse_yaml("name: \ud800", "x")


def test_keys_that_a_merge_brings_may_be_written_as_well():
    text = "a: &a {x: 1, y: 1}\nn: {b: &b {<<: *a, x: 2}}\nc: {<<: *b, y: 3}"
    assert parse_yaml(text, "x") == {"a": {"x": 1, "y": 1}, "n": {"b": {"x": 2, "y": 1}}, "c": {"x": 2, "y": 3}}
    with pytest.raises(AbraceError, match="x: line 2: key 'z' appears twice, expected once"):
        parse_yaml("a: &a {x: 1}\nb: {<<: *a, z: 1, z: 2}", "x")


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("2024-02-30", "2024-02-30, expected a date of the calendar, or a text in quotes"),
        ("!!int abc", "abc, expected a whole number"),
        ("!!bool maybe", "maybe, expected true or false"),
        ("0b_", "0b_, expected a whole number"),
        ("1" * 5000, f"{'1' * 40}..., expected a whole number"),
        ("[" * 5000, f"more than {DEEPEST} lists or mappings in one another"),
        ("[" * 100_000, f"more than {DEEPEST} lists or mappings in one another"),  # it ended the process
        ("{a: " * 5000, f"more than {DEEPEST} lists or mappings in one another"),
        ("- " * 5000, "not YAML: "),
        ("!!python/object:os.system x", "not YAML: could not determine a constructor"),
    ],
)
@pytest.mark.parametrize("libyaml", [True, False])
def test_a_value_that_cannot_be_made_is_one_line_with_its_place(value, told, libyaml, monkeypatch):
    if libyaml and not yaml.__with_libyaml__:
        pytest.skip("PyYAML without libyaml")
    monkeypatch.setattr(yaml, "__with_libyaml__", libyaml)
    with pytest.raises(AbraceError) as caught:
        parse_yaml(f"name: rig\nkey: {value}", "rig file x.yaml")
    assert str(caught.value).startswith(f"rig file x.yaml: line 2: {told}")
    assert "\n" not in str(caught.value)


def test_lists_that_stand_on_lines_of_their_own_may_not_be_too_deep_either():
    with pytest.raises(AbraceError, match=rf"x: line {DEEPEST + 1}: more than {DEEPEST} lists"):
        parse_yaml("\n".join(" " * i + f"k{i}:" for i in range(5000)), "x")
    assert parse_yaml("[" * DEEPEST + "]" * DEEPEST, "x")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"a": 1,\n "b": }', "line 2: not JSON: column 7: Expecting value"),
        ("[" * 100_000, "not JSON: too many brackets in one another"),
        ("", "line 1: not JSON: column 1: Expecting value"),
    ],
)
def test_what_is_no_json_is_one_line(tmp_path, text, told):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(AbraceError) as caught:
        read_json(tmp_path / "model.json", "model")
    assert str(caught.value) == f"model file {tmp_path}/model.json: {told}"


def test_a_file_that_is_no_text_is_told_with_its_line(tmp_path):
    (tmp_path / "model.json").write_bytes(b'{\n"name": "\xff"}')
    with pytest.raises(AbraceError, match=r"model\.json: line 2: not JSON: a character that is not UTF-8"):
        read_json(tmp_path / "model.json", "model")


def test_a_whole_number_of_any_length_is_read(tmp_path):
    (tmp_path / "x.json").write_text(f"[12, 1{'0' * 30}, -1{'0' * 400}, 1{'0' * 5000}]")
    assert read_json(tmp_path / "x.json", "some") == [12, 1e30, -float("inf"), float("inf")]
