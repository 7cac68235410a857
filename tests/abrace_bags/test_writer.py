"""What a bag is written with: compression, files, attachments, counts, a thread of its own, snapshots, choices."""

from __future__ import annotations

import errno
import json
import os
import resource
import struct
import threading
from typing import TYPE_CHECKING, Any

import mcap.reader
import mcap.stream_reader
import numpy as np
import pytest
import yaml
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from abrace_bags import BagWriter, read_facts, read_topics
from abrace_bags.mcap.attachments import file_attachments
from abrace_bags.mcap.file_writer import McapWriter
from abrace_bags.metadata import installed_versions
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.recording import Recording, parse_facts
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


def numbered(sequence: int, frame_id: str = "") -> bytes:
    text = frame_id.encode() + b"\0"
    head = wire.LITTLE_ENDIAN + struct.pack("<iII", 1, 2, len(text)) + text
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
    (tmp_path / "a").mkdir()
    for path in (tmp_path / "rig.yaml", tmp_path / "a/rig.yaml"):
        path.write_text("")
    with pytest.raises(AbraceError, match=r"attachment .*a/rig\.yaml: another one is called rig\.yaml"):
        file_attachments([tmp_path / "rig.yaml", tmp_path / "a/rig.yaml"])
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
    with recording.bag() as bag:
        topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    for k in range(3000):
        recording.write(topic, note(str(k)), START + k, START)
        if k == 1500:
            with recording.bag() as bag:
                bag.split()
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
    with pytest.raises(AbraceError, match=r"cannot write bag .*bag: No such file"), recording.bag() as bag:
        bag.split()
    for thread in threading.enumerate():
        if thread.name == "bag":
            thread.join()
    with pytest.raises(AbraceError, match="No such file"):
        recording.close()


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
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    assert notes_of(tmp_path / "bag") == texts


def test_a_file_is_seen_from_when_it_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flush(file: McapWriter) -> None:
        seen.append([len(read_topics(path)) for path in sorted((tmp_path / "bag").glob("*.mcap"))])
        flushed(file)

    seen: list[list[int]] = []
    flushed = McapWriter.flush
    monkeypatch.setattr(McapWriter, "flush", flush)
    with BagWriter(tmp_path / "bag", {}) as bag:
        write_notes(bag, 10)
        bag.split()
    assert seen == [[], [0], [1], [1, 0], [1, 0]], "topics in each file"


def test_an_interruption_of_a_recording_is_no_gap(tmp_path: Path) -> None:
    for name, snapshot in (("all", 0.0), ("snapshot", 2.0)):
        bag = BagWriter(tmp_path / name, {})
        topic = bag.add_topic("/response", NUMBERED, NUMBERED_TEXT, "RIHS01_0")
        recording = Recording(bag, 0.01, snapshot)
        for sequence in (0, 1, 50, 52):
            if sequence == 50:
                recording.interrupt()
            recording.write(topic, numbered(sequence), START, START)
        if snapshot:
            assert recording.write_snapshot() == 4
        recording.close()
        assert (bag.counts()["/response"].gaps, bag.counts()["/response"].missing) == (1, 1)


def test_a_snapshot_stays_small_and_drops_times_to_come(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", {})
    topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
    recording = Recording(bag, 10.0, 2.0, capacity=100_000)
    recording.write(topic, bytes(200_000), START, START)
    for k in range(1000):
        recording.write(topic, note(str(k)), START + k, START)
    assert 400 < recording.write_snapshot() < 500, "a message takes some 200 bytes in addition to its own"
    recording.write(topic, note("the clock is set back"), START, START)
    recording.write(topic, note("then"), START - 3600 * SECOND, START)
    assert recording.write_snapshot() == 1
    recording.close()


def test_a_snapshot_keeps_the_last_seconds_and_nothing_twice(tmp_path: Path) -> None:
    recording = Recording(BagWriter(tmp_path / "bag", {}), 0.01, 2.0)
    with recording.bag() as bag:
        topic = bag.add_topic("/note", STRING, TEXT, "RIHS01_0")
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
