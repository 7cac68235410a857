# SPDX-License-Identifier: Apache-2.0
"""The chunk of an MCAP file that is being filled; when it is full, its record and its message indexes."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from abrace_bags.mcap.records import record_bytes
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcap.records import McapRecord

CHUNK_SIZE = 64 * 1024
"""Bytes of messages in a chunk, before compression."""

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_AFTER_LENGTH = _MESSAGE_HEAD.size - 9
_SEQUENCES = 2**32 - 1
_LATEST = 2**64 - 1


def compressor(compression: str) -> tuple[str, Callable[[bytes], bytes]]:
    """MCAP's name for a compression, and the function that compresses.

    Parameters
    ----------
    compression
        `zstd`, `lz4` or `none`.

    Raises
    ------
    AbraceError
        If it is none of these.
    """
    if compression == "zstd":
        return "zstd", zstandard.ZstdCompressor().compress
    if compression == "lz4":
        return "lz4", lz4.frame.compress
    if compression == "none":
        return "", bytes
    raise AbraceError(f"compression {compression!r}, expected zstd, lz4 or none")


class ChunkWriter:
    """The chunk that messages are being added to.

    Attributes
    ----------
    size
        Bytes in it.
    """

    def __init__(self) -> None:
        self.size = 0
        self._parts: list[bytes] = []
        self._index: dict[int, list[int]] = {}
        self._first = _LATEST
        self._last = 0

    @property
    def has_messages(self) -> bool:
        """Whether it holds more than schemas and channels."""
        return bool(self._index)

    def counts(self) -> dict[int, int]:
        """Messages in it, by channel."""
        return {channel: len(index) // 2 for channel, index in self._index.items()}

    def describe(self, record: McapRecord) -> None:
        """Add the `record` of a schema or a channel, before the messages that refer to it."""
        part = record_bytes(record)
        self._parts.append(part)
        self.size += len(part)

    def add(self, channel: int, sequence: int, payload: bytes, log_time: int, publish_time: int) -> None:
        """Add a message.

        Parameters
        ----------
        channel
            Its channel's id.
        sequence
            Its number among those of its channel.
        payload
            As it came from the wire.
        log_time, publish_time
            When it arrived and when it was published [ns].
        """
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE, _AFTER_LENGTH + len(payload), channel, sequence & _SEQUENCES, log_time, publish_time
        )
        self._parts += (head, payload)
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        index += (log_time, self.size)
        self.size += _MESSAGE_HEAD.size + len(payload)
        if log_time > self._last:
            self._last = log_time
        if log_time < self._first:
            self._first = log_time

    def packed(self, name: str, compress: Callable[[bytes], bytes], offset: int) -> tuple[bytes, ChunkIndex]:
        """The chunk's record and its message indexes, and the chunk index for the summary section.

        Parameters
        ----------
        name, compress
            From `compressor`.
        offset
            Where in the file the chunk is to begin.
        """
        content = b"".join(self._parts)
        chunk = Chunk(
            compression=name,
            data=compress(content),
            message_start_time=self._first,
            message_end_time=self._last,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        records = [record_bytes(chunk)]
        length = end = len(records[0])
        offsets = {}
        for channel, index in self._index.items():
            offsets[channel] = offset + end
            size = 8 * len(index)
            records.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            records.append(struct.pack(f"<{len(index)}Q", *index))
            end += _INDEX_HEAD.size + size
        summary = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=name,
            compressed_size=len(chunk.data),
            message_end_time=self._last,
            message_index_length=end - length,
            message_index_offsets=offsets,
            message_start_time=self._first,
            uncompressed_size=len(content),
        )
        return b"".join(records), summary
