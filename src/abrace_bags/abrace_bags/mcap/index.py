# SPDX-License-Identifier: Apache-2.0
"""The summary section at the end of an MCAP file: channels, message counts, and where the chunks to read are."""

from __future__ import annotations

import struct
import zlib
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Footer, MetadataIndex, Schema, Statistics

from abrace_bags.mcap.records import LARGEST_CHUNK, MCAP0_MAGIC, RECORD_HEAD, DamagedError, parse, read_record
from abrace_bags.topics import RecordedTopic

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_bags.topics import Selection

_FOOTER_SIZE = RECORD_HEAD.size + 20
_CHUNK_INDEX = struct.Struct("<4QI")
_INDEX_OFFSET = np.dtype([("id", "<u2"), ("offset", "<u8")])
_BLOCK = 1 << 20
_UNKNOWN = Schema(id=0, name="", encoding="", data=b"")


@dataclass
class ChannelTable:
    """Channels and schemas by their ids."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, RecordedTopic] = field(default_factory=dict)
    conflicts: dict[str, None] = field(default_factory=dict)
    """Warnings of channels that are described in different ways; the first one holds."""

    def described(self) -> ChannelTable:
        """The schemas, and the channels whose types are known, to be added to."""
        known = {number: channel for number, channel in self.channels.items() if channel.type_name}
        return ChannelTable(dict(self.schemas), known)

    def add_schema(self, schema: Schema) -> None:
        """Add a schema."""
        self.schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> None:
        """Add a channel, the schema of which was added before; one that is known stays as it is."""
        known = self.channels.get(channel.id)
        schema = self.schemas.get(channel.schema_id, _UNKNOWN)
        topic = RecordedTopic(
            channel.topic,
            schema.name,
            channel.metadata.get("topic_type_hash", ""),
            (channel.metadata.get("offered_qos_profiles", ""),),
            schema.data.decode(errors="surrogateescape"),  # that of another encoding than ROS 2's may be no text
            schema.encoding,
            channel.message_encoding,
        )
        if known is None or not known.type_name:
            self.channels[channel.id] = topic
        elif known.name != topic.name or (schema is not _UNKNOWN and known.joined(topic) is None):
            names = known.name if known.name == topic.name else f"{known.name}, later {topic.name}"
            self.conflicts[f"channel {channel.id} ({names}) is described in two ways, the first one is used"] = None


class ChunkTable:
    """Where the chunks of a file are: a few numbers of each, as a large file has hundreds of thousands.

    Attributes
    ----------
    offsets, starts, ends
        (chunks,) first byte, and times of the first and the last message [ns].
    held
        (chunks,) ids of the channels that a chunk has messages of; empty where it does not say.
    """

    def __init__(self) -> None:
        self.offsets, self.starts, self.ends = array("Q"), array("Q"), array("Q")
        self.held: list[frozenset[int]] = []
        self._known: dict[bytes, frozenset[int]] = {}

    def __len__(self) -> int:
        return len(self.offsets)

    def add(self, body: bytes) -> None:
        """Add a chunk index, the `body` of its record."""
        try:
            start, end, offset, _, length = _CHUNK_INDEX.unpack_from(body)
            ids = np.frombuffer(body, _INDEX_OFFSET, length // 10, _CHUNK_INDEX.size)["id"].tobytes()
        except (struct.error, ValueError) as error:
            raise DamagedError("has inconsistent lengths") from error
        self.starts.append(start)
        self.ends.append(end)
        self.offsets.append(offset)
        if ids not in self._known:
            self._known[ids] = frozenset(np.frombuffer(ids, "<u2").tolist())
        self.held.append(self._known[ids])

    def matching(self, selection: Selection, channels: Mapping[int, RecordedTopic]) -> NDArray[np.intp]:
        """Numbers of the chunks that may hold messages of a `selection` of the file's `channels`, in its order."""
        refused = {number for number, channel in channels.items() if not selection.accepts(channel)}
        wanted = {held: not held or bool(held - refused) for held in set(self.held)}
        matching = np.array([wanted[held] for held in self.held], bool)
        if selection.begin is not None:
            matching &= np.array(self.ends, np.uint64) >= max(selection.begin, 0)
        if selection.end is not None:
            matching &= np.array(self.starts, np.uint64) < max(selection.end, 0)
        numbers = np.flatnonzero(matching)
        return numbers[np.argsort(np.array(self.offsets, np.uint64)[numbers], kind="stable")]


@dataclass
class SummarySection:
    """What the summary section holds.

    Parameters
    ----------
    start
        Offset of the section in the file.
    table
        All schemas and channels.
    message_counts
        By channel id; None where they are not counted.
    chunks
        Where they are.
    attachments, metadata
        Where their records are.
    checked
        Whether it has a checksum: without one only its counts are used.
    complete
        Whether it has everything that the statistics count.
    """

    start: int
    checked: bool
    table: ChannelTable = field(default_factory=ChannelTable)
    message_counts: Mapping[int, int] | None = None
    chunks: ChunkTable = field(default_factory=ChunkTable)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    complete: bool = False
    _counted: Statistics | None = None

    def add(self, opcode: int, body: bytes) -> None:
        """Add what one of its records says, by its `opcode` and its content, the `body`."""
        if opcode == Opcode.SCHEMA:
            schema, _ = parse(Schema, body)
            if self.table.schemas.get(schema.id, schema) != schema:
                raise DamagedError("describes a schema in two ways")
            self.table.add_schema(schema)
        elif opcode == Opcode.CHANNEL:
            self.table.add_channel(parse(Channel, body)[0])
        elif opcode == Opcode.CHUNK_INDEX:
            self.chunks.add(body)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self.attachments.append(parse(AttachmentIndex, body)[0])
        elif opcode == Opcode.METADATA_INDEX:
            self.metadata.append(parse(MetadataIndex, body)[0].offset)
        elif opcode == Opcode.STATISTICS:
            self._counted, _ = parse(Statistics, body)
            counts = self._counted.channel_message_counts
            self.message_counts = counts if counts or not self._counted.message_count else None

    def check(self) -> None:
        """Find out whether it is complete.

        Raises
        ------
        DamagedError
            If it names places that are behind it, or describes a channel in two ways.
        """
        places = [*self.chunks.offsets, *self.metadata, *(one.offset for one in self.attachments)]
        if max(places, default=0) >= self.start:
            raise DamagedError("names places that are not in the file")
        if self.table.conflicts:
            raise DamagedError("describes a channel in two ways")
        counted = self._counted
        self.complete = (
            counted is not None
            and self.checked
            and (
                len(self.table.schemas) == counted.schema_count
                and len(self.table.channels) == counted.channel_count
                and len(self.attachments) == counted.attachment_count
                and len(self.metadata) == counted.metadata_count
                and len(self.chunks) == counted.chunk_count
            )
        )


def read_footer(file: BinaryIO, size: int) -> tuple[int, int, int]:
    """Offset of the footer of a file of `size` bytes, that of the summary section or 0, and its checksum or 0.

    Raises
    ------
    DamagedError
        If the file does not end with a footer.
    """
    offset = size - len(MCAP0_MAGIC) - _FOOTER_SIZE
    if offset < len(MCAP0_MAGIC):
        raise DamagedError("is missing")
    opcode, body = read_record(file, offset, size)
    if opcode != Opcode.FOOTER or file.read() != MCAP0_MAGIC:
        raise DamagedError("does not end with a footer and MCAP's magic")
    footer, _ = parse(Footer, body)
    if footer.summary_start > offset:
        raise DamagedError("does not fit the file")
    return offset, footer.summary_start, footer.summary_crc


def read_summary(file: BinaryIO, size: int) -> SummarySection | None:
    """The summary section of a file of `size` bytes; None where it has no checksum, and makes no sense.

    Raises
    ------
    DamagedError
        If it is missing or does not match its checksum.
    """
    offset, start, checksum = read_footer(file, size)
    summary = SummarySection(start or offset, bool(checksum))
    content = _checked(file, summary.start, offset + _FOOTER_SIZE - 4 - summary.start, checksum)
    records = []
    position, end = 0, offset - summary.start
    try:
        while position < end:
            opcode, length = RECORD_HEAD.unpack_from(content, position)
            position += RECORD_HEAD.size + length
            records.append((opcode, content[position - length : position]))
        for opcode, body in sorted(records, key=lambda record: record[0]):  # schemas before channels
            summary.add(opcode, body)
        summary.check()
    except (DamagedError, struct.error) as error:
        if not checksum:
            return None
        raise DamagedError(str(error)) from error
    return summary


def _checked(file: BinaryIO, begin: int, size: int, checksum: int) -> bytes:
    """`size` bytes of a file, if they fit their `checksum` or have none (0); the size may be damaged, too."""
    if size > LARGEST_CHUNK:
        raise DamagedError(f"has {size} bytes, expected at most {LARGEST_CHUNK}")
    if checksum and file_checksum(file, begin, size) != checksum:
        raise DamagedError("does not match its checksum")
    file.seek(begin)
    return file.read(size)


def file_checksum(file: BinaryIO, begin: int, size: int, checksum: int = 0) -> int:
    """CRC-32 of `size` bytes of a `file` from `begin` on, which goes on from the `checksum` of what is before."""
    file.seek(begin)
    for position in range(0, size, _BLOCK):
        checksum = zlib.crc32(file.read(min(_BLOCK, size - position)), checksum)
    return checksum
