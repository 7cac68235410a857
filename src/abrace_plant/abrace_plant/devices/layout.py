# SPDX-License-Identifier: Apache-2.0
"""The layout of binary packets: a file names the fields of a sample and of a command in their order.

Fields are packed as Simulink Real-Time's Byte Packing block packs them: each entry of the list begins at a multiple of
`alignment`, counted from the start of the packet; the values within an entry follow each other without gaps. A CRC, if
there is one, is the last field and covers all bytes before it: CRC-32/ISO-HDLC as in zlib, Ethernet and PNG (polynomial
0x04C11DB7, reflected, initial value and final XOR 0xFFFFFFFF; of the bytes "123456789" it is 0xCBF43926).
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Type = Literal[
    "boolean", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"
]
CODES: dict[Type, str] = {
    "boolean": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Types of fields, by the names of Simulink's (single and double are float32 and float64)."""

NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
LATEST = 2**63
"""Nanoseconds: 292 years, the end of ROS's clock."""
_COUNTERS = ("uint8", "uint16", "uint32", "uint64")
_SPECIAL = {
    "counter": _COUNTERS,
    "time": ("int64", "uint64", "float64"),
    "arm": ("uint32",),
    "wanted": ("uint8", "uint16", "uint32"),
    "state": ("uint8", "uint16", "uint32"),
    "causes": ("uint8", "uint16", "uint32"),
    "applied_counter": _COUNTERS,
    "crc": ("uint32",),
    "constant": (*_COUNTERS, "int8", "int16", "int32", "int64"),
    "unused": tuple(CODES),
}
"""Fields with a meaning of their own, and the types that they may have."""
_OWN_KEYS = {"constant": {"value"}, "unused": {"count"}, "time": {"unit", "clock"}}
"""Keys that only one field has."""
_NEEDED = {
    "sample": ("constant", "counter", "time", "state", "causes", "arm", "applied_counter"),
    "command": ("constant", "counter", "arm", "wanted"),
}
"""Fields that a packet must have: without one of them the target cannot say, or be told, whether it follows."""
_ONLY_IN = {"wanted": "command", "state": "sample", "causes": "sample", "applied_counter": "sample"}
"""Fields that only one kind of packet has."""
STATES = 3
"""Of a target, and of what is wanted of it: 0 to 2."""


class Malformed(Exception):  # noqa: N818
    """A packet that must not be used; the error's text is the name under which it is counted."""


class Field(Checked):
    """One entry of a packet: a field of its own meaning, or one or several signals of one type."""

    field: str | Annotated[list[str], pydantic.Field(min_length=1)]
    type: Type
    value: int | None = None
    count: Annotated[int, pydantic.Field(ge=1)] = 1
    unit: Literal["s", "ms", "us", "ns"] = "ns"
    clock: Literal["own", "wall"] = "own"

    @property
    def names(self) -> list[str]:
        """The field's name, or those of the signals in it."""
        return [self.field] if isinstance(self.field, str) else self.field


class Layout(Checked):
    """A layout file: byte order, alignment, the fields of a sample (to abrace) and of a command (from abrace)."""

    byte_order: Literal["little", "big"] = "little"
    alignment: Literal[1, 2, 4, 8] = 1
    sample: list[Field]
    command: list[Field]


class Content(NamedTuple):
    """The content of a valid packet."""

    counter: int
    """The sender's life counter: the number of the tick, or of the command."""
    signals: tuple[float, ...]
    """As sent, in the order of the packet's `signals`."""
    time: int
    """By the sender's clock [ns]; 0 in commands without a time."""
    arm: int
    """Of a sample, the arm number that the target has accepted last; of a command, the one that is to be followed."""
    state: int
    """Of a sample, 0 disarmed, 1 armed, 2 stopping; of a command, what is wanted: 0 safe, 1 hold zero, 2 follow."""
    causes: int = 0
    """Of a sample: why the target has stopped, a bit for each cause."""
    applied_counter: int = 0
    """Of a sample: counter of the command that acts from this tick on; 0 before the first."""


class Packet:
    """A kind of packet, compiled from its fields.

    Parameters
    ----------
    layout
        The layout file.
    kind
        "sample" or "command".
    signals
        Names of the signals, in the order in which `encode` takes and `decode` gives them.

    Attributes
    ----------
    signals
        As given.
    length
        Of a packet [bytes].
    modulus
        The counter's number of values, after which it begins at zero again.
    echo_modulus
        That of the field `applied_counter`; 1 in a command.
    resolution
        Of the time [ns]; 0 where it is a real number, or there is none.
    wall_clock
        Whether the time is nanoseconds since 1970, kept by PTP or the like, and not that of the sender's own clock.

    Raises
    ------
    AbraceError
        Naming the field, and what was expected of it.
    """

    def __init__(self, layout: Layout, kind: Literal["sample", "command"], signals: Sequence[str]) -> None:
        self.signals = tuple(signals)
        fields: list[Field] = getattr(layout, kind)
        _check_fields(fields, kind, signals)
        by_name = {name: entry for entry in fields for name in entry.names}
        form, self._blank = "<" if layout.byte_order == "little" else ">", list[float]()
        place: dict[str, int] = {}
        self._constants: list[tuple[int, int]] = []
        length = 0
        for entry in fields:
            padding = -length % layout.alignment
            size = struct.calcsize("<" + CODES[entry.type])
            if entry.field == "unused":
                form += f"{padding + entry.count * size}x"
                length += padding + entry.count * size
                continue
            form += f"{padding}x" + CODES[entry.type] * len(entry.names)
            length += padding + size * len(entry.names)
            if entry.field == "constant":
                self._constants.append((len(self._blank), entry.value or 0))
            place |= {name: len(self._blank) + i for i, name in enumerate(entry.names)}
            self._blank += [entry.value or 0] * len(entry.names)
        self._struct = struct.Struct(form)
        self._order: Literal["little", "big"] = layout.byte_order
        self.length = length
        self.modulus = _modulus(by_name["counter"])
        self.echo_modulus = _modulus(by_name["applied_counter"]) if kind == "sample" else 1
        self.wall_clock = "time" in by_name and by_name["time"].clock == "wall"
        self._unit = NANOSECONDS[by_name["time"].unit] if "time" in by_name else 1
        self._whole_time = "time" in by_name and by_name["time"].type != "float64"
        self.resolution = self._unit if self._whole_time else 0
        self._crc = "crc" in by_name
        self._counter, self._arm, self._state = (
            place[name] for name in ("counter", "arm", "state" if kind == "sample" else "wanted")
        )
        self._time = place.get("time")
        self._of_sample = (place["causes"], place["applied_counter"]) if kind == "sample" else None
        self._places = [place[name] for name in signals]
        first = min(self._places)
        self._run = (
            slice(first, first + len(signals)) if self._places == [*range(first, first + len(signals))] else None
        )
        self._bounds = [_bounds(by_name[name].type) for name in signals]

    def encode(
        self,
        signals: Sequence[float],
        counter: int,
        time: int = 0,
        arm: int = 0,
        state: int = 0,
        causes: int = 0,
        applied_counter: int = 0,
    ) -> bytes:
        """A packet; values of whole-number types are rounded, and cut at the ends of their types.

        Parameters
        ----------
        signals
            In the units in which they are sent.
        counter
            Life counter; wraps.
        time
            By the sender's clock [ns].
        arm, state, causes, applied_counter
            As in `Content`; the last two of a sample alone, its counter wraps.
        """
        values = list(self._blank)
        values[self._counter] = counter % self.modulus
        if self._time is not None:
            values[self._time] = time // self._unit if self._whole_time else time / self._unit
        values[self._arm], values[self._state] = arm, state
        if self._of_sample is not None:
            values[self._of_sample[0]], values[self._of_sample[1]] = causes, applied_counter % self.echo_modulus
        for place, bounds, value in zip(self._places, self._bounds, signals, strict=True):
            values[place] = value if bounds is None else min(max(round(value), bounds[0]), bounds[1])
        packed = self._struct.pack(*values)
        return self.sign(packed) if self._crc else packed

    def sign(self, packet: bytes) -> bytes:
        """The `packet` with the CRC of its other bytes in the last four."""
        return packet[:-4] + zlib.crc32(packet[:-4]).to_bytes(4, self._order)

    def decode(self, packet: bytes) -> Content:
        """What a `packet` says.

        Raises
        ------
        Malformed
            Naming what is wrong: "wrong_length", "wrong_crc", "wrong_constant", "not_finite", "wrong_time" or
            "wrong_state".
        """
        if len(packet) != self.length:
            raise Malformed("wrong_length")
        if self._crc and zlib.crc32(packet[:-4]) != int.from_bytes(packet[-4:], self._order):
            raise Malformed("wrong_crc")
        values = self._struct.unpack(packet)
        for place, constant in self._constants:
            if values[place] != constant:
                raise Malformed("wrong_constant")
        signals = values[self._run] if self._run is not None else tuple([values[place] for place in self._places])
        time = values[self._time] if self._time is not None else 0
        # a sum is finite only where every value is; of huge ones it may not be, and those are no measurements either
        if not math.isfinite(sum(signals) + time):
            raise Malformed("not_finite")
        nanoseconds = time * self._unit
        if abs(nanoseconds) >= LATEST:
            raise Malformed("wrong_time")
        state = values[self._state]
        if state >= STATES:
            raise Malformed("wrong_state")
        causes, applied = (values[place] for place in self._of_sample) if self._of_sample is not None else (0, 0)
        return Content(values[self._counter], signals, round(nanoseconds), values[self._arm], state, causes, applied)


def read_layout(path: Path | str) -> Layout:
    """Read and check a layout file; `Packet` checks it against the signals of a rig.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, Layout, "layout")


def _check_fields(fields: list[Field], kind: str, signals: Sequence[str]) -> None:
    """Every signal once, special fields of fitting types, and the CRC at the end."""
    seen: set[str] = set()
    for number, entry in enumerate(fields):
        where = f"{kind}.{number}"
        for name in entry.names:
            alone = name in _SPECIAL
            if not (alone or name in signals) or (alone and isinstance(entry.field, list)):
                known = ", ".join([*_SPECIAL, *signals])
                raise AbraceError(f"{where}.field: {name!r}, expected one of {known}")
            if _ONLY_IN.get(name, kind) != kind:
                raise AbraceError(f"{where}.field: {name!r}, expected in a {_ONLY_IN[name]}")
            if name in seen and name not in ("constant", "unused"):
                raise AbraceError(f"{where}.field: {name!r} appears twice")
            if alone and entry.type not in _SPECIAL[name]:
                raise AbraceError(f"{where}.type: {entry.type} for {name}, expected {', '.join(_SPECIAL[name])}")
            seen.add(name)
        for owner, keys in _OWN_KEYS.items():
            if wrong := sorted(keys & entry.model_fields_set if entry.field != owner else ()):
                raise AbraceError(
                    f"{where}.{wrong[0]}: {getattr(entry, wrong[0])}, expected for the field {owner} alone"
                )
        if entry.field == "crc" and number != len(fields) - 1:
            raise AbraceError(f"{where}.field: crc, expected at the end of the packet")
        if entry.field == "constant" and entry.value is None:
            raise AbraceError(f"{where}.value: key is missing")
        bounds = _bounds(entry.type)
        if entry.value is not None and bounds is not None and not bounds[0] <= entry.value <= bounds[1]:
            raise AbraceError(f"{where}.value: {entry.value}, expected {bounds[0]} to {bounds[1]} ({entry.type})")
    needed = (*_NEEDED[kind], *signals)
    if missing := [name for name in needed if name not in seen]:
        raise AbraceError(f"{kind}: no field {', '.join(missing)}, expected {', '.join(needed)}")


def _modulus(entry: Field) -> int:
    return int(1 << 8 * struct.calcsize("<" + CODES[entry.type]))


def _bounds(kind: Type) -> tuple[int, int] | None:
    """Least and greatest value of a type of whole numbers."""
    if kind.startswith("float"):
        return None
    if kind == "boolean":
        return 0, 1
    bits = 8 * struct.calcsize("<" + CODES[kind])
    return (0, (1 << bits) - 1) if kind.startswith("u") else (-(1 << bits - 1), (1 << bits - 1) - 1)
