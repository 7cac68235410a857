# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: what is whole is read, what is missing is reported by topic, and a whole bag is recovered from it."""

from __future__ import annotations

import io
import resource
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bag_contents import lost_messages, read_topics
from bag_damage import damage, packed_as
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Footer, Header, Metadata, Schema, Statistics
from mcap.writer import CompressionType, Writer
from mcap_chunks import chunk_indexes, chunk_offsets, without_end
from reference_messages import DEFINITIONS, HASHES, RESPONSE, STORE, STRING, note, response_message, serialised
from rosbags.highlevel import AnyReader

from abrace_bags import DEFAULT_QOS, Bag, BagWriter, describe, file_attachments, recover
from abrace_bags.mcap import index
from abrace_bags.mcap.records import MCAP0_MAGIC, DamagedError, parse
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

FACTS = {"rig": "ncree", "sample_period": "0.002"}


def response(k: int) -> bytes:
    return serialised(response_message(k, np.random.default_rng(k).normal(size=10), 1, k))


def write_bag(directory: Path, samples: int, flush_every: int = 10**9) -> Path:
    """Responses and, after every fifth, a note; returns the MCAP file."""
    with BagWriter(directory, FACTS) as bag:
        responses = bag.add_topic(
            "/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE], DEFAULT_QOS._replace(depth=77)
        )
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
        for k in range(samples):
            bag.write(responses, response(k), 10 * k, 10 * k + 1)
            if k % 5 == 0:
                bag.write(notes, note(f"note {k}"), 10 * k + 2, 10 * k + 3)
            if k % flush_every == flush_every - 1:
                bag.flush()
    return directory / f"{directory.name}_0.mcap"


def flip(path: Path, offset: int, bit: int = 0) -> None:
    content = bytearray(path.read_bytes())
    content[offset] ^= 1 << bit
    path.write_bytes(content)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_every_door_gives_all_that_is_whole_of_cut_and_damaged_bags(tmp_path: Path, compression: str) -> None:
    write_bag(tmp_path / "bag", 400, flush_every=25)
    bag = tmp_path / "bag"
    if compression != "zstd":
        bag = packed_as(bag, CompressionType[compression.upper()])
    found = damage(bag, 6, 6)
    assert found["cuts"] == found["recovered"] == 12
    assert (found["tracebacks"], found["wrong_values"], found["unreported"]) == (0, 0, 0)


@pytest.mark.parametrize("closed", [True, False])
def test_a_message_index_that_is_cut_or_damaged_costs_nothing(tmp_path: Path, closed: bool) -> None:
    path = write_bag(tmp_path / "bag", 200, flush_every=25)
    whole = path.read_bytes()
    for trial, start in enumerate(message_index_offsets(path)[::5]):
        content = bytearray(whole if closed else whole[: start + 4 + trial])
        content[start + 3] ^= closed << trial % 8
        path.write_bytes(content)
        times = [10 * k for k in range(200 if closed else 25 * (whole[:start].count(b"zstd")))]
        assert read_topics(path)["/response"].log_time.tolist() == times
        assert [one.log_time for one in Bag(path).raw(["/response"])] == times
        assert recover(path, tmp_path / f"{trial}").counts["/response"] == len(times)


def message_index_offsets(path: Path) -> list[int]:
    return [offset for index in chunk_indexes(path) for offset in index.message_index_offsets.values()]


def test_records_with_fields_of_a_later_version_are_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 20)
    content = path.read_bytes()
    padded = bytearray(content[: len(MCAP0_MAGIC)])
    position = len(MCAP0_MAGIC)
    while position < len(content) - len(MCAP0_MAGIC) and content[position] != Opcode.DATA_END:
        end = position + 9 + int.from_bytes(content[position + 1 : position + 9], "little")
        body = content[position + 9 : end] + b"later"
        padded += content[position : position + 1] + len(body).to_bytes(8, "little") + body
        position = end
    path.write_bytes(padded + content[position:])
    contents = read_topics(path)
    assert contents["/response"].fields["sequence"].tolist() == list(range(20))
    assert contents.facts == FACTS


def test_a_place_in_the_index_beyond_the_file_is_damage(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 20)
    content = path.read_bytes()
    offset = chunk_offsets(path)[0].to_bytes(8, "little")
    (_, start, _), end = index.read_footer(io.BytesIO(content), len(content)), len(content) - 12
    summary = content[start:end].replace(offset, b"\xff" * 8)
    path.write_bytes(content[:start] + summary + zlib.crc32(summary).to_bytes(4, "little") + content[-8:])
    contents = read_topics(path)
    assert contents["/response"].log_time.size == 20
    assert any("names places that are not in the file" in warning for warning in contents.warnings)


RECORDS = [
    Header("ros2", "abrace"),
    Schema(3, b"float64 x\n", "ros2msg", "test_msgs/msg/Number"),
    Channel(5, "/number", "cdr", {"topic_type_hash": "RIHS01_0", "offered_qos_profiles": ""}, 3),
    Chunk("zstd", b"packed bytes", 7, 8, 9, 10),
    ChunkIndex(11, 12, "zstd", 13, 14, 15, {5: 16, 6: 17}, 18, 19),
    Attachment(20, 21, "rig.yaml", "text/plain", b"storeys: 3"),
    Metadata("abrace", {"rig": "ncree", "record": "El Centro"}),
    Statistics(1, 2, {5: 22, 6: 23}, 3, 45, 24, 25, 1, 1),
    Footer(26, 27, 28),
]


def content(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
def test_record_that_is_cut_or_has_a_wrong_length_is_damaged(record: Any) -> None:
    kind, body = type(record), content(record)
    assert parse(kind, body) == (record, 0)
    for size in range(len(body)):
        with pytest.raises(DamagedError):
            parse(kind, body[:size])
    if kind in (ChunkIndex, Statistics, Footer):  # the summary section has a checksum, and may have further fields
        return
    assert parse(kind, body + b"\0") == (record, 1), "later versions of MCAP may have further fields"
    for bit in range(8 * len(body)):
        flipped = bytearray(body)
        flipped[bit // 8] ^= 1 << bit % 8
        try:
            other, rest = parse(kind, bytes(flipped))
        except DamagedError:
            continue
        same = content(other)[:-4] == flipped[:-4]
        assert same or rest, f"bit {bit} is flipped, and something else is read"


@pytest.mark.parametrize("offset", range(8))
def test_damaged_magic_costs_nothing(tmp_path: Path, offset: int) -> None:
    path = write_bag(tmp_path / "bag", 20)
    flip(path, offset, offset)
    contents = read_topics(path)
    assert contents["/response"].fields["sequence"].tolist() == list(range(20))
    assert contents.facts == FACTS
    assert contents.warnings == (f"{path}: the magic at its beginning is damaged",)
    flip(path, (offset + 1) % 8, 0)
    assert read_topics(path)["/response"].log_time.size == 20, "there is the magic at its end, too"
    flip(path, path.stat().st_size - 1 - offset)
    assert read_topics(path)["/response"].log_time.size == 20, "there are chunks"


def test_a_file_whose_first_page_was_never_written_has_its_chunks(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 200, flush_every=10)
    before = read_topics(path)["/response"].log_time
    whole = path.read_bytes()
    for content in (bytes(4096) + whole[4096:], bytes(8) + without_end(whole)[8:]):
        path.write_bytes(content)
        for found in (read_topics(path)["/response"].log_time, Bag(path).raw(["/response"])):
            times = [getattr(one, "log_time", one) for one in found]
            assert times == before[-len(times) :].tolist()
            assert len(times) > 100


@pytest.mark.parametrize("part", ["opcode", "length"])
@pytest.mark.parametrize("indexed", [True, False])
def test_a_damaged_length_costs_its_chunk_alone_and_a_damaged_opcode_nothing(
    tmp_path: Path, part: str, indexed: bool
) -> None:
    path = write_bag(tmp_path / "bag", 60, flush_every=10)
    offset = chunk_offsets(path)[2]
    if not indexed:
        content = path.read_bytes()
        path.write_bytes(without_end(content))
    flip(path, offset + {"opcode": 0, "length": 3}[part], 3)
    contents = read_topics(path)
    missing = sorted(set(range(60)) - set(contents["/response"].fields["sequence"].tolist()))
    assert [message.log_time for message in Bag(path).raw(["/response"])] == contents["/response"].log_time.tolist()
    if part == "opcode":
        assert missing == []
        assert any(f"the chunk at byte {offset} has a damaged opcode" in one for one in contents.warnings)
        return
    assert missing == list(range(20, 30))
    expected = "10 of 60 messages of /response are missing" if indexed else "10 of the samples 0 to 59 are missing"
    assert any(expected in warning for warning in contents.warnings), contents.warnings
    assert any("/note" in warning for warning in contents.warnings), contents.warnings


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_whole_messages_of_the_open_chunk_are_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "open.mcap"
    with path.open("wb") as file:
        writer = Writer(file, 1 << 20, compression)
        writer.start("ros2")
        topic = writer.register_channel(
            "/response", "cdr", writer.register_schema(RESPONSE, "ros2msg", DEFINITIONS[RESPONSE].encode())
        )
        for k in range(3000):
            writer.add_message(topic, k, response(k), k)
        writer.finish()
    begin = chunk_offsets(path)[0]
    path.write_bytes(path.read_bytes()[: begin + 200_000])
    contents = read_topics(path)
    sequence = contents["/response"].fields["sequence"]
    np.testing.assert_array_equal(sequence, np.arange(sequence.size))
    assert sequence.size > 500, "a third of the messages are there"
    assert any("without its checksum" in warning for warning in contents.warnings)


@pytest.mark.parametrize("zeros", [1, 9, 60, 4096])
def test_zeros_at_the_end_of_a_file_are_no_values(tmp_path: Path, zeros: int) -> None:
    path = tmp_path / "uncompressed.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema(RESPONSE, "ros2msg", DEFINITIONS[RESPONSE].encode())
        channel = writer.register_channel("/response", "cdr", schema)
        for k in range(100):
            writer.add_message(channel, k, response(k), k)
        writer.finish()
    whole, end = path.read_bytes(), chunk_offsets(path)[0] + 8000
    for cut in range(end, end + 250, 9):
        path.write_bytes(whole[:cut] + bytes(zeros))
        read = read_topics(path)["/response"].fields
        assert read["sequence"].tolist() == list(range(read["sequence"].size))
        assert read["sequence"].size > 20
        for k in (-1, -2):
            _, *values = np.random.default_rng(read["sequence"][k]).normal(size=10)
            assert read["ground_acceleration"][k] == values[-1]


def test_damage_outside_chunks_costs_one_message_or_is_reported_of_all(tmp_path: Path) -> None:
    path = tmp_path / "unchunked.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=True)
        writer.start("ros2")
        topic = writer.register_channel(
            "/note", "cdr", writer.register_schema(STRING, "ros2msg", DEFINITIONS[STRING].encode())
        )
        for k in range(40):
            writer.add_message(topic, k, note(f"note {k}"), k)
        writer.finish()
    whole = path.read_bytes()
    first = whole.index(b"note 0\0")
    assert read_topics(path).warnings == ()
    for offset in range(first - 39, first + 300, 11):
        for closed in (True, False):
            path.write_bytes(whole if closed else whole[: whole.rindex(b"note 39\0") + 8])
            flip(path, offset, offset % 8)
            bag, recovered = Bag(path), tmp_path / f"{offset}{closed}"
            count = bag.raw().count
            assert count >= 39, f"byte {offset}"
            assert bag.warnings, f"byte {offset}"
            assert recover(path, recovered).counts.get("/note") == count, f"byte {offset}"
            assert len([*Bag(recovered).raw()]) == count, f"byte {offset}"


def raw(directory: Path) -> list[tuple[str, int, bytes]]:
    with AnyReader([directory], default_typestore=STORE) as reader:
        return [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]


def test_recovered_bag_is_whole_and_has_every_message_that_was_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 60, flush_every=10)
    before = raw(tmp_path / "bag")
    path.write_bytes(path.read_bytes()[: chunk_offsets(path)[4] + 50])
    recovered = recover(tmp_path / "bag", tmp_path / "whole")
    assert recovered.counts == {"/response": 40, "/note": 8}
    assert any("cut off" in warning for warning in recovered.warnings)
    assert any("/response: 0 of the samples 0 to 39 are missing" in warning for warning in recovered.warnings)
    assert raw(tmp_path / "whole") == [entry for entry in before if entry[1] < 400]
    again = read_topics(tmp_path / "whole")
    assert again.facts == FACTS
    assert again.warnings == tuple(f"{tmp_path}/whole: was made of another bag: {one}" for one in recovered.warnings)
    np.testing.assert_array_equal(again["/response"].publish_time, 10 * np.arange(40) + 1)
    with AnyReader([tmp_path / "whole"], default_typestore=STORE) as reader:
        connection = next(one for one in reader.connections if one.topic == "/response")
        assert connection.digest == HASHES[RESPONSE]
        assert connection.ext.offered_qos_profiles[0].depth == 77


def test_a_recovered_bag_keeps_files_records_and_losses(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("storeys: 3\n")
    attached = file_attachments([tmp_path / "rig.yaml"])
    qos = DEFAULT_QOS._replace(depth=3), DEFAULT_QOS._replace(depth=5)
    with BagWriter(tmp_path / "bag", FACTS, records={"versions": {"python": "3"}}, attachments=attached) as bag:
        topic = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING], *qos)
        bag.write(topic, note("a"), 10, 10)
        bag.add_lost(topic, 7)
    recover(tmp_path / "bag", tmp_path / "whole")
    first, again = read_topics(tmp_path / "bag"), read_topics(tmp_path / "whole")
    assert again.attachments == first.attachments == {"rig.yaml": b"storeys: 3\n"}
    assert again.records["versions"] == {"python": "3"}
    assert again.records["abrace_topics"] == first.records["abrace_topics"]
    assert '"lost": 7' in again.records["abrace_topics"]["/note"]
    with AnyReader([tmp_path / "whole"]) as reader:
        assert [profile.depth for profile in reader.connections[0].ext.offered_qos_profiles] == [3, 5]


def without_messages(folder: Path) -> Sequence[Path]:
    """A file cut off before its first chunk, one of no format that is known, a bag of nothing."""
    path = write_bag(folder / "bag", 20)
    path.write_bytes(path.read_bytes()[: chunk_offsets(path)[0] + 30])
    (folder / "other.mcap").write_bytes(b"SQLite format 3\0")
    write_bag(folder / "empty", 0)
    return path, folder / "other.mcap", folder / "empty"


def test_a_recovery_that_fails_midway_leaves_nothing(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 60)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    try:
        with pytest.raises(AbraceError, match=rf"cannot write bag {tmp_path}/whole: File too large"):
            recover(tmp_path / "bag", tmp_path / "whole")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    with pytest.raises(AbraceError, match="exists already"):
        recover(tmp_path / "bag", tmp_path / "bag")


def test_nothing_to_recover_is_an_error_and_writes_nothing(tmp_path: Path) -> None:
    for bag in without_messages(tmp_path):
        with pytest.raises(AbraceError, match=r"no message in it that can be read|expected a bag of rosbag2"):
            recover(bag, tmp_path / "whole")
    with pytest.raises(AbraceError, match="no such bag"):
        recover(tmp_path / "none", tmp_path / "whole")
    assert not (tmp_path / "whole").exists()


def test_a_recovered_bag_says_what_is_lost_or_that_nobody_knows(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 60, flush_every=10)
    whole, offset = path.read_bytes(), chunk_offsets(path)[3]
    flip(path, offset + 100)
    recover(tmp_path / "bag", tmp_path / "whole")
    assert lost_messages(Bag(tmp_path / "whole").metadata) == {"/response": 10, "/note": 2}
    path.write_bytes(whole[: offset + 100])
    recover(tmp_path / "bag", tmp_path / "part")
    assert lost_messages(Bag(tmp_path / "part").metadata) == {"/response": None, "/note": None}
    assert describe(tmp_path / "part").contents["/note"].lost is None
