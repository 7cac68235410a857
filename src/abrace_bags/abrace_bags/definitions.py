# SPDX-License-Identifier: Apache-2.0
"""Message definitions: the .msg texts that bags carry, found for installed types and parsed to fields."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

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

_LINE = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?P<bound><=\d+)?(?P<array>\[(?P<sequence><=\d+)?(?P<count>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)
_TYPE_NAME = re.compile(r"([a-z]\w*)/msg/([A-Z]\w*)")
_FEEDBACK = re.compile(r"([a-z]\w*)/action/([A-Z]\w*)_FeedbackMessage")
_ACTION_PARTS = re.compile(r"^---\s*$", re.MULTILINE)
_SEPARATOR = "=" * 80
_NESTED = re.compile(rf"^{_SEPARATOR}\s*^MSG: *(\S+) *$", re.MULTILINE)


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
        own_name = f"{match[1]}/{match[2]}"
        own_file = _installed_file(match[1], f"msg/{match[2]}.msg")
        texts = {own_name: _read(own_file)}
    elif match := _FEEDBACK.fullmatch(type_name):
        own_name, feedback = type_name, f"{match[1]}/action/{match[2]}_Feedback"
        own_file = _installed_file(match[1], f"action/{match[2]}.action")
        # goal, result, feedback; what a message of the feedback's topic has in addition is the same for all actions
        texts = {feedback: _ACTION_PARTS.split(_read(own_file))[-1].lstrip("\n")}
        texts = {own_name: f"unique_identifier_msgs/UUID goal_id\n{feedback} feedback\n", **texts}
    else:
        raise AbraceError(f"message type {type_name!r}: expected package/msg/Type")
    to_read = list(texts)
    while to_read:
        name, file = to_read.pop(0), own_file
        if name not in texts:
            package, _, short_name = name.partition("/")
            file = _installed_file(package, f"msg/{short_name}.msg")
            texts[name] = _read(file)
        try:
            to_read += [other for other in referred_types(name, parse_fields(texts[name])) if other not in texts]
        except AbraceError as error:
            raise AbraceError(f"{file}: {error}") from error
    parts = [texts.pop(own_name)]
    parts += [f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in texts.items()]
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


@dataclass(frozen=True)
class MessageField:
    """One field of a message: its name, the type of its elements, and how many there are.

    Parameters
    ----------
    name
        As in the .msg text.
    type_name
        A number's type, `string`, or the type of a nested message as it is written there.
    count
        None for one value, 0 for a sequence, otherwise the length of the array.
    """

    name: str
    type_name: str
    count: int | None


@dataclass(frozen=True)
class MessageType:
    """A message type with those that it uses: all that decoding needs.

    Parameters
    ----------
    name
        As `package/Type`.
    fields
        Of each type, by `package/Type`.
    """

    name: str
    fields: Mapping[str, tuple[MessageField, ...]]


def parse_fields(text: str) -> tuple[MessageField, ...]:
    r"""Fields of one .msg text; comments, constants and default values are left out.

    >>> parse_fields("int8 LIMIT=3  # a constant\nfloat64[] force  # N")
    (MessageField(name='force', type_name='float64', count=0),)
    """
    fields = []
    for number, line in enumerate(text.splitlines(), start=1):
        code = line.partition("#")[0].strip()
        if not code:
            continue
        match = _LINE.fullmatch(code)
        if match is None:
            raise AbraceError(f"message definition, line {number}: {code!r}, expected a type and a name")
        if match["rest"].startswith("="):
            continue
        type_name = match["type"]
        if type_name == "wstring":
            raise AbraceError(f"message definition, line {number}: wstring fields are not supported, expected string")
        count = None if match["array"] is None else int(match["count"] or 0)
        fields.append(MessageField(match["name"], type_name, count))
    return tuple(fields)


def parse_message_type(type_name: str, text: str) -> MessageType:
    """A message type from its definition text, as bags carry it.

    Parameters
    ----------
    type_name
        As `package/msg/Type`.
    text
        The .msg text with those of the types that it uses (`MessageDefinition.text`).

    Raises
    ------
    AbraceError
        If a line is not a field, a type is missing, or a type contains itself.
    """
    name = type_name.replace("/msg/", "/")
    own, *others = _NESTED.split(text)
    texts = dict(zip((other.replace("/msg/", "/") for other in others[::2]), others[1::2], strict=True))
    texts[name] = own
    fields: dict[str, tuple[MessageField, ...]] = {}

    def resolve(name: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise AbraceError(f"message definition of {type_name}: {name} contains itself")
        if name in fields:
            return
        if name not in texts:
            raise AbraceError(f"message definition of {type_name}: the definition of {name} is missing")
        parsed = parse_fields(texts[name])
        referred = referred_types(name, parsed)
        full_names = iter(referred)
        fields[name] = tuple(
            field if is_plain(field) else replace(field, type_name=next(full_names)) for field in parsed
        )
        for other in referred:
            resolve(other, (*above, name))

    resolve(name, ())
    return MessageType(name, fields)


def is_same_type(one: tuple[str, str], other: tuple[str, str]) -> bool:
    """Whether `one` and `other` definition (a type's name, its text) have the same fields; comments may differ."""
    try:
        return one == other or parse_message_type(*one) == parse_message_type(*other)
    except AbraceError:
        return False


def referred_types(name: str, fields: Sequence[MessageField]) -> list[str]:
    """Message types that these fields of type `name` (`package/Type`) use, as `package/Type`, in order."""
    types = []
    for field in fields:
        if is_plain(field):
            continue
        other = field.type_name.replace("/msg/", "/")
        if other == "Header":
            other = "std_msgs/Header"
        types.append(other if "/" in other else f"{name.partition('/')[0]}/{other}")
    return types


def is_plain(field: MessageField) -> bool:
    """Whether a `field` holds numbers or strings, not messages."""
    return field.type_name in NUMBERS or field.type_name == "string"
