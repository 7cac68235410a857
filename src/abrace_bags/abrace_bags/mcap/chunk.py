"""One chunk of an MCAP file: found, unpacked, its checksum checked, and where the records in it begin."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard

from abrace_bags.mcap.records import RECORD_HEAD, DamagedError, RecordFields

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_HEAD = struct.Struct("<BQQQQI")
"""What a chunk's record begins with: opcode, length, times of the first and the last message, size, checksum."""
_PATTERN = re.compile(rb"(?=\x06.{5}\0{3}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4}).{8})", re.DOTALL)
_LONGEST_HEAD = 64
_SEARCH_SIZE = 1 << 22
"""Bytes in which a chunk is looked for at a time."""


@dataclass(frozen=True)
class Chunk:
    """A chunk as it stands in the file.

    Parameters
    ----------
    size
        Bytes of its records.
    checksum
        CRC-32 of its records; 0: none.
    compression
        `zstd`, `lz4` or empty.
    packed
        Its records, compressed; fewer where the file is cut off.
    """

    size: int
    checksum: int
    compression: str
    packed: bytes


def parse_chunk(body: bytes, whole: bool = True) -> Chunk:
    """A chunk from the body of its record.

    Parameters
    ----------
    body
        The record behind its length.
    whole
        Whether the record is all there; if not, `body` ends where the file ends.

    Raises
    ------
    DamagedError
        If its lengths do not fit.
    """
    fields = RecordFields(body)
    fields.take(16)
    size, checksum, compression = fields.number(8), fields.number(4), fields.text()
    length = fields.number(8)
    packed = fields.take(length if whole else min(length, len(body) - fields.offset))
    if whole:
        fields.end()
    return Chunk(size, checksum, compression, packed)


def unpack(chunk: Chunk) -> bytes:
    """The records of a whole `chunk`.

    Raises
    ------
    DamagedError
        If it does not unpack, or does not fit its checksum.
    """
    try:
        if chunk.compression == "zstd":
            known = zstandard.frame_content_size(chunk.packed)
            if known not in (-1, chunk.size):
                raise DamagedError(f"does not unpack: is {known} bytes, expected {chunk.size}")
            data = zstandard.ZstdDecompressor().decompress(chunk.packed, max_output_size=chunk.size)
        elif chunk.compression == "lz4":
            data = bytes(lz4.frame.decompress(chunk.packed))
        elif chunk.compression == "":
            data = chunk.packed
        else:
            raise DamagedError(f"does not unpack: compression {chunk.compression!r}, expected zstd, lz4 or none")
    except (zstandard.ZstdError, RuntimeError, MemoryError, OverflowError) as error:
        raise DamagedError(f"does not unpack: {error}") from error
    if len(data) != chunk.size or (chunk.checksum and zlib.crc32(data) != chunk.checksum):
        raise DamagedError("does not fit its checksum")
    return data


def unpack_beginning(chunk: Chunk) -> bytes:
    """The whole records at the beginning of a `chunk` that is cut off, of which no checksum tells that they are right.

    Compressed data comes in blocks of up to 128 KiB, and of a block that is cut off comes nothing. After a power loss
    a file may end in zeros that were never written: a record that ends in them is not known to be whole.
    """
    data = b""
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().decompressobj().decompress(chunk.packed)
        elif chunk.compression == "lz4":
            data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.packed))
        elif chunk.compression == "":
            data = chunk.packed
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return b""
    written = len(data.rstrip(b"\0"))
    end = 0
    while end + RECORD_HEAD.size <= written:
        record_end = end + RECORD_HEAD.size + RECORD_HEAD.unpack_from(data, end)[1]
        if record_end > written:
            break
        end = record_end
    return data[:end]


def find_chunk(file: BinaryIO, begin: int, size: int) -> int | None:
    """Where the next chunk is that looks whole.

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
        for found in _PATTERN.finditer(searched):
            place = begin + found.start()
            if _lengths_fit(searched[found.start() : found.start() + _LONGEST_HEAD], size - place):
                return place
        last = begin + len(searched) >= size
        begin += len(searched) if last else len(searched) - _LONGEST_HEAD
    return None


def _lengths_fit(head: bytes, left: int) -> bool:
    """Whether the lengths in a chunk's head fit each other and the bytes left of the file."""
    length = _HEAD.unpack_from(head)[1]
    fields = RecordFields(head[_HEAD.size :])
    name = fields.take(fields.number(4))
    return 40 + len(name) + fields.number(8) == length <= left - RECORD_HEAD.size


def record_starts(data: bytes, said: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Where the records of a chunk begin.

    Parameters
    ----------
    data
        The records.
    said
        Where its messages begin, as its message indexes say. Believed where each record then ends where the next one
        begins; otherwise every record is walked over, about 0.2 microseconds each.

    Returns
    -------
    ndarray
        (records,) in order.

    Raises
    ------
    DamagedError
        If the records do not fill the chunk.
    """
    end = len(data)
    if said:
        starts = np.concatenate(said)
        starts.sort()
        if starts.size and starts[0] == 0 and 0 <= starts[-1] <= end - RECORD_HEAD.size:
            length = np.ndarray((end - RECORD_HEAD.size + 1,), "<u8", data, 1, (1,))[starts].astype(np.int64)
            if np.array_equal(starts + RECORD_HEAD.size + length, np.append(starts[1:], end)):
                return starts
    walked = []
    offset = 0
    length_at = struct.Struct("<Q").unpack_from
    while offset < end - 8:
        walked.append(offset)
        offset += 9 + length_at(data, offset + 1)[0]
    if offset != end:
        raise DamagedError("is a chunk whose records don't fill it")
    return np.array(walked, np.int64)
