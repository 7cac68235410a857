# SPDX-License-Identifier: Apache-2.0
"""Libyaml's parser is quick, PyYAML's own says what is wrong: people must not notice which one has read their file."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml

from abrace_core import yaml_text
from abrace_core.errors import AbraceError
from abrace_core.yaml_text import parse_yaml

FILES = sorted((Path(__file__).parents[2] / "src").rglob("*.yaml"))
TYPED = (
    *("\t", "\n", " ", ": ", ":", "- ", "[", "]", "{", "}", ",", "#", "'", '"', "&a", "*a", "!", "|", ">", "%", "@"),
    *("`", "?", "? ", "---\n", "...\n", "\u0085", "\u2028", "\ufeff", "ä", "😀", "\x00", "\r", "~", "<<: ", "010"),
    *("1e5", "1:30", "0x1F", "null", "\t- ", "a: b: c", "key:\tvalue", "\n\tkey: 1\n"),
)
"""What a hand may type in a wrong place."""
MISTYPED = 1500


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
    monkeypatch.setattr(yaml_text, "_Loader", None)
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
