"""The messages that are asked for, taken out of chunk after chunk."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode

from abrace_bags.mcap.chunk import record_starts
from abrace_bags.mcap.index import ChunkIndex, Descriptions
from abrace_bags.mcap.records import RECORD_HEAD, DamagedError
from abrace_bags.mcap.stream import MESSAGE_HEAD_SIZE, Channel, Stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

_LOG_TIME = 15
"""Where the log time stands in a message's record."""


@dataclass(frozen=True)
class Wanted:
    """Which messages to keep.

    Parameters
    ----------
    channel
        Whether to keep a channel's messages.
    begin, end
        Log times [ns], `begin` included, `end` not; None: from the first, to the last.
    """

    channel: Callable[[Channel], bool]
    begin: int | None = None
    end: int | None = None

    def may_be_in(self, chunk: ChunkIndex, descriptions: Descriptions) -> bool:
        """Whether such messages can be in a `chunk` whose channels have these `descriptions`."""
        if (self.end is not None and chunk.begin >= self.end) or (self.begin is not None and chunk.end < self.begin):
            return False
        found = [descriptions.channels.get(number) for number in chunk.channels]
        return not found or any(channel is None or self.channel(channel) for channel in found)


@dataclass
class Selection:
    """What was taken so far.

    Parameters
    ----------
    wanted
        Which messages to keep.
    descriptions
        Of the channels met so far.
    streams
        The messages kept, by channel number.
    counts
        Messages met, kept or not, by channel number.
    """

    wanted: Wanted
    descriptions: Descriptions = field(default_factory=Descriptions)
    streams: dict[int, Stream] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)

    def take(self, data: bytes, said: Sequence[NDArray[np.int64]]) -> int:
        """Keep what is wanted of records.

        Parameters
        ----------
        data
            Records of a chunk.
        said
            Where its messages begin (`record_starts`).

        Returns
        -------
        int
            Messages met.

        Raises
        ------
        DamagedError
            If they are not what a chunk may hold; nothing of it is kept then.
        """
        start = record_starts(data, said)
        if not start.size:
            return 0
        size = np.append(start[1:], len(data)) - start
        opcode = np.frombuffer(data, np.uint8)[start]
        is_message = opcode == Opcode.MESSAGE
        if not is_message.all():
            for one in np.flatnonzero((opcode == Opcode.SCHEMA) | (opcode == Opcode.CHANNEL)):
                self.descriptions.add(int(opcode[one]), data[start[one] + RECORD_HEAD.size : start[one] + size[one]])
            start, size = start[is_message], size[is_message]
            if not start.size:
                return 0
        if size.min() < MESSAGE_HEAD_SIZE:
            raise DamagedError("holds a message that is too short")
        channel = np.ndarray((len(data) - 1,), "<u2", data, strides=(1,))[start + RECORD_HEAD.size]
        inside = self._inside(data, start)
        counts = np.bincount(channel)
        met = sum(self.counts.values())
        for number in np.flatnonzero(counts).tolist():
            self.counts[number] = self.counts.get(number, 0) + int(counts[number])
            described = self.descriptions.channels.get(number)
            if described is not None and not self.wanted.channel(described):
                continue
            chosen = channel == number if inside is None else (channel == number) & inside
            self.streams.setdefault(number, Stream()).append(
                data, start[chosen], size[chosen], met + np.flatnonzero(chosen)
            )
        return int(start.size)

    def _inside(self, data: bytes, start: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """(messages,) whether they are in the range of time; None where there is none."""
        if self.wanted.begin is None and self.wanted.end is None:
            return None
        time = np.ndarray((len(data) - 7,), "<u8", data, strides=(1,))[start + _LOG_TIME]
        inside = np.ones(start.size, bool)
        if self.wanted.begin is not None:
            inside &= time >= max(self.wanted.begin, 0)
        if self.wanted.end is not None:
            inside &= time < max(self.wanted.end, 0)
        return inside
