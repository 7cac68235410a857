# SPDX-License-Identifier: Apache-2.0
"""Raw messages of any bag: all of them, in time order, their bytes and QoS as they were recorded."""

from __future__ import annotations

import contextlib
import sqlite3
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from reference_messages import note
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from abrace_bags import BagWriter, read_topics, recover
from abrace_bags.description import describe
from abrace_bags.export import write_csv
from abrace_bags.parts import TopicParts
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.raw import RawBag, read_raw
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

STRING = "std_msgs/msg/String"
STORE = get_typestore(Stores.ROS2_JAZZY)
HASH = STORE.hash_rihs01(STRING)
FOREVER = QosTime(2147483647, 4294967295)
TRANSIENT_LOCAL = Qos(
    QosHistory.KEEP_LAST, 3, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, QosTime(0, 5), FOREVER,
    QosLiveliness.AUTOMATIC, FOREVER, False,
)  # fmt: skip
Message = tuple[str, bytes, int]


def messages(count: int = 300) -> list[Message]:
    """Messages of two topics in the order of their times: of random bytes and lengths."""
    random = np.random.default_rng(1)
    return [("/a/said" if k % 3 else "/b/said", random.bytes(1 + k % 7), 1000 + 10 * k) for k in range(count)]


def wire(bag: RawBag) -> list[Message]:
    """Topics, bytes and log times of a bag's messages, which are as many as it says."""
    found = [message[:3] for message in bag.read()]
    assert len(found) == bag.count
    assert (found[0][2], found[-1][2]) == (bag.first, bag.last)
    return found


def write_ours(directory: Path, content: Sequence[Message]) -> Path:
    with BagWriter(directory, {}) as bag:
        numbers = {
            "/a/said": bag.add_topic("/a/said", STRING, "string data\n", HASH, TRANSIENT_LOCAL),
            "/b/said": bag.add_topic("/b/said", STRING, "string data\n", HASH),
        }
        for topic, payload, time in content:
            bag.write(numbers[topic], payload, time, time)
    return directory


def write_theirs(directory: Path, content: Sequence[Message], plugin: StoragePlugin, compression: Any = None) -> Path:
    writer = Writer(directory, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer as bag:
        connections = {
            "/a/said": bag.add_connection("/a/said", STRING, typestore=STORE, offered_qos_profiles=[TRANSIENT_LOCAL]),
            "/b/said": bag.add_connection("/b/said", STRING, typestore=STORE),
        }
        for topic, payload, time in content:
            bag.write(connections[topic], time, payload)
    return directory


@pytest.mark.parametrize(
    "kind", ["ours", "mcap", "sqlite3", "file compression", "message compression", "compressed messages in mcap"]
)
def test_every_bag_gives_every_message_as_it_was_in_time_order(tmp_path: Path, kind: str) -> None:
    content = messages()
    shuffled = [content[k] for k in np.random.default_rng(2).permutation(len(content))]
    path = tmp_path / "bag"
    if kind == "ours":
        write_ours(path, shuffled)
    else:
        plugin = StoragePlugin.MCAP if "mcap" in kind else StoragePlugin.SQLITE3
        modes = {"file compression": CompressionMode.FILE, "message compression": CompressionMode.MESSAGE}
        mode = CompressionMode.MESSAGE if kind.startswith("compressed") else modes.get(kind)
        write_theirs(path, shuffled, plugin, mode)
    bag = read_raw(path)
    assert wire(bag) == content
    assert all(kind == "mcap" and "have no checksum" in warning for warning in bag.warnings)
    assert set(bag.topics) == {"/a/said", "/b/said"}
    topic = bag.topics["/a/said"]
    assert topic.type_name == STRING
    assert topic.type_hash == ("" if kind == "mcap" else HASH), "rosbags leaves it out of MCAP files"
    forever = DEFAULT_QOS.lifespan
    assert topic.qos == TRANSIENT_LOCAL._replace(lifespan=forever, liveliness_lease_duration=forever)


def test_messages_of_one_time_come_in_the_order_in_which_they_were_written(tmp_path: Path) -> None:
    content = [(topic, bytes([k]) * (1 + k % 3), 1000 + k // 50) for k, (topic, _, _) in enumerate(messages(200))]
    with BagWriter(tmp_path / "bag", {}) as bag:
        numbers = {topic: bag.add_topic(topic, STRING, "string data\n", HASH) for topic in ("/b/said", "/a/said")}
        for k, (topic, payload, time) in enumerate(content):
            bag.write(numbers[topic], payload, time, time)
            if k in (70, 120):
                bag.split()
    assert wire(read_raw(tmp_path / "bag")) == content


def test_a_clock_that_was_set_back_while_recording_is_reported(tmp_path: Path) -> None:
    second = 10**9
    content = [("/a/said" if k % 2 else "/b/said", b"%d" % k, (k + 100) * second) for k in range(10)]
    content[7] = ("/a/said", b"7", 104 * second + 5)
    bag = read_raw(write_ours(tmp_path / "bag", content))
    assert [message.payload for message in bag.read()] == [b"%d" % k for k in (0, 1, 2, 3, 4, 7, 5, 6, 8, 9)]
    (warning,) = bag.warnings
    assert "the times of /a/said step back, its messages come in the order of their times" in warning


def test_a_sqlite3_file_alone_is_a_bag(tmp_path: Path) -> None:
    content = messages(20)
    (path,) = write_theirs(tmp_path / "bag", content, StoragePlugin.SQLITE3).glob("*.db3")
    assert wire(read_raw(path, ["/b/said"])) == [message for message in content if message[0] == "/b/said"]


@pytest.mark.parametrize("plugin", [None, StoragePlugin.SQLITE3])
def test_topics_are_chosen_by_whole_names_or_their_ends(tmp_path: Path, plugin: StoragePlugin | None) -> None:
    content = messages(20)
    path = tmp_path / "bag"
    path = write_theirs(path, content, plugin) if plugin else write_ours(path, content)
    for asked in ("/a/said", "a/said"):
        bag = read_raw(path, [asked])
        assert set(bag.topics) == {"/a/said"}
        assert wire(bag) == [m for m in content if m[0] == "/a/said"]
    with pytest.raises(AbraceError, match="topic said matches /a/said, /b/said, name one of them"):
        read_raw(path, ["said"])
    for asked in ("aid", "/said", ""):
        with pytest.raises(AbraceError, match=f"no topic {asked} in it, it has /a/said, /b/said"):
            read_raw(path, [asked])


def test_a_bag_that_was_cut_off_gives_what_is_whole_and_says_so(tmp_path: Path) -> None:
    content = messages(20000)
    path = write_ours(tmp_path / "bag", content)
    (path / "metadata.yaml").unlink()
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    bag = read_raw(path)
    assert 5000 < bag.count < len(content)
    assert wire(bag) == content[: bag.count]
    assert "cut off or damaged" in bag.warnings[0]
    assert bag.topics["/a/said"].qos.durability is QosDurability.TRANSIENT_LOCAL


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match="absent: no such bag"):
        read_raw(tmp_path / "absent")
    with pytest.raises(AbraceError, match="no MCAP file in it"):
        read_raw(tmp_path)
    (tmp_path / "bag.db3").write_bytes(b"SQLite format 3, or so it says" * 100)
    with pytest.raises(AbraceError, match=r"bag\.db3"):
        read_raw(tmp_path / "bag.db3")
    with pytest.raises(AbraceError, match=r"metadata\.yaml|metadata file"):
        read_raw(tmp_path)


def two_files(folder: Path, *topics: tuple[str, str, Qos]) -> Path:
    """A bag in files of which each has the topic /said: its type, hash and QoS."""
    path = folder / "bag"
    path.mkdir()
    for k, (type_name, type_hash, qos) in enumerate(topics):
        with BagWriter(folder / f"{k}", {}) as bag:
            bag.write(bag.add_topic("/said", type_name, "string data\n", type_hash, qos), b"\0\1\0\0", k, k)
        (folder / f"{k}" / f"{k}_0.mcap").rename(path / f"{k}.mcap")
    return path


def test_a_topic_with_two_types_is_refused(tmp_path: Path) -> None:
    path = two_files(tmp_path, (STRING, HASH, DEFAULT_QOS), ("std_msgs/msg/Header", "", DEFAULT_QOS))
    with pytest.raises(AbraceError, match=f"topic /said has the types {STRING} and std_msgs/msg/Header"):
        read_raw(path)


def test_a_type_that_changed_between_two_files_is_refused(tmp_path: Path) -> None:
    path = two_files(
        tmp_path, (STRING, "", DEFAULT_QOS), (STRING, HASH, DEFAULT_QOS), (STRING, "RIHS01_0", DEFAULT_QOS)
    )
    with pytest.raises(AbraceError, match=f"/said: {STRING} was recorded as {HASH} and as RIHS01_0"):
        read_raw(path)


def test_the_offers_of_all_files_are_one(tmp_path: Path) -> None:
    offers = (
        DEFAULT_QOS._replace(reliability=QosReliability.BEST_EFFORT, depth=3),
        DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL, depth=7),
    )
    topic = read_raw(two_files(tmp_path, (STRING, "", offers[0]), (STRING, HASH, offers[1]))).topics["/said"]
    assert topic.qos == offers[1]
    assert topic.type_hash == HASH


def test_qos_that_makes_no_sense_is_refused_with_its_topic(tmp_path: Path) -> None:
    path = two_files(tmp_path, (STRING, HASH, DEFAULT_QOS._replace(depth=-4)))
    with pytest.raises(AbraceError, match=r"bag: topic /said: QoS: -4 is less than 0, expected"):
        read_raw(path)


@pytest.mark.parametrize("mode", [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_damaged_sqlite3_bag_is_refused_or_says_what_is_missing(tmp_path: Path, mode: CompressionMode | None) -> None:
    content = messages(300)
    path = write_theirs(tmp_path / "bag", content, StoragePlugin.SQLITE3, mode)
    (file,) = path.glob("*.db3*")
    whole = file.read_bytes()
    random = np.random.default_rng(5)
    refusals = []
    for trial in range(40):
        place = int(random.integers(len(whole)))
        file.write_bytes(whole[:place] if trial % 2 else whole[:place] + random.bytes(64) + whole[place + 64 :])
        try:
            bag = read_raw(path)
        except AbraceError as error:
            refusals.append(str(error))
        else:
            assert bag.count == len(content) or "are missing" in " ".join(bag.warnings)
    assert refusals
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in refusals)


def test_messages_missing_in_a_database_are_reported(tmp_path: Path) -> None:
    path = write_theirs(tmp_path / "bag", messages(30), StoragePlugin.SQLITE3)
    (file,) = path.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as database, database:
        database.execute("DELETE FROM messages WHERE id IN (2, 5, 6)")
    bag = read_raw(path)
    assert bag.count == 27
    assert bag.warnings == (f"{path}: 3 of 20 messages of /a/said are missing",)


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.SQLITE3, None),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    ],
)
def test_bags_of_other_storages_are_described_read_exported_and_recovered(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode | None
) -> None:
    texts = [f"text {k}" for k in range(300)]
    content = [("/a/said" if k % 3 else "/b/said", note(text), 1000 + 10 * k) for k, text in enumerate(texts)]
    path = write_theirs(tmp_path / "bag", content, plugin, mode)
    assert [(topic.name, topic.count) for topic in describe(path).topics] == [("/a/said", 200), ("/b/said", 100)]
    contents = read_topics(path, ["/b/said"], 1000, 2000)
    assert contents["/b/said"].fields["data"].tolist() == texts[:100:3]
    assert contents["/b/said"].log_time.tolist() == list(range(1000, 2000, 30))
    write_csv(tmp_path / "out.csv", TopicParts(path, "/a/said"))
    rows = (tmp_path / "out.csv").read_text().splitlines()
    assert (len(rows), rows[1]) == (201, "1010,1010,text 1")
    assert recover(path, tmp_path / "whole").counts == {"/a/said": 200, "/b/said": 100}
    assert read_topics(tmp_path / "whole")["/a/said"].fields["data"].tolist() == [
        t for k, t in enumerate(texts) if k % 3
    ]


def test_a_bag_that_rosbags_does_not_know_names_the_command_that_converts_it(tmp_path: Path) -> None:
    path = write_theirs(tmp_path / "bag", messages(3), StoragePlugin.SQLITE3)
    (file,) = path.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as database, database:
        # as rosbag2 writes it for the hidden topics of actions
        database.execute("UPDATE message_definitions SET encoding = 'unknown'")
    with pytest.raises(AbraceError, match=rf"KeyError 'unknown'.*ros2 bag convert -i {path} -o mcap.yaml"):
        read_raw(path)
