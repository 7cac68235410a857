# SPDX-License-Identifier: Apache-2.0
"""Bags in sqlite3 files, as rosbag2 wrote them up to ROS 2 Humble by default: whole, cut off, renamed, damaged."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from typing import TYPE_CHECKING

import pytest

from abrace_bags import Bag, TopicParts, describe, recover, write_csv
from abrace_bags.playback import bag_to_replay
from abrace_core import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

COUNT = 4000
TABLES = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos TEXT)",
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)",
)


def write(path: Path, type_name: str = "std_msgs/msg/String", count: int = COUNT) -> sqlite3.Connection:
    """Texts on /said, numbers on /counted, one a microsecond; the connection is open."""
    database = sqlite3.connect(path)
    for table in TABLES:
        database.execute(table)
    names = (1, "/said", type_name), (7, "/counted", "std_msgs/msg/Int64")
    database.executemany("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", names)
    rows = []
    for k in range(count):
        text = f"text {k}".encode() + b"\0"
        content = struct.pack("<I", len(text)) + text if k % 2 else struct.pack("<q", k)
        rows.append((1 if k % 2 else 7, 1000 * k, b"\0\1\0\0" + content))
    database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    database.commit()
    return database


def times(bag: Path) -> dict[str, list[int]]:
    """Log times of each topic, the same through every door."""
    opened = Bag(bag)
    found = {name: one.log_time.tolist() for name, one in opened.arrays().items()}
    copied = recover(bag, bag.with_name("recovered"))
    assert copied.counts == {name: len(of_topic) for name, of_topic in found.items()}
    assert {name: one.messages for name, one in describe(bag).contents.items()} == copied.counts
    assert {name: one.messages for name, one in bag_to_replay(str(bag), [], 0.0, 0.0).contents.items()} == copied.counts
    for topic, of_topic in found.items():
        write_csv(bag.with_name("table.csv"), TopicParts(Bag(bag).raw([topic])))
        assert len(bag.with_name("table.csv").read_text().splitlines()) == 1 + len(of_topic)
    shutil.rmtree(bag.with_name("recovered"))
    assert any("have no checksum" in warning for warning in opened.warnings)
    return found


@pytest.mark.parametrize("type_name", ["std_msgs/msg/String", "std_msgs/String"])
@pytest.mark.parametrize("named", ["bag", "bag/other_0.db3", "bag/odd.name"])
def test_a_sqlite3_bag_is_read_by_every_door(tmp_path: Path, type_name: str, named: str) -> None:
    (tmp_path / "bag").mkdir()
    write(tmp_path / (named if "/" in named else "bag/bag_0.db3"), type_name).close()
    found = times(tmp_path / named)
    assert found["/said"] == list(range(1000, 1000 * COUNT, 2000))
    assert found["/counted"] == list(range(0, 1000 * COUNT, 2000))
    arrays = Bag(tmp_path / named).arrays(begin=10_000, end=14_000)
    assert arrays["/said"].fields["data"].tolist() == ["text 11", "text 13"]
    assert arrays["/counted"].fields["data"].tolist() == [10, 12]


def test_rows_that_a_killed_recorder_left_in_the_log_are_read(tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "live.db3")
    database.execute("PRAGMA journal_mode=WAL")
    database.close()
    live = write(tmp_path / "live.db3", count=20)
    for name in ("live.db3", "live.db3-wal"):
        shutil.copy(tmp_path / name, tmp_path / name.replace("live", "killed"))
    assert times(tmp_path / "killed.db3") == {
        "/said": list(range(1000, 20_000, 2000)),
        "/counted": list(range(0, 20_000, 2000)),
    }
    live.close()


def test_a_damaged_page_or_row_costs_its_rows_alone(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    database = write(path)
    database.execute("UPDATE messages SET data = 5 WHERE id = 100")
    database.execute("UPDATE messages SET timestamp = -1 WHERE id = 200")
    database.execute("UPDATE messages SET topic_id = 3 WHERE id = 300")
    database.commit()
    size = path.stat().st_size
    database.close()
    found = times(path)
    assert sum(map(len, found.values())) == COUNT - 3
    assert any("3 rows are left out" in warning for warning in Bag(path).raw().warnings)
    content = bytearray(path.read_bytes())
    page = size // 2 // 4096 * 4096
    content[page : page + 4096] = bytes(4096)
    path.write_bytes(content)
    found = times(path)
    assert COUNT - 300 < sum(map(len, found.values())) < COUNT - 3
    assert set(range(0, 1000 * COUNT, 2000)) >= set(found["/counted"])
    path.write_bytes(bytes(100) + content[100:4096])
    with pytest.raises(AbraceError, match="not an MCAP file"):
        Bag(path)


def test_a_type_that_nobody_knows_is_kept_and_not_decoded(tmp_path: Path) -> None:
    write(tmp_path / "bag.db3", "nowhere_msgs/msg/Foo").close()
    bag = Bag(tmp_path / "bag.db3")
    assert list(bag.arrays()) == ["/counted"]
    assert any("the definition of nowhere_msgs/msg/Foo is not in the bag" in warning for warning in bag.warnings)
    assert recover(bag.path, tmp_path / "bag").counts == {"/said": COUNT // 2, "/counted": COUNT // 2}
    payloads = [message.payload for message in bag.raw(["/said"])]
    assert [message.payload for message in Bag(tmp_path / "bag").raw(["/said"])] == payloads
