"""One MCAP file to the messages of each channel, chunk by chunk, with every checksum checked.

What is whole is kept; what is damaged is left out, with a warning. After damage, reading goes on at the next chunk, by
the summary section; in a file that was cut off, which has no summary section, the next chunk is searched for. For some
topics or a range of time, only the chunks are read that hold some of them according to their chunk index.
"""

from __future__ import annotations

import os
import zlib
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Header, Metadata
from mcap.writer import MCAP0_MAGIC

from abrace_bags.mcap.chunk import MESSAGE_HEAD_SIZE, Selection, Stream, find_chunk, unpack, unpack_beginning
from abrace_bags.mcap.index import MessageFilter, RecordedChannel, SummarySection, read_summary
from abrace_bags.mcap.records import (
    FACTS_RECORD,
    RECORD_HEAD,
    DamagedError,
    checked_facts,
    next_record,
    open_mcap,
    parse,
)
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_DATA_END_SIZE = RECORD_HEAD.size + 4


class McapFile:
    """What is whole in an MCAP file.

    Parameters
    ----------
    path
        The file.
    message_filter
        Which messages to keep.

    Attributes
    ----------
    channels
        By channel id.
    streams
        Messages by channel id.
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

    Raises
    ------
    AbraceError
        If the file can't be read or is not MCAP.
    """

    def __init__(self, path: Path, message_filter: MessageFilter) -> None:
        self.facts: dict[str, str] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
        self.warnings: list[str] = []
        self.uncounted = False
        self._path = path
        self._filter = message_filter
        self._selection = Selection(message_filter)
        self._chunk: tuple[int, Chunk] | None = None
        self._message_offsets: list[NDArray[np.int64]] = []
        self._unchunked = bytearray()
        self._without_checksum = 0
        self._undamaged = True
        with open_mcap(path) as self._file:
            self._size = os.fstat(self._file.fileno()).st_size
            summary, damage = None, None
            try:
                summary = read_summary(self._file, self._size)
            except DamagedError as error:
                damage = str(error)
            if summary is None or not self._read_chosen_chunks(summary):
                self._read_all(summary, damage)
            self._file.seek(0)
            if self._file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                self._warn("the magic at its beginning is damaged")
        self.channels: dict[int, RecordedChannel] = self._selection.table.channels
        self.streams: dict[int, Stream] = self._selection.streams
        for channel_id in sorted(self.streams.keys() - self.channels.keys()):
            lost = self.streams.pop(channel_id).count
            self.uncounted = True
            self._warn(f"{lost} messages of channel {channel_id} are left out: the record of the channel is lost")

    def _warn(self, text: str) -> None:
        self.warnings.append(f"{self._path}: {text}")

    def _read_chosen_chunks(self, summary: SummarySection) -> bool:
        """Read the chunks that may hold messages to keep, if the summary has all and those chunks are whole.

        Returns False, with nothing read, where it is better to read the whole file.
        """
        if not summary.complete:
            return False
        chosen = [chunk for chunk in summary.chunks if self._filter.may_match(chunk, summary.table.channels)]
        if len(chosen) == len(summary.chunks):
            return False
        self._selection.table = summary.table
        try:
            for offset in summary.other_offsets:
                self._file.seek(offset)
                self._read_metadata_or_attachment(*next_record(self._file, self._size))
            for index in chosen:
                self._file.seek(index.chunk_start_offset)
                opcode, body = next_record(self._file, self._size)
                if opcode != Opcode.CHUNK:
                    raise DamagedError("is not a chunk")
                chunk = parse(Chunk, body)
                self._without_checksum += chunk.uncompressed_crc == 0
                self._selection.add_chunk(unpack(chunk), self._read_message_indexes())
        except DamagedError:
            self._selection = Selection(self._filter)
            self.facts, self._without_checksum = None, 0
            self.metadata.clear()
            self.attachments.clear()
            self.warnings.clear()
            return False
        self._warn_of_missing_checksums()
        return True

    def _read_message_indexes(self) -> list[NDArray[np.int64]]:
        """Where the messages of a chunk begin, by the message indexes that follow it here."""
        offsets = []
        while self._file.read(1) == bytes([Opcode.MESSAGE_INDEX]):
            self._file.seek(-1, os.SEEK_CUR)
            offsets.append(_message_offsets(next_record(self._file, self._size)[1]))
        return offsets

    def _warn_of_missing_checksums(self) -> None:
        if self._without_checksum:
            self._warn(f"{self._without_checksum} chunks have no checksum: damage in them would not be noticed")

    def _read_all(self, summary: SummarySection | None, summary_damage: str | None) -> None:
        checksum = zlib.crc32(MCAP0_MAGIC)
        expected: int | None = None
        self._file.seek(len(MCAP0_MAGIC))
        while expected is None:
            offset = self._file.tell()
            try:
                opcode, body = next_record(self._file, self._size)
                if opcode == Opcode.DATA_END and len(body) == 4:
                    expected = int.from_bytes(body, "little")
                    break
                self._read_data_record(offset, opcode, body)
                checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), checksum))
            except DamagedError as error:
                resumed = self._offset_after_damage(offset, summary)
                where = f"damaged at byte {offset} of {self._size}"
                if resumed is None:
                    self._warn(f"cut off or {where}, the rest is not read: the record there {error}")
                    self._read_cut_chunk(offset)
                    break
                self._undamaged = False
                self._warn(f"{where}, reading goes on at byte {resumed}: the record there {error}")
                self._file.seek(resumed)
        self._finish_chunk()
        if expected is None:
            self._undamaged = False
        elif summary_damage is not None:
            self._warn(f"cut off or damaged, the summary section is not used: it {summary_damage}")
        self._add_unchunked_messages(expected, checksum)
        if self._undamaged and expected not in (None, 0, checksum):
            self._warn("damaged between its chunks: the checksum of the data section does not fit")
        self._warn_of_missing_checksums()
        self._compare_counts(summary)

    def _read_data_record(self, offset: int, opcode: int, body: bytes) -> None:
        if opcode == Opcode.MESSAGE_INDEX:
            message_offsets = _message_offsets(body)
            if self._chunk is not None:
                self._message_offsets.append(message_offsets)
            return
        self._finish_chunk()
        if opcode == Opcode.CHUNK:
            if self._unchunked:
                raise DamagedError("is a chunk among messages outside chunks")
            self._chunk = offset, parse(Chunk, body)
        elif opcode == Opcode.MESSAGE:
            first = offset == len(MCAP0_MAGIC)  # where the header belongs
            if first or self._selection.counts or len(body) < MESSAGE_HEAD_SIZE - RECORD_HEAD.size:
                raise DamagedError("is a message outside the chunks")
            self._unchunked += RECORD_HEAD.pack(opcode, len(body)) + body
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._selection.table.add(opcode, body)
        elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            self._read_metadata_or_attachment(opcode, body)
        elif opcode == Opcode.HEADER:
            parse(Header, body)
        elif opcode < 0x80:
            raise DamagedError(f"is of an unknown kind ({opcode:#04x})")
        else:
            self._undamaged = False
            self._warn(f"the record at byte {offset} is of an unknown kind ({opcode:#04x}) and left out")

    def _read_metadata_or_attachment(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.ATTACHMENT:
            attachment = parse(Attachment, body)
            if int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
                raise DamagedError("is an attachment that does not fit its checksum")
            self.attachments.append(attachment)
            return
        record = parse(Metadata, body)
        self.metadata[record.name] = record.metadata
        if record.name == FACTS_RECORD:
            try:
                self.facts = checked_facts(self._path, record.metadata)
            except AbraceError as error:
                self.warnings.append(str(error))

    def _finish_chunk(self) -> None:
        """Keep the messages of the chunk whose message indexes have all been read."""
        if self._chunk is None:
            return
        (offset, chunk), message_offsets = self._chunk, self._message_offsets
        self._chunk, self._message_offsets = None, []
        try:
            self._selection.add_chunk(unpack(chunk), message_offsets)
        except DamagedError as error:
            self._undamaged = False
            self._warn(f"the chunk at byte {offset} {error} and is left out")
            return
        self._without_checksum += chunk.uncompressed_crc == 0

    def _offset_after_damage(self, offset: int, summary: SummarySection | None) -> int | None:
        """Where reading can go on: the next chunk, or the end of the data section."""
        resumable = [] if summary is None else [chunk.chunk_start_offset for chunk in summary.chunks]
        if not resumable:
            found = find_chunk(self._file, offset + 1, self._size)
            resumable = [] if found is None else [found]
        if summary is not None:
            resumable.append(summary.start - _DATA_END_SIZE)
        return next((resumed for resumed in resumable if resumed > offset), None)

    def _read_cut_chunk(self, offset: int) -> None:
        """Keep the whole messages of the chunk in which the file ends."""
        self._file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        closed = self._file.read() == MCAP0_MAGIC
        self._file.seek(offset)
        head = self._file.read(RECORD_HEAD.size)
        if closed or self._unchunked or len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
            return
        self._finish_chunk()
        try:
            chunk = parse(Chunk, self._file.read(), exact=False)
            records = unpack_beginning(chunk)
            count = self._selection.add_chunk(records, [])
        except DamagedError:
            return
        if count and (len(records) != chunk.uncompressed_size or zlib.crc32(records) != chunk.uncompressed_crc):
            self._warn(f"{count} messages of the chunk that is cut off are read without its checksum")

    def _add_unchunked_messages(self, expected: int | None, checksum: int) -> None:
        """Keep the messages outside chunks, if the data section fits its checksum or has none."""
        if not self._unchunked:
            return
        self._file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        cut = expected is None and self._file.read() != MCAP0_MAGIC
        if not cut and expected not in (0, checksum):
            raise AbraceError(f"{self._path}: its messages do not fit their checksum, the file is damaged")
        self._selection.add_chunk(bytes(self._unchunked), [])
        if expected != checksum:
            self._warn("the messages are in no chunks and have no checksum: damage in them would not be noticed")

    def _compare_counts(self, summary: SummarySection | None) -> None:
        """Warn of the messages that are missing, by topic."""
        if summary is None or summary.message_counts is None:
            self.uncounted = not self._undamaged
            return
        table = self._selection.table
        read, named = table.channels, summary.table.channels
        table.channels = read | (named if summary.complete else named | read)
        for channel_id, expected in summary.message_counts.items():
            missing = expected - self._selection.counts.get(channel_id, 0)
            channel = table.channels.get(channel_id)
            if missing > 0 and channel is not None and self._filter.accepts(channel):
                self._warn(f"{missing} of {expected} messages of {channel.topic} are missing")


def _message_offsets(body: bytes) -> NDArray[np.int64]:
    """Where messages begin in their chunk, from the content of a message index."""
    size = int.from_bytes(body[2:6], "little")
    if len(body) < 6 or size % 16 or size != len(body) - 6:
        raise DamagedError("has lengths that don't fit")
    return np.frombuffer(body, "<i8", offset=6)[1::2]
