# SPDX-License-Identifier: Apache-2.0
"""One file of a bag, read forward from its beginning to its end: what is asked for of it, what is missing in it."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from abrace_bags.mcap.index import ChannelTable
from abrace_bags.mcap.records import DamagedError
from abrace_bags.topics import Selection
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from abrace_bags.mcap.attachments import StoredAttachment
    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.mcap.index import SummarySection
    from abrace_bags.topics import RecordedTopic


class BagFile:
    """The undamaged content of a file.

    Where the file has its index, everything but the messages is known at once; otherwise when `chunks` has come to its
    end, and so is what follows from the messages: `warnings`, `uncounted`.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    summary
        The summary section, if it is there and whole.
    table
        Channels by their ids.
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
    indexed
        Whether the summary section names everything in the file.
    known
        Whether everything but the messages is known.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary: SummarySection | None = None
        self.indexed = self.known = False
        self._clear()

    def _scan(self) -> Iterator[Messages]:
        """All messages, some at a time; everything else is taken on the way."""
        raise NotImplementedError

    def _chunk_at(self, offset: int) -> Messages:
        """The messages that `_scan` gave with this `offset`.

        Raises
        ------
        DamagedError
            If they are not there.
        """
        raise NotImplementedError

    @property
    def channels(self) -> dict[int, RecordedTopic]:
        """By channel id."""
        return self.table.channels

    def know(self) -> None:
        """Read the file, if its topics, records and attachments are not known without."""
        if not self.known:
            for _ in self.chunks(Selection()):
                pass

    def chunks(self, selection: Selection) -> Iterator[Messages]:
        """The messages that a `selection` keeps, chunk by chunk in the order of the file.

        Those of unknown channels are among them.
        """
        delivered: set[int] = set()
        self._without_checksum = self._untimed = 0
        if self.indexed and self.summary is not None:
            chunks = self.summary.chunks
            matching = chunks.matching(selection, self.channels)
            if len(matching) < len(chunks):
                with contextlib.suppress(DamagedError):
                    for k in matching:
                        yield self._kept(self._chunk_at(chunks.offsets[k]), selection)
                        delivered.add(chunks.offsets[k])
                    self._warn_of_left_out()
                    return
        # all is requested, no index, or a damaged chunk: what is missing is known when everything has been read
        self._clear()
        if self.summary is not None and self.summary.checked:
            self.table = self.summary.table.described()
        for messages in self._scan():
            if messages.offset not in delivered:
                yield self._kept(messages, selection)
        self._count_missing(selection)
        self._warn_of_left_out()
        self.known = True

    def chunks_at(self, offsets: Iterable[int], selection: Selection) -> Iterator[Messages]:
        """The messages that a `selection` keeps of the chunks at these `offsets`, which `chunks` gave.

        Raises
        ------
        AbraceError
            If they can't be read any more.
        """
        for offset in offsets:
            try:
                yield self._kept(self._chunk_at(offset), selection)
            except DamagedError as error:
                raise AbraceError(
                    f"{self.path}: changed while it was read: the chunk at byte {offset} {error}"
                ) from error

    def ends(self, selection: Selection, last: bool) -> Iterator[Messages]:
        """The messages that a `selection` keeps of as many chunks as it takes to find the first one, or the `last`."""
        if not self.indexed or self.summary is None:
            yield from self.chunks(selection)
            return
        chunks = self.summary.chunks
        matching = chunks.matching(selection, self.channels)
        sign, bounds = (-1, chunks.ends) if last else (1, chunks.starts)
        found: list[int] = []
        for bound, k in sorted((sign * bounds[k], k) for k in matching.tolist()):
            if found and min(found) <= bound:
                return
            try:
                messages = self._kept(self._chunk_at(chunks.offsets[k]), selection)
            except DamagedError as error:
                self._warn(f"the chunk at byte {chunks.offsets[k]} {error} and is left out")
                continue
            found += (sign * messages.log_time).tolist()
            yield messages

    def _clear(self) -> None:
        """Forget what was read."""
        self.table = ChannelTable()
        self.facts: dict[str, str] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[StoredAttachment] = []
        self.warnings: list[str] = []
        self.uncounted = False
        self._counts: dict[int, int] = {}
        self._without_checksum = self._untimed = 0
        self._refused: tuple[Selection | None, int, list[int]] = None, 0, []
        self._undamaged = True

    def _warn(self, text: str) -> None:
        self.warnings.append(f"{self.path}: {text}")

    def _kept(self, messages: Messages, selection: Selection) -> Messages:
        """Those of the `messages` that a `selection` keeps."""
        if self._refused[:2] != (selection, len(self.channels)):
            refused = [number for number, channel in self.channels.items() if not selection.accepts(channel)]
            self._refused = selection, len(self.channels), refused
        keep = np.ones(messages.begins.size, bool)
        if self._refused[2]:
            accepted = np.ones(1 << 16, bool)
            accepted[self._refused[2]] = False
            keep &= accepted[messages.channel_ids]
        log_time = messages.log_time
        if selection.begin is not None:
            keep &= log_time >= selection.begin
        if selection.end is not None:
            keep &= (log_time < selection.end) & (log_time >= 0)
        untimed = keep & ((log_time | messages.publish_time) < 0)
        self._untimed += int(untimed.sum())
        keep &= ~untimed
        return messages if keep.all() else messages.chosen(keep)

    def _count(self, messages: Messages) -> None:
        """Count the `messages` of a chunk."""
        counts = np.bincount(messages.channel_ids)
        for channel_id in np.flatnonzero(counts).tolist():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + int(counts[channel_id])

    def _count_missing(self, selection: Selection) -> None:
        """Warn of missing messages that `selection` would keep, by topic, and of those of unknown topics."""
        summary = self.summary
        if summary is None or summary.message_counts is None:
            self.uncounted = not self._undamaged
        else:
            self.table.channels = self.channels | summary.table.channels | self.table.described().channels
            for channel_id, expected in summary.message_counts.items():
                missing = expected - self._counts.get(channel_id, 0)
                channel = self.channels.get(channel_id)
                if missing > 0 and channel is not None and selection.accepts(channel):
                    self._warn(f"{missing} of {expected} messages of {channel.name} are missing")
        for channel_id in sorted(self._counts.keys() - self.channels.keys()):
            self.uncounted = True
            lost = f"{self._counts[channel_id]} messages of channel {channel_id}"
            self._warn(f"{lost} are left out: the record of the channel is lost")

    def _warn_of_left_out(self) -> None:
        for conflict in self.table.conflicts:
            self._warn(conflict)
        if self._without_checksum:
            self._warn(f"{self._without_checksum} chunks have no checksum: damage in them would not be noticed")
        if self._untimed:
            self._warn(f"{self._untimed} messages are left out: their times are 2^63 ns or more, after the year 2262")
