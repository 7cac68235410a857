# SPDX-License-Identifier: Apache-2.0
"""YAML files that people write, with readable errors. Launch files use it: only PyYAML and the standard library."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from abrace_core.errors import AbraceError

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
_NOT_DECIMAL = ", expected a number without leading zeros and colons, or a text in quotes"
_USUAL = re.compile(r"-?\d+\.\d+(e[-+]\d+)?$")
"""The reals of most files."""
_REAL_WITHOUT_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")


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
                        message = f"key {key.value!r} appears twice"
                        raise yaml.constructor.ConstructorError(None, None, message, key.start_mark)
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
            raise yaml.constructor.ConstructorError(None, None, f"{text}{_NOT_DECIMAL}", node.start_mark)


_Rules.add_constructor("tag:yaml.org,2002:int", _Rules.construct_yaml_int)  # type: ignore[type-var]
_Rules.add_constructor("tag:yaml.org,2002:float", _Rules.construct_yaml_float)  # type: ignore[type-var]
_Rules.add_implicit_resolver("tag:yaml.org,2002:float", _REAL_WITHOUT_POINT, list("-+.0123456789"))


class _Loader(_Rules, yaml.SafeLoader):
    """PyYAML's own parser, by whose errors it is found what is wrong in a file."""


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
    try:
        return parse_yaml(Path(path).read_text(encoding="utf-8"), where)
    except OSError as error:
        raise AbraceError(
            f"{where}: {'a folder, expected a file' if isinstance(error, IsADirectoryError) else error.strerror}"
        ) from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise AbraceError(f"{where}: line {line}: not YAML: a character that is not UTF-8, expected UTF-8") from error


def parse_yaml(text: str, where: str) -> Any:
    """The content of a YAML `text`; an AbraceError says what is wrong in which line of `where`."""
    if yaml.__with_libyaml__ and not _TAKEN_OTHERWISE.search(text):
        with contextlib.suppress(yaml.YAMLError, UnicodeEncodeError):
            return yaml.load(text, _QuickLoader)  # a safe loader
    try:
        return yaml.load(text, _Loader)  # a safe loader
    except yaml.MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or ""
        line = f": line {mark.line + 1}" if mark else ""
        if "appears twice" in problem:
            raise AbraceError(f"{where}{line}: {problem}, expected once") from error
        if problem.endswith(_NOT_DECIMAL):
            raise AbraceError(f"{where}{line}: {problem}") from error
        words = next((words for pattern, words in _IN_WORDS if re.search(pattern, problem)), f"{problem}")
        raise AbraceError(f"{where}{line}: not YAML: {words}") from error
    except yaml.YAMLError as error:
        raise AbraceError(f"{where}: not YAML: a character that YAML does not allow, expected a text file") from error
