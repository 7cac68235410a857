# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, chunk by chunk, with every checksum checked.

Undamaged data is kept; damaged data is left out, with a warning. After damage, reading continues at the next chunk,
found by the summary section; in a file that was cut off, which has no summary section, the next chunk is searched for.
For some topics or a range of time, only the chunks are read that hold some of them according to their chunk index.
"""

from __future__ import annotations

import contextlib
import math
import os
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata

from abrace_bags.mcap.chunk import Messages, find_messages, unpack
from abrace_bags.mcap.index import ChannelTable, MessageFilter, read_summary
from abrace_bags.mcap.records import (
    FACTS_RECORD,
    MCAP0_MAGIC,
    RECORD_HEAD,
    DamagedError,
    checked_facts,
    next_record,
    open_mcap,
    parse,
    record_head,
)
from abrace_bags.mcap.scan import FileContent, Scan, message_offsets_of, unchunked_records
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path


class McapFile(FileContent):
    """The undamaged content of an MCAP file.

    Where the file has its index, everything but the messages is read at once; otherwise when `chunks` has come to its
    end, and so is what follows from the messages: `counts`, `warnings`, `uncounted`.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    in_time_order
        Whether messages come in the order of their log times.
    indexed
        Whether the summary section names everything in the file.

    Raises
    ------
    AbraceError
        If the file can't be read or is not MCAP.
    """

    in_time_order = False

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with open_mcap(path) as file:
            self._size = os.fstat(file.fileno()).st_size
            try:
                self.summary = read_summary(file, self._size)
            except DamagedError as error:
                self.summary_damage = str(error)
            self.indexed = self._read_indexed_records(file)

    @property
    def paths(self) -> list[Path]:
        """The file, in a list."""
        return [self.path]

    def chunks(self, message_filter: MessageFilter) -> Iterator[Messages]:
        """The messages that `message_filter` keeps, chunk by chunk in the order of the file.

        Those of unknown channels are among them.
        """
        delivered: set[int] = set()
        if self.indexed and self.summary is not None:
            chunks = self.summary.chunks
            matching = chunks.matching(message_filter, self.channels)
            if len(matching) < len(chunks):
                with contextlib.suppress(DamagedError):
                    for k in matching:
                        yield self._kept(self.chunk_at(chunks.offsets[k]), message_filter)
                        delivered.add(chunks.offsets[k])
                    self._warn_of_left_out()
                    return
        # all is requested, no index, or a damaged chunk: what is missing is known when everything has been read
        self.clear()
        with open_mcap(self.path) as file:
            scan = Scan(self, file, self._size)
            for messages in scan.chunks():
                if messages.offset not in delivered:
                    yield self._kept(messages, message_filter)
            scan.finish(message_filter)
        self._warn_of_left_out()

    def chunk_at(self, offset: int) -> Messages:
        """All messages of the chunk at this `offset`.

        Raises
        ------
        DamagedError
            If it is incomplete.
        """
        if self.cut is not None and self.cut.offset == offset:
            return self.cut
        with open_mcap(self.path) as file:
            file.seek(offset)
            opcode, body = next_record(file, self._size)
            if opcode == Opcode.MESSAGE:
                return find_messages(offset, unchunked_records(file, offset, self._size), [], self.table)
            if opcode != Opcode.CHUNK:
                raise DamagedError("is not a chunk")
            chunk = parse(Chunk, body)
            self.without_checksum += chunk.uncompressed_crc == 0
            message_offsets = []
            while file.read(1) == bytes([Opcode.MESSAGE_INDEX]):
                file.seek(-1, os.SEEK_CUR)
                message_offsets.append(message_offsets_of(next_record(file, self._size)[1]))
        return find_messages(offset, unpack(chunk), message_offsets, self.table)

    def chunks_at(self, offsets: Iterable[int], message_filter: MessageFilter) -> Iterator[Messages]:
        """The messages that `message_filter` keeps of the chunks at these `offsets`, which `chunks` gave.

        Raises
        ------
        AbraceError
            If they can't be read any more.
        """
        for offset in offsets:
            try:
                yield self._kept(self.chunk_at(offset), message_filter)
            except DamagedError as error:
                raise AbraceError(
                    f"{self.path}: changed while it was read: the chunk at byte {offset} {error}"
                ) from error

    def edge(self, message_filter: MessageFilter, last: bool) -> Iterator[Messages]:
        """The messages that `message_filter` keeps of as many chunks as it takes to find the first, or the `last`."""
        if not self.indexed or self.summary is None:
            yield from self.chunks(message_filter)
            return
        chunks = self.summary.chunks
        matching = chunks.matching(message_filter, self.channels)
        bounds = np.array(chunks.ends if last else chunks.starts, np.uint64)[matching].astype(float)
        sign = -1.0 if last else 1.0
        found = math.inf
        for k in matching[np.argsort(sign * bounds, kind="stable")]:
            bound = sign * (chunks.ends if last else chunks.starts)[k]
            if bound > found:
                return
            try:
                messages = self._kept(self.chunk_at(chunks.offsets[k]), message_filter)
            except DamagedError:
                yield from self.chunks(message_filter)
                return
            if messages.begins.size:
                found = min(found, float((sign * messages.log_time).min()))
            yield messages

    def _read_indexed_records(self, file: BinaryIO) -> bool:
        """Read the records other than chunks from the summary section; False, with nothing read, if one is damaged."""
        if self.summary is None or not self.summary.complete:
            return False
        self.table = ChannelTable(dict(self.summary.table.schemas), dict(self.summary.table.channels))
        try:
            file.seek(0)
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise DamagedError("is damaged")
            for offset in self.summary.other_offsets:
                file.seek(offset)
                self.read_metadata_or_attachment(*next_record(file, self._size))
        except DamagedError:
            self.clear()
            return False
        return True

    def _kept(self, messages: Messages, message_filter: MessageFilter) -> Messages:
        if self._refused[:2] != (message_filter, len(self.channels)):
            refused = {number for number, channel in self.channels.items() if not message_filter.accepts(channel)}
            self._refused = message_filter, len(self.channels), refused
        kept = messages.kept(self._refused[2], message_filter.begin, message_filter.end)
        untimed = (kept.log_time | kept.publish_time) < 0
        if untimed.any():
            self._untimed += int(untimed.sum())
            kept = kept.chosen(~untimed)
        return kept

    def _warn_of_left_out(self) -> None:
        if self.without_checksum:
            self.warn(f"{self.without_checksum} chunks have no checksum: damage in them would not be noticed")
        if self._untimed:
            self.warn(f"{self._untimed} messages are left out: their times are 2^63 ns or more, after the year 2262")


def read_facts_record(path: Path) -> dict[str, str] | None:
    """The run's facts in one file, of which no chunk is read; None where it has none.

    Raises
    ------
    AbraceError
        If the file can't be read, is not MCAP, or its facts are damaged.
    """
    with open_mcap(path) as file, contextlib.suppress(DamagedError):
        size = os.fstat(file.fileno()).st_size
        opcode, indexed = 0, None
        while opcode != Opcode.DATA_END:
            opcode, length = record_head(file, size)
            if opcode != Opcode.METADATA:
                file.seek(length, os.SEEK_CUR)
            else:
                file.seek(-RECORD_HEAD.size, os.SEEK_CUR)
                # the facts have a checksum of their own
                record = parse(Metadata, next_record(file, size)[1], exact=False)
                if record.name == FACTS_RECORD:
                    return checked_facts(path, record.metadata)
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE) and indexed is None:
                indexed = McapFile(path)
                if indexed.indexed:
                    return indexed.facts
    return None
