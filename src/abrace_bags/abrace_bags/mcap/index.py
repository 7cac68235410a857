"""The summary section at the end of an MCAP file: channels, message counts, and where the chunks to read are."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Footer, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from abrace_bags.mcap.records import RECORD_HEAD, DamagedError, next_record, parse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_FOOTER_SIZE = RECORD_HEAD.size + 20


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
                raise DamagedError("holds text that is not UTF-8") from error
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

    def may_match(self, chunk: ChunkIndex, channels: Mapping[int, RecordedChannel]) -> bool:
        """Whether a chunk may hold such messages, by its index and the file's `channels`."""
        if self.end is not None and chunk.message_start_time >= self.end:
            return False
        if self.begin is not None and chunk.message_end_time < self.begin:
            return False
        held = [channels.get(number) for number in chunk.message_index_offsets]
        return not held or any(channel is None or self.accepts(channel) for channel in held)


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
    chunks
        In the order of the file.
    other_offsets
        Where attachments and metadata records begin.
    complete
        Whether it has everything that the statistics count.
    """

    start: int
    table: ChannelTable = field(default_factory=ChannelTable)
    message_counts: Mapping[int, int] | None = None
    chunks: list[ChunkIndex] = field(default_factory=list)
    other_offsets: list[int] = field(default_factory=list)
    complete: bool = False


def read_summary(file: BinaryIO, size: int) -> SummarySection | None:
    """The summary section of a file of `size` bytes; None where it has no checksum.

    Raises
    ------
    DamagedError
        If it is missing or does not fit its checksum.
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
    if zlib.crc32(file.read(footer_offset - summary.start + _FOOTER_SIZE - 4)) != footer.summary_crc:
        raise DamagedError("does not fit its checksum")
    file.seek(summary.start)
    records = []
    while file.tell() < footer_offset:
        records.append(next_record(file, size))
    statistics = None
    for opcode, body in sorted(records, key=lambda record: record[0]):  # schemas before channels
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            summary.table.add(opcode, body)
        elif opcode == Opcode.CHUNK_INDEX:
            summary.chunks.append(parse(ChunkIndex, body))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            summary.other_offsets.append(parse(AttachmentIndex, body).offset)
        elif opcode == Opcode.METADATA_INDEX:
            summary.other_offsets.append(parse(MetadataIndex, body).offset)
        elif opcode == Opcode.STATISTICS:
            statistics = parse(Statistics, body)
    summary.chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    if statistics is not None:
        summary.message_counts = statistics.channel_message_counts
        counted = statistics.attachment_count + statistics.metadata_count
        summary.complete = (
            len(summary.table.schemas) == statistics.schema_count
            and len(summary.table.channels) == statistics.channel_count
            and len(summary.other_offsets) == counted
            and len(summary.chunks) == statistics.chunk_count
        )
    return summary
