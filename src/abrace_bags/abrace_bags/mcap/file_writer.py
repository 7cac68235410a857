"""One MCAP file, written record by record, with checksums and a summary section.

`mcap`'s own writer makes Python objects of every message: 2.5 microseconds each, too slow for a flood of messages. Here
a message is two byte strings in the chunk that is being filled; all other records are `mcap`'s.
"""

from __future__ import annotations

import contextlib
import zlib
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
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
from mcap.writer import MCAP0_MAGIC

from abrace_bags.mcap.chunk_writer import CHUNK_SIZE, ChunkWriter
from abrace_bags.mcap.records import record_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from abrace_bags.metadata import FileSpan

CHUNKS_DESCRIBED = 100
"""Schemas and channels are repeated in the second chunk and in every such number of chunks after it: messages can then
be read of a file that was cut off and whose first chunk is damaged."""


class McapWriter:
    """An MCAP file that is being written; errors of the file system are raised as OSError.

    Parameters
    ----------
    path
        The file, which must not exist.
    compression, compress
        From `compressor`.

    Attributes
    ----------
    size
        Bytes of the file so far, without the chunk that is being filled.
    """

    def __init__(self, path: Path, compression: str, compress: Callable[[bytes], bytes]) -> None:
        self._compression, self._compress = compression, compress
        self._chunk = ChunkWriter()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.size = 0
        self._checksum = 0
        self._file = path.open("xb")
        self._append(MCAP0_MAGIC)
        self._append_record(Header("ros2", "abrace"))

    @property
    def closed(self) -> bool:
        """Whether nothing more can be written."""
        return self._file.closed

    def add_schema(self, schema: Schema) -> None:
        """Add a `schema`, the description of a message type, before its channels."""
        self._schemas.append(schema)
        self._chunk.describe(schema)

    def add_channel(self, channel: Channel) -> None:
        """Add a `channel`, the description of a topic, before its messages."""
        self._channels.append(channel)
        self._chunk.describe(channel)

    def add_message(self, channel: int, sequence: int, payload: bytes, log_time: int, publish_time: int) -> None:
        """Add a message, as in `ChunkWriter.add`; a full chunk goes to the file."""
        self._chunk.add(channel, sequence, payload, log_time, publish_time)
        if self._chunk.size > CHUNK_SIZE:
            self._end_chunk()

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Add a metadata record of this `name` with `texts` by key."""
        offset = self.size
        self._append_record(Metadata(name=name, metadata=dict(texts)))
        self._metadata.append(MetadataIndex(offset=offset, length=self.size - offset, name=name))

    def add_attachment(self, attachment: Attachment) -> None:
        """Add an `attachment`: a file's name and content."""
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

    def flush(self) -> None:
        """End the chunk and hand everything to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self, span: FileSpan) -> None:
        """Write the summary section and close the file; `span` is what the file holds."""
        self._end_chunk()
        self._append_record(DataEnd(self._checksum))
        start = self.size
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=span.counts,
            chunk_count=len(self._chunks),
            message_count=span.count,
            message_end_time=span.last_time,
            message_start_time=span.first_time if span.count else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        summary = b""
        offsets = []
        for opcode, records in groups:
            group = b"".join(map(record_bytes, records))
            if records:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        summary += b"".join(map(record_bytes, (*offsets, footer)))[:-4]
        self._file.write(summary + zlib.crc32(summary).to_bytes(4, "little") + MCAP0_MAGIC)
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _end_chunk(self) -> None:
        if not self._chunk.has_messages:
            return
        records, index = self._chunk.packed(self._compression, self._compress, self.size)
        self._chunk = ChunkWriter()
        self._append(records)
        self._chunks.append(index)
        if len(self._chunks) % CHUNKS_DESCRIBED == 1:
            for record in (*self._schemas, *self._channels):
                self._chunk.describe(record)

    def _append_record(self, record: McapRecord) -> None:
        self._append(record_bytes(record))

    def _append(self, content: bytes) -> None:
        self._checksum = zlib.crc32(content, self._checksum)
        self._file.write(content)
        self.size += len(content)
