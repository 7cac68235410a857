"""The index at the end of an MCAP file: what its chunks hold, and how many messages of each channel there should be."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from abrace_bags.mcap.records import RECORD_HEAD, DamagedError, RecordFields, next_record
from abrace_bags.mcap.stream import Channel

if TYPE_CHECKING:
    from collections.abc import Mapping

_FOOTER_SIZE = RECORD_HEAD.size + 20


@dataclass(frozen=True)
class ChunkIndex:
    """Where a chunk is and what it holds.

    Parameters
    ----------
    begin, end
        Log times of its first and its last message [ns].
    offset
        Where its record begins.
    size
        Bytes of that record.
    channels
        Channels with messages in it; empty where that is not said.
    """

    begin: int
    end: int
    offset: int
    size: int
    channels: frozenset[int]


@dataclass
class Descriptions:
    """What schema and channel records say."""

    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, opcode: int, body: bytes) -> None:
        """Take in one such record: its `opcode` and its `body`."""
        fields = RecordFields(body)
        number = fields.number(2)
        if opcode == Opcode.SCHEMA:
            name, encoding = fields.text(), fields.text()
            schema = (name, encoding, fields.text())
            fields.end()
            self.schemas[number] = schema
        else:
            schema = self.schemas.get(fields.number(2), ("", "", ""))
            topic, encoding = fields.text(), fields.text()
            details = fields.texts()
            fields.end()
            self.channels[number] = Channel(topic, encoding, details, *schema)


@dataclass
class Index:
    """What an MCAP file's index says.

    Parameters
    ----------
    descriptions
        Of all channels.
    counts
        Messages by channel number; None where that is not said.
    chunks
        In the order in which they stand in the file.
    beside
        Offsets of the attachments and the metadata records.
    begin
        Where the index begins.
    complete
        Whether it names all that is in the file.
    """

    begin: int
    descriptions: Descriptions = field(default_factory=Descriptions)
    counts: Mapping[int, int] | None = None
    chunks: list[ChunkIndex] = field(default_factory=list)
    beside: list[int] = field(default_factory=list)
    complete: bool = False


def read_index(file: BinaryIO, size: int) -> Index | None:
    """The index of a file of this `size`; None where it has none, or one without a checksum.

    Raises
    ------
    DamagedError
        If it does not fit its checksum.
    """
    footer = size - len(MCAP0_MAGIC) - _FOOTER_SIZE
    if footer < len(MCAP0_MAGIC):
        raise DamagedError("is missing")
    file.seek(footer)
    opcode, body = next_record(file, size)
    if opcode != Opcode.FOOTER or file.read() != MCAP0_MAGIC:
        raise DamagedError("does not end with MCAP's closing mark")
    fields = RecordFields(body)
    begin, _, checksum = fields.number(8), fields.number(8), fields.number(4)
    if checksum == 0:
        return None
    if begin > footer:
        raise DamagedError("does not fit the file")
    begin = begin or footer
    file.seek(begin)
    if zlib.crc32(file.read(footer - begin + _FOOTER_SIZE - 4)) != checksum:
        raise DamagedError("does not fit its checksum")
    file.seek(begin)
    records = []
    while file.tell() < footer:
        records.append(next_record(file, size))
    index = Index(begin)
    stated = None
    for opcode, body in sorted(records, key=lambda record: record[0]):  # the schemas before the channels
        if opcode == Opcode.STATISTICS:
            stated, index.counts = _statistics(body)
        else:
            _add(index, opcode, body)
    index.chunks.sort(key=lambda chunk: chunk.offset)
    schemas, channels = index.descriptions.schemas, index.descriptions.channels
    index.complete = stated == (len(schemas), len(channels), len(index.beside), len(index.chunks))
    return index


def _statistics(body: bytes) -> tuple[tuple[int, int, int, int], dict[int, int]]:
    """How many schemas, channels, attachments and metadata records, and chunks there are; messages by channel."""
    fields = RecordFields(body)
    fields.take(8)
    schemas, channels, attachments, metadata, chunks = (fields.number(size) for size in (2, 4, 4, 4, 4))
    fields.take(16)
    return (schemas, channels, attachments + metadata, chunks), fields.numbers(2)


def _add(index: Index, opcode: int, body: bytes) -> None:
    fields = RecordFields(body)
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        index.descriptions.add(opcode, body)
    elif opcode == Opcode.CHUNK_INDEX:
        begin, end, offset, size = (fields.number(8) for _ in range(4))
        index.chunks.append(ChunkIndex(begin, end, offset, size, frozenset(fields.numbers(2))))
    elif opcode in (Opcode.METADATA_INDEX, Opcode.ATTACHMENT_INDEX):
        index.beside.append(fields.number(8))
