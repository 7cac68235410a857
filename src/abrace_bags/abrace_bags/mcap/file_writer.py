# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, written record by record, with checksums and a summary section.

Everything that is written goes to the operating system at once, so that it is kept if the process is killed; after
`sync` it is on the disk. The name ends in `.part` until readers can open the file.

`mcap`'s own writer makes Python objects of every message: 2.5 microseconds each, too slow for a flood of messages. Here
a message is two byte strings in the chunk that is being filled; all other records are `mcap`'s.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
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

from abrace_bags.mcap.chunk_writer import CHUNK_SIZE, ChunkWriter
from abrace_bags.mcap.records import MCAP0_MAGIC, record_bytes
from abrace_core.files import move

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
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
        The file, which must not exist; `path` and `.part` until `publish`.
    compression, compress
        From `compressor`.

    Attributes
    ----------
    path
        The file.
    size
        Bytes of the file so far, without the chunk that is being filled.
    """

    def __init__(self, path: Path, compression: str, compress: Callable[[bytes], bytes]) -> None:
        self.path = path
        self._part = path.with_name(f"{path.name}.part")
        self._compression, self._compress = compression, compress
        self._chunk = ChunkWriter()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        # kept as bytes: some 100 for each chunk, instead of 600 as records, which would be half a gigabyte a day
        self._chunk_index = bytearray()
        self._chunk_count = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.size = 0
        self._synced = 0
        self._checksum = 0
        self._file = self._part.open("xb", buffering=0)
        try:
            self._append(MCAP0_MAGIC)
            self._append_record(Header("ros2", "abrace"))
        except OSError:
            self.abandon()
            raise

    def publish(self) -> None:
        """Rename the file to its final name, now that readers can open it."""
        self.sync()
        move(self._part, self.path)

    def add_schema(self, schema: Schema) -> None:
        """Add a `schema`, the description of a message type, before its channels."""
        self._schemas.append(schema)
        self._chunk.describe(schema)

    def add_channel(self, channel: Channel) -> None:
        """Add a `channel`, the description of a topic, before its messages."""
        self._channels.append(channel)
        self._chunk.describe(channel)

    def add_message(self, channel: int, sequence: int, payload: bytes, log_time: int, publish_time: int) -> bool:
        """Add a message to the chunk, as in `ChunkWriter.add`; returns whether it is time to `flush` that."""
        self._chunk.add(channel, sequence, payload, log_time, publish_time)
        return self._chunk.size > CHUNK_SIZE

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

    def sync(self) -> None:
        """As `flush`, and wait until the file is on the disk."""
        self._end_chunk()
        if self._synced < self.size:
            os.fdatasync(self._file.fileno())
            self._synced = self.size

    def finish(self, span: FileSpan) -> None:
        """Write the summary section, sync and close the file; `span` is what the file holds."""
        self._end_chunk()
        self._append_record(DataEnd(self._checksum))
        start = self.size
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=span.counts,
            chunk_count=self._chunk_count,
            message_count=span.count,
            message_end_time=span.last_time,
            message_start_time=span.first_time if span.count else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[int, bytes | bytearray]] = [
            (Opcode.SCHEMA, _joined(self._schemas)),
            (Opcode.CHANNEL, _joined(self._channels)),
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
        summary += b"".join(map(record_bytes, (*offsets, footer)))[:-4]
        self._append(summary + zlib.crc32(summary).to_bytes(4, "little") + MCAP0_MAGIC)
        self.sync()
        self._file.close()

    def abandon(self) -> dict[int, int]:
        """Close the file as it is; returns how many messages of each channel are not in it."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._part.unlink()
        return self._chunk.counts()

    def _end_chunk(self) -> None:
        if not self._chunk.has_messages:
            return
        records, index = self._chunk.packed(self._compression, self._compress, self.size)
        self._append(records)
        self._chunk = ChunkWriter()
        self._chunk_index += record_bytes(index)
        self._chunk_count += 1
        if self._chunk_count % CHUNKS_DESCRIBED == 1:
            for record in (*self._schemas, *self._channels):
                self._chunk.describe(record)

    def _append_record(self, record: McapRecord) -> None:
        self._append(record_bytes(record))

    def _append(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._checksum = zlib.crc32(content, self._checksum)
        self.size += len(content)


def _joined(records: Iterable[McapRecord]) -> bytes:
    return b"".join(map(record_bytes, records))
