"""A chunk of an MCAP file: found in a damaged file, unpacked, checked, and the messages to keep taken out of it."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode

from abrace_bags.mcap.index import ChannelTable, MessageFilter
from abrace_bags.mcap.records import RECORD_HEAD, DamagedError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mcap.records import Chunk
    from numpy.typing import NDArray

_CHUNK_HEAD = re.compile(rb"(?=\x06(.{5}\0{3}).{28}(\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})(.{8}))", re.DOTALL)
"""What a chunk's record begins with: opcode, length, times, size, checksum, name of the compression, packed bytes."""
_HEAD_SIZE = 64
"""Bytes that hold it."""
_SEARCH_SIZE = 1 << 22
"""Bytes in which a chunk is looked for at a time."""

MESSAGE_HEAD_SIZE = 31
"""Bytes of a message record before the message: opcode, length, channel, sequence, log time, publish time."""
_LOG_TIME, _PUBLISH_TIME = 15, 23
"""Where the times stand in it."""


def find_chunk(file: BinaryIO, begin: int, size: int) -> int | None:
    """Offset of the next chunk that looks whole: its lengths fit each other and the file.

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
        for match in _CHUNK_HEAD.finditer(searched):
            offset = begin + match.start()
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
        If it does not unpack, or does not fit its checksum.
    """
    size = chunk.uncompressed_size
    try:
        if chunk.compression == "zstd":
            frame_size = zstandard.frame_content_size(chunk.data)
            if frame_size not in (-1, size):
                raise DamagedError(f"does not unpack: is {frame_size} bytes, expected {size}")
            records = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
        elif chunk.compression == "lz4":
            records = bytes(lz4.frame.decompress(chunk.data))
        elif chunk.compression == "":
            records = chunk.data
        else:
            raise DamagedError(f"does not unpack: compression {chunk.compression!r}, expected zstd, lz4 or none")
    except (zstandard.ZstdError, RuntimeError, MemoryError, OverflowError) as error:
        raise DamagedError(f"does not unpack: {error}") from error
    if len(records) != size or (chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc):
        raise DamagedError("does not fit its checksum")
    return records


def unpack_beginning(chunk: Chunk) -> bytes:
    """The whole records at the beginning of a chunk that is cut off; its checksum can't confirm them.

    Compressed data comes in blocks of up to 128 KiB, and of a block that is cut off comes nothing. After a power loss
    a file may end in zeros that were never written: a record that ends in them is not known to be whole.
    """
    records = b""
    try:
        if chunk.compression == "zstd":
            records = zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
        elif chunk.compression == "lz4":
            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data))
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


@dataclass
class Stream:
    """Messages of one channel: for each length that occurs, their numbers and their records.

    Parameters
    ----------
    count
        Messages.
    file_numbers
        Their numbers among the messages of all channels, chunk by chunk.
    blocks
        By length of the message: numbers among those of the channel, and records, chunk by chunk.
    """

    count: int = 0
    file_numbers: list[NDArray[np.int64]] = field(default_factory=list)
    blocks: dict[int, list[tuple[NDArray[np.int64], NDArray[np.void]]]] = field(default_factory=dict)

    def append(
        self, records: bytes, offsets: NDArray[np.int64], sizes: NDArray[np.int64], file_numbers: NDArray[np.int64]
    ) -> None:
        """Add messages: those of `sizes` bytes at `offsets` in the `records` of a chunk, with their `file_numbers`."""
        self.file_numbers.append(file_numbers)
        numbers = np.arange(self.count, self.count + offsets.size)
        self.count += offsets.size
        for size in np.unique(sizes).tolist():
            chosen = sizes == size
            # a record at every byte of the chunk, of which those that are records are copied
            everywhere = np.ndarray((len(records) - size + 1,), np.dtype(f"V{size}"), records, strides=(1,))
            block = (numbers[chosen], everywhere[offsets[chosen]])
            self.blocks.setdefault(size - MESSAGE_HEAD_SIZE, []).append(block)

    @property
    def log_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self._times(_LOG_TIME)

    @property
    def publish_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self._times(_PUBLISH_TIME)

    def _times(self, offset: int) -> NDArray[np.int64]:
        times = np.empty(self.count, np.int64)
        for size, blocks in self.blocks.items():
            for numbers, records in blocks:
                times[numbers] = records.view(_one_field(size, "<u8", offset))["field"]
        return times

    def payloads(self) -> list[tuple[NDArray[np.int64], NDArray[np.void]]]:
        """For each length that occurs: numbers of the messages, and their bytes."""
        payloads = []
        for size, blocks in self.blocks.items():
            records = np.concatenate([records for _, records in blocks])
            payload = records.view(_one_field(size, f"V{size}", MESSAGE_HEAD_SIZE))["field"]
            payloads.append((np.concatenate([numbers for numbers, _ in blocks]), payload))
        return payloads

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Log time and publish time [ns] and bytes of every message, in their order."""
        payloads: list[bytes] = [b""] * self.count
        for numbers, block in self.payloads():
            for number, payload in zip(numbers.tolist(), block.tolist(), strict=True):
                payloads[number] = payload
        yield from zip(self.log_time.tolist(), self.publish_time.tolist(), payloads, strict=True)


def _one_field(size: int, form: str, offset: int) -> np.dtype[np.void]:
    """Type of a message record with a payload of `size` bytes, of which one field is read."""
    itemsize = MESSAGE_HEAD_SIZE + size
    return np.dtype({"names": ["field"], "formats": [form], "offsets": [offset], "itemsize": itemsize})


@dataclass
class Selection:
    """Messages that a filter accepts, collected chunk by chunk.

    Parameters
    ----------
    filter
        Which messages to keep.
    table
        Channels and schemas so far.
    streams
        The messages kept, by channel id.
    counts
        Messages in the chunks, kept or not, by channel id.
    """

    filter: MessageFilter
    table: ChannelTable = field(default_factory=ChannelTable)
    streams: dict[int, Stream] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)

    def add_chunk(self, records: bytes, message_offsets: Sequence[NDArray[np.int64]]) -> int:
        """Keep the messages of a chunk that the filter accepts.

        Parameters
        ----------
        records, message_offsets
            As for `record_offsets`.

        Returns
        -------
        int
            Messages in the chunk.

        Raises
        ------
        DamagedError
            If they are not what a chunk may hold; none of them is kept then.
        """
        offsets = record_offsets(records, message_offsets)
        if not offsets.size:
            return 0
        sizes = np.append(offsets[1:], len(records)) - offsets
        opcodes = np.frombuffer(records, np.uint8)[offsets]
        is_message = opcodes == Opcode.MESSAGE
        if not is_message.all():
            for k in np.flatnonzero((opcodes == Opcode.SCHEMA) | (opcodes == Opcode.CHANNEL)):
                self.table.add(int(opcodes[k]), records[offsets[k] + RECORD_HEAD.size : offsets[k] + sizes[k]])
            offsets, sizes = offsets[is_message], sizes[is_message]
            if not offsets.size:
                return 0
        if sizes.min() < MESSAGE_HEAD_SIZE:
            raise DamagedError("holds a message that is too short")
        channel_ids = np.ndarray((len(records) - 1,), "<u2", records, strides=(1,))[offsets + RECORD_HEAD.size]
        in_range = self._in_range(records, offsets)
        counts = np.bincount(channel_ids)
        before = sum(self.counts.values())
        for channel_id in np.flatnonzero(counts).tolist():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + int(counts[channel_id])
            channel = self.table.channels.get(channel_id)
            if channel is not None and not self.filter.accepts(channel):
                continue
            kept = channel_ids == channel_id
            if in_range is not None:
                kept &= in_range
            self.streams.setdefault(channel_id, Stream()).append(
                records, offsets[kept], sizes[kept], before + np.flatnonzero(kept)
            )
        return int(offsets.size)

    def _in_range(self, records: bytes, offsets: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """(messages,) whether they are in the filter's range of time; None where it has none."""
        begin, end = self.filter.begin, self.filter.end
        if begin is None and end is None:
            return None
        log_time = np.ndarray((len(records) - 7,), "<u8", records, strides=(1,))[offsets + _LOG_TIME]
        in_range = np.ones(offsets.size, bool)
        if begin is not None:
            in_range &= log_time >= max(begin, 0)
        if end is not None:
            in_range &= log_time < max(end, 0)
        return in_range
