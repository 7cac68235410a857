"""Message definitions: the .msg texts that bags carry, as fields."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
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
_SEPARATOR = re.compile(r"^={80}\s*^MSG: *(\S+) *$", re.MULTILINE)


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
    r"""Fields of one .msg text; comments, constants and default values are passed over.

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
        The .msg text with those of the types that it uses (`definitions.MessageDefinition`).

    Raises
    ------
    AbraceError
        If a line is not a field, a type is missing, or a type contains itself.
    """
    name = type_name.replace("/msg/", "/")
    own, *others = _SEPARATOR.split(text)
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
        found = parse_fields(texts[name])
        referred = referred_types(name, found)
        full_names = iter(referred)
        fields[name] = tuple(one if is_plain(one) else replace(one, type_name=next(full_names)) for one in found)
        for other in referred:
            resolve(other, (*above, name))

    resolve(name, ())
    return MessageType(name, fields)


def is_same_type(one: tuple[str, str], other: tuple[str, str]) -> bool:
    """Whether two definitions, each a type's name and its text, have the same fields; comments may differ."""
    try:
        return one == other or parse_message_type(*one) == parse_message_type(*other)
    except AbraceError:
        return False


def referred_types(name: str, fields: Sequence[MessageField]) -> list[str]:
    """Message types that these fields of type `name` (`package/Type`) use, as `package/Type`, in order."""
    types = []
    for one in fields:
        if is_plain(one):
            continue
        other = one.type_name.replace("/msg/", "/")
        if other == "Header":
            other = "std_msgs/Header"
        types.append(other if "/" in other else f"{name.partition('/')[0]}/{other}")
    return types


def is_plain(one: MessageField) -> bool:
    """Whether a field holds numbers or strings, not messages."""
    return one.type_name in NUMBERS or one.type_name == "string"
