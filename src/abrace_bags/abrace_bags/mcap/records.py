# SPDX-License-Identifier: Apache-2.0
"""Records of an MCAP file, read from bytes that may be damaged, and the metadata record that holds the run's facts."""

from __future__ import annotations

import contextlib
import json
import operator
import struct
import zlib
from typing import TYPE_CHECKING, BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Metadata, Schema

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

MCAP0_MAGIC = b"\x89MCAP0\r\n"
"""MCAP's magic, at the beginning and the end of a file; importing it from `mcap.writer` takes long."""

FACTS_RECORD = "abrace"
"""Name of the metadata record that holds the run's facts."""

CHECKSUM_KEY = "checksum"
"""Key of the facts' CRC-32 in that record, which MCAP itself doesn't protect in a file that was cut off."""

RECORD_HEAD = struct.Struct("<BQ")
"""Before the content of every record: its opcode and the content's length."""

LARGEST_CHUNK = 1 << 29
"""Greatest size [bytes] of a chunk, compressed or not, and of any other record: a larger one is treated as damaged. The
logger takes no message of more than half of it."""
_TRUSTED = 1 << 24
"""Bytes of a record that are read before its lengths are compared with each other."""

_EXACT = (Attachment, Channel, Chunk, Header, Metadata, Schema)
"""Records of the data section end with their last known field. Those of the summary section, which has a checksum, may
have further fields of a later version of MCAP."""
_WITH_TEXTS = (Channel, Metadata)
_U64 = struct.Struct("<Q")
_CHUNK_NAME_LENGTH = struct.Struct("<28xI")
_INDEX_LENGTH = struct.Struct("<2xI")

Record = TypeVar("Record", bound=McapRecord)


class DamagedError(Exception):
    """Damage of a record or a section; the text is a predicate, such as `does not match its checksum`."""


class _Fields(ReadDataStream):
    """The fields of one record for the `read` of its class in `mcap.records`: none goes beyond the record's end."""

    def __init__(self, body: bytes, exact: bool) -> None:
        self._body, self._exact, self._count = body, exact, 0

    def read(self, length: int) -> bytes:
        begin = self._count
        self._count += length
        if self._exact and self._count > len(self._body):
            raise DamagedError("has inconsistent lengths")
        return self._body[begin : self._count]

    def read8(self) -> int:  # most fields of chunk indexes, of which a file has thousands
        (number,) = _U64.unpack_from(self._body, self._count)
        self._count += 8
        return int(number)


def parse(kind: type[Record], body: bytes, exact: bool = True) -> Record:
    """A record from its content.

    Parameters
    ----------
    kind
        Its class in `mcap.records`.
    body
        The content: what follows opcode and length.
    exact
        Whether its lengths must fit `body`. If not, bytes after the last field are ignored, and a text or packed data
        that would go beyond the end is cut off there.

    Raises
    ------
    DamagedError
        If its lengths do not fit, or a text is not UTF-8.
    """
    fields = _Fields(body, exact)
    try:
        record: Record = kind.read(fields)  # type: ignore[attr-defined]
    except struct.error as error:
        raise DamagedError("has inconsistent lengths") from error
    except UnicodeDecodeError as error:
        raise DamagedError("contains text that is not UTF-8") from error
    if exact and kind in _EXACT:
        # mcap reads texts by key until their length is reached, or passed
        fits = record_bytes(record)[RECORD_HEAD.size :] == body if kind in _WITH_TEXTS else fields.count == len(body)
        if not fits:
            raise DamagedError("has inconsistent lengths")
    return record


def record_bytes(record: McapRecord) -> bytes:
    """A record as bytes of a file, opcode and length first."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@contextlib.contextmanager
def open_mcap(path: Path) -> Iterator[BinaryIO]:
    """The file, positioned after MCAP's magic, of which one byte may be damaged."""
    try:
        with path.open("rb") as file:
            magic = file.read(len(MCAP0_MAGIC))
            if not magic:
                raise AbraceError(f"{path}: the file is empty, expected an MCAP file")
            if len(magic) < len(MCAP0_MAGIC) or sum(map(operator.ne, magic, MCAP0_MAGIC)) > 1:
                raise AbraceError(f"{path}: not an MCAP file")
            yield file
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}") from error


def next_record(file: BinaryIO, size: int) -> tuple[int, bytes]:
    """Opcode and content of the next record of a file of `size` bytes.

    Raises
    ------
    DamagedError
        If the file ends before it does, or its length can't be right.
    """
    opcode, length = record_head(file, size)
    if length > _TRUSTED:
        _check_length(file, opcode, length)
    try:
        return opcode, file.read(length)
    except MemoryError as error:
        raise DamagedError(f"has {length} bytes, more than there is memory") from error


def record_head(file: BinaryIO, size: int) -> tuple[int, int]:
    """Opcode and length of the next record of a file of `size` bytes, which holds the whole of it.

    Raises
    ------
    DamagedError
        If the file ends before it does.
    """
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise DamagedError("is incomplete")
    opcode, length = RECORD_HEAD.unpack(head)
    if length > size - file.tell():
        raise DamagedError("is incomplete")
    return opcode, length


def _check_length(file: BinaryIO, opcode: int, length: int) -> None:
    """Compare the `length` of a large record with the length that its content states, before reading it into memory."""
    if length > LARGEST_CHUNK:
        raise DamagedError(f"has {length} bytes, expected at most {LARGEST_CHUNK}")
    begin = file.tell()
    if opcode == Opcode.CHUNK:
        fixed = file.read(_CHUNK_NAME_LENGTH.size)
        named = _CHUNK_NAME_LENGTH.unpack(fixed)[0]
        file.seek(begin + len(fixed) + named)
        expected = len(fixed) + named + _U64.size + _U64.unpack(file.read(_U64.size))[0]
    elif opcode == Opcode.MESSAGE_INDEX:
        expected = 6 + _INDEX_LENGTH.unpack(file.read(_INDEX_LENGTH.size))[0]
    elif opcode in (Opcode.ATTACHMENT, Opcode.MESSAGE):
        return
    else:
        raise DamagedError(f"has {length} bytes, expected at most {_TRUSTED}")
    if expected != length:
        raise DamagedError("has inconsistent lengths")
    file.seek(begin)


def facts_checksum(facts: Mapping[str, str]) -> str:
    """CRC-32 of a run's facts as JSON with sorted keys, in hexadecimal."""
    return f"{zlib.crc32(json.dumps(dict(facts), sort_keys=True).encode()):08x}"


def checked_facts(path: Path, texts: Mapping[str, str]) -> dict[str, str]:
    """The facts in the `texts` of their record, without the checksum.

    Raises
    ------
    AbraceError
        If they do not fit it.
    """
    facts = {key: text for key, text in texts.items() if key != CHECKSUM_KEY}
    if texts.get(CHECKSUM_KEY) != facts_checksum(facts):
        raise AbraceError(f"{path}: the run's facts do not match their checksum, the file is damaged")
    return facts
