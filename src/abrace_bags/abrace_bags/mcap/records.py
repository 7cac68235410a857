# SPDX-License-Identifier: Apache-2.0
"""Records of an MCAP file, read from bytes that may be damaged, and the metadata record that holds the run's facts."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import zlib
from typing import TYPE_CHECKING, BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Metadata

from abrace_core import AbraceError

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
"""Greatest size [bytes] of a chunk, compressed or not: a larger one is treated as damaged."""
LARGEST_MESSAGE = LARGEST_CHUNK // 2
"""Greatest size [bytes] of a message that is written: its chunk also holds smaller ones."""
LARGEST_TEXTS = 1 << 24
"""Greatest size [bytes] of other records, such as metadata."""
LATEST_TIME = 2**63 - 1
"""Greatest log time [ns] that a clock gives: messages with a later one are not read, and not written."""

_WITH_TEXTS = (Channel, Metadata)

Record = TypeVar("Record", bound=McapRecord)


class DamagedError(Exception):
    """Damage of a record or a section; the text is a predicate, such as `does not match its checksum`."""


class _Fields(ReadDataStream):
    """The fields of one record for the `read` of its class in `mcap.records`: none goes beyond the record's end."""

    def __init__(self, body: bytes, cut: bool) -> None:
        self._body, self._cut, self._count = body, cut, 0

    def read(self, length: int) -> bytes:
        begin = self._count
        self._count += length
        if not self._cut and self._count > len(self._body):
            raise DamagedError("has inconsistent lengths")
        return self._body[begin : self._count]


def parse(kind: type[Record], body: bytes, cut: bool = False) -> tuple[Record, int]:
    """A record from its content, and how many bytes follow its last field: those of a later version of MCAP.

    Parameters
    ----------
    kind
        Its class in `mcap.records`.
    body
        The content: what follows opcode and length.
    cut
        Whether the file may end in it: a text or packed data that would go beyond the end is then cut off there.

    Raises
    ------
    DamagedError
        If its lengths do not fit, or a text is not UTF-8.
    """
    fields = _Fields(body, cut)
    try:
        record: Record = kind.read(fields)  # type: ignore[attr-defined]
    except struct.error as error:
        raise DamagedError("has inconsistent lengths") from error
    except UnicodeDecodeError as error:
        raise DamagedError("contains text that is not UTF-8") from error
    read = fields.count
    if kind in _WITH_TEXTS:  # mcap reads texts by key until their length is reached, or passed
        content = record_bytes(record)[RECORD_HEAD.size :]
        read = len(content)
        if not body.startswith(content):
            raise DamagedError("has inconsistent lengths")
    return record, len(body) - read


def attachment_head(body: bytes) -> tuple[str, str, int, int]:
    """Name, media type, where the content begins, and its length, from the beginning of an attachment's `body`.

    Raises
    ------
    DamagedError
        If it ends before, or a name is not UTF-8.
    """
    fields = _Fields(body, cut=False)
    try:
        fields.read(16)
        name, media_type, size = fields.read_prefixed_string(), fields.read_prefixed_string(), fields.read8()
    except UnicodeDecodeError as error:
        raise DamagedError("contains text that is not UTF-8") from error
    return name, media_type, fields.count, size


def record_bytes(record: McapRecord) -> bytes:
    """A record as bytes of a file, opcode and length first."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@contextlib.contextmanager
def open_file(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """A file, and its size; what the operating system refuses is an AbraceError."""
    try:
        with path.open("rb") as file:
            yield file, os.fstat(file.fileno()).st_size
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}") from error


def record_head(file: BinaryIO, offset: int, size: int) -> tuple[int, int]:
    """Opcode and length of the record at an `offset` of a file of `size` bytes, which holds the whole of it.

    Raises
    ------
    DamagedError
        If the file ends before it does, or its length can't be right.
    """
    file.seek(offset)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        raise DamagedError("is incomplete")
    opcode, length = RECORD_HEAD.unpack(head)
    if length > size - offset - RECORD_HEAD.size:
        raise DamagedError("is incomplete")
    if opcode != Opcode.ATTACHMENT and length > largest_record(opcode):
        raise DamagedError(f"has {length} bytes, expected at most {largest_record(opcode)}")
    return opcode, length


def is_record(file: BinaryIO, offset: int, size: int, following: int = 1) -> bool:
    """Whether at an `offset` of a file of `size` bytes may be a record, and some `following`, or the last magic."""
    file.seek(offset)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return head == MCAP0_MAGIC
    opcode, length = RECORD_HEAD.unpack(head)
    end = offset + len(head) + length
    return opcode > 0 and end <= size and (not following or end == size or is_record(file, end, size, following - 1))


def read_record(file: BinaryIO, offset: int, size: int) -> tuple[int, bytes]:
    """Opcode and content of the record at an `offset`, as `record_head`."""
    opcode, length = record_head(file, offset, size)
    file.seek(offset + RECORD_HEAD.size)
    try:
        return opcode, file.read(length)
    except MemoryError as error:
        raise DamagedError(f"has {length} bytes, more than there is memory") from error


def largest_record(opcode: int) -> int:
    """Greatest size [bytes] of a record of this `opcode`: a larger one is treated as damaged, and not written."""
    large = opcode in (Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.MESSAGE)
    return LARGEST_CHUNK if large else LARGEST_TEXTS


def facts_checksum(facts: Mapping[str, str]) -> str:
    """CRC-32 of a run's facts as JSON with sorted keys, in hexadecimal."""
    return f"{zlib.crc32(json.dumps(dict(facts), sort_keys=True).encode()):08x}"


def checked_facts(texts: Mapping[str, str]) -> dict[str, str]:
    """The facts in the `texts` of their record, without the checksum.

    Raises
    ------
    DamagedError
        If they do not fit it.
    """
    facts = {key: text for key, text in texts.items() if key != CHECKSUM_KEY}
    if texts.get(CHECKSUM_KEY) != facts_checksum(facts):
        raise DamagedError("do not match their checksum")
    return facts
