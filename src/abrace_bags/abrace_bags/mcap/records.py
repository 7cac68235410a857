"""The records of an MCAP file, one after the other, and the one among them that holds the run's facts."""

from __future__ import annotations

import contextlib
import json
import operator
import os
import struct
import zlib
from typing import TYPE_CHECKING, BinaryIO

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

FACTS_RECORD = "abrace"
"""Name of the metadata record that holds the run's facts."""

CHECKSUM_KEY = "checksum"
"""Key in that record, which MCAP itself doesn't protect in a file that was cut off."""

RECORD_HEAD = struct.Struct("<BQ")
"""Before every record: what it is, and its length."""


def facts_checksum(facts: Mapping[str, str]) -> str:
    """CRC-32 of a run's facts as JSON with sorted keys: kept beside them."""
    return f"{zlib.crc32(json.dumps(dict(facts), sort_keys=True).encode()):08x}"


class DamagedError(Exception):
    """What is wrong with a record."""


class RecordFields:
    """Reads the fields of a record one after the other."""

    def __init__(self, body: bytes) -> None:
        self.body = body
        self.offset = 0

    def number(self, size: int) -> int:
        """An unsigned number of `size` bytes."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """A string with its length before it."""
        try:
            return self.take(self.number(4)).decode()
        except UnicodeDecodeError as error:
            raise DamagedError("holds text that is not UTF-8") from error

    def texts(self) -> dict[str, str]:
        """Strings by name."""
        end = self.number(4) + self.offset
        found = {}
        while self.offset < end:
            key = self.text()
            found[key] = self.text()
        if self.offset != end:
            raise DamagedError("has lengths that don't fit")
        return found

    def numbers(self, key_size: int) -> dict[int, int]:
        """Numbers of 8 bytes by numbers of `key_size` bytes."""
        end = self.number(4) + self.offset
        found = {}
        while self.offset < end:
            key = self.number(key_size)
            found[key] = self.number(8)
        if self.offset != end:
            raise DamagedError("has lengths that don't fit")
        return found

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        self.offset += size
        if self.offset > len(self.body):
            raise DamagedError("has lengths that don't fit")
        return self.body[self.offset - size : self.offset]

    def end(self) -> None:
        """Nothing may follow."""
        if self.offset != len(self.body):
            raise DamagedError("has lengths that don't fit")


def _is_nearly_mark(mark: bytes) -> bool:
    """Whether the first bytes of a file are MCAP's opening mark, one of them damaged or none."""
    return len(mark) == len(MCAP0_MAGIC) and sum(map(operator.ne, mark, MCAP0_MAGIC)) <= 1


@contextlib.contextmanager
def open_mcap(path: Path) -> Iterator[BinaryIO]:
    """The file, behind MCAP's opening mark."""
    try:
        with path.open("rb") as file:
            mark = file.read(len(MCAP0_MAGIC))
            if not mark:
                raise AbraceError(f"{path}: the file is empty, expected an MCAP file")
            if not _is_nearly_mark(mark):
                raise AbraceError(f"{path}: not an MCAP file")
            yield file
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}") from error


def next_record(file: BinaryIO, size: int) -> tuple[int, bytes]:
    """Opcode and body of the next record of a file of this size."""
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise DamagedError("is not a whole record")
    opcode, length = RECORD_HEAD.unpack(head)
    if length > size - file.tell():
        raise DamagedError("is not a whole record")
    return opcode, file.read(length)


def read_facts_record(path: Path) -> dict[str, str] | None:
    """The run's facts in one file, without reading further than to them; None where it has none.

    Raises
    ------
    AbraceError
        If the file can't be read, is not MCAP, or its facts are damaged.
    """
    with open_mcap(path) as file, contextlib.suppress(DamagedError):
        size = os.fstat(file.fileno()).st_size
        opcode = 0
        while opcode != Opcode.DATA_END:
            opcode, body = next_record(file, size)
            if opcode == Opcode.METADATA:
                fields = RecordFields(body)
                if fields.text() == FACTS_RECORD:
                    return checked_facts(path, fields.texts())
    return None


def checked_facts(path: Path, texts: dict[str, str]) -> dict[str, str]:
    """The facts of that record, without their checksum.

    Raises
    ------
    AbraceError
        If they do not fit it.
    """
    if texts.pop(CHECKSUM_KEY, None) != facts_checksum(texts):
        raise AbraceError(f"{path}: the run's facts do not fit their checksum, the file is damaged")
    return texts
