# SPDX-License-Identifier: Apache-2.0
"""What a bag is written with: compression, files, attachments, counts, a thread of its own, snapshots, choices."""

from __future__ import annotations

import errno
import gc
import json
import os
import resource
import struct
import threading
import time
import tracemalloc
from typing import TYPE_CHECKING, Any

import mcap.reader
import mcap.stream_reader
import numpy as np
import pytest
import yaml
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from abrace_bags import BagWriter, read_facts, read_topics
from abrace_bags.losses import lost_messages
from abrace_bags.mcap.attachments import file_attachments
from abrace_bags.mcap.file_writer import McapWriter
from abrace_bags.metadata import installed_versions
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.recording import TRANSIENT_LOCAL_KEPT, Recording, parse_facts
from abrace_bags.topic_choice import TopicChoice
from abrace_core import wire
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = "std_msgs/msg/String"
NUMBERED = "test_msgs/msg/Numbered"
TEXT = "string data\n"
NUMBERED_TEXT = (
    "std_msgs/Header header\nuint64 sequence\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
SECOND = 10**9
START = 1_700_000_000 * SECOND


def note(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=text), STRING))


def numbered(sequence: int, frame_id: str = "", stamp: int = SECOND + 2) -> bytes:
    text = frame_id.encode() + b"\0"
    head = wire.LITTLE_ENDIAN + struct.pack("<2xiII", *divmod(stamp, SECOND), len(text)) + text
    return head + bytes((4 - len(head)) % 8) + struct.pack("<Q", sequence)


def notes_of(bag: Path | str) -> list[str]:
    return list(read_topics(bag)["/note"].fields["data"])


def write_notes(bag: BagWriter, count: int, step: int = SECOND // 10) -> list[str]:
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    texts = [f"note {k} " + "x" * 100 for k in range(count)]
    for k, text in enumerate(texts):
        bag.write(topic, note(text), START + k * step, START + k * step - 1)
    return texts


@pytest.mark.parametrize(("compression", "name"), [("zstd", "zstd"), ("lz4", "lz4"), ("none", "")])
def test_each_compression_is_read_by_us_and_by_independent_readers(tmp_path: Path, compression: str, name: str) -> None:
    with BagWriter(tmp_path / "bag", {}, compression=compression) as bag:
        texts = write_notes(bag, 2000)
    assert notes_of(tmp_path / "bag") == texts
    assert read_topics(tmp_path / "bag").warnings == ()
    with Reader(tmp_path / "bag") as reader:
        assert [STORE.deserialize_cdr(raw, STRING).data for _, _, raw in reader.messages()] == texts
    with (tmp_path / "bag/bag_0.mcap").open("rb") as file:
        found = list(mcap.reader.make_reader(file, validate_crcs=True).iter_messages())
    assert [message.data for _, _, message in found] == [note(text) for text in texts]
    assert [message.sequence for _, _, message in found] == list(range(1, 2001))
    with (tmp_path / "bag/bag_0.mcap").open("rb") as file:
        stream = mcap.stream_reader.StreamReader(file, emit_chunks=True, validate_crcs=True)
        chunks: list[Any] = [record for record in stream.records if type(record).__name__ == "Chunk"]
    assert {chunk.compression for chunk in chunks} == {name}
    assert all(chunk.uncompressed_crc for chunk in chunks)
    assert len(chunks) > 3
    assert max(chunk.uncompressed_size for chunk in chunks) < 65 * 1024


def test_another_compression_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match="compression 'zip', expected zstd, lz4 or none"):
        BagWriter(tmp_path / "bag", {}, compression="zip")
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("limits", "most_files", "fewest_files"), [({"split_size": 20_000}, 30, 5), ({"split_duration": 10.0}, 20, 20)]
)
def test_a_split_bag_is_one_bag(tmp_path: Path, limits: dict[str, Any], most_files: int, fewest_files: int) -> None:
    facts = {"record": "el_centro"}
    with BagWriter(tmp_path / "bag", facts, compression="none", **limits) as bag:
        texts = write_notes(bag, 2000)
    files = sorted((tmp_path / "bag").glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
    assert fewest_files <= len(files) <= most_files
    assert [path.name for path in files] == [f"bag_{k}.mcap" for k in range(len(files))]
    assert notes_of(tmp_path / "bag") == texts
    assert [text for path in files for text in notes_of(path)] == texts
    assert all(read_facts(path) == facts for path in files)
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == [path.name for path in files]
    assert information["message_count"] == sum(file["message_count"] for file in information["files"]) == 2000
    assert information["duration"]["nanoseconds"] == 1999 * SECOND // 10
    for file, path in zip(information["files"], files, strict=True):
        assert file["message_count"] == len(notes_of(path))
    with Reader(tmp_path / "bag") as reader:
        assert [STORE.deserialize_cdr(raw, STRING).data for _, _, raw in reader.messages()] == texts


def test_split_size_counts_messages_however_much_stands_before_them(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {"rig_file": "x" * 5000}, compression="none", split_size=1000) as bag:
        write_notes(bag, 2000)
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = [file["message_count"] for file in information["files"]]
    assert len(counts) > 3
    assert min(counts[:-1]) > 100, "a file takes at least a chunk"


def test_a_bag_that_cannot_be_begun_is_not_there(tmp_path: Path) -> None:
    record = tmp_path / "record.at2"
    record.write_bytes(bytes(300_000))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        with pytest.raises(AbraceError, match=r"cannot write bag .*bag: File too large"):
            BagWriter(tmp_path / "bag", {}, attachments=file_attachments([record]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (tmp_path / "bag").exists(), "the next try finds no bag in its way"


def test_a_topic_keeps_the_qos_of_each_of_its_publishers(tmp_path: Path) -> None:
    best_effort = DEFAULT_QOS._replace(reliability=QosReliability.BEST_EFFORT)
    with BagWriter(tmp_path / "bag", {}) as bag:
        bag.add_topic("/note", STRING, TEXT, "RIHS01_0", DEFAULT_QOS._replace(depth=7), best_effort)
    with Reader(tmp_path / "bag") as reader:
        first, second = reader.connections[0].ext.offered_qos_profiles
    assert (first.depth, first.reliability.name) == (7, "RELIABLE")
    assert second.reliability.name == "BEST_EFFORT"


def test_attached_files_come_back_whole_and_damage_to_them_is_seen(tmp_path: Path) -> None:
    rig, record = tmp_path / "rig.yaml", tmp_path / "record.at2"
    rig.write_bytes(b"storeys: 3\n")
    record.write_bytes(np.random.default_rng(1).bytes(300_000))
    os.utime(record, (-1, -1))
    with BagWriter(tmp_path / "bag", {}, attachments=file_attachments([rig, record])) as bag:
        texts = write_notes(bag, 10)
    path = tmp_path / "bag/bag_0.mcap"
    with path.open("rb") as file:
        found = {one.name: one.data for one in mcap.reader.make_reader(file).iter_attachments()}
    assert found == {"rig.yaml": rig.read_bytes(), "record.at2": record.read_bytes()}
    assert notes_of(tmp_path / "bag") == texts
    assert read_topics(path).attachments == found
    assert read_topics(path, begin=0, end=1).attachments == found, "by the index, too"
    path.write_bytes(path.read_bytes().replace(b"storeys: 3\n", b"storeys: 4\n"))
    assert any("checksum" in warning for warning in read_topics(path).warnings)


def test_attachments_that_cannot_be_are_refused_by_name(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("rig.yaml", "a/rig.yaml", "b/a/rig.yaml")]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    assert [one.name for one in file_attachments(paths[:2])] == ["rig.yaml", "a/rig.yaml"]
    with pytest.raises(AbraceError, match=r"attachment .*b/a/rig\.yaml: another one is called a/rig\.yaml"):
        file_attachments(paths)
    with pytest.raises(AbraceError, match=r"attachment .*none: No such file"):
        file_attachments([tmp_path / "none"])


def test_counts_gaps_and_losses_stand_at_the_end(tmp_path: Path) -> None:
    records = {"abrace_versions": installed_versions()}
    with BagWriter(tmp_path / "bag", {}, records=records) as bag:
        topic = bag.add_topic("/response", NUMBERED, NUMBERED_TEXT, "RIHS01_0")
        write_notes(bag, 3)
        for frame in ("", "a", "table", "a longer frame"):
            for sequence in (0, 1, 2, 5, 6, 9):
                bag.write(topic, numbered(sequence, frame), START, START)
            bag.interrupt()
        bag.add_lost(topic, 4)
    with (tmp_path / "bag/bag_0.mcap").open("rb") as file:
        found = {record.name: record.metadata for record in mcap.reader.make_reader(file).iter_metadata()}
    assert json.loads(found["abrace_topics"]["/response"]) == {"messages": 24, "gaps": 8, "missing": 16, "lost": 4}
    assert json.loads(found["abrace_topics"]["/note"]) == {"messages": 3, "gaps": 0, "missing": 0, "lost": 0}
    assert found["abrace_versions"]["mcap"]


def test_an_interruption_is_no_gap(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        topic = bag.add_topic("/response", NUMBERED, NUMBERED_TEXT, "RIHS01_0")
        for sequence in (0, 1):
            bag.write(topic, numbered(sequence), START, START)
        bag.interrupt()
        for sequence in (50, 51, 53):
            bag.write(topic, numbered(sequence), START, START)
        assert (bag.counts()["/response"].gaps, bag.counts()["/response"].missing) == (1, 1)


def test_the_thread_writes_everything_in_order(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(3000):
        recording.write(topic, note(str(k)), START + k, START)
        if k == 1500:
            recording.split()
    recording.close()
    assert notes_of(tmp_path / "bag") == [str(k) for k in range(3000)]
    assert notes_of(tmp_path / "bag/bag_0.mcap") == [str(k) for k in range(1501)]
    assert not recording.overflowed


def test_messages_that_the_queue_cannot_hold_are_counted_as_lost_in_the_bag(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {})
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording = Recording(bag, 10.0, capacity=50_000)
    for k in range(1000):
        recording.write(topic, note(str(k)), START + k, START)
    lost = recording.overflowed[topic]
    assert recording.close({topic: 3}) is bag
    assert 700 < lost < 1000
    assert notes_of(tmp_path / "bag") == [str(k) for k in range(1000 - lost)]
    assert bag.counts()["/note"].lost == lost + 3


def test_a_full_disk_is_an_error_of_the_recording(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {}, compression="none")
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        recording = Recording(bag, 0.01)
        for k in range(10_000):
            recording.write(topic, note(f"note {k} " + "x" * 100), START + k, START)
        with pytest.raises(AbraceError, match=r"cannot write bag .*bag: File too large"):
            recording.close()
        with pytest.raises(AbraceError, match="File too large"):
            recording.check()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    kept = notes_of(tmp_path / "bag")
    assert len(kept) > 500
    assert [text.split()[1] for text in kept] == [str(k) for k in range(len(kept))]
    assert not any(thread.name == "bag" for thread in threading.enumerate())


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_split_that_fails_ends_the_thread_without_a_traceback(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01)
    (tmp_path / "bag").rename(tmp_path / "elsewhere")
    recording.split()
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: No such file"):
        recording.close()
    with pytest.raises(AbraceError, match="No such file"):
        recording.check()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_unexpected_error_in_the_thread_is_an_error_of_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = BagWriter(tmp_path / "bag", {})
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    monkeypatch.setattr(bag, "write", lambda *_: bytes(2**60))
    recording = Recording(bag, 0.01)
    recording.write(topic, note(""), START, START)
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: MemoryError"):
        recording.close()


def test_a_file_that_cannot_be_begun_does_not_cost_those_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def add_metadata(file: McapWriter, *record: Any) -> None:
        if file.size < 100:
            raise OSError(errno.ENOSPC, "No space left on device")
        written(file, *record)

    bag = BagWriter(tmp_path / "bag", {})
    texts = write_notes(bag, 100)
    written = McapWriter.add_metadata
    monkeypatch.setattr(McapWriter, "add_metadata", add_metadata)
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: No space left on device"):
        bag.split()
    assert bag.closed
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 100
    assert notes_of(tmp_path / "bag") == texts


def test_a_file_is_seen_from_when_it_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def append(file: McapWriter, content: bytes) -> None:
        seen.append([len(read_topics(path)) for path in sorted((tmp_path / "bag").glob("*.mcap"))])
        appended(file, content)

    seen: list[list[int]] = []
    appended = McapWriter._append
    monkeypatch.setattr(McapWriter, "_append", append)
    with BagWriter(tmp_path / "bag", {}) as bag:
        write_notes(bag, 10)
        bag.split()
    changes = [files for files, before in zip(seen, [None, *seen], strict=False) if files != before]
    assert changes == [[], [0], [1], [1, 0]], "topics in each file"


def test_an_interruption_of_a_recording_is_no_gap(tmp_path: Path) -> None:
    for name, snapshot in (("all", 0.0), ("snapshot", 2.0)):
        bag = BagWriter(tmp_path / name, {})
        topic = bag.add_topic("/response", NUMBERED, NUMBERED_TEXT, "RIHS01_0")
        recording = Recording(bag, 0.01, snapshot=snapshot)
        for sequence in (0, 1, 50, 52):
            if sequence == 50:
                recording.interrupt()
            recording.write(topic, numbered(sequence), START, START)
        if snapshot:
            assert recording.write_snapshot() == 4
        recording.close()
        assert (bag.counts()["/response"].gaps, bag.counts()["/response"].missing) == (1, 1)


def test_a_snapshot_stays_small(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 10.0, snapshot=2.0, capacity=100_000)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording.write(topic, bytes(200_000), START, START)
    for k in range(1000):
        recording.write(topic, note(str(k)), START + k, START)
    assert 400 < recording.write_snapshot() < 500, "a message takes some 200 bytes in addition to its own"
    recording.close()


def test_a_snapshot_drops_times_to_come(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 10.0, snapshot=2.0)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording.write(topic, note("before the clock is set back"), START, START)
    recording.write(topic, note("then"), START - 3600 * SECOND, START)
    assert recording.write_snapshot() == 1
    recording.close()
    assert notes_of(tmp_path / "bag") == ["then"]


def test_a_snapshot_has_the_last_messages_of_transient_local_topics_however_old(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01, snapshot=2.0)
    latched = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL)
    description = recording.add_topic("/description", STRING, TEXT, "RIHS01_0", latched)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(TRANSIENT_LOCAL_KEPT + 50):
        recording.write(description, note(str(k)), START - 1000 + k, START)
    for k in range(100):
        recording.write(topic, note(str(k)), START + k * SECOND, START)
    assert recording.write_snapshot() == TRANSIENT_LOCAL_KEPT + 3
    recording.write(topic, note("later"), START + 200 * SECOND, START)
    assert recording.write_snapshot() == 1, "nothing is written twice"
    recording.close()
    found = read_topics(tmp_path / "bag")
    assert list(found["/description"].fields["data"]) == [str(k) for k in range(50, TRANSIENT_LOCAL_KEPT + 50)]
    assert list(found["/note"].fields["data"]) == ["97", "98", "99", "later"]


def test_a_time_that_the_middleware_does_not_know_is_replaced_and_counted(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    begin = time.time_ns()
    for k, times in enumerate(((START, START - 1), (START + 1, -1), (-1, START - 1), (-1, -2))):
        recording.write(topic, note(str(k)), *times)
    recording.close()
    assert recording.untimed == {topic: 3}
    found = read_topics(tmp_path / "bag")["/note"]
    assert list(found.fields["data"]) == ["0", "1", "2", "3"]
    assert list(found.log_time[:2]) == [START, START + 1]
    assert begin <= found.log_time[2] <= found.log_time[3] <= time.time_ns(), "received now"
    assert list(found.publish_time[:3]) == [START - 1, START + 1, START - 1]
    assert found.publish_time[3] == found.log_time[3]


def test_what_fails_in_the_thread_costs_nothing_that_was_written_before(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 10.0)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(32):
        recording.write(topic, note(str(k)), START + k, START)
    recording.write(topic, note("no such time"), 2**64, START)
    for k in range(16):
        recording.write(topic, note(str(k)), START + k, START)
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: error\("):
        recording.close()
    bag = read_topics(tmp_path / "bag")
    assert list(bag["/note"].fields["data"]) == [str(k) for k in range(32)]
    assert bag.warnings == ()
    assert lost_messages(bag.records) == {"/note": 17}
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 32


def test_who_records_never_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(*message: Any) -> None:
        assert disk.wait(60)
        written(*message)

    disk = threading.Event()
    for name, snapshot in (("all", 0.0), ("snapshot", 10.0)):
        bag = BagWriter(tmp_path / name, {})
        written = bag.write
        disk.clear()
        monkeypatch.setattr(bag, "write", write)
        recording = Recording(bag, 0.01, snapshot=snapshot)
        first = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
        for k in range(3):
            recording.write(first, note(str(k)), START + k, START)
        if snapshot:
            assert recording.write_snapshot() == 3
        second = recording.add_topic("/later", STRING, TEXT, "RIHS01_0")
        recording.split()
        recording.interrupt()
        recording.write(second, note("3"), START + 3, START)
        if snapshot:
            assert recording.write_snapshot() == 1
        recording.check()
        assert bag.counts().get("/note") is None or bag.counts()["/note"].messages == 0, "the disk has not begun"
        disk.set()
        recording.close()
        assert notes_of(tmp_path / name) == ["0", "1", "2"]
        assert list(read_topics(tmp_path / name / f"{name}_1.mcap")["/later"].fields["data"]) == ["3"]


def test_a_chunk_takes_little_memory_for_as_long_as_its_file_is_written(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        topics = [bag.add_topic(f"/note_{k}", STRING, TEXT, "RIHS01_0") for k in range(4)]

        def write_chunks(count: int) -> int:
            for k in range(count):
                for topic in topics:
                    bag.write(topic, note(str(k)), START, START)
                bag.flush()
            gc.collect()
            return tracemalloc.get_traced_memory()[0]

        tracemalloc.start()
        try:
            before = write_chunks(200)
            taken = (write_chunks(2000) - before) / 2000
        finally:
            tracemalloc.stop()
    assert taken < 250, "bytes: at ten chunks a second 9 MB an hour, when by default the next file begins"


def test_a_closed_bag_takes_nothing_more(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        write_notes(bag, 3)
    for use in (
        lambda: bag.write(1, note(""), START, START),
        lambda: bag.add_topic("/other", STRING, TEXT, "RIHS01_0"),
        bag.flush,
        bag.sync,
        bag.split,
    ):
        with pytest.raises(AbraceError, match=r"bag .*bag is closed"):
            use()
    bag.close()
    assert bag.counts()["/note"].messages == 3


def test_a_bag_that_no_disk_holds_any_more_says_what_is_in_it(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {}, compression="none")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        with pytest.raises(AbraceError, match="File too large"):
            write_notes(bag, 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    kept = len(notes_of(tmp_path / "bag"))
    assert 500 < information["message_count"] <= kept < 2000, "a part of the last chunk is read, it is not counted"


def test_in_lockstep_the_log_time_is_the_time_of_the_sample(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01, lockstep=True)
    response = recording.add_topic("/response", "abrace_interfaces/msg/Response", NUMBERED_TEXT, "RIHS01_0")
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording.write(topic, note("before"), START, START - 5)
    for k in range(3):
        recording.write(response, numbered(k, stamp=k * SECOND), START + k, START + k - 5)
        recording.write(topic, note(str(k)), START + k, START + k - 5)
    recording.write(response, b"", START, START)
    recording.close()
    found = read_topics(tmp_path / "bag", ["/note"])["/note"]
    assert list(found.log_time) == [0, 0, SECOND, 2 * SECOND]
    assert list(found.publish_time) == [START - 5, START - 5, START - 4, START - 3], "as it was"
    with Reader(tmp_path / "bag") as reader:
        times = [time for connection, time, _ in reader.messages() if connection.topic == "/response"]
    assert times == [0, SECOND, 2 * SECOND, 2 * SECOND]


def test_a_snapshot_keeps_the_last_seconds_and_nothing_twice(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01, snapshot=2.0)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(100):
        recording.write(topic, note(str(k)), START + k * SECOND // 10, START)
    assert recording.write_snapshot() == 21
    recording.write(topic, note("later"), START + 11 * SECOND, START)
    assert recording.write_snapshot() == 1
    recording.write(topic, note("not requested"), START + 11 * SECOND, START)
    recording.close()
    assert notes_of(tmp_path / "bag") == [*(str(k) for k in range(79, 100)), "later"]
    assert not recording.overflowed


def test_facts_are_keys_and_values_each_once() -> None:
    assert parse_facts(["rig=east", "note=a=b"]) == {"rig": "east", "note": "a=b"}
    for texts, complaint in ((["rig"], "'rig', expected key=value"), (["a=1", "a=2"], "expected each key once")):
        with pytest.raises(AbraceError, match=f"parameter facts: .*{complaint}"):
            parse_facts(texts)


def test_topics_are_chosen_by_name_by_pattern_or_all_but_hidden_ones() -> None:
    topics = ["/lab/response", "/lab/sensor_1", "/lab/sensor_x", "/lab/_hidden", "/rosout", "/lab/play/_action/status"]
    named = TopicChoice(frozenset({"/lab/response", "/lab/_hidden", "/lab/to_come"}))
    assert named.of(topics) == {"/lab/response", "/lab/_hidden"}
    assert TopicChoice(frozenset(), r"sensor_\d").of(topics) == {"/lab/sensor_1"}
    both = TopicChoice(frozenset({"/rosout"}), "sensor")
    assert both.of(topics) == {"/rosout", "/lab/sensor_1", "/lab/sensor_x"}
    everything = TopicChoice(frozenset(), everything=True).of(topics)
    assert everything == {"/lab/response", "/lab/sensor_1", "/lab/sensor_x", "/rosout"}
    with pytest.raises(AbraceError, match=r"pattern '\(': .*expected a regular expression"):
        TopicChoice(frozenset(), "(")
    with pytest.raises(AbraceError, match="no topics"):
        TopicChoice(frozenset())
