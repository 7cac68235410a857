# SPDX-License-Identifier: Apache-2.0
"""A chunk of an MCAP file: search in a damaged file, decompression, check, and its messages."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode

from abrace_bags.mcap.records import LARGEST_CHUNK, RECORD_HEAD, DamagedError

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from mcap.records import Chunk
    from numpy.typing import NDArray

    from abrace_bags.mcap.index import ChannelTable

_CHUNK_HEAD = re.compile(rb"\x06(.{5}\0{3}).{28}(\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})(.{8})", re.DOTALL)
"""What a chunk's record begins with: opcode, length, times, size, checksum, name of the compression, packed bytes."""
_CHUNK_OPCODE = b"\x06"
_HEAD_SIZE = 64
"""Bytes that hold it."""
_SEARCH_SIZE = 1 << 22
"""Bytes that are searched for a chunk at a time."""

MESSAGE_HEAD_SIZE = 31
"""Bytes of a message record before the message: opcode, length, channel, sequence, log time, publish time."""
LOG_TIME, PUBLISH_TIME = 15, 23
"""Offset of the times in it."""


def find_chunk(file: BinaryIO, begin: int, size: int) -> int | None:
    """Offset of the next chunk that looks complete: its lengths are consistent with each other and the file.

    Parameters
    ----------
    file
        Where to look.
    begin
        From where on.
    size
        Of the file.
    """
    while begin < size:
        file.seek(begin)
        searched = file.read(_SEARCH_SIZE)
        position = -1
        while (position := searched.find(_CHUNK_OPCODE, position + 1)) >= 0:
            match = _CHUNK_HEAD.match(searched, position)
            if match is None:
                continue
            offset = begin + position
            length, packed_size = (int.from_bytes(match[group], "little") for group in (1, 3))
            if 36 + len(match[2]) + packed_size == length <= size - offset - RECORD_HEAD.size:
                return offset
        last = begin + len(searched) >= size
        begin += len(searched) if last else len(searched) - _HEAD_SIZE
    return None


def unpack(chunk: Chunk) -> bytes:
    """The records of a whole chunk.

    Raises
    ------
    DamagedError
        If it does not unpack, or does not match its checksum.
    """
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise DamagedError(f"does not unpack: has {size} bytes, expected at most {LARGEST_CHUNK}")
    try:
        if chunk.compression == "zstd":
            frame_size = zstandard.frame_content_size(chunk.data)
            if frame_size not in (-1, size):
                raise DamagedError(f"does not unpack: is {frame_size} bytes, expected {size}")
            records = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1))
        elif chunk.compression == "":
            records = chunk.data
        else:
            raise DamagedError(f"does not unpack: compression {chunk.compression!r}, expected zstd, lz4 or none")
    except (zstandard.ZstdError, RuntimeError, MemoryError, OverflowError) as error:
        raise DamagedError(f"does not unpack: {error}") from error
    if len(records) != size or (chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc):
        raise DamagedError("does not match its checksum")
    return records


def unpack_beginning(chunk: Chunk) -> bytes:
    """The whole records at the beginning of a chunk that is cut off; its checksum can't confirm them.

    Compressed data comes in blocks of up to 128 KiB, and of a block that is cut off comes nothing. After a power loss
    a file may end in zeros that were never written: a record that ends in them is not known to be whole.
    """
    records = b""
    size = min(chunk.uncompressed_size, LARGEST_CHUNK)
    try:
        if chunk.compression == "zstd":
            records = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size)
        elif chunk.compression == "lz4":
            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size))
        elif chunk.compression == "":
            records = chunk.data
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return b""
    written = len(records.rstrip(b"\0"))
    end = 0
    while end + RECORD_HEAD.size <= written:
        record_end = end + RECORD_HEAD.size + RECORD_HEAD.unpack_from(records, end)[1]
        if record_end > written:
            break
        end = record_end
    return records[:end]


def record_offsets(records: bytes, message_offsets: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Where the records of a chunk begin.

    Parameters
    ----------
    records
        The chunk, unpacked.
    message_offsets
        Of its message indexes. Used where each record then ends where the next one begins; otherwise all records are
        walked through, about 0.2 microseconds each.

    Returns
    -------
    ndarray
        (records,) in order.

    Raises
    ------
    DamagedError
        If the records do not fill the chunk.
    """
    end = len(records)
    if message_offsets:
        offsets = np.concatenate(message_offsets)
        offsets.sort()
        if offsets.size and offsets[0] == 0 and 0 <= offsets[-1] <= end - RECORD_HEAD.size:
            lengths = np.ndarray((end - RECORD_HEAD.size + 1,), "<u8", records, 1, (1,))[offsets].astype(np.int64)
            if np.array_equal(offsets + RECORD_HEAD.size + lengths, np.append(offsets[1:], end)):
                return offsets
    walked = []
    offset = 0
    length_at = struct.Struct("<Q").unpack_from
    while offset < end - 8:
        walked.append(offset)
        offset += 9 + length_at(records, offset + 1)[0]
    if offset != end:
        raise DamagedError("is a chunk whose records don't fill it")
    return np.array(walked, np.int64)


@dataclass(frozen=True)
class Messages:
    """Messages of a chunk, in the order in which they were written.

    Parameters
    ----------
    offset
        Of the chunk in its file; tells chunks of a file apart.
    records
        The chunk, unpacked.
    begins, sizes
        (messages,) where each message's record begins in it, and its bytes.
    channel_ids
        (messages,)
    """

    offset: int
    records: bytes
    begins: NDArray[np.int64]
    sizes: NDArray[np.int64]
    channel_ids: NDArray[np.uint16]

    @property
    def log_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self.numbers("<i8", LOG_TIME)

    @property
    def publish_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self.numbers("<i8", PUBLISH_TIME)

    def numbers(self, form: str, offset: int | NDArray[np.int64]) -> NDArray[Any]:
        """(messages,) the number of this form that each record has at an `offset`."""
        size = np.dtype(form).itemsize
        if not self.begins.size:
            return np.empty(0, form)
        everywhere = np.ndarray((len(self.records) - size + 1,), form, self.records, strides=(1,))
        return everywhere[self.begins + offset]

    def chosen(self, which: NDArray[Any]) -> Messages:
        """Some of them: `which` is a mask or their numbers."""
        return Messages(self.offset, self.records, self.begins[which], self.sizes[which], self.channel_ids[which])

    def payloads(self) -> list[bytes]:
        """Their serialised bytes."""
        ends = (self.begins + self.sizes).tolist()
        begins = (self.begins + MESSAGE_HEAD_SIZE).tolist()
        return [self.records[begin:end] for begin, end in zip(begins, ends, strict=True)]

    def kept(self, refused: Collection[int], begin: int | None, end: int | None) -> Messages:
        """Those that are not of `refused` channels, with log times [ns] from `begin` on and before `end`."""
        if begin is end is None and not refused:
            return self
        keep = ~np.isin(self.channel_ids, list(refused))
        if begin is not None:
            keep &= self.log_time >= begin
        if end is not None:
            keep &= self.log_time < end
        return self if keep.all() else self.chosen(keep)


def find_messages(
    offset: int, records: bytes, message_offsets: Sequence[NDArray[np.int64]], table: ChannelTable
) -> Messages:
    """The messages of a chunk.

    Parameters
    ----------
    offset
        Of the chunk in its file.
    records, message_offsets
        As for `record_offsets`.
    table
        Gets the schemas and channels that are in the chunk.

    Raises
    ------
    DamagedError
        If they are not what a chunk may hold.
    """
    begins = record_offsets(records, message_offsets)
    sizes = np.append(begins[1:], len(records)) - begins if begins.size else begins
    opcodes = np.frombuffer(records, np.uint8)[begins] if begins.size else begins
    is_message = opcodes == Opcode.MESSAGE
    if not is_message.all():
        for k in np.flatnonzero((opcodes == Opcode.SCHEMA) | (opcodes == Opcode.CHANNEL)):
            table.add(int(opcodes[k]), records[begins[k] + RECORD_HEAD.size : begins[k] + sizes[k]])
        begins, sizes = begins[is_message], sizes[is_message]
    if not begins.size:
        return Messages(offset, records, begins, sizes, np.empty(0, np.uint16))
    if sizes.min() < MESSAGE_HEAD_SIZE:
        raise DamagedError("holds a message that is too short")
    channel_ids = np.ndarray((len(records) - 1,), "<u2", records, strides=(1,))[begins + RECORD_HEAD.size]
    return Messages(offset, records, begins, sizes, channel_ids)
