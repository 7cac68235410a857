"""The chunk of an MCAP file that is being filled: packed, checksummed, with an index of where each message is."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcap.records import Channel, Schema

CHUNK_SIZE = 64 * 1024
"""Bytes of messages in a chunk, before compression."""

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_AFTER_LENGTH = _MESSAGE_HEAD.size - 9
_COUNTS = 2**32 - 1
_LATEST = 2**64 - 1


def compressor(compression: str) -> tuple[str, Callable[[bytes], bytes]]:
    """MCAP's name for a compression, and what does it.

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


class OpenChunk:
    """The chunk that messages are being added to.

    Attributes
    ----------
    size
        Bytes in it.
    """

    def __init__(self) -> None:
        self.size = 0
        self._parts: list[bytes] = []
        self._places: dict[int, list[int]] = {}
        self._first = _LATEST
        self._last = 0

    @property
    def has_messages(self) -> bool:
        """Whether it holds more than descriptions."""
        return bool(self._places)

    def describe(self, record: Schema | Channel) -> None:
        """Add what the messages after it refer to.

        Parameters
        ----------
        record
            A topic or a type.
        """
        builder = RecordBuilder()
        record.write(builder)
        part = builder.end()
        self._parts.append(part)
        self.size += len(part)

    def add(self, channel: int, count: int, payload: bytes, log_time: int, publish_time: int) -> None:
        """Add a message.

        Parameters
        ----------
        channel
            Its topic's number.
        count
            Its number among those of its topic.
        payload
            As it came from the wire.
        log_time, publish_time
            When it arrived and when it was published [ns].
        """
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE, _AFTER_LENGTH + len(payload), channel, count & _COUNTS, log_time, publish_time
        )
        self._parts += (head, payload)
        places = self._places.get(channel)
        if places is None:
            places = self._places[channel] = []
        places += (log_time, self.size)
        self.size += _MESSAGE_HEAD.size + len(payload)
        if log_time > self._last:
            self._last = log_time
        if log_time < self._first:
            self._first = log_time

    def packed(self, name: str, compress: Callable[[bytes], bytes], offset: int) -> tuple[bytes, ChunkIndex]:
        """The records of the chunk and of its messages' places, and what the file's index says of it.

        Parameters
        ----------
        name, compress
            From `compressor`.
        offset
            Where in the file the chunk is to begin.
        """
        content = b"".join(self._parts)
        builder = RecordBuilder()
        chunk = Chunk(
            compression=name,
            data=compress(content),
            message_start_time=self._first,
            message_end_time=self._last,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        chunk.write(builder)
        length = builder.count
        offsets = {}
        for channel, places in self._places.items():
            offsets[channel] = offset + builder.count
            size = 8 * len(places)
            builder.write(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            builder.write(struct.pack(f"<{len(places)}Q", *places))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=name,
            compressed_size=len(chunk.data),
            message_end_time=self._last,
            message_index_length=builder.count - length,
            message_index_offsets=offsets,
            message_start_time=self._first,
            uncompressed_size=len(content),
        )
        return builder.end(), index
