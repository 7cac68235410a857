# SPDX-License-Identifier: Apache-2.0
"""Raw messages of any bag: all of them, in time order, their bytes and QoS as they were recorded."""

from __future__ import annotations

import subprocess
import sys
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

from abrace_bags import Bag, BagWriter, RawMessages
from abrace_bags.qos import DEFAULT_QOS
from abrace_core import AbraceError

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


def wire(bag: RawMessages) -> list[Message]:
    """Topics, bytes and log times of a bag's messages, which are as many as it says."""
    found = [message[:3] for message in bag]
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


@pytest.mark.parametrize("kind", ["ours", "mcap"])
def test_every_bag_gives_every_message_as_it_was_in_time_order(tmp_path: Path, kind: str) -> None:
    content = messages()
    shuffled = [content[k] for k in np.random.default_rng(2).permutation(len(content))]
    path = tmp_path / "bag"
    if kind == "ours":
        write_ours(path, shuffled)
    else:
        write_theirs(path, shuffled, StoragePlugin.MCAP)
    bag = Bag(path).raw()
    assert wire(bag) == content
    assert (kind == "ours") == (not bag.warnings)
    assert all("have no checksum" in warning for warning in bag.warnings)
    assert set(bag.topics) == {"/a/said", "/b/said"}
    topic = bag.topics["/a/said"]
    assert topic.type_name == STRING
    assert topic.type_hash == ("" if kind == "mcap" else HASH), "rosbags leaves it out of MCAP files"
    forever = DEFAULT_QOS.lifespan
    assert topic.qos == TRANSIENT_LOCAL._replace(lifespan=forever, liveliness_lease_duration=forever)


def test_messages_of_one_time_come_in_the_order_in_which_they_were_written(tmp_path: Path) -> None:
    content = [(topic, bytes([k]) * (1 + k % 3), 1000 + k // 50) for k, (topic, _, _) in enumerate(messages(200))]
    with BagWriter(tmp_path / "bag", {}, split_size=1) as bag:
        numbers = {topic: bag.add_topic(topic, STRING, "string data\n", HASH) for topic in ("/b/said", "/a/said")}
        for k, (topic, payload, time) in enumerate(content):
            bag.write(numbers[topic], payload, time, time)
            if k in (70, 120):
                bag.flush()
    assert wire(Bag(tmp_path / "bag").raw()) == content


def test_a_clock_that_was_set_back_while_recording_is_reported(tmp_path: Path) -> None:
    second = 10**9
    content = [("/a/said" if k % 2 else "/b/said", b"%d" % k, (k + 100) * second) for k in range(10)]
    content[7] = ("/a/said", b"7", 104 * second + 5)
    bag = Bag(write_ours(tmp_path / "bag", content)).raw()
    assert [message.payload for message in bag] == [b"%d" % k for k in (0, 1, 2, 3, 4, 7, 5, 6, 8, 9)]
    (warning,) = bag.warnings
    assert "the times of /a/said step back, its messages come in the order of their times" in warning


def test_topics_are_chosen_by_whole_names_or_their_ends(tmp_path: Path) -> None:
    content = messages(20)
    path = write_ours(tmp_path / "bag", content)
    for asked in ("/a/said", "a/said"):
        bag = Bag(path).raw([asked])
        assert set(bag.topics) == {"/a/said"}
        assert wire(bag) == [m for m in content if m[0] == "/a/said"]
    with pytest.raises(AbraceError, match="topic said matches /a/said, /b/said, name one of them"):
        Bag(path).raw(["said"])
    for asked in ("aid", "/said", ""):
        with pytest.raises(AbraceError, match=f"no topic {asked} in it.*, expected one of /a/said, /b/said"):
            Bag(path).raw([asked])


def two_files(folder: Path, *topics: tuple[str, str, Qos]) -> Path:
    """A bag in files of which each has the topic /said: its type, hash and QoS."""
    path = folder / "bag"
    path.mkdir()
    for k, (type_name, type_hash, qos) in enumerate(topics):
        with BagWriter(folder / f"{k}", {}) as bag:
            bag.write(bag.add_topic("/said", type_name, "string data\n", type_hash, qos), b"\0\1\0\0", k, k)
        (folder / f"{k}" / f"{k}_0.mcap").rename(path / f"{k}.mcap")
    return path


@pytest.mark.parametrize(
    ("type_name", "type_hash"), [("std_msgs/msg/Header", ""), (STRING, "RIHS01_0")], ids=["other", "changed"]
)
def test_messages_of_another_type_than_their_topics_first_are_left_out(
    tmp_path: Path, type_name: str, type_hash: str
) -> None:
    path = two_files(
        tmp_path, (STRING, "", DEFAULT_QOS), (STRING, HASH, DEFAULT_QOS), (type_name, type_hash, DEFAULT_QOS)
    )
    bag = Bag(path).raw()
    assert [message.log_time for message in bag] == [0, 1]
    assert (bag.count, bag.topics["/said"].type_hash) == (2, HASH)
    (warning,) = bag.warnings
    assert f"messages of topic /said are left out: they are of another {type_name}, expected {STRING}" in warning


def test_the_offers_of_all_files_are_one(tmp_path: Path) -> None:
    offers = (
        DEFAULT_QOS._replace(reliability=QosReliability.BEST_EFFORT, depth=3),
        DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL, depth=7),
    )
    topic = Bag(two_files(tmp_path, (STRING, "", offers[0]), (STRING, HASH, offers[1]))).topics["/said"]
    assert topic.qos == offers[1]
    assert topic.type_hash == HASH


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    ],
)
def test_bags_that_rosbag2_compressed_are_refused_with_the_command_that_converts_them(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    content = [(topic, note(f"text {k}"), time) for k, (topic, _, time) in enumerate(messages(30))]
    path = write_theirs(tmp_path / "bag", content, plugin, mode)
    with pytest.raises(AbraceError, match=r"bag: was compressed .*: rosbags-convert --src ") as raised:
        Bag(path)
    command = str(raised.value).partition(": rosbags-convert ")[2].split()
    subprocess.run([sys.executable, "-m", "rosbags.convert", *command], check=True, timeout=60)
    assert wire(Bag(tmp_path / "bag_mcap").raw()) == content
    (path / "metadata.yaml").unlink()
    (file,) = path.iterdir()
    for one in (path, file) if file.suffix != ".mcap" else ():
        with pytest.raises(AbraceError, match=rf"zstd, expected MCAP: zstd -d {file}"):
            Bag(one)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"#ROSBAG V2.0\n", r"is a bag of ROS 1, expected MCAP: rosbags-convert --src .*bag.mcap --dst .*bag "),
        (b"version https://git-lfs.github.com/spec/v1\n", "git-lfs's pointer to the file: git lfs pull"),
        (b"\x1f\x8b\x08\0", r"is packed with gzip, expected MCAP: gunzip .*bag.mcap"),
        (b"a text of some length", "not an MCAP file"),
        (b"SQLite format 3\0" + bytes(100), "can't be read .*, expected a bag of rosbag2"),
    ],
)
def test_other_files_are_refused_by_what_they_are(tmp_path: Path, content: bytes, complaint: str) -> None:
    (tmp_path / "bag.mcap").write_bytes(content)
    with pytest.raises(AbraceError, match=complaint):
        Bag(tmp_path / "bag.mcap")
