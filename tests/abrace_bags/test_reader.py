# SPDX-License-Identifier: Apache-2.0
"""Bags: written ones are read back whole, by us and by independent readers, and damage is never read as good."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import mcap.reader
import mcap.stream_reader
import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType, Writer
from mcap_chunks import chunk_indexes
from reference_messages import DEFINITIONS, HASHES, RESPONSE, STORE, STRING, TYPES, note, response_message, serialised
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from abrace_bags import DEFAULT_QOS, BagWriter, read_facts, read_topics
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

FACTS = {"rig": "ncree: three storeys\nsecond line", "sample_period": "0.002", "empty": "", "größe": "½ #1"}
FIELDS = ("displacement", "acceleration", "stroke", "force", "command", "ground_acceleration")
START = 1_700_000_000_000_000_000


def response(k: int) -> Any:
    return response_message(k, np.random.default_rng(k).normal(size=10), k // 500, k % 500 * 2_000_000)


def write_bag(directory: Path, samples: int, flush_every: int = 10**9) -> list[Any]:
    """A bag of responses, and of a string after every fifth of them; returns the responses."""
    messages = [response(k) for k in range(samples)]
    with BagWriter(directory, FACTS) as bag:
        number = bag.add_topic(
            "/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE], DEFAULT_QOS._replace(depth=50)
        )
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
        for k, message in enumerate(messages):
            bag.write(number, serialised(message), START + 2_000_000 * k, START + 2_000_000 * k - 70_000)
            if k % 5 == 0:
                bag.write(notes, note(f"note {k}"), START + 2_000_000 * k + 1, START)
            if k % flush_every == flush_every - 1:
                bag.flush()
    return messages


def mcap_of(directory: Path) -> Path:
    return directory / f"{directory.name}_0.mcap"


def check_values(fields: dict[str, Any], messages: list[Any]) -> None:
    """Every value of these fields is that of the message of its sequence."""
    for i, k in enumerate(fields["sequence"]):
        message = messages[int(k)]
        assert fields["header.frame_id"][i] == "table"
        assert fields["header.stamp.sec"][i] == message.header.stamp.sec
        assert fields["header.stamp.nanosec"][i] == message.header.stamp.nanosec
        for name in FIELDS:
            np.testing.assert_array_equal(fields[name][i], getattr(message, name))


def test_bag_reads_back_value_for_value(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 1000)
    contents = read_topics(tmp_path / "bag")
    assert contents.warnings == ()
    assert contents.facts == FACTS
    assert set(contents) == {"/response", "/note"}
    found = contents["/response"]
    assert found.type_name == RESPONSE
    np.testing.assert_array_equal(found.fields["sequence"], np.arange(1000))
    assert found.fields["force"].shape == (1000, 1)
    assert found.fields["displacement"].dtype == np.float64
    check_values(found.fields, messages)
    np.testing.assert_array_equal(found.log_time, START + 2_000_000 * np.arange(1000))
    np.testing.assert_array_equal(found.publish_time, found.log_time - 70_000)
    assert list(contents["/note"].fields["data"]) == [f"note {k}" for k in range(0, 1000, 5)]


def test_single_file_reads_as_its_directory_does(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 20)
    contents = read_topics(mcap_of(tmp_path / "bag"), ["/response"])
    assert list(contents) == ["/response"]
    assert contents.facts == FACTS
    check_values(contents["/response"].fields, messages)


def test_rosbags_reads_our_bag_value_for_value(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 1000)
    with AnyReader([tmp_path / "bag"], default_typestore=STORE) as reader:
        connections = [c for c in reader.connections if c.topic == "/response"]
        read = [(time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages(connections)]
        assert reader.message_count == 1200
    assert [time for time, _ in read] == [START + 2_000_000 * k for k in range(1000)]
    for (_, found), written in zip(read, messages, strict=True):
        assert found.sequence == written.sequence
        assert found.header.stamp.nanosec == written.header.stamp.nanosec
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found, name), getattr(written, name))


def test_metadata_is_what_rosbag2_writes(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 10)
    with Reader(tmp_path / "bag") as reader:
        connection = next(c for c in reader.connections if c.topic == "/response")
        assert connection.msgtype == RESPONSE
        assert connection.digest == HASHES[RESPONSE]
        assert connection.msgcount == 10
        (qos,) = connection.ext.offered_qos_profiles
        assert (qos.depth, qos.reliability.name, qos.durability.name) == (50, "RELIABLE", "VOLATILE")
        assert reader.start_time == START
        assert reader.duration == 9 * 2_000_000 + 1
        assert reader.ros_distro == "jazzy"
    text = (tmp_path / "bag/metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["custom_data"] == FACTS
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert "&" not in text, "rosbag2 writes no YAML anchors"
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_mcap_reads_our_file_with_profile_qos_hash_and_facts(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 10)
    with mcap_of(tmp_path / "bag").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        channel = next(c for c in summary.channels.values() if c.topic == "/response")
        schema = summary.schemas[channel.schema_id]
        assert (schema.name, schema.encoding, channel.message_encoding) == (RESPONSE, "ros2msg", "cdr")
        assert schema.data.decode() == DEFINITIONS[RESPONSE]
        assert channel.metadata["topic_type_hash"] == HASHES[RESPONSE]
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["depth"] == 50
        assert sum(1 for _ in reader.iter_messages()) == 12
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert FACTS.items() <= metadata["abrace"].items()
        assert yaml.safe_load(metadata["rosbag2"]["serialized_metadata"])["message_count"] == 12
    with mcap_of(tmp_path / "bag").open("rb") as file:
        chunks = [
            record
            for record in mcap.stream_reader.StreamReader(file, emit_chunks=True, validate_crcs=True).records
            if type(record).__name__ == "Chunk"
        ]
    assert all(chunk.compression == "zstd" and chunk.uncompressed_crc for chunk in chunks)


def test_facts_are_read_without_the_rest(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 10)
    assert read_facts(tmp_path / "bag") == FACTS
    assert read_facts(mcap_of(tmp_path / "bag")) == FACTS


def test_bag_without_messages_is_a_bag(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 0)
    contents = read_topics(tmp_path / "bag")
    assert contents.warnings == ()
    assert contents["/response"].log_time.shape == (0,)
    assert contents["/response"].fields["header.stamp.sec"].shape == (0,)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 0


def test_existing_directory_is_refused_and_untouched(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 3)
    before = mcap_of(tmp_path / "bag").read_bytes()
    with pytest.raises(AbraceError, match="exists already"):
        BagWriter(tmp_path / "bag", {})
    assert mcap_of(tmp_path / "bag").read_bytes() == before


def test_directory_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AbraceError, match=r"cannot write bag .*file/bag: Not a directory"):
        BagWriter(tmp_path / "file/bag", {})


def test_topic_is_announced_once_with_known_qos(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
        with pytest.raises(AbraceError, match="topic /note is in it already"):
            bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
    assert list(read_topics(tmp_path / "bag")) == ["/note"]


def test_a_writer_refuses_a_negative_time_and_writes_on(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        note = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
        with pytest.raises(AbraceError, match="-5 ns"):
            bag.write(note, b"\0\1\0\0", 7, -5)
        bag.write(note, serialised(TYPES[STRING](data="good"), STRING), 7, 5)
    assert list(read_topics(tmp_path / "bag")["/note"].fields["data"]) == ["good"]


def test_full_disk_is_reported_and_what_was_written_stays_readable(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", FACTS)
    number = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
    messages = [response(k) for k in range(2000)]

    def write_all() -> None:
        for k, message in enumerate(messages):
            bag.write(number, serialised(message), START + 2_000_000 * k, START)
            if k % 100 == 99:
                bag.flush()

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(AbraceError, match=r"cannot write bag .*bag: File too large"):
            write_all()
        bag.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    contents = read_topics(tmp_path / "bag")
    assert "cut off or damaged" in contents.warnings[0]
    assert contents["/response"].log_time.size > 300
    check_values(contents["/response"].fields, messages)


def test_killed_writer_leaves_all_that_was_flushed(tmp_path: Path) -> None:
    code = f"""
import os, signal
from abrace_bags import BagWriter
bag = BagWriter({str(tmp_path / "bag")!r}, {FACTS!r})
number = bag.add_topic("/note", {STRING!r}, {DEFINITIONS[STRING]!r}, "")
payload = {serialised(TYPES[STRING](data="whole"), STRING)!r}
for k in range(100):
    bag.write(number, payload, k, k)
bag.flush()
bag.write(number, payload, 100, 100)
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    contents = read_topics(tmp_path / "bag")
    assert contents.facts == read_facts(tmp_path / "bag") == FACTS
    np.testing.assert_array_equal(contents["/note"].log_time, np.arange(100))
    assert set(contents["/note"].fields["data"]) == {"whole"}
    assert "cut off or damaged" in contents.warnings[0]


def test_cut_file_gives_the_whole_chunks_before_the_cut(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 60, flush_every=10)
    whole = mcap_of(tmp_path / "bag").read_bytes()
    counts = []
    for size in [*range(8, len(whole), 97), len(whole) - 1]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:size])
        contents = read_topics(cut)
        assert any("cut off or damaged" in warning for warning in contents.warnings), f"{size} bytes"
        assert contents.facts in ({}, FACTS)
        found = contents.get("/response")
        counts.append(0 if found is None else found.log_time.size)
        if found is not None:
            np.testing.assert_array_equal(found.fields["sequence"], np.arange(counts[-1]))
            check_values(found.fields, messages)
    assert counts == sorted(counts)
    assert set(counts) == {0, 10, 20, 30, 40, 50, 60}, "every flushed chunk counts once it is whole"


def test_flipped_byte_is_never_read_as_good(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 12, flush_every=4)
    whole = mcap_of(tmp_path / "bag").read_bytes()
    damaged = tmp_path / "damaged.mcap"
    for offset in range(0, len(whole), 9):
        content = bytearray(whole)
        content[offset] ^= 1 << (offset // 9) % 8
        damaged.write_bytes(content)
        try:
            contents = read_topics(damaged)
        except AbraceError:
            continue
        assert contents.warnings, f"byte {offset} is flipped and nothing is reported"
        assert contents.facts in ({}, FACTS), f"byte {offset}"
        for topic, found in contents.items():
            if topic == "/response":
                check_values(found.fields, messages)
                np.testing.assert_array_equal(found.log_time, START + 2_000_000 * found.fields["sequence"])
            else:
                assert topic == "/note", f"byte {offset}"
                assert set(found.fields["data"]) <= {"note 0", "note 5", "note 10"}, f"byte {offset}"


def test_flipped_byte_in_a_cut_file_is_never_read_as_good(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 12, flush_every=4)
    whole = mcap_of(tmp_path / "bag").read_bytes()
    whole = whole[: whole.rindex(b"serialized_metadata")]
    damaged = tmp_path / "damaged.mcap"
    for offset in range(3, len(whole), 11):
        content = bytearray(whole)
        content[offset] ^= 1 << (offset // 11) % 8
        damaged.write_bytes(content)
        try:
            contents = read_topics(damaged)
        except AbraceError:
            continue
        assert contents.facts in ({}, FACTS), f"byte {offset}"
        if "/response" in contents:
            check_values(contents["/response"].fields, messages)


def test_damaged_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 60, flush_every=10)
    path = mcap_of(tmp_path / "bag")
    indexes = chunk_indexes(path)
    for chunk, lost in ((0, range(10)), (2, range(20, 30))):
        index = indexes[chunk]
        content = bytearray(path.read_bytes())
        content[index.chunk_start_offset + index.chunk_length - 20] ^= 0xFF
        damaged = tmp_path / "damaged.mcap"
        damaged.write_bytes(content)
        contents = read_topics(damaged)
        fields = contents["/response"].fields
        assert set(range(60)) - set(fields["sequence"].tolist()) == set(lost)
        check_values(fields, messages)
        assert any("10 of 60 messages of /response are missing" in warning for warning in contents.warnings)
        assert any("2 of 12 messages of /note are missing" in warning for warning in contents.warnings)


def test_damaged_facts_are_an_error(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 3)
    path = mcap_of(tmp_path / "bag")
    path.write_bytes(path.read_bytes().replace(b"three storeys", b"seven storeys", 1))
    with pytest.raises(AbraceError, match="facts do not match their checksum"):
        read_facts(path)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [(b"", "the file is empty"), (b"SQLite format 3\0" * 9, "not an MCAP file"), (b"\x89MCAP", "not an MCAP file")],
)
def test_other_files_are_refused_by_name(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "thing.mcap"
    path.write_bytes(content)
    for read in (read_topics, read_facts):
        with pytest.raises(AbraceError, match=rf"thing\.mcap: {complaint}"):
            read(path)


def test_missing_bag_topic_and_file_are_reported(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match=r"nothing: no such bag"):
        read_topics(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(AbraceError, match=r"empty: no MCAP file in it"):
        read_facts(tmp_path / "empty")
    write_bag(tmp_path / "bag", 3)
    with pytest.raises(AbraceError, match=r"bag: no topic /respons in it"):
        read_topics(tmp_path / "bag", ["/respons"])
    metadata = tmp_path / "bag/metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag_0.mcap", "- bag_0.mcap\n  - bag_1.mcap"))
    assert read_topics(tmp_path / "bag").warnings == (f"{tmp_path / 'bag'}: bag_1.mcap is missing",)
    metadata.write_text("{")
    assert "can't be read" in read_topics(tmp_path / "bag").warnings[0]


def test_bag_of_several_files_is_read_in_order(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 30)
    for part, first in (("2", 10), ("10", 20)):
        with BagWriter(tmp_path / part, {}) as bag:
            number = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
            for k in range(first, first + 10):
                bag.write(number, serialised(messages[k]), START + k, START + k)
    split = tmp_path / "split"
    split.mkdir()
    for number, part in enumerate(("2", "10")):
        mcap_of(tmp_path / part).rename(split / f"split_{'9' if number == 0 else '10'}.mcap")
    found = read_topics(split)["/response"]
    np.testing.assert_array_equal(found.fields["sequence"], np.arange(10, 30))
    check_values(found.fields, messages)


def test_bag_of_another_writer_is_read(tmp_path: Path) -> None:
    messages = [response(k) for k in range(50)]
    with RosbagsWriter(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/response", RESPONSE, typestore=STORE)
        for k, message in enumerate(messages):
            bag.write(connection, START + k, serialised(message))
    contents = read_topics(tmp_path / "other")
    check_values(contents["/response"].fields, messages)
    assert contents["/response"].log_time.size == 50
    assert contents.facts == read_facts(tmp_path / "other") == {}
    assert len(contents.warnings) == 1
    assert "1 chunks have no checksum" in contents.warnings[0]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunks", [True, False])
def test_every_form_of_mcap_is_read(tmp_path: Path, compression: CompressionType, chunks: bool) -> None:
    messages = [response(k) for k in range(50)]
    path = tmp_path / "form.mcap"
    with path.open("wb") as file:
        writer = Writer(file, 1000, compression, use_chunking=chunks, enable_data_crcs=True)
        writer.start("ros2")
        schema = writer.register_schema(RESPONSE, "ros2msg", DEFINITIONS[RESPONSE].encode())
        one = writer.register_channel("/response", "cdr", schema)
        other = writer.register_channel("/response", "cdr", schema)
        for k, message in enumerate(messages):
            writer.add_message(one if k % 3 else other, START + k, serialised(message), START)
        writer.add_attachment(0, 0, "note", "text/plain", b"not ours")
        writer.finish()
    contents = read_topics(path)
    assert contents.warnings == ()
    np.testing.assert_array_equal(contents["/response"].fields["sequence"], np.arange(50))
    check_values(contents["/response"].fields, messages)
    if not chunks:
        damaged = bytearray(path.read_bytes())
        damaged[damaged.index(b"table")] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(AbraceError, match="do not match their checksum"):
            read_topics(path)


def test_topic_that_cannot_be_read_is_reported_or_refused_if_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(STRING, "ros2msg", DEFINITIONS[STRING].encode())
        good = writer.register_channel("/good", "cdr", schema)
        short = writer.register_channel("/short", "cdr", schema)
        empty = writer.register_channel("/empty", "cdr", schema)
        writer.add_message(empty, 1, b"", 1)
        odd = writer.register_channel("/odd", "json", writer.register_schema("odd", "jsonschema", b"{}"))
        writer.add_message(good, 1, serialised(TYPES[STRING](data="ok"), STRING), 1)
        writer.add_message(short, 1, b"\0\1\0\0\xff\0\0\0a", 1)
        writer.add_message(odd, 1, b"{}", 1)
        writer.finish()
    contents = read_topics(path)
    assert list(contents) == ["/good"]
    assert any("/short is left out: message 0" in warning for warning in contents.warnings)
    assert any("/empty is left out: message 0" in warning for warning in contents.warnings)
    assert any("/odd is left out" in warning and "'json'" in warning for warning in contents.warnings)
    with pytest.raises(AbraceError, match=r"no topic /odd in it .*jsonschema"):
        read_topics(path, ["/odd"])
