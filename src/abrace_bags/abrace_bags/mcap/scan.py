# SPDX-License-Identifier: Apache-2.0
"""A scan of an MCAP file from beginning to end, despite any damage: all undamaged chunks, and what is missing."""

from __future__ import annotations

import contextlib
import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Header, Metadata

from abrace_bags.mcap.chunk import MESSAGE_HEAD_SIZE, Messages, find_chunk, find_messages, unpack, unpack_beginning
from abrace_bags.mcap.index import ChannelTable
from abrace_bags.mcap.records import (
    FACTS_RECORD,
    LARGEST_CHUNK,
    MCAP0_MAGIC,
    RECORD_HEAD,
    DamagedError,
    checked_facts,
    next_record,
    parse,
    record_head,
)
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.mcap.index import MessageFilter, RecordedChannel, SummarySection

_DATA_END_SIZE = RECORD_HEAD.size + 4
_UNCHUNKED_SIZE = 1 << 20
"""Bytes of messages outside chunks that are read at a time."""


class FileContent:
    """The content found in an MCAP file.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    summary, summary_damage
        The summary section, if it is there and whole; what is wrong with it.
    table
        Channels by their ids.
    counts
        Messages in the chunks, kept or not, by channel id.
    facts
        The run's facts; None where there are none, or they are damaged.
    metadata
        All metadata records: texts by key, by the record's name.
    attachments
        Files of the run.
    warnings
        What is missing or can't be trusted, one sentence each.
    uncounted
        Whether messages may be missing and the file does not say how many.
    cut
        The messages of the chunk in which the file ends, which can't be read again.
    without_checksum
        How many chunks have none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary: SummarySection | None = None
        self.summary_damage: str | None = None
        self.cut: Messages | None = None
        self.clear()

    def clear(self) -> None:
        """Forget what was read."""
        self.table = ChannelTable()
        self.counts: dict[int, int] = {}
        self.facts: dict[str, str] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
        self.warnings: list[str] = []
        self.uncounted = False
        self.without_checksum = self._untimed = 0
        self._refused: tuple[MessageFilter | None, int, set[int]] = None, 0, set()

    @property
    def channels(self) -> dict[int, RecordedChannel]:
        """By channel id."""
        return self.table.channels

    def warn(self, text: str) -> None:
        """Add a warning, the `text`."""
        self.warnings.append(f"{self.path}: {text}")

    def count_chunk(self, messages: Messages, checked: bool) -> None:
        """Count the `messages` of a chunk; whether it was `checked` with its checksum."""
        self.without_checksum += not checked
        counts = np.bincount(messages.channel_ids)
        for channel_id in np.flatnonzero(counts).tolist():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + int(counts[channel_id])

    def read_metadata_or_attachment(self, opcode: int, body: bytes) -> None:
        """Keep the record with this `opcode` and `body`.

        Raises
        ------
        DamagedError
            If it is incomplete.
        """
        if opcode == Opcode.ATTACHMENT:
            attachment = parse(Attachment, body)
            if int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
                raise DamagedError("is an attachment that does not match its checksum")
            self.attachments.append(attachment)
            return
        record = parse(Metadata, body)
        self.metadata[record.name] = record.metadata
        if record.name == FACTS_RECORD:
            try:
                self.facts = checked_facts(self.path, record.metadata)
            except AbraceError as error:
                self.warnings.append(str(error))


class Scan:
    """Reads an MCAP file from beginning to end, despite any damage; the content goes to `found`."""

    def __init__(self, found: FileContent, file: BinaryIO, size: int) -> None:
        self._found, self._file, self._size = found, file, size
        self._summary = found.summary
        self._chunk: tuple[int, Chunk] | None = None
        self._message_offsets: list[NDArray[np.int64]] = []
        self._unchunked = False
        self._undamaged = True
        self._checksum = zlib.crc32(MCAP0_MAGIC)

    def chunks(self) -> Iterator[Messages]:
        """All messages, chunk by chunk."""
        expected: int | None = None
        self._file.seek(len(MCAP0_MAGIC))
        while expected is None:
            offset = self._file.tell()
            try:
                opcode, body = next_record(self._file, self._size)
                if opcode == Opcode.DATA_END and len(body) == 4:
                    expected = int.from_bytes(body, "little")
                    break
                yield from self._read_data_record(offset, opcode, body)
            except DamagedError as error:
                resumed = self._offset_after_damage(offset)
                where = f"damaged at byte {offset} of {self._size}"
                if resumed is None:
                    self._found.warn(f"cut off or {where}, the rest is not read: the record there {error}")
                    yield from self._read_cut_chunk(offset)
                    break
                self._undamaged = False
                self._found.warn(f"{where}, reading continues at byte {resumed}: the record there {error}")
                self._file.seek(resumed)
        yield from self._finish_chunk()
        if expected is None:
            self._undamaged = False
        elif self._found.summary_damage is not None:
            self._found.warn(f"cut off or damaged, the summary section is not used: it {self._found.summary_damage}")
        if self._unchunked and expected != self._checksum:
            self._found.warn("the messages are in no chunks and have no checksum: damage in them would not be noticed")
        elif self._undamaged and expected not in (None, 0, self._checksum):
            self._found.warn("damaged between its chunks: the checksum of the data section does not fit")

    def finish(self, message_filter: MessageFilter) -> None:
        """Warn of missing messages that `message_filter` would keep, by topic, and of those of unknown topics."""
        self._file.seek(0)
        if self._file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            self._found.warn("the magic at its beginning is damaged")
        found, summary = self._found, self._summary
        if summary is None or summary.message_counts is None:
            found.uncounted = not self._undamaged
        else:
            read, named = found.channels, summary.table.channels
            found.table.channels = read | (named if summary.complete else named | read)
            for channel_id, expected in summary.message_counts.items():
                missing = expected - found.counts.get(channel_id, 0)
                channel = found.channels.get(channel_id)
                if missing > 0 and channel is not None and message_filter.accepts(channel):
                    found.warn(f"{missing} of {expected} messages of {channel.topic} are missing")
        for channel_id in sorted(found.counts.keys() - found.channels.keys()):
            found.uncounted = True
            lost = f"{found.counts[channel_id]} messages of channel {channel_id}"
            found.warn(f"{lost} are left out: the record of the channel is lost")

    def _read_data_record(self, offset: int, opcode: int, body: bytes) -> Iterator[Messages]:
        if opcode == Opcode.MESSAGE_INDEX:
            message_offsets = message_offsets_of(body)
            if self._chunk is not None:
                self._message_offsets.append(message_offsets)
        else:
            yield from self._finish_chunk()
        if opcode == Opcode.MESSAGE:
            yield self._read_unchunked(offset, body)
            return
        if opcode == Opcode.CHUNK:
            if self._unchunked:
                raise DamagedError("is a chunk among messages outside chunks")
            self._chunk = offset, parse(Chunk, body)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._found.table.add(opcode, body)
        elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            self._found.read_metadata_or_attachment(opcode, body)
        elif opcode == Opcode.HEADER:
            parse(Header, body)
        elif opcode < 0x80 and opcode != Opcode.MESSAGE_INDEX:
            raise DamagedError(f"is of an unknown kind ({opcode:#04x})")
        elif opcode >= 0x80:
            self._undamaged = False
            self._found.warn(f"the record at byte {offset} is of an unknown kind ({opcode:#04x}) and left out")
        self._checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), self._checksum))

    def _finish_chunk(self) -> Iterator[Messages]:
        """The messages of the chunk whose message indexes have all been read."""
        if self._chunk is None:
            return
        (offset, chunk), message_offsets = self._chunk, self._message_offsets
        self._chunk, self._message_offsets = None, []
        try:
            messages = find_messages(offset, unpack(chunk), message_offsets, self._found.table)
        except DamagedError as error:
            self._undamaged = False
            self._found.warn(f"the chunk at byte {offset} {error} and is left out")
            return
        self._found.count_chunk(messages, bool(chunk.uncompressed_crc))
        yield messages

    def _offset_after_damage(self, offset: int) -> int | None:
        """Where reading can go on: the next chunk, or the end of the data section."""
        summary = self._summary
        if summary is not None and len(summary.chunks):
            later = [chunk for chunk in summary.chunks.offsets if chunk > offset]
            resumed = min(later, default=None)
        else:
            resumed = find_chunk(self._file, offset + 1, self._size)
        if resumed is None and summary is not None and summary.start - _DATA_END_SIZE > offset:
            return summary.start - _DATA_END_SIZE
        return resumed

    def _read_cut_chunk(self, offset: int) -> Iterator[Messages]:
        """The whole messages of the chunk in which the file ends."""
        head = self._at(offset, RECORD_HEAD.size)
        if self._closed() or self._unchunked or len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
            return
        yield from self._finish_chunk()
        try:
            packed = self._at(offset + RECORD_HEAD.size, min(self._size - offset, LARGEST_CHUNK))
            chunk = parse(Chunk, packed, exact=False)
            records = unpack_beginning(chunk)
            messages = find_messages(offset, records, [], self._found.table)
        except DamagedError:
            return
        count = len(messages.begins)
        if count and (len(records) != chunk.uncompressed_size or zlib.crc32(records) != chunk.uncompressed_crc):
            self._found.warn(f"{count} messages of the chunk that is cut off are read without its checksum")
        self._found.cut = messages
        self._found.count_chunk(messages, True)
        yield messages

    def _read_unchunked(self, offset: int, body: bytes) -> Messages:
        """The messages outside chunks from this `offset` on, some at a time, of a file that fits its checksum."""
        if not self._unchunked:
            first = offset == len(MCAP0_MAGIC)  # where the header belongs
            if first or self._found.counts or len(body) < MESSAGE_HEAD_SIZE - RECORD_HEAD.size:
                raise DamagedError("is a message outside the chunks")
            self._check_unchunked(offset)
            self._unchunked = True
        records = unchunked_records(self._file, offset, self._size)
        messages = find_messages(offset, records, [], self._found.table)
        self._checksum = zlib.crc32(records, self._checksum)
        self._found.count_chunk(messages, True)
        return messages

    def _check_unchunked(self, offset: int) -> None:
        """Compare everything from `offset` to the end of the data section with its checksum, before any is used."""
        checksum, expected = self._checksum, None
        self._file.seek(offset)
        with contextlib.suppress(DamagedError):
            while expected is None:
                opcode, body = next_record(self._file, self._size)
                if opcode == Opcode.DATA_END and len(body) == 4:
                    expected = int.from_bytes(body, "little")
                else:
                    checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), checksum))
        if expected not in (0, checksum) and not (expected is None and not self._closed()):
            raise AbraceError(f"{self._found.path}: its messages do not match their checksum, the file is damaged")

    def _closed(self) -> bool:
        """Whether the file ends as one that was closed."""
        return self._at(self._size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)) == MCAP0_MAGIC

    def _at(self, offset: int, size: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(size)


def unchunked_records(file: BinaryIO, offset: int, size: int) -> bytes:
    """Message records outside chunks of a `file` of `size` bytes from `offset` on, about `_UNCHUNKED_SIZE` bytes."""
    end = offset
    while end - offset < _UNCHUNKED_SIZE:
        file.seek(end)
        try:
            opcode, length = record_head(file, size)
        except DamagedError:
            break
        if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD_SIZE - RECORD_HEAD.size or length > LARGEST_CHUNK:
            break
        end += RECORD_HEAD.size + length
    file.seek(offset)
    return file.read(end - offset)


def message_offsets_of(body: bytes) -> NDArray[np.int64]:
    """Where messages begin in their chunk, from the `body` of a message index."""
    size = int.from_bytes(body[2:6], "little")
    if len(body) < 6 or size % 16 or size != len(body) - 6:
        raise DamagedError("has inconsistent lengths")
    return np.frombuffer(body, "<i8", offset=6)[1::2]
