"""Messages of one channel as raw records, in blocks of equal length that are arrays already."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

MESSAGE_HEAD_SIZE = 31
"""Bytes of a message record before the message: opcode, length, channel, sequence, log time, publish time."""


@dataclass(frozen=True)
class Channel:
    """One topic in one file: its name, how its messages are written, what else is said of it (QoS, hash), its type."""

    topic: str
    message_encoding: str
    details: Mapping[str, str]
    type_name: str
    schema_encoding: str
    definition: str


@dataclass
class Stream:
    """Messages of one channel so far: for each length that occurred, their numbers and their records."""

    count: int = 0
    places: list[NDArray[np.int64]] = field(default_factory=list)
    blocks: dict[int, list[tuple[NDArray[np.int64], NDArray[np.void]]]] = field(default_factory=dict)

    def append(
        self, data: bytes, starts: NDArray[np.int64], sizes: NDArray[np.int64], places: NDArray[np.int64]
    ) -> None:
        """Take the message records that start at `starts` in `data` and are `sizes` long.

        `places` are their numbers among the messages of all channels.
        """
        self.places.append(places)
        numbers = np.arange(self.count, self.count + starts.size)
        self.count += starts.size
        for size in np.unique(sizes).tolist():
            chosen = sizes == size
            # a record at every byte of the chunk, of which those that are records are copied
            everywhere = np.ndarray((len(data) - size + 1,), np.dtype(f"V{size}"), data, strides=(1,))
            block = (numbers[chosen], everywhere[starts[chosen]])
            self.blocks.setdefault(size - MESSAGE_HEAD_SIZE, []).append(block)

    def columns(self, name: str, form: str, offset: int) -> NDArray[np.int64]:
        """(messages,) of one number in the head of every message."""
        column = np.empty(self.count, np.int64)
        for size, blocks in self.blocks.items():
            row = np.dtype(
                {"names": [name], "formats": [form], "offsets": [offset], "itemsize": MESSAGE_HEAD_SIZE + size}
            )
            for numbers, records in blocks:
                column[numbers] = records.view(row)[name]
        return column

    @property
    def place(self) -> NDArray[np.int64]:
        """(messages,) numbers among the messages of all channels: the order in which they were written."""
        return np.concatenate(self.places)

    @property
    def log_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self.columns("log_time", "<u8", 15)

    @property
    def publish_time(self) -> NDArray[np.int64]:
        """(messages,) [ns]."""
        return self.columns("publish_time", "<u8", 23)

    def payloads(self) -> list[tuple[NDArray[np.int64], NDArray[np.void]]]:
        """For each length that occurs: numbers of the messages, and their bytes."""
        payloads = []
        for size, blocks in self.blocks.items():
            row = np.dtype(
                {
                    "names": ["payload"],
                    "formats": [f"V{size}"],
                    "offsets": [MESSAGE_HEAD_SIZE],
                    "itemsize": MESSAGE_HEAD_SIZE + size,
                }
            )
            records = np.concatenate([records for _, records in blocks])
            payloads.append((np.concatenate([numbers for numbers, _ in blocks]), records.view(row)["payload"]))
        return payloads

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Log time and publish time [ns] and bytes of every message, in their order."""
        texts: list[bytes] = [b""] * self.count
        for numbers, block in self.payloads():
            for number, payload in zip(numbers.tolist(), block.tolist(), strict=True):
                texts[number] = payload
        yield from zip(self.log_time.tolist(), self.publish_time.tolist(), texts, strict=True)
