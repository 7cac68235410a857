# SPDX-License-Identifier: Apache-2.0
"""A chunk of an MCAP file: search in a damaged file, decompression, check, and its messages."""

from __future__ import annotations

import itertools
import re
import zlib
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from abrace_bags.mcap.records import LARGEST_CHUNK, RECORD_HEAD, DamagedError, parse

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mcap.records import Chunk
    from numpy.typing import NDArray

    from abrace_bags.mcap.index import ChannelTable

_CHUNK_HEAD = re.compile(rb"\x06(.{5}\0{3}).{28}(\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})(.{8})", re.DOTALL)
"""What a chunk's record begins with: opcode, length, times, size, checksum, name of the compression, packed bytes."""
_HEAD_SIZE = 64
"""Bytes that hold it."""
_SEARCH_SIZE = 1 << 22
"""Bytes that are searched for a chunk at a time."""

_PATTERN = 12
"""Records in a row after which more of the same lengths in the same order are expected."""
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
        position = 0
        while match := _CHUNK_HEAD.search(searched, position):
            length, packed_size = (int.from_bytes(match[group], "little") for group in (1, 3))
            offset, position = begin + match.start(), match.start() + 1
            if 36 + len(match[2]) + packed_size == length <= size - offset - RECORD_HEAD.size:
                return offset
        begin += len(searched) if begin + len(searched) >= size else len(searched) - _HEAD_SIZE
    return None


def unpack(chunk: Chunk) -> bytes:
    """The records of a whole chunk.

    Raises
    ------
    DamagedError
        If it does not unpack, or does not match its checksum.
    """
    records = _unpacked(chunk, whole=True)
    size = chunk.uncompressed_size
    if len(records) != size:
        raise DamagedError(f"does not unpack: expected {size} bytes, found {'more' if len(records) > size else 'less'}")
    if chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
        raise DamagedError("does not match its checksum")
    return records


def unpack_beginning(chunk: Chunk) -> bytes:
    """The whole records at the beginning of a chunk that is cut off; its checksum can't confirm them.

    Compressed data comes in blocks of up to 128 KiB, and of a block that is cut off comes nothing. After a power loss
    a file may end in zeros that were never written: a record that ends in them is not known to be whole.
    """
    records = _unpacked(chunk, whole=False)
    written = len(records.rstrip(b"\0"))
    end = 0
    while end + RECORD_HEAD.size <= written:
        record_end = end + RECORD_HEAD.size + RECORD_HEAD.unpack_from(records, end)[1]
        if record_end > written:
            break
        end = record_end
    return records[:end]


def _unpacked(chunk: Chunk, whole: bool) -> bytes:
    """What a chunk unpacks to: all of it, or if it is not `whole` the beginning. It may be packed in several frames."""
    size, data = chunk.uncompressed_size, chunk.data
    if size > LARGEST_CHUNK:
        raise DamagedError(f"does not unpack: has {size} bytes, expected at most {LARGEST_CHUNK}")
    try:
        if chunk.compression == "":
            return data
        if chunk.compression == "zstd":
            if whole and zstandard.frame_content_size(data) == size:
                return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
            reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
            return b"".join(itertools.takewhile(bool, (reader.read(1 << 20) for _ in range(0, size + 1, 1 << 20))))
        if chunk.compression == "lz4":
            records = b""
            while data:
                frame = lz4.frame.LZ4FrameDecompressor()
                records += frame.decompress(data, size + 1 - len(records))
                data = frame.unused_data
            return records
    except (zstandard.ZstdError, RuntimeError, MemoryError, OverflowError) as error:
        raise DamagedError(f"does not unpack: {error}") from error
    raise DamagedError(f"does not unpack: compression {chunk.compression!r}, expected zstd, lz4 or none")


def record_offsets(records: bytes) -> NDArray[np.int64]:
    """(records,) where the `records` of a chunk begin, in order.

    Raises
    ------
    DamagedError
        If they do not fill the chunk.
    """
    parts = [np.empty(0, np.int64)]
    offset, end, some = 0, len(records), _PATTERN
    size, unpack = RECORD_HEAD.size, RECORD_HEAD.unpack_from
    while offset < end - 8:
        walked = []
        for _ in range(some):
            if not records[offset]:
                raise DamagedError("is a chunk whose records don't fill it")
            walked.append(offset)
            offset += size + unpack(records, offset)[1]
            if offset >= end - 8:
                break
        parts.append(np.array(walked, np.int64))
        if offset > end:
            break
        last = [*walked[-_PATTERN:], offset]
        found = _repeated(records, offset, [one - before for before, one in pairwise(last)])
        if found.size:
            parts.append(found)
            offset = int(found[-1]) + size + unpack(records, int(found[-1]))[1]
        # where that does not go on for long it is tried less and less often
        some = _PATTERN if found.size > 2 * _PATTERN else 4 * some
    begins = np.concatenate(parts)
    if offset != end or not np.frombuffer(records, np.uint8)[begins].all():
        raise DamagedError("is a chunk whose records don't fill it")
    return begins


def _repeated(records: bytes, offset: int, sizes: list[int]) -> NDArray[np.int64]:
    """Where the records from `offset` on begin that go on like those before them, of these `sizes`: found at once."""
    for count in range(1, len(sizes) // 2 + 1):
        if sizes[count:] == sizes[:-count]:
            break
    else:
        return np.empty(0, np.int64)
    pattern = np.array(sizes[-count:])
    period = int(pattern.sum())
    places = offset + np.cumsum(pattern) - pattern + period * np.arange((len(records) - offset) // period)[:, None]
    if not places.size:
        return np.empty(0, np.int64)
    lengths = np.ndarray((len(records) - 8,), "<u8", records, 1, (1,))[places]
    same = (lengths == pattern - RECORD_HEAD.size).all(axis=1)
    rows = int(np.argmin(np.append(same, False)))
    found: NDArray[np.int64] = places[:rows].ravel()
    return found


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
        return gather(self.records, form, self.begins + offset)

    def chosen(self, which: NDArray[Any]) -> Messages:
        """Some of them: `which` is a mask or their numbers."""
        return Messages(self.offset, self.records, self.begins[which], self.sizes[which], self.channel_ids[which])

    def by_channel(self) -> Iterator[tuple[int, Messages]]:
        """The messages of each channel, with its id."""
        for channel_id in np.flatnonzero(np.bincount(self.channel_ids)).tolist():
            yield channel_id, self.chosen(self.channel_ids == channel_id)

    def compact(self) -> Messages:
        """The same, without what is between them if that is most of the chunk."""
        if 2 * int(self.sizes.sum()) >= len(self.records):
            return self
        ends = (self.begins + self.sizes).tolist()
        records = b"".join(self.records[begin:end] for begin, end in zip(self.begins.tolist(), ends, strict=True))
        return Messages(self.offset, records, np.cumsum(self.sizes) - self.sizes, self.sizes, self.channel_ids)

    def payloads(self) -> list[bytes]:
        """Their serialised bytes."""
        ends = (self.begins + self.sizes).tolist()
        begins = (self.begins + MESSAGE_HEAD_SIZE).tolist()
        return [self.records[begin:end] for begin, end in zip(begins, ends, strict=True)]


def gather(content: bytes, form: Any, begins: NDArray[np.int64], count: int | None = None) -> NDArray[Any]:
    """(messages,) values of the type `form` that `content` has at `begins`, or (messages, count) for a `count`."""
    form = np.dtype(form)
    shape, strides = ((), ()) if count is None else ((count,), (form.itemsize,))
    if not len(begins) or count == 0:
        return np.empty((len(begins), *shape), form)
    everywhere = len(content) - form.itemsize * (1 if count is None else count) + 1
    found: NDArray[Any] = np.ndarray((everywhere, *shape), form, content, 0, (1, *strides))[begins]
    return found


def find_messages(offset: int, records: bytes, table: ChannelTable) -> tuple[Messages, int]:
    """The messages of a chunk, and how many records it has that no chunk may hold.

    Parameters
    ----------
    offset
        Of the chunk in its file.
    records
        The chunk, unpacked.
    table
        Gets the schemas and channels that are in the chunk.

    Raises
    ------
    DamagedError
        If they are not what a chunk may hold.
    """
    try:
        begins = record_offsets(records)
    except MemoryError as error:
        raise DamagedError("needs more memory than there is") from error
    sizes = np.append(begins[1:], len(records)) - begins if begins.size else begins
    is_message = gather(records, "u1", begins) == Opcode.MESSAGE
    others = [] if is_message.all() else np.flatnonzero(~is_message).tolist()
    strange = 0
    for k in others:
        body = records[begins[k] + RECORD_HEAD.size : begins[k] + sizes[k]]
        if records[begins[k]] == Opcode.SCHEMA:
            table.add_schema(parse(Schema, body)[0])
        elif records[begins[k]] == Opcode.CHANNEL:
            table.add_channel(parse(Channel, body)[0])
        else:
            strange += 1
    if others:
        begins, sizes = begins[is_message], sizes[is_message]
    if sizes.size and sizes.min() < MESSAGE_HEAD_SIZE:
        raise DamagedError("holds a message that is too short")
    return Messages(offset, records, begins, sizes, gather(records, "<u2", begins + RECORD_HEAD.size)), strange
