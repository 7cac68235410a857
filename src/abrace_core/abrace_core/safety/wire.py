# SPDX-License-Identifier: Apache-2.0
"""The control loop's three messages as serialised (CDR, little endian), each packed and unpacked in one step.

rclpy builds a Python object for each message and each message in it: 10 to 16 microseconds a message, which, apart from
DDS, is most of the time of a lockstep sample. The loop's nodes receive and publish these bytes instead; to other nodes
they are ordinary messages. Tests compare every layout with rclpy's own serialisation.

Layout (XCDR1): 4 bytes of encapsulation; then, with alignment counted from there, the header (int32 sec, uint32
nanosec, string frame_id), and the fields of Response, BraceCommand or geometry_msgs/AccelStamped.
"""

from __future__ import annotations

import math
import struct
from itertools import accumulate
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LITTLE_ENDIAN = b"\x00\x01"
_HEADER = struct.Struct("<2s2xiII")
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
    if len(payload) < _HEADER.size or payload[:2] != LITTLE_ENDIAN:
        raise AbraceError("message: expected a stamped message in little-endian CDR")
    _, seconds, nanoseconds, length = _HEADER.unpack_from(payload)
    return Header(seconds * 10**9 + nanoseconds, _aligned(_HEADER.size + length, 8))


class _Layout:
    """Layout of a message: header, whole numbers, arrays of doubles of known lengths, and single doubles.

    Parameters
    ----------
    frame
        Length of the header's string, with the zero at its end.
    numbers
        Format of the whole numbers, without byte order.
    lengths
        Of the arrays.
    singles
        Number of single doubles.

    Attributes
    ----------
    struct
        Of the message.
    starts
        By array, the index of its length in what `struct` unpacks; its elements follow. The numbers begin at 5.
    """

    def __init__(self, frame: int, numbers: str, lengths: Sequence[int], singles: int) -> None:
        text = _aligned(_HEADER.size + frame, 8) - _HEADER.size
        form, self.starts = f"{_HEADER.format}{text}s{numbers}", []
        position = struct.calcsize(form)
        values = len(struct.unpack(form, bytes(position)))
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

    def pack(self, stamp: int, frame: bytes, values: Sequence[float]) -> bytes:
        """The message with this `stamp` [ns], `frame` with its zero, and `values` of all that follows."""
        seconds, nanoseconds = divmod(stamp, 10**9)
        return self.struct.pack(LITTLE_ENDIAN, seconds, nanoseconds, len(frame), frame, *values)


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
    """Packs and unpacks Response messages; a reader learns the rig's size and sensors from a run's first one."""

    _HEAD = "QQQIB3x"
    _FRAME = b"table\0"
    _layout: _Layout | None = None
    _text = "", b""
    # of what the layout unpacks: counts, and what they are; displacements, strokes, accelerations; each group's cells
    _counts: Callable[[tuple[Any, ...]], tuple[Any, ...]] = tuple
    _counted: tuple[Any, ...] = ()
    _motion = slice(0), slice(0), slice(0)
    _command = slice(0)
    _cells: Sequence[tuple[int, int]] = ()
    _measured_cells: Sequence[Sequence[int]] = ()
    """Of each group, where a load cell of the rig is missing."""
    floors = groups = 0
    table_displacement = math.nan
    """Of the Response that was unpacked last [m]; NaN: unknown."""
    command: tuple[float, ...] = ()
    """(groups,) of the Response that was unpacked last [N]."""

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
        table_displacement: float,
    ) -> bytes:
        """The message with the fields of Response, SI units; `stamp` [ns].

        `head` has the sequence, run, clipped, flags and state; the other arguments are as in `Response.msg`. The
        arrays' lengths stay those of the first call.
        """
        values: list[float] = [*head, len(braces), *braces]
        for array in (displacement, acceleration, stroke, force, command):
            values.append(len(array))
            values.extend(array)
        values += ground_acceleration, table_displacement
        if self._layout is None:
            lengths = [len(array) for array in (displacement, acceleration, stroke, force, command)]
            self._layout = _Layout(len(self._FRAME), self._numbers(len(braces)), lengths, 2)
        if cause != self._text[0] or not self._text[1]:
            self._text = cause, _pack_text(cause, self._layout.struct.size)
        return self._layout.pack(stamp, self._FRAME, values) + self._text[1]

    def unpack(self, payload: bytes) -> tuple[int, Head, tuple[float, ...]]:
        """Stamp [ns], head, and z = [displacement, stroke, acceleration, force] of a `payload`.

        The force is the mean of each group's load cells; NaN is what has no sensor.

        Raises
        ------
        AbraceError
            If it is no Response.
        """
        layout = self._layout
        if layout is None or len(payload) < layout.struct.size:
            layout = self._learn(payload)
        values = layout.struct.unpack_from(payload)
        if self._counts(values) != self._counted:
            self._learn(payload)
            return self.unpack(payload)
        self.table_displacement, self.command = values[-1], values[self._command]
        if self._measured_cells:
            force = tuple([_mean([values[i] for i in cells]) for cells in self._measured_cells])
        else:
            force = tuple([sum(values[begin:end]) / (end - begin) for begin, end in self._cells])
        x, s, a = self._motion
        return values[1] * 10**9 + values[2], Head._make(values[5:10]), values[x] + values[s] + values[a] + force

    def cause(self, payload: bytes) -> str:
        """The cause of a fault in a `payload` that has just been unpacked; empty: there is none.

        Raises
        ------
        AbraceError
            If the payload is cut off.
        """
        assert self._layout is not None
        return _unpack_text(payload, self._layout.struct.size, "Response")

    def _learn(self, payload: bytes) -> _Layout:
        header = read_header(payload)
        counts = header.offset + struct.calcsize(f"<{self._HEAD}I")
        groups = int.from_bytes(payload[counts - 4 : counts], "little")
        braces = tuple(payload[counts : counts + groups])
        numbers = self._numbers(len(braces))
        position, lengths = header.offset + struct.calcsize(f"<{numbers}"), []
        for _ in range(5):
            position = _aligned(position, 4)
            if position + 4 > len(payload):
                raise AbraceError("Response: cut off")
            (length,) = struct.unpack_from("<I", payload, position)
            lengths.append(length)
            position += 4
            if length:
                position = _aligned(position, 8) + 8 * length
        if len(braces) < groups or _aligned(position, 8) + 16 > len(payload):
            raise AbraceError("Response: cut off")
        floors, accelerations, strokes, forces, commands = lengths
        if floors != accelerations or not groups == strokes == commands or forces != sum(braces) or 0 in braces:
            raise AbraceError(
                f"Response: arrays of {lengths}, {groups} groups of {sum(braces)} braces, expected floors, floors, "
                "groups, braces, groups"
            )
        self.floors, self.groups = floors, groups
        (frame,) = struct.unpack_from("<I", payload, _HEADER.size - 4)
        layout = self._layout = _Layout(frame, numbers, lengths, 2)
        x, a, s, f, u = layout.starts
        values = layout.struct.unpack_from(payload)
        counted = [0, 3, 6, *range(10, x), *layout.starts]
        self._counts = itemgetter(*counted)
        self._counted = (LITTLE_ENDIAN, frame, values[6], groups, *braces, *lengths)
        self._motion = slice(x + 1, x + 1 + floors), slice(s + 1, s + 1 + groups), slice(a + 1, a + 1 + floors)
        self._command = slice(u + 1, u + 1 + groups)
        ends = [f + 1 + end for end in accumulate(braces)]
        self._cells = list(zip([f + 1, *ends], ends, strict=False))
        measured = [[i for i in range(*edges) if not math.isnan(values[i])] for edges in self._cells]
        self._measured_cells = measured if sum(map(len, measured)) < forces else ()
        return layout

    @classmethod
    def _numbers(cls, groups: int) -> str:
        """Format of the head and the number of braces in each group, up to the next 4-byte field."""
        return f"{cls._HEAD}I{groups}B{-groups % 4}x"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


class BraceCommands:
    """Packs and unpacks BraceCommand messages."""

    _layout: _Layout | None = None
    _text = "", b""

    def pack(self, stamp: int, run: int, sequence: int, force: Sequence[float], fault: str = "") -> bytes:
        """The message with `stamp` [ns], `run` and `sequence` of the Response that it answers, `force` [N], `fault`."""
        if self._layout is None or self._layout.lengths != (len(force),):
            self._layout = _Layout(1, "QQ", [len(force)], 0)
            self._text = "", b""
        if fault != self._text[0] or not self._text[1]:
            self._text = fault, _pack_text(fault, self._layout.struct.size)
        return self._layout.pack(stamp, b"\0", (sequence, run, len(force), *force)) + self._text[1]

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
_TABLE = _Layout(len(b"table\0"), "", [], 6)


def pack_acceleration(stamp: int, acceleration: float) -> bytes:
    """An AccelStamped of the table: `stamp` [ns], `acceleration` [m/s^2] along x."""
    return _TABLE.pack(stamp, b"table\0", (acceleration, 0.0, 0.0, 0.0, 0.0, 0.0))


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
