# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON files that people write or change, with readable errors: what is wrong, in which line.

Launch files use it: only PyYAML and the standard library.
"""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError, SafeConstructor
from yaml.resolver import Resolver

from abrace_core import AbraceError

DEEPEST = 50
"""Levels of lists and mappings in one another. PyYAML's composers recurse; libyaml's does so until the process ends."""

LONGEST = 40
"""Characters of a wrong value that are shown."""

_IN_WORDS = (
    (r"'\\t'", "a tab, expected spaces"),
    (r"mapping values are not allowed", "a second colon, or a line indented too far, expected `key: value`"),
    (r"expected <block end>", "a line that is indented otherwise than the one before, expected the same or two more"),
    (r"could not find expected ':'", "a line without a colon, expected `key: value`"),
    (r"expected ',' or '[\]}]'", "a bracket that is not closed, or a comma that is missing"),
    (r"end of stream|the stream end|<stream end>", "a quotation mark or bracket that is not closed"),
    (r"found undefined alias|expected alphabetic|anchor", "a text that begins with * or &, expected it in quotes"),
    (r"found character .* that cannot start", "a text that begins with @, ` or %, expected it in quotes"),
    (r"expected a single document", "a line of three dashes, expected one document"),
    (r"found unhashable key|expected a mapping", "a key that is a list or mapping, expected a text"),
)
_KINDS = {"int": "a whole number", "float": "a number", "bool": "true or false", "timestamp": "a date of the calendar"}
_USUAL = re.compile(r"-?\d+\.\d+(e[-+]\d+)?$")
"""The reals of most files."""
_REAL_WITHOUT_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")


class _RefusedError(ConstructorError):
    """Right YAML that is refused here, or a value that PyYAML cannot make: the message says what was expected."""

    def __init__(self, message: str, mark: Any) -> None:
        super().__init__(None, None, message, mark)


class _Rules(SafeConstructor, Resolver):
    """YAML in which a number is what it looks like, and a duplicate key an error.

    In YAML 1.1 the last key wins, 1e-3 is a text, 010 is 8 and 1:30 is 90; the latter two are refused here.
    """

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        if "unique" not in vars(node):  # merged into others (<<) it comes again, perhaps with keys of its own merges
            known: set[tuple[str, str]] = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode):
                    if (key.tag, key.value) in known:
                        raise _RefusedError(f"key {key.value!r} appears twice, expected once", key.start_mark)
                    known.add((key.tag, key.value))
            vars(node)["unique"] = True
        super().flatten_mapping(node)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        self._expect_decimal(node)
        return super().construct_yaml_int(node)

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        if _USUAL.match(node.value):
            return float(node.value)
        self._expect_decimal(node)
        return super().construct_yaml_float(node)

    def _expect_decimal(self, node: yaml.ScalarNode) -> None:
        text = str(node.value)
        if ":" in text or re.fullmatch(r"[-+]?0[0-9_]+", text):
            expected = "a number without leading zeros and colons, or a text in quotes"
            raise _RefusedError(f"{text}, expected {expected}", node.start_mark)


_Rules.add_constructor("tag:yaml.org,2002:int", _Rules.construct_yaml_int)  # type: ignore[type-var]
_Rules.add_constructor("tag:yaml.org,2002:float", _Rules.construct_yaml_float)  # type: ignore[type-var]
_Rules.add_implicit_resolver("tag:yaml.org,2002:float", _REAL_WITHOUT_POINT, list("-+.0123456789"))


class _Loader(_Rules, yaml.SafeLoader):
    """PyYAML's own parser, by whose errors it is found what is wrong in a file."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, KeyError, AttributeError) as error:  # of PyYAML, for `2024-02-30`, `0b_`, `!!bool maybe`
            kind = _KINDS.get(node.tag.rpartition(":")[2], f"a value of {node.tag}")
            text = str(node.value)
            shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
            raise _RefusedError(f"{shown}, expected {kind}, or a text in quotes", node.start_mark) from error


if yaml.__with_libyaml__:
    _TAKEN_OTHERWISE = re.compile(r"[\t!?|>\ufeff]")
    """In texts with these libyaml sees other things than PyYAML's own parser, or takes for right what that refuses."""

    class _QuickLoader(_Rules, yaml.CSafeLoader):
        """Libyaml's parser, ten times as quick: a running controller reads its next file beside its loop."""


def read_yaml(path: Path | str, kind: str) -> Any:
    """The content of a YAML file, which errors call a `kind`, such as "rig".

    Raises
    ------
    AbraceError
        If there is no such file, or it is no YAML: in which line, and what is wrong there.
    """
    where = f"{kind} file {path}"
    return parse_yaml(read_text(path, where, "YAML"), where)


def read_json(path: Path | str, kind: str) -> Any:
    """The content of a JSON file, which errors call a `kind`, such as "model".

    A whole number that no float can hold is infinite, whatever its length.

    Raises
    ------
    AbraceError
        If there is no such file, or it is no JSON: in which line and column.
    """
    where = f"{kind} file {path}"
    try:
        return json.loads(read_text(path, where, "JSON"), parse_int=_whole)
    except json.JSONDecodeError as error:
        raise AbraceError(f"{where}: line {error.lineno}: not JSON: column {error.colno}: {error.msg}") from error
    except RecursionError as error:
        raise AbraceError(f"{where}: not JSON: too many brackets in one another") from error


def _whole(text: str) -> int | float:
    return int(text) if len(text) < 20 else float(text)


def read_text(path: Path | str, where: str, form: str) -> str:
    """The content of a text file in UTF-8; an AbraceError begins with `where` and calls the file's `form`, as YAML."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        what = "a folder, expected a file" if isinstance(error, IsADirectoryError) else error.strerror
        raise AbraceError(f"{where}: {what}") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise AbraceError(f"{where}: line {line}: not {form}: a character that is not UTF-8, expected UTF-8") from error


def parse_yaml(text: str, where: str) -> Any:
    """The content of a YAML `text`; an AbraceError says what is wrong in which line of `where`."""
    if yaml.__with_libyaml__ and not _TAKEN_OTHERWISE.search(text):
        with contextlib.suppress(Exception):  # PyYAML's own parser meets it again, and says what it is
            return load_yaml(text, _QuickLoader)
    try:
        return load_yaml(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or ""
        line = f": line {mark.line + 1}" if mark else ""
        if isinstance(error, _RefusedError):
            raise AbraceError(f"{where}{line}: {problem}") from error
        words = next((words for pattern, words in _IN_WORDS if re.search(pattern, problem)), problem)
        raise AbraceError(f"{where}{line}: not YAML: {words}") from error
    except yaml.YAMLError as error:
        raise AbraceError(f"{where}: not YAML: a character that YAML does not allow, expected a text file") from error


def load_yaml(text: str, loader: Any) -> Any:
    """The content of a YAML `text` by a safe `loader` of PyYAML; one that is nested too deeply is a YAMLError."""
    depth = 0
    for event in yaml.parse(text, loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            message = f"more than {DEEPEST} lists or mappings in one another, expected fewer, or a closed bracket"
            raise _RefusedError(message, event.start_mark)
    return yaml.load(text, loader)  # a safe loader
