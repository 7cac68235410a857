# SPDX-License-Identifier: Apache-2.0
"""One sqlite3 file of a bag, as rosbag2 wrote it up to Humble by default: its rows as an MCAP file has messages."""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.opcode import Opcode

from abrace_bags.definitions import message_definition
from abrace_bags.mcap.bag_file import BagFile
from abrace_bags.mcap.chunk import Messages
from abrace_bags.mcap.records import RECORD_HEAD
from abrace_bags.topics import RecordedTopic
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SQLITE_MAGIC = b"SQLite format 3\0"

_HEAD = struct.Struct("<BQHIQQ")
_SIZE = 1 << 20
"""Bytes of messages that are read at a time."""
_LATEST = 2**63
_ROWS = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id"


class SqliteFile(BagFile):
    """The rows that can be read of the sqlite3 file at a `path`.

    Raises
    ------
    AbraceError
        If its topics can't be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        # a file that a killed recorder left has its last rows in a second one; without that one nothing is written
        mode = "mode=ro" if path.with_name(f"{path.name}-wal").exists() else "immutable=1"
        try:
            self._database = sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True, check_same_thread=False)
            self._database.text_factory = lambda text: text.decode(errors="replace")
            self._topics = dict(self._channels())
            ((self._last,),) = self._database.execute("SELECT max(id) FROM messages")
        except (sqlite3.Error, ValueError) as error:
            raise AbraceError(f"{path}: can't be read ({error}), expected a bag of rosbag2") from error

    def _channels(self) -> Iterator[tuple[int, RecordedTopic]]:
        known = {}
        with contextlib.suppress(sqlite3.Error):  # before ROS 2 Iron there are none
            known = {row["topic_type"]: row for row in self._table("message_definitions")}
        for row in self._table("topics"):
            name = row["type"] if row["type"].count("/") > 1 else row["type"].replace("/", "/msg/")
            described = known.get(row["type"], {})
            text, encoding = described.get("encoded_message_definition", ""), described.get("encoding", "")
            if not text:
                text, encoding = _known_definition(name)
            yield (
                row["id"],
                RecordedTopic(
                    row["name"],
                    name,
                    row.get("type_description_hash", ""),
                    (row.get("offered_qos_profiles", ""),),
                    text,
                    encoding,
                    row["serialization_format"],
                ),
            )

    def _table(self, name: str) -> list[dict[str, Any]]:
        found = self._database.execute(f"SELECT * FROM {name}")
        columns = [column[0] for column in found.description]
        return [dict(zip(columns, row, strict=True)) for row in found]

    def _scan(self) -> Iterator[Messages]:
        self.table.channels = dict(enumerate(self._topics.values()))
        self._warn("the messages have no checksum, as in every sqlite3 file: damage in them would not be noticed")
        begin, self._wrong = 0, 0
        while begin <= (self._last or 0):
            messages, begin = self._read(begin)
            self._count(messages)
            yield messages
        if self._wrong:
            self._undamaged = False
            self._warn(f"{self._wrong} rows are left out: they are damaged")

    def _chunk_at(self, offset: int) -> Messages:
        return self._read(offset)[0]

    def _read(self, begin: int) -> tuple[Messages, int]:
        """Messages from the row `begin` on, and the row after them."""
        numbers = {topic: number for number, topic in enumerate(self._topics)}
        records: list[bytes] = []
        channels: list[int] = []
        size, row = 0, begin
        while row <= self._last and size < _SIZE:
            try:
                for found, topic, time, data in self._database.execute(_ROWS, (row,)):
                    row = found + 1
                    if topic not in numbers or not isinstance(data, bytes) or not _is_time(time):
                        self._wrong += 1
                        continue
                    length = _HEAD.size - RECORD_HEAD.size + len(data)
                    head = _HEAD.pack(Opcode.MESSAGE, length, numbers[topic], 0, time, time)
                    records.append(head + data)
                    channels.append(numbers[topic])
                    size += len(records[-1])
                    if size >= _SIZE:
                        break
                else:
                    row = self._last + 1
            except (sqlite3.Error, OverflowError):
                self._wrong += 1
                row += 1
        sizes = np.array([len(record) for record in records], np.int64)
        content = b"".join(records)
        return Messages(begin, content, np.cumsum(sizes) - sizes, sizes, np.array(channels, np.uint16)), row


def _is_time(time: object) -> bool:
    return isinstance(time, int) and 0 <= time < _LATEST


def _known_definition(type_name: str) -> tuple[str, str]:
    """The text of a type that the file does not describe, and how it is written; empty where nobody knows it."""
    from rosbags.typesys import Stores, TypesysError, get_typestore

    try:
        return message_definition(type_name).text, "ros2msg"
    except AbraceError:
        with contextlib.suppress(TypesysError, KeyError):
            return get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(type_name, ros_version=2)[0], "ros2msg"
    return "", ""
