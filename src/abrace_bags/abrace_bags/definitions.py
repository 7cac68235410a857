# SPDX-License-Identifier: Apache-2.0
"""Message definitions: the texts that bags carry, found for installed types, and parsed to fields by `rosbags`."""

from __future__ import annotations

import functools
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NUMBERS = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
"""Types of numbers and how they are serialised."""
_TYPE_NAME = re.compile(r"([a-z]\w*)/msg/([A-Z]\w*)")
_FEEDBACK = re.compile(r"([a-z]\w*)/action/([A-Z]\w*)_FeedbackMessage")
_ACTION_PARTS = re.compile(r"^---\s*$", re.MULTILINE)
_SEPARATOR = "=" * 80
_MOST_VALUES = 20_000
"""Values of a message; types in one another can have 2^26 with a text of a few lines."""


@dataclass(frozen=True)
class MessageDefinition:
    """What a reader needs to decode a message type.

    Parameters
    ----------
    type_name
        As `std_msgs/msg/Header`.
    text
        The .msg text, then those of the types that it uses, each below a line of 80 `=` and one of `MSG: package/Type`.
    type_hash
        RIHS01 hash of the type.
    """

    type_name: str
    text: str
    type_hash: str


@dataclass(frozen=True)
class MessageType:
    """A message type with those that it uses: all that decoding needs.

    Parameters
    ----------
    name
        As `package/msg/Type`.
    fields
        Of each type, by such a name: names of the fields with their types, as `rosbags.typesys` describes them.
    """

    name: str
    fields: Mapping[str, Sequence[tuple[str, Any]]]

    def names(self, type_name: str, prefix: str = "") -> list[str]:
        """Names of the values of the type `type_name`, after the `prefix`; those of nested messages joined by dots."""
        found = []
        for name, (kind, detail) in self.fields[type_name]:
            one = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
            nested = one[0] is Nodetype.NAME
            found += self.names(one[1], f"{prefix}{name}.") if nested else [prefix + name]
        return found


def message_definition(type_name: str) -> MessageDefinition:
    """Definition of an installed message type, found under the folders of AMENT_PREFIX_PATH.

    Parameters
    ----------
    type_name
        As `abrace_interfaces/msg/Response`, or that of an action's feedback:
        `abrace_interfaces/action/PlayGroundMotion_FeedbackMessage`.

    Raises
    ------
    AbraceError
        If the name is not a message type's, or the type or one that it uses is not installed.
    """
    if match := _TYPE_NAME.fullmatch(type_name):
        own_file = _installed_file(match[1], f"msg/{match[2]}.msg")
        texts = {type_name: _read(own_file)}
    elif match := _FEEDBACK.fullmatch(type_name):
        feedback = f"{match[1]}/action/{match[2]}_Feedback"
        own_file = _installed_file(match[1], f"action/{match[2]}.action")
        # goal, result, feedback; what a message of the feedback's topic has in addition is the same for all actions
        texts = {feedback: _ACTION_PARTS.split(_read(own_file))[-1].lstrip("\n")}
        texts = {type_name: f"unique_identifier_msgs/UUID goal_id\n{feedback} feedback\n", **texts}
    else:
        raise AbraceError(f"message type {type_name!r}: expected package/msg/Type")
    to_read = list(texts)
    while to_read:
        name, file = to_read.pop(0), own_file
        if name not in texts:
            package, _, short_name = name.split("/")
            file = _installed_file(package, f"msg/{short_name}.msg")
            texts[name] = _read(file)
        try:
            to_read += [other for other in _used(_parsed(name, texts[name])[name]) if other not in texts]
        except AbraceError as error:
            raise AbraceError(f"{file}: {error}") from error
    parts = [texts.pop(type_name)]
    parts += [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()]
    text = "\n".join(part if part.endswith("\n") else f"{part}\n" for part in parts)
    return MessageDefinition(type_name, text, _type_hash(type_name, own_file.with_suffix(".json")))


def _installed_file(package: str, file: str) -> Path:
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for prefix in prefixes:
        path = Path(prefix) / "share" / package / file
        if path.is_file():
            return path
    where = f"the {len(prefixes)} folders of AMENT_PREFIX_PATH" if prefixes else "AMENT_PREFIX_PATH, which is empty"
    name = f"{package}/{Path(file).stem}"
    raise AbraceError(f"message type {name} is not installed: no share/{package}/{file} in {where}")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise AbraceError(f"{path}: not UTF-8 text") from error


def _type_hash(type_name: str, path: Path) -> str:
    try:
        hashes = {entry["type_name"]: str(entry["hash_string"]) for entry in json.loads(_read(path))["type_hashes"]}
        return hashes[type_name]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise AbraceError(f"{path}: expected `type_hashes` with an entry for {type_name}") from error


@functools.lru_cache(maxsize=256)
def parse_message_type(type_name: str, text: str, encoding: str = "ros2msg") -> MessageType:
    """A message type from its definition text, as bags carry it.

    Parameters
    ----------
    type_name
        As `package/msg/Type`.
    text
        The definition with those of the types that it uses (`MessageDefinition.text`).
    encoding
        `ros2msg` or `ros2idl`: how the text is written.

    Raises
    ------
    AbraceError
        If the text is neither, a line is not a field, a type is missing, can't be decoded or contains itself.
    """
    own = type_name if type_name.count("/") > 1 else type_name.replace("/", "/msg/")
    types = _parsed(own, text, encoding)
    fields: dict[str, Sequence[tuple[str, Any]]] = {}

    sizes: dict[str, int] = {}

    def values(name: str, above: tuple[str, ...]) -> int:
        """How many values a message of this type has, an array of numbers and a sequence counted as one."""
        if name in above:
            raise AbraceError(f"message definition of {type_name}: {name} contains itself")
        if name not in types:
            raise AbraceError(f"message definition of {type_name}: the definition of {name} is missing")
        if name not in sizes:
            fields[name] = types[name]
            of_types = {other: values(other, (*above, name)) for other in _used(types[name])}
            sizes[name] = 0
            for _, (kind, detail) in types[name]:
                one = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
                count = detail[1] if kind is Nodetype.ARRAY and one[1][0] not in NUMBERS else 1
                sizes[name] += count * of_types.get(one[1], 1)
        return sizes[name]

    if values(own, ()) > _MOST_VALUES:
        raise AbraceError(f"message definition of {type_name}: {sizes[own]} values, expected at most {_MOST_VALUES}")
    return MessageType(own, fields)


def is_same_type(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether `one` and `other` have the same fields: type name, text, encoding; comments may differ."""
    try:
        return one == other or parse_message_type(*one) == parse_message_type(*other)
    except AbraceError:
        return False


def _parsed(type_name: str, text: str, encoding: str = "ros2msg") -> dict[str, Sequence[tuple[str, Any]]]:
    """The fields of a type and of those that its definition brings along, by their names."""
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    # without comments, which are most of a text, it is parsed in a fraction of the time
    lines = [line.partition("#")[0].rstrip() for line in text.splitlines()]
    try:
        if encoding == "ros2idl":
            parsed = get_types_from_idl(text)
        elif "---" in lines:
            raise AbraceError(f"message definition of {type_name}: is that of a service or an action, not of a message")
        elif encoding == "ros2msg":
            parsed = get_types_from_msg("\n".join(filter(None, lines)), type_name)
        elif not encoding:
            raise AbraceError(f"the definition of {type_name} is not in the bag, and the type is not installed")
        else:
            raise AbraceError(f"message definition of {type_name}: is written as {encoding!r}, expected 'ros2msg'")
    except TypesysError as error:
        for number, line in enumerate(lines, start=1):
            try:
                get_types_from_msg("" if line == _SEPARATOR or line.startswith("MSG: ") else line, type_name)
            except TypesysError:
                raise AbraceError(f"message definition, line {number}: {line!r}, expected a type and a name") from error
        raise AbraceError(f"message definition of {type_name}: {' '.join(str(error).split())[:200]}") from error
    return {name: fields for name, (_, fields) in parsed.items()}


def _used(fields: Sequence[tuple[str, Any]]) -> list[str]:
    """Message types that `fields` use, in order."""
    types = []
    for name, (kind, detail) in fields:
        one = detail[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, detail)
        if (one[0] is Nodetype.NAME and one[1].endswith("/wstring")) or one[1][0] == "wstring":
            raise AbraceError(f"field {name} is a wstring, which is not supported, expected string")
        if one[0] is Nodetype.NAME:
            types.append(one[1])
        elif one[1][0] not in NUMBERS and one[1][0] != "string":
            raise AbraceError(f"field {name} is a {one[1][0]}, which is not supported")
    return types
