# SPDX-License-Identifier: Apache-2.0
"""A Modbus register map: the registers of each signal, read and written in as few requests as possible."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Annotated, Literal

import pydantic

from abrace_core.config_file import Checked, expect_entries, read_config
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

CODES = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"}
LONGEST = 120
"""Registers of one request; the protocol allows 125 to read and 123 to write."""
WIDEST_GAP = 8
"""Unused registers between two signals that are also read, to save a request."""


class Register(Checked):
    """The place of a value: its first register, as in requests (from 0 on), and its type."""

    register_: Annotated[int, pydantic.Field(ge=0, le=65535, alias="register")]
    type: Literal["int16", "uint16", "int32", "uint32", "float32", "float64"] = "float32"

    @property
    def words(self) -> int:
        """Registers that it takes."""
        return struct.calcsize("<" + CODES[self.type]) // 2


class Setting(Register):
    """A value that is written once, when the device is opened."""

    value: float


class RegisterMap(Checked):
    """A register map file; `highest_rate` [Hz] is what the device can do."""

    name: str
    highest_rate: Annotated[float, pydantic.Field(gt=0)]
    word_order: Literal["big", "little"] = "big"
    set_up: list[Setting] = []
    inputs: dict[str, Register]
    outputs: dict[str, Register]
    life_counter: Register | None = None


class Block:
    """Values in neighbouring registers, compiled.

    Parameters
    ----------
    entries
        (position in the list of values, register) in ascending order of registers.
    word_order
        Whether a value's first register has its most significant word ("big") or its least.

    Attributes
    ----------
    first
        First register.
    words
        Number of registers.
    positions
        Of the block's values in the list of all.
    """

    def __init__(self, entries: Sequence[tuple[int, Register]], word_order: str) -> None:
        self.first = end = entries[0][1].register_
        self.positions = [position for position, _ in entries]
        form, order = ">", list[int]()
        for _, entry in entries:
            gap = entry.register_ - end
            form += "xx" * gap + CODES[entry.type]
            order += range(len(order), len(order) + gap)
            words = range(len(order), len(order) + entry.words)
            order += words if word_order == "big" else reversed(words)
            end = entry.register_ + entry.words
        self.words = len(order)
        self._order = order
        self._values = struct.Struct(form)
        self._registers = struct.Struct(f">{self.words}H")
        self._cuts = [_cut(entry) for _, entry in entries]

    def decode(self, registers: Sequence[int]) -> tuple[float, ...]:
        """The values in `registers` (words,)."""
        return self._values.unpack(self._registers.pack(*[registers[i] for i in self._order]))

    def encode(self, values: Sequence[float]) -> list[int]:
        """(words,) registers that hold `values`; whole-number types round, and end at their ends."""
        fitting = [value if cut is None else cut(value) for cut, value in zip(self._cuts, values, strict=True)]
        words = self._registers.unpack(self._values.pack(*fitting))
        return [words[i] for i in self._order]


def read_register_map(path: Path | str) -> RegisterMap:
    """Read and check a register map file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, RegisterMap, "register map")


def blocks(
    entries: Mapping[str, Register], names: Sequence[str], word_order: str, widest_gap: int, key: str
) -> list[Block]:
    """The blocks that hold the signals `names`, whose values are counted in this order.

    Parameters
    ----------
    entries
        Register of each signal.
    names
        The signals that there must be, and no others.
    word_order
        Of values of several registers.
    widest_gap
        Registers between two values of one block.
    key
        Of the entries in their file, for errors.

    Raises
    ------
    AbraceError
        If signals are missing or unknown, or one overlaps the registers of another.
    """
    expect_entries(entries, names, key)
    sorted_entries = sorted(((i, entries[name]) for i, name in enumerate(names)), key=lambda each: each[1].register_)
    groups: list[list[tuple[int, Register]]] = []
    end = 0
    for position, entry in sorted_entries:
        if groups and entry.register_ < end:
            raise AbraceError(f"{key}.{names[position]}: register {entry.register_} belongs to another signal")
        first = groups[-1][0][1].register_ if groups else 0
        if groups and entry.register_ - end <= widest_gap and entry.register_ + entry.words - first <= LONGEST:
            groups[-1].append((position, entry))
        else:
            groups.append([(position, entry)])
        end = entry.register_ + entry.words
    return [Block(group, word_order) for group in groups]


def _cut(entry: Register) -> Callable[[float], int] | None:
    """What makes a number one of a whole-number type; None for types of real numbers."""
    if entry.type.startswith("float"):
        return None
    bits = 16 * entry.words
    low, high = (0, (1 << bits) - 1) if entry.type.startswith("u") else (-(1 << bits - 1), (1 << bits - 1) - 1)
    return lambda value: min(max(round(value), low), high)
