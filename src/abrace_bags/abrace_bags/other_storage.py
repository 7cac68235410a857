# SPDX-License-Identifier: Apache-2.0
"""Bags that rosbag2 writes otherwise than as MCAP files: sqlite3, compressed files, compressed messages.

`rosbags` reads them; here their messages become the chunks that an MCAP file would have them in.
"""

from __future__ import annotations

import contextlib
import itertools
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.opcode import Opcode

from abrace_bags.mcap.chunk import find_messages
from abrace_bags.mcap.index import ChannelTable, RecordedChannel
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from mcap.records import Attachment

    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.mcap.index import MessageFilter

CHUNK_SIZE = 1 << 20
"""Bytes of messages that are read at a time."""
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_AFTER_LENGTH = _MESSAGE_HEAD.size - 9


class OtherStorage:
    """A bag of another storage: its attributes are those of `McapFile`; it has no metadata records, no attachments.

    Parameters
    ----------
    path
        A bag directory or a single file.

    Raises
    ------
    AbraceError
        If it can't be read.
    """

    in_time_order = indexed = True
    uncounted = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.table = ChannelTable()
        self.facts: dict[str, str] | None = None
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[Attachment] = []
        self.warnings: list[str] = []
        self.counts: dict[int, int] = {}
        self._expected: dict[int, int] = {}
        with self._open() as reader:
            for number, connection in enumerate(reader.connections):
                self._expected[number] = connection.msgcount
                self.channels[number] = _channel(connection)

    @property
    def paths(self) -> list[Path]:
        """All files in it but its metadata.yaml."""
        if self.path.is_file():
            return [self.path]
        return sorted(path for path in self.path.iterdir() if path.is_file() and path.suffix != ".yaml")

    @property
    def channels(self) -> dict[int, RecordedChannel]:
        """By channel id."""
        return self.table.channels

    def chunks(self, message_filter: MessageFilter) -> Iterator[Messages]:
        """The messages that `message_filter` keeps, some at a time, in the order of their log times."""
        accepted = {number for number, channel in self.channels.items() if message_filter.accepts(channel)}
        self.counts, self.warnings = {}, []
        parts: list[bytes] = []
        offset = size = 0
        with self._open() as reader:
            numbers = {(one.id, one.topic): number for number, one in enumerate(reader.connections)}
            connections = [one for number, one in enumerate(reader.connections) if number in accepted]
            if connections:
                for connection, time, payload in reader.messages(connections, message_filter.begin, message_filter.end):
                    number = numbers[connection.id, connection.topic]
                    self.counts[number] = self.counts.get(number, 0) + 1
                    head = _MESSAGE_HEAD.pack(Opcode.MESSAGE, _AFTER_LENGTH + len(payload), number, 0, time, time)
                    parts += (head, payload)
                    size += len(head) + len(payload)
                    if size > CHUNK_SIZE:
                        yield self._chunk(offset, parts)
                        offset, parts, size = offset + 1, [], 0
        if parts:
            yield self._chunk(offset, parts)
        if message_filter.begin is message_filter.end is None:
            for number in sorted(accepted):
                expected, found = self._expected[number], self.counts.get(number, 0)
                if found < expected:
                    topic = self.channels[number].topic
                    self.warnings.append(
                        f"{self.path}: {expected - found} of {expected} messages of {topic} are missing"
                    )

    def chunks_at(self, offsets: Sequence[int], message_filter: MessageFilter) -> Iterator[Messages]:
        """As `chunks` with `message_filter`, which reads everything again; nothing for no `offsets`."""
        if len(offsets):
            yield from self.chunks(message_filter)

    def edge(self, message_filter: MessageFilter, last: bool) -> Iterator[Messages]:
        """The first messages that `message_filter` keeps, or for the `last` ones all."""
        yield from itertools.islice(self.chunks(message_filter), None if last else 1)

    def _chunk(self, offset: int, parts: list[bytes]) -> Messages:
        heads = np.array([len(part) for part in parts], np.int64).reshape(-1, 2).sum(axis=1)
        begins = np.cumsum(heads) - heads
        message_offsets = [begins] if begins.size else []
        return find_messages(offset, b"".join(parts), message_offsets, self.table)

    @contextlib.contextmanager
    def _open(self) -> Iterator[Any]:
        # takes 0.2 s, which plain MCAP bags don't need
        from rosbags.rosbag2 import Reader

        try:
            with Reader(self.path) as reader:
                yield reader
        except AbraceError:
            raise
        except Exception as error:
            # of a damaged file rosbags raises what its database, its decompression or its own code happen to raise
            why = f"{type(error).__name__} {' '.join(str(error).split())}".strip()
            raise AbraceError(
                f"{self.path}: can't be read ({why}), expected MCAP: ros2 bag convert -i {self.path} "
                "-o mcap.yaml, in mcap.yaml output_bags: [{uri: NEW_BAG, storage_id: mcap, all_topics: true}]"
            ) from error


def _channel(connection: Any) -> RecordedChannel:
    """A topic as an MCAP file would have it; older bags have no definitions, then the installed one is taken."""
    from abrace_bags.definitions import message_definition
    from abrace_bags.metadata import yaml_text
    from abrace_bags.qos import in_words

    definition, digest = connection.msgdef.data, connection.digest
    if not definition:
        with contextlib.suppress(AbraceError):
            definition = message_definition(connection.msgtype).text
    encoding = "ros2idl" if connection.msgdef.format.name == "IDL" else "ros2msg"
    profiles = yaml_text([in_words(profile) for profile in connection.ext.offered_qos_profiles])
    metadata = {"offered_qos_profiles": profiles, "topic_type_hash": digest}
    return RecordedChannel(connection.topic, "cdr", metadata, connection.msgtype, encoding, definition)
