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

from abrace_bags.mcap.records import LARGEST_CHUNK, MCAP0_MAGIC, RECORD_HEAD, DamagedError, next_record, parse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

_FOOTER_SIZE = RECORD_HEAD.size + 20
_CHUNK_INDEX = struct.Struct("<4QI")
_INDEX_OFFSET = np.dtype([("id", "<u2"), ("offset", "<u8")])
_BLOCK = 1 << 20


@dataclass(frozen=True)
class RecordedChannel:
    """A channel with its schema.

    Parameters
    ----------
    topic
        Its name.
    message_encoding
        How its messages are serialised: `cdr` in bags of ROS 2.
    metadata
        From rosbag2: `offered_qos_profiles` and `topic_type_hash`.
    type_name, schema_encoding, definition
        Of its message type; empty where the schema is unknown.
    """

    topic: str
    message_encoding: str
    metadata: Mapping[str, str]
    type_name: str
    schema_encoding: str
    definition: str


@dataclass
class ChannelTable:
    """Channels and schemas by their ids."""

    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    channels: dict[int, RecordedChannel] = field(default_factory=dict)

    def add(self, opcode: int, body: bytes) -> None:
        """Add a schema or a channel: the `opcode` of its record and the `body`, which is the content."""
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, body)
            try:
                self.schemas[schema.id] = schema.name, schema.encoding, schema.data.decode()
            except UnicodeDecodeError as error:
                raise DamagedError("contains text that is not UTF-8") from error
        else:
            channel = parse(Channel, body)
            described = self.schemas.get(channel.schema_id, ("", "", ""))
            self.channels[channel.id] = RecordedChannel(
                channel.topic, channel.message_encoding, channel.metadata, *described
            )


@dataclass(frozen=True)
class MessageFilter:
    """Which messages to keep.

    Parameters
    ----------
    accepts
        Whether to keep a channel's messages.
    begin, end
        Log times [ns], `begin` included, `end` not; None: from the first, to the last.
    """

    accepts: Callable[[RecordedChannel], bool]
    begin: int | None = None
    end: int | None = None


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

    def matching(self, message_filter: MessageFilter, channels: Mapping[int, RecordedChannel]) -> NDArray[np.intp]:
        """Numbers of the chunks in which `message_filter` may keep messages of the file's `channels`, in its order."""
        refused = {number for number, channel in channels.items() if not message_filter.accepts(channel)}
        wanted = {held: not held or bool(held - refused) for held in set(self.held)}
        matching = np.array([wanted[held] for held in self.held], bool)
        if message_filter.begin is not None:
            matching &= np.array(self.ends, np.uint64) >= max(message_filter.begin, 0)
        if message_filter.end is not None:
            matching &= np.array(self.starts, np.uint64) < max(message_filter.end, 0)
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
        By channel id; None where there are no statistics.
    first_time, last_time
        Of its messages, by the statistics [ns].
    chunks
        Where they are.
    other_offsets
        Where attachments and metadata records begin.
    complete
        Whether it has everything that the statistics count.
    """

    start: int
    table: ChannelTable = field(default_factory=ChannelTable)
    message_counts: Mapping[int, int] | None = None
    first_time: int = 0
    last_time: int = 0
    chunks: ChunkTable = field(default_factory=ChunkTable)
    other_offsets: list[int] = field(default_factory=list)
    complete: bool = False


def read_summary(file: BinaryIO, size: int) -> SummarySection | None:
    """The summary section of a file of `size` bytes; None where it has no checksum.

    Raises
    ------
    DamagedError
        If it is missing or does not match its checksum.
    """
    footer_offset = size - len(MCAP0_MAGIC) - _FOOTER_SIZE
    if footer_offset < len(MCAP0_MAGIC):
        raise DamagedError("is missing")
    file.seek(footer_offset)
    opcode, body = next_record(file, size)
    if opcode != Opcode.FOOTER or file.read() != MCAP0_MAGIC:
        raise DamagedError("does not end with a footer and MCAP's magic")
    footer = parse(Footer, body)
    if footer.summary_crc == 0:
        return None
    if footer.summary_start > footer_offset:
        raise DamagedError("does not fit the file")
    summary = SummarySection(footer.summary_start or footer_offset)
    file.seek(summary.start)
    content = _checked(file, footer_offset - summary.start + _FOOTER_SIZE - 4, footer.summary_crc)
    records: dict[int, list[bytes]] = {}
    position, end = 0, footer_offset - summary.start
    while position < end:
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        position += RECORD_HEAD.size + length
        records.setdefault(opcode, []).append(content[position - length : position])
    for opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        for body in records.get(opcode, ()):
            summary.table.add(opcode, body)
    for body in records.get(Opcode.CHUNK_INDEX, ()):
        summary.chunks.add(body)
    summary.other_offsets = [parse(AttachmentIndex, body).offset for body in records.get(Opcode.ATTACHMENT_INDEX, ())]
    summary.other_offsets += [parse(MetadataIndex, body).offset for body in records.get(Opcode.METADATA_INDEX, ())]
    for body in records.get(Opcode.STATISTICS, ()):
        statistics = parse(Statistics, body)
        summary.message_counts = statistics.channel_message_counts
        summary.first_time, summary.last_time = statistics.message_start_time, statistics.message_end_time
        counted = statistics.attachment_count + statistics.metadata_count
        summary.complete = (
            len(summary.table.schemas) == statistics.schema_count
            and len(summary.table.channels) == statistics.channel_count
            and len(summary.other_offsets) == counted
            and len(summary.chunks) == statistics.chunk_count
        )
    return summary


def _checked(file: BinaryIO, size: int, checksum: int) -> bytes:
    """The next `size` bytes of a file, if they fit their `checksum`; the size may be damaged, too."""
    if size > LARGEST_CHUNK:
        raise DamagedError(f"has {size} bytes, expected at most {LARGEST_CHUNK}")
    found = 0
    begin = file.tell()
    for position in range(0, size, _BLOCK):
        found = zlib.crc32(file.read(min(_BLOCK, size - position)), found)
    if found != checksum:
        raise DamagedError("does not match its checksum")
    file.seek(begin)
    return file.read(size)
