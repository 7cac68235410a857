# SPDX-License-Identifier: Apache-2.0
"""The control loop's three messages as serialised (CDR, little endian), each packed and unpacked in one step.

rclpy builds a Python object for each message and each message in it: 10 to 16 microseconds a message, which, apart from
DDS, is most of the time of a lockstep sample. The loop's nodes receive and publish these bytes instead; to other nodes
they are ordinary messages. Tests compare every layout with rclpy's own serialisation.

Layout (XCDR1): 4 bytes of encapsulation; then, with alignment counted from there, the header (int32 sec, uint32
nanosec, string frame_id), and the fields of Response, BraceCommand or geometry_msgs/AccelStamped.
"""

from __future__ import annotations

import struct
from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_HEADER = struct.Struct("<4siII")
SATURATED, RATE_LIMITED, TABLE_LIMITED, STOP_PRESSED, LATE, LOCKSTEP, LAST = (1 << bit for bit in range(7))
"""Flags of Response.msg."""
LONGEST_TEXT = 1000
"""Bytes of a received fault or cause that are kept."""
_BODY = 4
"""Offset from which alignment counts."""


class Header(NamedTuple):
    """Stamp [ns] of a message, and offset of its first 8-byte field."""

    stamp: int
    offset: int


def _aligned(offset: int, size: int) -> int:
    return offset + (_BODY - offset) % size


def read_header(payload: bytes) -> Header:
    """The header of a `payload` of any of the three messages.

    Raises
    ------
    AbraceError
        If the payload is not little-endian CDR, or is truncated.
    """
    if len(payload) < _HEADER.size or payload[:2] != LITTLE_ENDIAN[:2]:
        raise AbraceError("message: expected a stamped message in little-endian CDR")
    _, seconds, nanoseconds, length = _HEADER.unpack_from(payload)
    return Header(seconds * 10**9 + nanoseconds, _aligned(_HEADER.size + length, 8))


def _pack_header(stamp: int, frame_id: str) -> bytes:
    """Encapsulation and header, up to the next 8-byte field."""
    text = frame_id.encode() + b"\0"
    packed = _HEADER.pack(LITTLE_ENDIAN, stamp // 10**9, stamp % 10**9, len(text)) + text
    return packed.ljust(_aligned(len(packed), 8), b"\0")


class _Arrays:
    """Layout of whole numbers, arrays of doubles of known lengths, and single doubles."""

    def __init__(self, offset: int, numbers: struct.Struct, lengths: Sequence[int], singles: int) -> None:
        form, position, self.starts = numbers.format, offset + numbers.size, []
        values = len(numbers.unpack(bytes(numbers.size)))
        for length in lengths:
            form, position = form + "I", position + 4
            padding = (_aligned(position, 8) - position) if length else 0
            form, position = form + f"{padding}x{length}d", position + padding + 8 * length
            self.starts.append(values)
            values += 1 + length
        if singles:
            form += f"{_aligned(position, 8) - position}x{singles}d"
        self.lengths = tuple(lengths)
        self.struct = struct.Struct(form)
        self.offset = offset

    def pack(
        self, numbers: Sequence[int], arrays: Sequence[Sequence[float]], singles: Sequence[float], text: bytes
    ) -> bytes:
        """`numbers`, `arrays` and `singles` in this layout, and a `text` after them."""
        values: list[float] = []
        for array in arrays:
            values.append(len(array))
            values.extend(array)
        return self.struct.pack(*numbers, *values, *singles) + text


def _pack_text(text: str, position: int) -> bytes:
    """A string that comes after `position`."""
    data = text.encode() + b"\0"
    return bytes(_aligned(position, 4) - position) + struct.pack("<I", len(data)) + data


def _unpack_text(payload: bytes, position: int, name: str) -> str:
    """The string after `position`, at most LONGEST_TEXT of it, in one line; raises an AbraceError if there is none."""
    begin = _aligned(position, 4) + 4
    length = int.from_bytes(payload[begin - 4 : begin], "little")
    if not length:
        if len(payload) < begin:
            raise AbraceError(f"{name}: cut off")
        return ""
    if length > len(payload) - begin:
        raise AbraceError(f"{name}: cut off")
    text = payload[begin : begin + min(length - 1, LONGEST_TEXT)].decode(errors="replace")
    # the rig passes it on in every sample, and it is shown on terminals
    return text if text.isprintable() else "".join(one if one.isprintable() else " " for one in text)


class Head(NamedTuple):
    """The fields of a Response other than measurements, with the names and meanings of Response.msg."""

    sequence: int
    run: int
    clipped: int
    flags: int
    state: int


class Responses:
    """Packs and unpacks Response messages; a reader learns the rig's size from the first one."""

    _HEAD = struct.Struct("<QQQIB3x")
    _arrays: _Arrays | None = None
    _text = "", b""
    _counted: tuple[int, ...] = ()
    _spans: Sequence[tuple[int, int]] = ()
    floors = groups = 0

    def pack(
        self,
        stamp: int,
        head: Head,
        cause: str,
        braces: Sequence[int],
        displacement: Sequence[float],
        acceleration: Sequence[float],
        stroke: Sequence[float],
        force: Sequence[float],
        command: Sequence[float],
        ground_acceleration: float,
    ) -> bytes:
        """The message with the fields of Response, SI units; `stamp` [ns].

        `cause`, `braces`, `displacement`, `acceleration`, `stroke`, `force`, `command` and `ground_acceleration` are as
        in Response.msg, `head` has the rest; the arrays' lengths stay those of the first call.
        """
        arrays = (displacement, acceleration, stroke, force, command)
        header = _pack_header(stamp, "table")
        if self._arrays is None:
            self._arrays = _Arrays(len(header), self._numbers(len(braces)), [len(array) for array in arrays], 1)
        if cause != self._text[0] or not self._text[1]:
            self._text = cause, _pack_text(cause, self._arrays.offset + self._arrays.struct.size)
        numbers = (*head, len(braces), *braces)
        return header + self._arrays.pack(numbers, arrays, (ground_acceleration,), self._text[1])

    def unpack(self, payload: bytes) -> tuple[int, Head, tuple[float, ...]]:
        """Stamp [ns], head, and z = [displacement, stroke, acceleration, force] of a `payload`.

        The force is the mean of each group's braces.

        Raises
        ------
        AbraceError
            If it is no Response.
        """
        stamp, offset = read_header(payload)
        arrays = self._arrays
        if arrays is None or arrays.offset != offset or len(payload) < offset + arrays.struct.size:
            arrays = self._learn(payload, offset)
        values = arrays.struct.unpack_from(payload, offset)
        x, a, s, f, u = arrays.starts
        n, m, cells = self.floors, self.groups, arrays.lengths[3]
        known = values[x] == values[a] == n and values[s] == values[u] == m and values[f] == cells
        if not known or values[5:x] != self._counted:
            self._learn(payload, offset)
            return self.unpack(payload)
        z = values[x + 1 : x + 1 + n] + values[s + 1 : s + 1 + m] + values[a + 1 : a + 1 + n]
        force = values[f + 1 : f + 1 + cells]
        if cells != m:
            force = tuple([sum(force[begin:end]) / (end - begin) for begin, end in self._spans])
        return stamp, Head(*values[:5]), z + force

    def cause(self, payload: bytes) -> str:
        """The cause of a fault in a `payload` that has just been unpacked; empty: there is none.

        Raises
        ------
        AbraceError
            If the payload is cut off.
        """
        assert self._arrays is not None
        return _unpack_text(payload, self._arrays.offset + self._arrays.struct.size, "Response")

    def _learn(self, payload: bytes, offset: int) -> _Arrays:
        counts = offset + self._HEAD.size + 4
        groups = int.from_bytes(payload[counts - 4 : counts], "little")
        braces = tuple(payload[counts : counts + groups])
        numbers = self._numbers(len(braces))
        position, lengths = offset + numbers.size, []
        for _ in range(5):
            position = _aligned(position, 4)
            if position + 4 > len(payload):
                raise AbraceError("Response: cut off")
            (length,) = struct.unpack_from("<I", payload, position)
            lengths.append(length)
            position += 4
            if length:
                position = _aligned(position, 8) + 8 * length
        if len(braces) < groups or _aligned(position, 8) + 8 > len(payload):
            raise AbraceError("Response: cut off")
        floors, accelerations, strokes, forces, commands = lengths
        if floors != accelerations or not groups == strokes == commands or forces != sum(braces) or 0 in braces:
            raise AbraceError(
                f"Response: arrays of {lengths}, {groups} groups of {sum(braces)} braces, expected floors, floors, "
                "groups, braces, groups"
            )
        self.floors, self.groups = floors, groups
        ends = list(accumulate(braces))
        self._counted, self._spans = (groups, *braces), list(zip([0, *ends], ends, strict=False))
        self._arrays = _Arrays(offset, numbers, lengths, 1)
        return self._arrays

    @classmethod
    def _numbers(cls, groups: int) -> struct.Struct:
        """Layout of the head and the number of braces in each group, up to the next 4-byte field."""
        return struct.Struct(f"{cls._HEAD.format}I{groups}B{-groups % 4}x")


class BraceCommands:
    """Packs and unpacks BraceCommand messages."""

    _NUMBERS = struct.Struct("<QQ")
    _arrays: _Arrays | None = None
    _text = "", b""

    def pack(self, stamp: int, run: int, sequence: int, force: Sequence[float], fault: str = "") -> bytes:
        """The message with `stamp` [ns], `run` and `sequence` of the Response that it answers, `force` [N], `fault`."""
        header = _pack_header(stamp, "")
        if self._arrays is None or self._arrays.lengths != (len(force),):
            self._arrays = _Arrays(len(header), self._NUMBERS, [len(force)], 0)
            self._text = "", b""
        if fault != self._text[0] or not self._text[1]:
            self._text = fault, _pack_text(fault, self._arrays.offset + self._arrays.struct.size)
        return header + self._arrays.pack((sequence, run), (force,), (), self._text[1])

    def unpack(self, payload: bytes) -> tuple[int, int, tuple[float, ...], str]:
        """Run, sequence, force [N] and fault of a `payload`.

        Raises
        ------
        AbraceError
            If it is no BraceCommand.
        """
        _, offset = read_header(payload)
        if len(payload) < offset + 20:
            raise AbraceError("BraceCommand: cut off")
        sequence, run, length = struct.unpack_from("<QQI", payload, offset)
        start = offset + 24 if length else offset + 20
        if len(payload) < start + 8 * length:
            raise AbraceError("BraceCommand: cut off")
        force = struct.unpack_from(f"<{length}d", payload, start)
        return run, sequence, force, _unpack_text(payload, start + 8 * length, "BraceCommand")


_ACCELERATION = struct.Struct("<6d")


def pack_acceleration(stamp: int, acceleration: float) -> bytes:
    """An AccelStamped of the table: `stamp` [ns], `acceleration` [m/s^2] along x."""
    return _pack_header(stamp, "table") + _ACCELERATION.pack(acceleration, 0.0, 0.0, 0.0, 0.0, 0.0)


def unpack_acceleration(payload: bytes) -> tuple[int, float]:
    """Stamp [ns] and acceleration along x [m/s^2] of an AccelStamped `payload`.

    Raises
    ------
    AbraceError
        If it is none.
    """
    stamp, offset = read_header(payload)
    if len(payload) < offset + _ACCELERATION.size:
        raise AbraceError("AccelStamped: cut off")
    return stamp, _ACCELERATION.unpack_from(payload, offset)[0]
