# SPDX-License-Identifier: Apache-2.0
"""What a bag is written with: files, attachments, counts, a thread of its own; what is refused."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import struct
import threading
import time
from typing import TYPE_CHECKING, Any

import mcap.reader
import mcap.records
import mcap.stream_reader
import numpy as np
import pytest
import yaml
from bag_contents import lost_messages, read_topics
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from abrace_bags import Bag, BagWriter, file_attachments, writer
from abrace_bags.mcap.file_writer import McapWriter
from abrace_bags.metadata import installed_versions
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.recording import Recording, parse_facts
from abrace_core import AbraceError
from abrace_core.safety import wire

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
    random = np.random.default_rng(1)
    texts = [f"note {k} {random.bytes(50).hex()}" for k in range(count)]
    for k, text in enumerate(texts):
        bag.write(topic, note(text), START + k * step, START + k * step - 1)
    return texts


def test_a_bag_is_read_by_us_and_by_independent_readers(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
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
    assert {chunk.compression for chunk in chunks} == {"zstd"}
    assert all(chunk.uncompressed_crc for chunk in chunks)
    assert len(chunks) > 3
    assert max(chunk.uncompressed_size for chunk in chunks) < 65 * 1024


@pytest.mark.parametrize(
    ("limits", "most_files", "fewest_files"), [({"split_size": 20_000}, 30, 5), ({"split_duration": 10.0}, 20, 20)]
)
def test_a_split_bag_is_one_bag(tmp_path: Path, limits: dict[str, Any], most_files: int, fewest_files: int) -> None:
    facts = {"record": "el_centro"}
    with BagWriter(tmp_path / "bag", facts, **limits) as bag:
        texts = write_notes(bag, 2000)
    files = sorted((tmp_path / "bag").glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
    assert fewest_files <= len(files) <= most_files
    assert [path.name for path in files] == [f"bag_{k}.mcap" for k in range(len(files))]
    assert notes_of(tmp_path / "bag") == texts
    assert [text for path in files for text in notes_of(path)] == texts
    assert all(Bag(path).facts == facts for path in files)
    information = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == [path.name for path in files]
    assert information["message_count"] == sum(file["message_count"] for file in information["files"]) == 2000
    assert information["duration"]["nanoseconds"] == 1999 * SECOND // 10
    for file, path in zip(information["files"], files, strict=True):
        assert file["message_count"] == len(notes_of(path))
    with Reader(tmp_path / "bag") as reader:
        assert [STORE.deserialize_cdr(raw, STRING).data for _, _, raw in reader.messages()] == texts


def test_split_size_counts_messages_however_much_stands_before_them(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {"rig_file": "x" * 5000}, split_size=1000) as bag:
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
        bag.add_lost(topic, 4)
    with (tmp_path / "bag/bag_0.mcap").open("rb") as file:
        found = {record.name: record.metadata for record in mcap.reader.make_reader(file).iter_metadata()}
    times = {"first_time": START, "last_time": START, "rate": 0.0}
    assert json.loads(found["abrace_topics"]["/response"]) == (
        {"messages": 24, "gaps": 8, "missing": 16, "lost": 4, "first_number": 0} | times
    )
    assert json.loads(found["abrace_topics"]["/note"]) == (
        {"messages": 3, "gaps": 0, "missing": 0, "lost": 0, "first_number": None}
        | times
        | {"last_time": START + 2 * SECOND // 10, "rate": 10.0}
    )
    assert found["abrace_versions"]["mcap"]


def test_messages_that_the_queue_cannot_hold_are_counted_as_lost_in_the_bag(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {})
    recording = Recording(bag, 10.0, capacity=50_000)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(1000):
        recording.write(topic, note(str(k)), START + k, START)
    lost = recording.dropped[topic]
    assert recording.close({topic: 3}) is bag
    assert 700 < lost < 1000
    assert notes_of(tmp_path / "bag") == [str(k) for k in range(1000 - lost)]
    assert bag.contents()["/note"].lost == lost + 3


def test_a_full_disk_is_an_error_of_the_recording(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {})
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        recording = Recording(bag, 0.01)
        for k in range(10_000):
            recording.write(topic, note(f"note {k} {os.urandom(50).hex()}"), START + k, START)
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_unexpected_error_in_the_thread_is_an_error_of_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*_: Any) -> None:
        reached.set()
        assert disk.wait(60)
        bytes(2**60)

    disk, reached = threading.Event(), threading.Event()
    bag = BagWriter(tmp_path / "bag", {})
    monkeypatch.setattr(bag, "write", write)
    recording = Recording(bag, 0.01)
    topic = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording.write(topic, note(""), START, START)
    assert reached.wait(60)
    for _ in range(3):
        recording.write(topic, note(""), START, START)
    disk.set()
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: MemoryError"):
        recording.close()
    assert recording.dropped == {topic: 4}
    assert lost_messages(read_topics(tmp_path / "bag").records) == {"/note": 4}


def test_a_file_that_cannot_be_begun_does_not_cost_those_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def add_metadata(file: McapWriter, *record: Any) -> None:
        if file.size < 100:
            raise OSError(errno.ENOSPC, "No space left on device")
        written(file, *record)

    bag = BagWriter(tmp_path / "bag", {}, split_duration=10.0)
    texts = write_notes(bag, 100)
    written = McapWriter.add_metadata
    monkeypatch.setattr(McapWriter, "add_metadata", add_metadata)
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: No space left on device"):
        bag.write(1, note("of the next file"), START + 10 * SECOND, START)
    with pytest.raises(AbraceError, match="is closed"):
        bag.flush()
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
    with BagWriter(tmp_path / "bag", {}, split_duration=1.0) as bag:
        write_notes(bag, 10)
        bag.write(1, note("of the next file"), START + SECOND, START)
    changes = [files for files, before in zip(seen, [None, *seen], strict=False) if files != before]
    assert changes == [[], [0], [1], [1, 0], [1, 1]], "topics in each file"


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
    recording.write(topic, note("no such time"), 2**63, START)
    for k in range(16):
        recording.write(topic, note(str(k)), START + k, START)
    with pytest.raises(
        AbraceError,
        match=r"bag .*bag: message of /note: at 9223372036854775808 ns, published at .*, expected 0 to 2\^63 - 1",
    ):
        recording.close()
    bag = read_topics(tmp_path / "bag")
    assert list(bag["/note"].fields["data"]) == [str(k) for k in range(32)]
    assert bag.warnings == ()
    assert lost_messages(bag.records) == {"/note": 17}
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 32


def test_who_records_never_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(*message: Any) -> None:
        reached.set()
        assert disk.wait(60)
        written(*message)

    disk, reached = threading.Event(), threading.Event()
    bag = BagWriter(tmp_path / "bag", {})
    written = bag.write
    monkeypatch.setattr(bag, "write", write)
    recording = Recording(bag, 0.01, capacity=1100)
    first = recording.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording.write(first, note("0"), START, START)
    assert reached.wait(60)
    recording.write(first, note("1"), START + 1, START)
    second = recording.add_topic("/later", STRING, TEXT, "RIHS01_0")
    recording.write(second, note("2"), START + 2, START)
    for _ in range(10):
        recording.write(first, note("x" * 390), START + 3, START)
    recording.check()
    assert recording.dropped == {first: 9}, "two of the others wait, and one of these"
    assert bag.contents()["/note"].messages == 0, "the disk has not begun"
    disk.set()
    recording.close()
    contents = read_topics(tmp_path / "bag")
    assert list(contents["/later"].fields["data"]) == ["2"]
    assert len(contents["/note"].log_time) == 3
    assert lost_messages(contents.records) == {"/note": 9, "/later": 0}


def test_a_closed_bag_takes_nothing_more(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        write_notes(bag, 3)
    for use in (
        lambda: bag.write(1, note(""), START, START),
        lambda: bag.add_topic("/other", STRING, TEXT, "RIHS01_0"),
        bag.flush,
        bag.sync,
    ):
        with pytest.raises(AbraceError, match=r"bag .*bag is closed"):
            use()
    bag.close()
    assert bag.contents()["/note"].messages == 3


def test_in_lockstep_the_log_time_is_the_time_of_the_sample(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01, lockstep=True)
    response = recording.add_topic("/response", "abrace_interfaces/msg/Response", NUMBERED_TEXT, "RIHS01_0")
    # as long as a sample, and with a stamp of its own
    other = recording.add_topic("/other", NUMBERED, NUMBERED_TEXT, "RIHS01_0")
    recording.write(other, numbered(99, stamp=17 * SECOND), START, START - 5)
    for k in range(3):
        recording.write(response, numbered(k, stamp=k * SECOND), START + k, START + k - 5)
        recording.write(other, numbered(k, stamp=17 * SECOND), START + k, START + k - 5)
    recording.write(response, b"", START, START)
    recording.close()
    found = read_topics(tmp_path / "bag", ["/other"])["/other"]
    assert list(found.log_time) == [0, 0, SECOND, 2 * SECOND]
    assert list(found.publish_time) == [START - 5, START - 5, START - 4, START - 3], "as it was"
    with Reader(tmp_path / "bag") as reader:
        times = [time for connection, time, _ in reader.messages() if connection.topic == "/response"]
    assert times == [0, SECOND, 2 * SECOND, 2 * SECOND]


def test_a_message_that_no_reader_takes_is_refused_and_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "LARGEST_MESSAGE", 1000)
    with BagWriter(tmp_path / "bag", {}) as bag:
        topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
        bag.write(topic, note("first"), 0, 2**63 - 1)
        refused: tuple[tuple[tuple[Any, ...], str], ...] = (
            ((topic, "text", START, START), "message of /note: is a str, expected bytes"),
            ((topic, bytes(1001), START, START), "message of /note: has 1001 bytes, expected at most 1000"),
            ((topic, b"", 2**63, START), "at 9223372036854775808 ns, published at"),
            ((topic, b"", -1, START), "at -1 ns, published at"),
            ((topic, b"", START, 2**64), "published at 18446744073709551616 ns, expected 0 to 2^63 - 1"),
            ((topic, b"", START, -1), "published at -1 ns, expected 0 to 2^63 - 1"),
            ((topic + 1, b"", START, START), "no topic has the number 2, expected one from add_topic"),
        )
        for message, complaint in refused:
            with pytest.raises(AbraceError, match=rf"bag .*bag: .*{re.escape(complaint)}"):
                bag.write(*message)
        with pytest.raises(AbraceError, match=r"bag .*bag: no topic has the number 2"):
            bag.add_lost(topic + 1, 1)
        bag.write(topic, note("last"), 2**63 - 1, 0)
    assert notes_of(tmp_path / "bag") == ["first", "last"]
    assert read_topics(tmp_path / "bag").warnings == ()
    assert bag.contents()["/note"].messages == 2


@pytest.mark.parametrize(
    ("facts", "records", "complaint"),
    [
        ({"n": 5}, {}, "fact 'n': 5, expected a text"),
        ({5: "n"}, {}, "fact 5: 5, expected a text"),
        ({"name": "frame \udcff"}, {}, r"fact 'name': '\udcff' in it is no character"),
        ({"checksum": "0"}, {}, "fact checksum: it is written with the facts, expected another name"),
        ({}, {"notes": {"n": 5}}, "record notes: 'n': 5, expected a text"),
        ({}, {"abrace": {}}, "record abrace: every bag has one of this name, expected another name"),
        ({}, {"notes": {"x": "a" * 2**24}}, "metadata notes has 16777238 bytes, expected at most 16777216"),
    ],
)
def test_facts_and_records_that_no_reader_takes_are_refused(
    tmp_path: Path, facts: dict[Any, Any], records: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(AbraceError, match=re.escape(complaint)):
        BagWriter(tmp_path / "bag", facts, records=records)
    assert not (tmp_path / "bag").exists()


def test_the_next_file_begins_before_its_index_fills_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "INDEX_MEMORY", 1000)
    with BagWriter(tmp_path / "bag", {}) as bag:
        topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
        for k in range(100):
            bag.write(topic, note(str(k)), START + k, START)
            bag.flush()
    assert 5 < len(list((tmp_path / "bag").glob("*.mcap"))) < 20
    assert notes_of(tmp_path / "bag") == [str(k) for k in range(100)]


def test_facts_are_keys_and_values_each_once() -> None:
    assert parse_facts(["rig=east", "note=a=b"]) == {"rig": "east", "note": "a=b"}
    for texts, complaint in ((["rig"], "'rig', expected key=value"), (["a=1", "a=2"], "expected each key once")):
        with pytest.raises(AbraceError, match=f"parameter facts: .*{complaint}"):
            parse_facts(texts)
