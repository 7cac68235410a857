# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read forward from its beginning to its end, whole, cut off or damaged, with every checksum checked.

Undamaged data is kept; damaged data is left out, with a warning. After damage, reading continues at the next place that
the summary section names; in a file that was cut off, which has none, at the next chunk that is found. The index only
skips: of some topics or a range of time, only the chunks are read that hold some of them.
"""

from __future__ import annotations

import operator
import re
import zlib
from typing import TYPE_CHECKING, BinaryIO

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Chunk, Header, Metadata, Schema

from abrace_bags.mcap.attachments import StoredAttachment
from abrace_bags.mcap.bag_file import BagFile
from abrace_bags.mcap.chunk import MESSAGE_HEAD_SIZE, find_chunk, find_messages, unpack, unpack_beginning
from abrace_bags.mcap.index import ChannelTable, file_checksum, read_summary
from abrace_bags.mcap.records import (
    FACTS_RECORD,
    LARGEST_CHUNK,
    LARGEST_TEXTS,
    MCAP0_MAGIC,
    RECORD_HEAD,
    DamagedError,
    Record,
    attachment_head,
    checked_facts,
    is_record,
    open_file,
    parse,
    read_record,
    record_head,
)
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.mcap.index import SummarySection

_MESSAGE_HEAD = re.compile(rb"\x05(?=(.{4}\0{4}.{22}))", re.DOTALL)
"""What a message's record begins with: opcode, length, channel, sequence, times."""
_DATA_END_SIZE = RECORD_HEAD.size + 4
_UNCHUNKED_SIZE = 1 << 20
"""Bytes of messages outside chunks that are read at a time."""
_SEARCHED = 1 << 26
"""Bytes at the beginning of a file in which a chunk is looked for if its magic is damaged."""


class McapFile(BagFile):
    """The undamaged content of the MCAP file at a `path`.

    Raises
    ------
    AbraceError
        If the file can't be read or is not MCAP.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._summary_damage = ""
        with open_file(path) as (file, self._size):
            self._check_magic(file)
            try:
                self.summary = read_summary(file, self._size)
            except DamagedError as error:
                self._summary_damage = str(error)
            if self.summary is not None and self.summary.complete:
                self.indexed = self.known = self._read_indexed_records(file, self.summary)

    def _check_magic(self, file: BinaryIO) -> None:
        """Refuse what is no MCAP file; its magic may be damaged, if it is at the end or there are chunks."""
        magic = file.read(len(MCAP0_MAGIC))
        if not magic:
            raise AbraceError(f"{self.path}: the file is empty, expected an MCAP file")
        file.seek(max(self._size - len(MCAP0_MAGIC), 0))
        if len(magic) < len(MCAP0_MAGIC) or (
            sum(map(operator.ne, magic, MCAP0_MAGIC)) > 1
            and file.read() != MCAP0_MAGIC
            and find_chunk(file, 0, min(self._size, _SEARCHED)) is None
        ):
            raise AbraceError(f"{self.path}: not an MCAP file")

    def _clear(self) -> None:
        super()._clear()
        self._seen: set[tuple[int, int, int, int]] = set()
        self._cut: Messages | None = None
        # messages outside chunks: where they begin, and how many bytes they are
        self._outside: dict[int, int] = {}
        self._checksum = zlib.crc32(MCAP0_MAGIC)

    def _read_indexed_records(self, file: BinaryIO, summary: SummarySection) -> bool:
        """Take what the summary section names; False, with nothing taken, if a record is damaged."""
        self.table = ChannelTable(dict(summary.table.schemas), dict(summary.table.channels))
        try:
            file.seek(0)
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise DamagedError("is damaged")
            for offset in summary.metadata:
                opcode, body = read_record(file, offset, self._size)
                if opcode != Opcode.METADATA:
                    raise DamagedError("is no metadata record")
                self._add_metadata(parse(Metadata, body)[0])
            for one in summary.attachments:
                if record_head(file, one.offset, self._size)[0] != Opcode.ATTACHMENT:
                    raise DamagedError("is no attachment")
                self._add_attachment(one.offset, one)
        except DamagedError:
            self._clear()
            return False
        return True

    def _add_metadata(self, record: Metadata) -> None:
        # a file may have several of one name
        self.metadata[record.name] = self.metadata.get(record.name, {}) | record.metadata
        if record.name == FACTS_RECORD:
            try:
                self.facts = checked_facts(record.metadata)
            except DamagedError as error:
                self._warn(f"the run's facts {error}, the file is damaged")

    def _add_attachment(self, offset: int, one: AttachmentIndex) -> None:
        self.attachments.append(StoredAttachment(self.path, offset, one.name, one.media_type, one.data_size))

    def _chunk_at(self, offset: int) -> Messages:
        if self._cut is not None and self._cut.offset == offset:
            return self._cut
        with open_file(self.path) as (file, size):
            if offset in self._outside:
                file.seek(offset)
                return find_messages(offset, file.read(self._outside[offset]), self.table)[0]
            opcode, body = read_record(file, offset, size)
            if opcode != Opcode.CHUNK and not _is_chunk(opcode, body):
                raise DamagedError("is not a chunk")
            chunk, _ = parse(Chunk, body)
            self._without_checksum += chunk.uncompressed_crc == 0
            return find_messages(offset, unpack(chunk), self.table)[0]

    def _scan(self) -> Iterator[Messages]:
        with open_file(self.path) as (file, _):
            offset = len(MCAP0_MAGIC)
            expected: int | None = None
            while expected is None:
                try:
                    opcode, length = record_head(file, offset, self._size)
                    end = offset + RECORD_HEAD.size + length
                    if opcode == Opcode.MESSAGE:
                        messages = self._messages_outside(file, offset, length)
                        end = offset + len(messages.records)
                        yield messages
                    elif opcode == Opcode.ATTACHMENT:
                        self._scan_attachment(file, offset, length)
                    else:
                        if length > LARGEST_TEXTS and find_chunk(file, offset, self._size) != offset:
                            raise DamagedError("has inconsistent lengths")  # found before it is read into memory
                        _, body = read_record(file, offset, self._size)
                        if opcode in (Opcode.DATA_END, Opcode.FOOTER) and length >= 4:
                            expected = int.from_bytes(body[:4], "little") if opcode == Opcode.DATA_END else 0
                            break
                        taken = self._take(file, offset, opcode, body)
                        self._checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, length), self._checksum))
                        if taken is not None:
                            yield taken
                    offset = end
                except DamagedError as error:
                    self._undamaged = False
                    where = f"damaged at byte {offset} of {self._size}"
                    resumed = self._place_after(file, offset)
                    if resumed is None:
                        self._warn(f"cut off or {where}, the rest is not read: the record there {error}")
                        yield from self._cut_chunk(file, offset)
                        break
                    self._warn(f"{where}, reading continues at byte {resumed}: the record there {error}")
                    offset = resumed
            self._check_end(file, offset, expected)

    def _check_end(self, file: BinaryIO, offset: int, expected: int | None) -> None:
        """Warn of what is wrong at the end of the data, at this `offset`; `expected` is their checksum, 0 without."""
        if expected is not None and self._summary_damage:
            self._warn(f"cut off or damaged, the summary section is not used: it {self._summary_damage}")
        if expected is not None and (self.summary is None or not self.summary.checked):
            behind = find_chunk(file, offset, self._size)
            if behind is not None:
                self._undamaged = False
                self._warn(f"the chunks from byte {behind} on are not read, they are behind the end of the data")
        if not expected and self._outside:
            self._warn("the messages are in no chunks and have no checksum: damage in them would not be noticed")
        elif expected not in (None, self._checksum) and self._outside:
            self._warn("the messages are in no chunks, and the checksum of all does not fit: their values may be wrong")
        elif self._undamaged and expected not in (None, 0, self._checksum):
            self._warn("damaged between its chunks: the checksum of the data section does not fit")
        file.seek(0)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            self._warn("the magic at its beginning is damaged")

    def _take(self, file: BinaryIO, offset: int, opcode: int, body: bytes) -> Messages | None:
        """Take the content of a record at `offset`; returns the messages of a chunk."""
        end = offset + RECORD_HEAD.size + len(body)

        def parsed(kind: type[Record]) -> Record:
            record, rest = parse(kind, body)
            if rest and not is_record(file, end, self._size):  # not a later version's fields, but a wrong length
                raise DamagedError("has inconsistent lengths")
            return record

        if opcode == Opcode.CHUNK:
            return self._take_chunk(offset, parsed(Chunk))
        if opcode == Opcode.SCHEMA:
            self.table.add_schema(parsed(Schema))
        elif opcode == Opcode.CHANNEL:
            self.table.add_channel(parsed(Channel))
        elif opcode == Opcode.METADATA:
            self._add_metadata(parsed(Metadata))
        elif opcode == Opcode.HEADER:
            parsed(Header)
        elif opcode == Opcode.MESSAGE_INDEX and int.from_bytes(body[2:6], "little") == len(body) - 6:
            return None
        elif _is_chunk(opcode, body):
            self._undamaged = False
            self._warn(f"the chunk at byte {offset} has a damaged opcode")
            return self._take_chunk(offset, parsed(Chunk))
        elif not is_record(file, end, self._size):  # else it is a later version's, or another program's own
            raise DamagedError(f"is of an unknown kind ({opcode:#04x}), or has a wrong length")
        return None

    def _take_chunk(self, offset: int, chunk: Chunk) -> Messages | None:
        checksum = chunk.uncompressed_crc or zlib.crc32(chunk.data)
        key = chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size, checksum
        if key in self._seen:
            self._warn(f"the chunk at byte {offset} is there twice, and read once")
            return None
        try:
            messages, strange = find_messages(offset, unpack(chunk), self.table)
        except DamagedError as error:
            self._undamaged = False
            self._warn(f"the chunk at byte {offset} {error} and is left out")
            return None
        self._seen.add(key)
        if strange:
            self._warn(f"{strange} records of the chunk at byte {offset} are left out, expected messages")
        self._without_checksum += not chunk.uncompressed_crc
        self._count(messages)
        return messages

    def _scan_attachment(self, file: BinaryIO, offset: int, length: int) -> None:
        """Note an attachment, the content of which is only compared with its checksum, some at a time."""
        begin = offset + RECORD_HEAD.size
        file.seek(begin)
        name, media_type, size, content = attachment_head(file.read(min(length, 1 << 16)))
        if size + content + 4 > length or (
            size + content + 4 < length and not is_record(file, begin + length, self._size)
        ):
            raise DamagedError("has inconsistent lengths")
        checksum = file_checksum(file, begin, size + content)
        stored = int.from_bytes(file.read(4), "little")
        if stored not in (0, checksum):
            self._warn(f"attachment {name} does not match its checksum and is left out")
        else:
            self.attachments.append(StoredAttachment(self.path, offset, name, media_type, content))
        self._checksum = file_checksum(file, offset, RECORD_HEAD.size + length, self._checksum)

    def _place_after(self, file: BinaryIO, offset: int) -> int | None:
        """Where reading can go on after damage: the next place that the index names, or else the next chunk."""
        summary = self.summary
        places = []
        if summary is not None:
            places.append(summary.start - _DATA_END_SIZE)
            if summary.checked:
                places += [*summary.chunks.offsets, *summary.metadata, *(one.offset for one in summary.attachments)]
        if summary is None or not summary.checked or not len(summary.chunks):
            found = find_chunk(file, offset + 1, self._size)
            if found is None and not self._seen:
                found = self._find_message(file, offset + 1)
            places += [] if found is None else [found]
        return min((place for place in places if place > offset), default=None)

    def _cut_chunk(self, file: BinaryIO, offset: int) -> Iterator[Messages]:
        """The whole messages of the chunk in which the file ends."""
        file.seek(max(self._size - len(MCAP0_MAGIC), 0))
        closed = file.read() == MCAP0_MAGIC
        file.seek(offset)
        head = file.read(RECORD_HEAD.size)
        if closed or len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
            return
        try:
            chunk, _ = parse(Chunk, file.read(min(self._size - offset, LARGEST_CHUNK)), cut=True)
            records = unpack_beginning(chunk)
            messages, _ = find_messages(offset, records, self.table)
        except DamagedError:
            return
        count = len(messages.begins)
        if count and (len(records) != chunk.uncompressed_size or zlib.crc32(records) != chunk.uncompressed_crc):
            self._warn(f"{count} messages of the chunk that is cut off are read without its checksum")
        self._cut = messages
        self._count(messages)
        yield messages

    def _messages_outside(self, file: BinaryIO, offset: int, length: int) -> Messages:
        """The messages outside chunks from this `offset` on, some at a time; the first one's content has a `length`."""
        file.seek(offset)
        block = file.read(max(_UNCHUNKED_SIZE, length + 2 * RECORD_HEAD.size))
        end = 0
        while end < len(block) and self._is_message(file, offset + end, block[end : end + MESSAGE_HEAD_SIZE]):
            after = end + RECORD_HEAD.size + RECORD_HEAD.unpack_from(block, end)[1]
            if after > len(block):
                break
            end = after
        if not end:
            raise DamagedError("is no message of a channel before it")
        messages, _ = find_messages(offset, block[:end], self.table)
        self._outside[offset] = end
        self._checksum = zlib.crc32(messages.records, self._checksum)
        self._count(messages)
        return messages

    def _is_message(self, file: BinaryIO, offset: int, head: bytes) -> bool:
        """Whether a message of a known channel is at an `offset`, where this `head` is, and a record after it."""
        if len(head) < MESSAGE_HEAD_SIZE or not self._begins_message(head):
            return False
        end = offset + RECORD_HEAD.size + RECORD_HEAD.unpack_from(head)[1]
        if not offset + MESSAGE_HEAD_SIZE <= end <= self._size:
            return False
        file.seek(end)
        # the length of the record after it may be damaged
        return end == self._size or self._begins_message(file.read(11)) or is_record(file, end, self._size)

    def _begins_message(self, head: bytes) -> bool:
        return head[:1] == bytes([Opcode.MESSAGE]) and int.from_bytes(head[9:11], "little") in self.channels

    def _find_message(self, file: BinaryIO, begin: int) -> int | None:
        """Where from `begin` on the next message outside chunks is."""
        while begin < self._size:
            file.seek(begin)
            block = file.read(_UNCHUNKED_SIZE)
            for found in _MESSAGE_HEAD.finditer(block):
                if self._is_message(file, begin + found.start(), found[0] + found[1]):
                    return begin + found.start()
            begin += len(block) if begin + len(block) >= self._size else len(block) - MESSAGE_HEAD_SIZE
        return None


def _is_chunk(opcode: int, body: bytes) -> bool:
    """Whether a record with another `opcode` has the content of a chunk, as its checksum shows."""
    try:
        chunk, _ = parse(Chunk, body)
        return bool(opcode > Opcode.MESSAGE and chunk.uncompressed_crc and unpack(chunk))
    except DamagedError:
        return False
