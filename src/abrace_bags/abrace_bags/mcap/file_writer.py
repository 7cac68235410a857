# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, written record by record, with checksums and a summary section.

Everything that is written goes to the operating system at once, so that it is kept if the process is killed; after
`sync` it is on the disk. A file has its name once readers can open it; before that the name ends in `.part`.

`mcap.writer.Writer` can't serve here: it neither ends a chunk before it is full nor syncs, and keeps some 600 bytes of
each chunk, which at ten flushes a second are half a gigabyte a day.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from abrace_bags.mcap.records import LATEST_TIME, MCAP0_MAGIC, RECORD_HEAD, largest_record, record_bytes
from abrace_core import AbraceError
from abrace_core.files.writing import move

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from abrace_bags.mcap.contents import TopicContent

CHUNK_SIZE = 64 * 1024
"""Bytes of messages in a chunk, before compression."""
CHUNKS_DESCRIBED = 100
"""Schemas and channels are repeated in the second chunk and in every such number of chunks after it: messages can then
be read of a file that was cut off and whose first chunk is damaged."""

_MESSAGE = int(Opcode.MESSAGE)
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = _MESSAGE_HEAD.size - RECORD_HEAD.size
_INDEX_HEAD = struct.Struct("<BQHI")
_SEQUENCES = 2**32 - 1


@dataclass(eq=False, kw_only=True)
class WrittenTopic:
    """A topic that is being written.

    Parameters
    ----------
    schema, channel
        Its records; several topics may have the same schema.
    profiles
        QoS of its publishers in rosbag2's words.
    content
        What is in the chunks of all files.
    sequence
        Number of its last message.
    in_file
        Messages in the chunks of the file that is being written.
    index
        Of its messages in the chunk that is being filled: log time [ns] and offset, one after the other.
    """

    schema: Schema
    channel: Channel
    profiles: list[dict[str, Any]]
    content: TopicContent
    sequence: int = 0
    in_file: int = 0
    index: list[int] = field(default_factory=list)


class McapWriter:
    """An MCAP file that is being written; errors of the file system are raised as OSError.

    Parameters
    ----------
    path
        The file, which must not exist.
    topics
        All of the bag: those that come later are described (`describe`) before their first message.
    records
        Metadata records at its beginning: texts by key, by the record's name.
    attachments
        Files that follow these.

    Raises
    ------
    AbraceError
        If a record is larger than readers accept.

    Attributes
    ----------
    path
        The file.
    size
        Bytes of the file so far, without the chunk that is being filled.
    first_time, last_time
        Least and greatest log time of the messages in complete chunks [ns].
    """

    def __init__(
        self,
        path: Path,
        topics: Collection[WrittenTopic],
        records: Mapping[str, Mapping[str, str]],
        attachments: Iterable[Attachment] = (),
    ) -> None:
        self.path = path
        self._part = path.with_name(f"{path.name}.part")
        self._topics = topics
        self._compress = zstandard.ZstdCompressor().compress
        # as bytes: some 100 for each chunk
        self._chunk_index = bytearray()
        self._chunk_count = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.size = 0
        self.first_time, self.last_time = LATEST_TIME, 0
        self._synced = 0
        self._checksum = 0
        self._begin_chunk()
        self._file = self._part.open("xb", buffering=0)
        try:
            self._append(MCAP0_MAGIC)
            self._append_record(Header("ros2", "abrace"))
            for name, texts in records.items():
                self.add_metadata(name, texts)
            for attachment in attachments:
                self._add_attachment(attachment)
            self._describe_all()
            self.sync()
            move(self._part, path)
        except BaseException:
            self.abandon()
            raise
        for one in topics:
            one.in_file = 0

    @property
    def count(self) -> int:
        """Messages in the chunks of the file."""
        return sum(one.in_file for one in self._topics)

    @property
    def index_size(self) -> int:
        """Bytes of memory that the index of the chunks takes."""
        return len(self._chunk_index)

    def describe(self, record: Schema | Channel) -> None:
        """Add the `record` of a schema, or of a channel before its first message, to the chunk."""
        content = record_bytes(record)
        self._records.append(content)
        self._chunk_size += len(content)

    def add_message(self, topic: WrittenTopic, payload: bytes, log_time: int, publish_time: int) -> bool:
        """Add a message of a `topic`, its serialised `payload`, to the chunk.

        `log_time` and `publish_time` [ns] are when it arrived and when it was published. Returns whether the chunk is
        full: it is time to `flush`.
        """
        size = len(payload)
        topic.sequence += 1
        head = _MESSAGE_HEAD.pack(
            _MESSAGE, _MESSAGE_FIELDS + size, topic.channel.id, topic.sequence & _SEQUENCES, log_time, publish_time
        )
        self._records += (head, payload)
        topic.index += (log_time, self._chunk_size)
        self._chunk_size += _MESSAGE_HEAD.size + size
        return self._chunk_size > CHUNK_SIZE

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Add a metadata record of this `name` with `texts` by key."""
        offset = self.size
        self._append_record(Metadata(name=name, metadata=dict(texts)))
        self._metadata.append(MetadataIndex(offset=offset, length=self.size - offset, name=name))

    def flush(self) -> None:
        """End the chunk and hand everything to the operating system."""
        written = [one for one in self._topics if one.index]
        if not written:
            return
        content = b"".join(self._records)
        first = min(min(one.index[::2]) for one in written)
        last = max(max(one.index[::2]) for one in written)
        chunk = Chunk(
            compression="zstd",
            data=self._compress(content),
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        records = [record_bytes(chunk)]
        length = end = len(records[0])
        offsets = {}
        for one in written:
            offsets[one.channel.id] = self.size + end
            size = 8 * len(one.index)
            records.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, one.channel.id, size))
            records.append(struct.pack(f"<{len(one.index)}Q", *one.index))
            end += _INDEX_HEAD.size + size
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=self.size,
            compression="zstd",
            compressed_size=len(chunk.data),
            message_end_time=last,
            message_index_length=end - length,
            message_index_offsets=offsets,
            message_start_time=first,
            uncompressed_size=len(content),
        )
        self._append(b"".join(records))
        self._chunk_index += record_bytes(index)
        self._chunk_count += 1
        self.first_time, self.last_time = min(self.first_time, first), max(self.last_time, last)
        for one in written:
            one.in_file += len(one.index) // 2
            one.content.write(one.index[::2], content, one.index[1::2])
        self._begin_chunk()
        if self._chunk_count % CHUNKS_DESCRIBED == 1:
            self._describe_all()

    def sync(self) -> None:
        """As `flush`, and wait until the file is on the disk."""
        self.flush()
        if self._synced < self.size:
            os.fdatasync(self._file.fileno())
            self._synced = self.size

    def finish(self) -> None:
        """Write the summary section, sync and close the file."""
        self.flush()
        self._append_record(DataEnd(self._checksum))
        start = self.size
        schemas = self._schemas()
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._topics),
            channel_message_counts={one.channel.id: one.in_file for one in self._topics},
            chunk_count=self._chunk_count,
            message_count=self.count,
            message_end_time=self.last_time,
            message_start_time=self.first_time if self._chunk_count else 0,
            metadata_count=len(self._metadata),
            schema_count=len(schemas),
        )
        groups: list[tuple[int, bytes | bytearray]] = [
            (Opcode.SCHEMA, _joined(schemas)),
            (Opcode.CHANNEL, _joined(one.channel for one in self._topics)),
            (Opcode.STATISTICS, record_bytes(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_index),
            (Opcode.ATTACHMENT_INDEX, _joined(self._attachments)),
            (Opcode.METADATA_INDEX, _joined(self._metadata)),
        ]
        summary = b""
        offsets = []
        for opcode, group in groups:
            if group:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        summary += _joined((*offsets, footer))[:-4]
        self._append(summary + zlib.crc32(summary).to_bytes(4, "little") + MCAP0_MAGIC)
        self.sync()
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._part.unlink()

    def _schemas(self) -> Collection[Schema]:
        return {one.schema.id: one.schema for one in self._topics}.values()

    def _add_attachment(self, attachment: Attachment) -> None:
        offset = self.size
        self._append_record(attachment)
        index = AttachmentIndex(
            offset=offset,
            length=self.size - offset,
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._attachments.append(index)

    def _begin_chunk(self) -> None:
        self._records: list[bytes] = []
        self._chunk_size = 0
        for one in self._topics:
            one.index.clear()

    def _describe_all(self) -> None:
        for schema in self._schemas():
            self.describe(schema)
        for one in self._topics:
            self.describe(one.channel)

    def _append_record(self, record: McapRecord) -> None:
        """Append a record; one that the reader would take for damaged, as it is too large, is an AbraceError."""
        content = record_bytes(record)
        size, most = len(content) - RECORD_HEAD.size, largest_record(content[0])
        if size > most:
            named = f"{type(record).__name__.lower()} {getattr(record, 'name', '')}".rstrip()
            raise AbraceError(f"{self.path}: {named} has {size} bytes, expected at most {most}")
        self._append(content)

    def _append(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._checksum = zlib.crc32(content, self._checksum)
        self.size += len(content)


def _joined(records: Iterable[McapRecord]) -> bytes:
    return b"".join(map(record_bytes, records))
