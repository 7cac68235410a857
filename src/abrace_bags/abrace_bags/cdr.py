# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays: the layout of a serialised message, and its decoding for many messages at once.

A message is serialised as little-endian CDR (XCDR1): the encapsulation header of four bytes, then the fields in order,
each number aligned to its own size counted from the end of that header. Only the lengths of strings and sequences move
what follows them, so one walk through one message gives the offset of every number in all messages of the same lengths.
They are decoded together; messages of other lengths are walked and decoded in their turn.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from abrace_bags.definitions import NUMBERS
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from abrace_bags.definitions import MessageType

_HEADER_SIZE = 4
_MOST_UNDECODABLE = 100
_PADDED_SIZE = 1 << 28
"""Bytes of texts, each as long as the longest, above which they become objects."""


@dataclass(frozen=True)
class _Leaf:
    """A number, an array of numbers or a string in a message, and its offset; a count of None is a single value."""

    offset: int
    format: str
    count: int | None = None
    kind: str = "number"


_Column: TypeAlias = "_Leaf | list[_Column]"


@dataclass
class _Layout:
    """Where everything is in a message, and the numbers (offset, format, value) by which messages have this layout."""

    columns: dict[str, _Column] = field(default_factory=dict)
    signature: list[tuple[int, str, int]] = field(default_factory=list)


def decode(message_type: MessageType, payloads: Sequence[tuple[NDArray[np.int64], NDArray[np.void]]]) -> dict[str, Any]:
    """Decode messages to one array a field.

    Parameters
    ----------
    message_type
        What they are.
    payloads
        For each length that occurs: the numbers of its messages, counted from 0 over all, and their bytes.

    Returns
    -------
    dict
        By field, nested names joined by dots: (messages, ...) arrays of numbers or of str; an array of objects, one a
        message, where their shapes differ, and of str where the longest of many is very long.

    Raises
    ------
    AbraceError
        If a message is not little-endian CDR, or does not fit the definition.
    """
    count = sum(len(numbers) for numbers, _ in payloads)
    groups = [
        (numbers[chosen], {path: _values(column, records) for path, column in layout.columns.items()})
        for numbers, block in payloads
        for chosen, records, layout in _by_layout(message_type, numbers, block)
    ]
    if not groups:
        return {path: np.empty(0) for path in _paths(message_type, message_type.name)}
    return {path: _joined(count, [(numbers, group[path]) for numbers, group in groups]) for path in groups[0][1]}


def undecodable(
    message_type: MessageType, payloads: Sequence[tuple[NDArray[np.int64], NDArray[np.void]]]
) -> NDArray[np.int64]:
    """Numbers of the messages that `decode` refuses, found by bisection.

    Parameters
    ----------
    message_type, payloads
        As for `decode`.

    Raises
    ------
    AbraceError
        If there are many: the definition is another type's then.
    """
    refused: list[int] = []

    def search(numbers: NDArray[np.int64], block: NDArray[np.void]) -> None:
        try:
            decode(message_type, [(np.arange(len(block)), block)])
        except AbraceError:
            if len(refused) == _MOST_UNDECODABLE:
                raise
            if len(block) == 1:
                refused.append(int(numbers[0]))
                return
            half = len(block) // 2
            search(numbers[:half], block[:half])
            search(numbers[half:], block[half:])

    for numbers, block in payloads:
        search(numbers, block)
    return np.array(refused, np.int64)


def _by_layout(
    message_type: MessageType, numbers: NDArray[np.int64], block: NDArray[np.void]
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.void], _Layout]]:
    """Groups of messages of one layout: which of the block, their records, the layout."""
    remaining = np.arange(len(block))
    while remaining.size:
        try:
            layout = _Walk(message_type, block[0].tobytes()).layout
        except AbraceError as error:
            raise AbraceError(f"message {numbers[remaining[0]]}: {error}") from error
        leaves = list(_leaves(layout.columns.values()))
        names = [f"signature {offset}" for offset, _, _ in layout.signature] + [str(leaf.offset) for leaf in leaves]
        formats: list[Any] = [form for _, form, _ in layout.signature]
        formats += [leaf.format if leaf.count is None else (leaf.format, (leaf.count,)) for leaf in leaves]
        offsets = [offset for offset, _, _ in layout.signature] + [leaf.offset for leaf in leaves]
        row = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": block.dtype.itemsize})
        records = block.view(row)
        same = np.ones(len(block), bool)
        for offset, _, value in layout.signature:
            same &= records[f"signature {offset}"] == value
        if same.all():
            yield remaining, records, layout
            return
        yield remaining[same], records[same], layout
        remaining, block = remaining[~same], block[~same]


def _leaves(columns: Any) -> Iterator[_Leaf]:
    for column in columns:
        if isinstance(column, list):
            yield from _leaves(column)
        elif column.count != 0:
            yield column


def _values(column: _Column, records: NDArray[np.void]) -> NDArray[Any]:
    """(messages, ...) values of a column."""
    messages = len(records)
    if isinstance(column, list):
        parts = [_values(part, records) for part in column]
        if not parts:
            return np.empty((messages, 0))
        if len({part.shape for part in parts}) == 1:
            return np.stack(parts, axis=1)
        ragged = np.empty((messages, len(parts)), dtype=object)
        for j, part in enumerate(parts):
            for i in range(messages):
                ragged[i, j] = part[i]
        return ragged
    if column.count == 0:
        return np.full(messages, "") if column.kind == "string" else np.empty((messages, 0), column.format)
    values = np.ascontiguousarray(records[str(column.offset)])
    if column.kind == "bool":
        return values != 0
    if column.kind == "string":
        distinct, which = (values[:1], None) if (values == values[0]).all() else np.unique(values, return_inverse=True)
        try:
            texts = np.array([text.decode() for text in distinct.tolist()])
        except UnicodeDecodeError as error:
            raise AbraceError(f"a string of the message is not UTF-8 ({error.reason})") from error
        return np.repeat(texts, messages) if which is None else texts[which]
    return values


def _joined(count: int, groups: list[tuple[NDArray[np.int64], NDArray[Any]]]) -> NDArray[Any]:
    """Values of all messages in their order, from those of each group."""
    if len(groups) == 1 and len(groups[0][0]) == count:
        return groups[0][1]
    joined: NDArray[Any]
    if len({values.shape[1:] for _, values in groups}) == 1:
        shape, dtype = (count, *groups[0][1].shape[1:]), np.result_type(*(values for _, values in groups))
        if dtype.kind == "U" and math.prod(shape) * dtype.itemsize > _PADDED_SIZE:
            dtype = np.dtype(object)
        joined = np.empty(shape, dtype)
        for numbers, values in groups:
            joined[numbers] = values
        return joined
    joined = np.empty(count, dtype=object)
    for numbers, values in groups:
        for number, value in zip(numbers, values, strict=True):
            joined[number] = value
    return joined


def _paths(message_type: MessageType, type_name: str, prefix: str = "") -> list[str]:
    """Names of the values of a message type."""
    paths = []
    for member in message_type.fields[type_name]:
        nested = member.type_name in message_type.fields
        paths += _paths(message_type, member.type_name, f"{prefix}{member.name}.") if nested else [prefix + member.name]
    return paths


class _Walk:
    """Goes through one message, field by field, for its layout."""

    def __init__(self, message_type: MessageType, payload: bytes) -> None:
        self._type = message_type
        self._payload = payload
        self._offset = _HEADER_SIZE
        self.layout = _Layout()
        if payload[:2] != b"\x00\x01":
            raise AbraceError(f"begins with {payload[:2].hex(' ')}, expected 00 01 (little-endian CDR)")
        self.layout.signature.append((0, ">u2", 1))
        self.layout.columns.update(self._message(message_type.name))
        # Fast DDS reserves up to 8 bytes for an empty sequence that it doesn't write, and pads the end to 4 bytes
        spare = 3 + 8 * sum(form == "<u4" and value == 0 for _, form, value in self.layout.signature)
        if not 0 <= len(payload) - self._offset <= spare:
            raise AbraceError(
                f"has {len(payload)} bytes, expected {self._offset} by the definition of {message_type.name}"
            )

    def _message(self, type_name: str) -> dict[str, _Column]:
        columns: dict[str, _Column] = {}
        fields = self._type.fields[type_name]
        if not fields:  # ROS gives an empty message one unused byte
            self._advance(1)
        for member in fields:
            count = self._length() if member.count == 0 else member.count
            if member.type_name in NUMBERS:
                columns[member.name] = self._numbers(member.type_name, count)
            elif member.type_name == "string":
                columns[member.name] = self._string() if count is None else [self._string() for _ in range(count)]
            elif count is None:
                nested = self._message(member.type_name)
                columns.update({f"{member.name}.{path}": column for path, column in nested.items()})
            else:
                elements = [self._message(member.type_name) for _ in range(count)]
                for path in _paths(self._type, member.type_name):
                    columns[f"{member.name}.{path}"] = [element[path] for element in elements]
        return columns

    def _numbers(self, type_name: str, count: int | None) -> _Leaf:
        form = NUMBERS[type_name]
        kind = "bool" if type_name == "bool" else "number"
        if count == 0:
            return _Leaf(self._offset, "?" if kind == "bool" else form, 0)
        size = int(form[-1])
        self._align(size)
        leaf = _Leaf(self._offset, form, count, kind)
        self._advance(size * (1 if count is None else count))
        return leaf

    def _string(self) -> _Leaf:
        length = self._length()
        leaf = _Leaf(self._offset, f"S{length}", None if length else 0, "string")
        self._advance(length)
        if length:
            if self._payload[self._offset - 1] != 0:
                raise AbraceError(f"the string at byte {leaf.offset} does not end with a zero after {length} bytes")
            self.layout.signature.append((self._offset - 1, "u1", 0))
        return leaf

    def _length(self) -> int:
        self._align(4)
        offset = self._offset
        self._advance(4)
        (value,) = struct.unpack_from("<I", self._payload, offset)
        self.layout.signature.append((offset, "<u4", value))
        return int(value)

    def _align(self, size: int) -> None:
        self._offset += (_HEADER_SIZE - self._offset) % size

    def _advance(self, size: int) -> None:
        self._offset += size
        if self._offset > len(self._payload):
            raise AbraceError(f"has {len(self._payload)} bytes, too few for the definition of {self._type.name}")
