"""One MCAP file to the messages of each channel, chunk by chunk, with every checksum checked.

What is whole is kept, what is not is left out and said. Behind a damaged place reading goes on at the next chunk: the
index says where that is, and where there is no index, because the file was cut off, it is looked for. Where topics or a
range of time are asked for, only the chunks that the index names for them are read.
"""

from __future__ import annotations

import os
import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from abrace_bags.mcap.attachments import parse_attachment
from abrace_bags.mcap.chunk import Chunk, find_chunk, parse_chunk, unpack, unpack_beginning
from abrace_bags.mcap.index import Index, read_index
from abrace_bags.mcap.records import (
    FACTS_RECORD,
    RECORD_HEAD,
    DamagedError,
    RecordFields,
    checked_facts,
    next_record,
    open_mcap,
)
from abrace_bags.mcap.selection import Selection, Wanted
from abrace_bags.mcap.stream import MESSAGE_HEAD_SIZE, Channel, Stream
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

    from mcap.records import Attachment
    from numpy.typing import NDArray

_DATA_END_SIZE = RECORD_HEAD.size + 4


class McapFile:
    """What is whole in an MCAP file.

    Parameters
    ----------
    path
        The file.
    wanted
        Which messages to keep.

    Attributes
    ----------
    channels
        By channel number.
    streams
        Messages by channel number.
    facts
        The run's facts; None where there are none, or they are damaged.
    metadata
        All metadata records: texts by key, by the record's name.
    attachments
        Files of the run.
    warnings
        What is missing or can't be trusted, one sentence each.
    uncounted
        Whether messages are missing, nobody knows how many.

    Raises
    ------
    AbraceError
        If the file can't be read or is not MCAP.
    """

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self.facts: dict[str, str] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
        self.warnings: list[str] = []
        self.uncounted = False
        self._path = path
        self._wanted = wanted
        self._found = Selection(wanted)
        self._chunk: tuple[int, Chunk] | None = None
        self._said: list[NDArray[np.int64]] = []
        self._loose = bytearray()
        self._unchecked = 0
        self._whole = True
        with open_mcap(path) as file:
            self._size = os.fstat(file.fileno()).st_size
            index, trouble = None, None
            try:
                index = read_index(file, self._size)
            except DamagedError as error:
                trouble = str(error)
            if index is None or not self._read_by_index(file, index):
                self._found = Selection(wanted)
                self._read_all(file, index, trouble)
            file.seek(0)
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                self._warn("its opening mark is damaged")
        self.channels: dict[int, Channel] = self._found.descriptions.channels
        self.streams: dict[int, Stream] = self._found.streams
        for number in [number for number in self.streams if number not in self.channels]:
            lost = self.streams.pop(number).count
            self.uncounted = True
            self._warn(f"{lost} messages of channel {number} are left out: what the channel is was lost")

    def _warn(self, text: str) -> None:
        self.warnings.append(f"{self._path}: {text}")

    def _read_by_index(self, file: BinaryIO, index: Index) -> bool:
        """Read the chunks that are needed, if there are others, nothing else is in the file, and those are whole."""
        if not index.complete:
            return False
        needed = [chunk for chunk in index.chunks if self._wanted.may_be_in(chunk, index.descriptions)]
        if len(needed) == len(index.chunks):
            return False
        self._found.descriptions = index.descriptions
        try:
            for offset in index.beside:
                file.seek(offset)
                self._beside(*next_record(file, self._size))
            for place in needed:
                file.seek(place.offset)
                opcode, body = next_record(file, self._size)
                if opcode != Opcode.CHUNK:
                    raise DamagedError("is not a chunk")
                chunk = parse_chunk(body)
                self._unchecked += chunk.checksum == 0
                self._found.take(unpack(chunk), self._messages_said(file))
        except DamagedError:
            self.facts, self._unchecked = None, 0
            self.metadata.clear()
            self.attachments.clear()
            self.warnings.clear()
            return False
        self._warn_of_unchecked()
        return True

    def _messages_said(self, file: BinaryIO) -> list[NDArray[np.int64]]:
        """Where the messages of the chunk begin that ends here, as the records behind it say."""
        said = []
        while file.read(1) == bytes([Opcode.MESSAGE_INDEX]):
            file.seek(-1, os.SEEK_CUR)
            said.append(_message_index(next_record(file, self._size)[1]))
        return said

    def _warn_of_unchecked(self) -> None:
        if self._unchecked:
            self._warn(f"{self._unchecked} chunks have no checksum: damage in them would not be seen")

    def _read_all(self, file: BinaryIO, index: Index | None, trouble: str | None) -> None:
        checksum = zlib.crc32(MCAP0_MAGIC)
        expected: int | None = None
        file.seek(len(MCAP0_MAGIC))
        while expected is None:
            offset = file.tell()
            try:
                opcode, body = next_record(file, self._size)
                if opcode == Opcode.DATA_END and len(body) == 4:
                    expected = int.from_bytes(body, "little")
                    break
                self._data_record(offset, opcode, body)
                checksum = zlib.crc32(body, zlib.crc32(RECORD_HEAD.pack(opcode, len(body)), checksum))
            except DamagedError as error:
                place = self._next_place(file, offset, index)
                if place is None:
                    what = f"cut off or damaged at byte {offset} of {self._size}, the rest is not read"
                    self._warn(f"{what}: what is there {error}")
                    self._cut_chunk(file, offset)
                    break
                self._whole = False
                self._warn(f"damaged at byte {offset} of {self._size}, read on at byte {place}: what is there {error}")
                file.seek(place)
        self._finish_chunk()
        if expected is None:
            self._whole = False
        elif trouble is not None:
            self._warn(f"cut off or damaged, the index is not used: it {trouble}")
        self._loose_messages(expected, checksum, file)
        if self._whole and expected not in (None, 0, checksum):
            self._warn("damaged between its chunks: the checksum over them does not fit")
        self._warn_of_unchecked()
        self._count(index)

    def _data_record(self, offset: int, opcode: int, body: bytes) -> None:
        if opcode == Opcode.MESSAGE_INDEX and self._chunk is not None:
            self._said.append(_message_index(body))
            return
        self._finish_chunk()
        fields = RecordFields(body)
        if opcode == Opcode.CHUNK:
            if self._loose:
                raise DamagedError("is a chunk among messages outside chunks")
            self._chunk = offset, parse_chunk(body)
        elif opcode == Opcode.MESSAGE:
            first = offset == len(MCAP0_MAGIC)  # there stands the header
            if first or self._found.counts or len(body) < MESSAGE_HEAD_SIZE - RECORD_HEAD.size:
                raise DamagedError("is a message outside the chunks")
            self._loose += RECORD_HEAD.pack(opcode, len(body)) + body
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._found.descriptions.add(opcode, body)
        elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            self._beside(opcode, body)
        elif opcode == Opcode.MESSAGE_INDEX:
            _message_index(body)
        elif opcode == Opcode.HEADER:
            fields.text()
            fields.text()
            fields.end()
        elif opcode < 0x80:
            raise DamagedError(f"is of an unknown kind ({opcode:#04x})")
        else:
            self._whole = False
            self._warn(f"the record at byte {offset} is of an unknown kind ({opcode:#04x}) and left out")

    def _beside(self, opcode: int, body: bytes) -> None:
        """Take in what stands beside the messages: an attachment or a metadata record."""
        if opcode == Opcode.ATTACHMENT:
            self.attachments.append(parse_attachment(body))
            return
        fields = RecordFields(body)
        name = fields.text()
        texts = fields.texts()
        fields.end()
        self.metadata[name] = texts
        if name == FACTS_RECORD:
            try:
                self.facts = checked_facts(self._path, dict(texts))
            except AbraceError as error:
                self.warnings.append(str(error))

    def _finish_chunk(self) -> None:
        """Take the messages of the chunk whose message indexes have all been read."""
        if self._chunk is None:
            return
        (offset, chunk), said = self._chunk, self._said
        self._chunk, self._said = None, []
        try:
            self._found.take(unpack(chunk), said)
        except DamagedError as error:
            self._whole = False
            self._warn(f"the chunk at byte {offset} {error} and is left out")
            return
        self._unchecked += chunk.checksum == 0

    def _next_place(self, file: BinaryIO, offset: int, index: Index | None) -> int | None:
        """Where reading can go on behind damage at `offset`."""
        places = [] if index is None else [chunk.offset for chunk in index.chunks]
        if not places:
            found = find_chunk(file, offset + 1, self._size)
            places = [] if found is None else [found]
        if index is not None:
            places.append(index.begin - _DATA_END_SIZE)
        return next((place for place in places if place > offset), None)

    def _cut_chunk(self, file: BinaryIO, offset: int) -> None:
        """Take what is there of the chunk in which the file ends."""
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        closed = file.read() == MCAP0_MAGIC
        file.seek(offset)
        head = file.read(RECORD_HEAD.size)
        if closed or self._loose or len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
            return
        self._finish_chunk()
        try:
            chunk = parse_chunk(file.read(), whole=False)
            data = unpack_beginning(chunk)
            taken = self._found.take(data, [])
        except DamagedError:
            return
        if taken and not (len(data) == chunk.size and zlib.crc32(data) == chunk.checksum):
            self._warn(f"{taken} messages of the chunk that is cut off are read without its checksum")

    def _loose_messages(self, expected: int | None, checksum: int, file: BinaryIO) -> None:
        """Take the messages outside chunks, where the checksum of all of them fits, or there is none."""
        if not self._loose:
            return
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        cut = expected is None and file.read() != MCAP0_MAGIC
        if not cut and expected not in (0, checksum):
            raise AbraceError(f"{self._path}: its messages do not fit their checksum, the file is damaged")
        self._found.take(bytes(self._loose), [])
        if expected != checksum:
            self._warn("the messages are in no chunks and have no checksum: damage in them would not be seen")

    def _count(self, index: Index | None) -> None:
        """Say what is missing, by topic."""
        found = self._found
        if index is None or index.counts is None:
            self.uncounted = not self._whole
            return
        channels = found.descriptions.channels
        known = index.descriptions.channels if index.complete else channels
        channels.update({**index.descriptions.channels, **known})
        for number, expected in index.counts.items():
            missing = expected - found.counts.get(number, 0)
            channel = channels.get(number)
            if missing > 0 and channel is not None and self._wanted.channel(channel):
                self._warn(f"{missing} of {expected} messages of {channel.topic} are missing")


def _message_index(body: bytes) -> NDArray[np.int64]:
    """Where messages begin in their chunk."""
    fields = RecordFields(body)
    fields.number(2)
    size = fields.number(4)
    if size % 16 or size != len(body) - fields.offset:
        raise DamagedError("has lengths that don't fit")
    return np.frombuffer(body, "<i8", offset=fields.offset)[1::2]
