# SPDX-License-Identifier: Apache-2.0
"""Bags that other programs wrote: every way that the format leaves open is read, whole and damaged."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Any

import lz4.frame  # type: ignore[import-untyped]
import mcap.writer
import pytest
import zstandard
from bag_contents import read_topics
from mcap.records import Channel
from mcap.writer import CompressionType, IndexType, Writer
from mcap_chunks import chunk_offsets
from mcap_variants import inputs, text_message, variant

from abrace_bags import Bag, recover
from abrace_bags.topics import printable
from abrace_core import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

NUMBERED = "uint64 sequence\n"
UNCHUNKED_INDEX = IndexType.ATTACHMENT | IndexType.METADATA | IndexType.MESSAGE


def number(value: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<Q", value)


def write(path: Path, samples: int = 60, **options: Any) -> Path:
    """Numbers on /early every 10 ns, on /late from the 40th on; between the chunks an attachment and a record."""
    with path.open("wb") as file:
        writer = Writer(file, **{"chunk_size": 400, **options})
        writer.start("ros2")
        schema = writer.register_schema("test_msgs/msg/Numbered", "ros2msg", NUMBERED.encode())
        topics = [writer.register_channel("/early", "cdr", schema)]
        for k in range(samples):
            if k == 40:
                topics.append(writer.register_channel("/late", "cdr", schema))
                writer.add_attachment(1, 2, "rig.yaml", "text/plain", b"storeys: 3\n")
                writer.add_metadata("versions", {"python": "3"})
            for topic in topics:
                writer.add_message(topic, 10 * k, number(k), 10 * k)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"repeat_schemas": False},
        {"repeat_channels": False},
        {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.NONE},
        {"enable_crcs": False},
        {"use_chunking": False},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE, "enable_data_crcs": True},
    ],
)
def test_every_form_of_the_index_gives_the_same_range_of_time(tmp_path: Path, options: dict[str, Any]) -> None:
    path = write(tmp_path / "bag.mcap", **options)
    for begin, end in ((None, None), (100, 200), (450, 500)):
        contents = read_topics(path, begin=begin, end=end)
        inside = [k for k in range(60) if (begin or 0) <= 10 * k < (end or 600)]
        assert contents["/early"].fields["sequence"].tolist() == inside
        assert contents["/late"].fields["sequence"].tolist() == [k for k in inside if k >= 40]
        assert (contents.attachments, contents.records) == (
            {"rig.yaml": b"storeys: 3\n"},
            {"versions": {"python": "3"}},
        )
    assert read_topics(path, ["/late"])["/late"].log_time.size == 20


@pytest.mark.parametrize("index", [IndexType.NONE, UNCHUNKED_INDEX])
def test_damaged_chunk_costs_itself_alone_where_no_chunk_is_indexed(tmp_path: Path, index: IndexType) -> None:
    offset = chunk_offsets(write(tmp_path / "whole.mcap"))[2]
    path = write(tmp_path / "bag.mcap", index_types=index, use_statistics=index != IndexType.NONE)
    content = bytearray(path.read_bytes())
    content[offset + 4] ^= 1
    path.write_bytes(content)
    contents = read_topics(path)
    assert 0 < 60 - contents["/early"].log_time.size < 15, "one chunk of about ten is missing"
    assert contents["/late"].log_time.size == 20
    assert any("/early" in warning for warning in contents.warnings), contents.warnings


@pytest.mark.parametrize("bit", [20, 33, 47, 62, 63])
def test_chunk_that_says_it_is_huge_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bit: int) -> None:
    unsized = zstandard.ZstdCompressor(write_content_size=False)
    monkeypatch.setattr(mcap.writer.zstandard, "compress", unsized.compress)
    path = write(tmp_path / "bag.mcap")
    assert read_topics(path).warnings == ()
    content = bytearray(path.read_bytes())
    content[chunk_offsets(path)[1] + 25 + bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    contents = read_topics(path)
    missing = 60 - contents["/early"].log_time.size
    assert missing > 0
    assert any(f"{missing} of 60 messages of /early are missing" in warning for warning in contents.warnings)


def write_definitions(path: Path, *channels: tuple[str, str, bytes], qos: str = "") -> Path:
    """One message on each channel, all of types of one name: topic, definition, message."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for time, (topic, definition, payload) in enumerate(channels):
            schema = writer.register_schema("test_msgs/msg/Odd", "ros2msg", definition.encode())
            number = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": qos})
            writer.add_message(number, 100 - time, payload, 100 - time)
        writer.finish()
    return path


DOUBLE, FLOATS = b"\0\1\0\0" + struct.pack("<d", 1.5), b"\0\1\0\0" + struct.pack("<2f", 2.5, 3.5)


def test_types_of_one_name_keep_their_definitions_when_recovered(tmp_path: Path) -> None:
    one, two = ("/one", "float64 a\n", DOUBLE), ("/two", "float32 a\nfloat32 b\n", FLOATS)
    path = write_definitions(tmp_path / "bag.mcap", one, two, qos="- {depth: 3, new_word: 1}\n- nothing")
    assert recover(path, tmp_path / "whole").counts == {"/one": 1, "/two": 1}
    for bag in (path, tmp_path / "whole"):
        contents = read_topics(bag)
        assert contents["/one"].fields["a"].tolist() == [1.5]
        assert (contents["/two"].fields["a"].tolist(), contents["/two"].fields["b"].tolist()) == ([2.5], [3.5])


def test_definitions_that_differ_in_comments_are_one_type_in_the_order_of_time(tmp_path: Path) -> None:
    same = [("/one", f"float64 a{comment}\n", DOUBLE) for comment in ("", "  # m")]
    path = write_definitions(tmp_path / "bag.mcap", *same)
    assert read_topics(path)["/one"].log_time.tolist() == [99, 100]
    assert recover(path, tmp_path / "whole").counts == {"/one": 2}
    path = write_definitions(tmp_path / "other.mcap", *same, ("/one", "float32 a\nfloat32 b\n", FLOATS))
    contents = read_topics(path)
    assert contents["/one"].fields["a"].tolist() == [1.5, 1.5]
    assert any("messages of topic /one are left out: they are of another" in one for one in contents.warnings)
    recovered = recover(path, tmp_path / "first")
    assert recovered.counts == {"/one": 2}
    assert any("of another test_msgs/msg/Odd" in warning for warning in recovered.warnings)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"SQLite format 3\0"])
def test_file_that_is_none_does_not_cost_the_others(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bag").mkdir()
    write(tmp_path / "bag/bag_0.mcap")
    (tmp_path / "bag/bag_1.mcap").write_bytes(content)
    contents = read_topics(tmp_path / "bag")
    assert contents["/early"].log_time.size == 60
    assert any("bag_1.mcap" in warning for warning in contents.warnings)
    assert any(
        "/early: 0 of the samples 0 to 59 are missing, later ones are not known" in one for one in contents.warnings
    )
    assert Bag(tmp_path / "bag").raw().count == 80
    assert recover(tmp_path / "bag", tmp_path / "whole").counts == {"/early": 60, "/late": 20}
    (tmp_path / "bag/bag_0.mcap").write_bytes(content)
    with pytest.raises(AbraceError, match=r"bag_0.mcap: .*; .*bag_1.mcap: "):
        read_topics(tmp_path / "bag")


@pytest.mark.parametrize(
    "text", ["a: 2001-99-99\n", "[" * 100_000, "- " * 100_000, "[1", "- 1", "{a: !!python/object:os.system x}"]
)
def test_metadata_that_makes_no_sense_is_a_warning(tmp_path: Path, text: str) -> None:
    write(tmp_path / "bag_0.mcap")
    (tmp_path / "metadata.yaml").write_text(text)
    (warning,) = read_topics(tmp_path).warnings
    assert "metadata.yaml: can't be read" in warning
    assert Bag(tmp_path).raw().count == 80


@pytest.mark.parametrize("wrong", [b"", b"\0\1\0\0", number(7)[:-1], b"\0\0" + number(7)[2:]])
def test_messages_that_do_not_fit_their_definition_cost_themselves_alone(tmp_path: Path, wrong: bytes) -> None:
    def write_with(path: Path, misfits: set[int]) -> Path:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start("ros2")
            schema = writer.register_schema("test_msgs/msg/Numbered", "ros2msg", NUMBERED.encode())
            topic = writer.register_channel("/numbers", "cdr", schema)
            for k in range(500):
                writer.add_message(topic, k, wrong if k in misfits else number(k), k)
            writer.finish()
        return path

    contents = read_topics(write_with(tmp_path / "some.mcap", {7, 300, 499}))
    whole = [k for k in range(500) if k not in (7, 300, 499)]
    assert contents["/numbers"].fields["sequence"].tolist() == contents["/numbers"].log_time.tolist() == whole
    (warning,) = contents.warnings
    assert "topic /numbers: 3 of 500 messages are left out: message 7: " in warning
    for misfits in (set(range(400)), set(range(500))):
        contents = read_topics(write_with(tmp_path / "most.mcap", misfits))
        assert list(contents) == []
        assert "topic /numbers is left out: message" in contents.warnings[0]


def test_a_file_that_is_named_twice_is_read_once(tmp_path: Path) -> None:
    write(tmp_path / "bag_0.mcap")
    names = "\n".join(["  relative_file_paths: [bag_0.mcap, bag_0.mcap]", "  storage_identifier: mcap"])
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{names}\n")
    contents = read_topics(tmp_path)
    assert contents["/early"].log_time.size == 60
    assert contents.warnings == (f"{tmp_path}: metadata.yaml names bag_0.mcap twice",)


def test_a_topic_described_by_idl_is_read_and_recovered(tmp_path: Path) -> None:
    idl = b"module test_msgs { module msg { struct Odd { double a; sequence<float> b; }; }; };"
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        topic = writer.register_channel("/odd", "cdr", writer.register_schema("test_msgs/msg/Odd", "ros2idl", idl))
        binary = writer.register_schema("Odd", "protobuf", bytes(range(128, 256)))
        writer.add_message(writer.register_channel("/binary", "protobuf", binary), 5, b"12", 5)
        writer.add_message(topic, 7, b"\0\1\0\0" + struct.pack("<dI2f", 1.5, 2, 2.5, 3.5), 7)
        writer.finish()
    recover(tmp_path / "bag.mcap", tmp_path / "whole")
    for bag in (tmp_path / "bag.mcap", tmp_path / "whole"):
        fields = read_topics(bag, ["/odd"])["/odd"].fields
        assert (fields["a"].tolist(), fields["b"].tolist()) == ([1.5], [[2.5, 3.5]])


def test_a_definition_that_explodes_or_is_no_messages_costs_its_topic_alone_and_no_time(tmp_path: Path) -> None:
    line = "=" * 80
    nested = "".join(f"{line}\nMSG: test_msgs/A{k}\ntest_msgs/A{k - 1} a\ntest_msgs/A{k - 1} b\n" for k in range(1, 27))
    explodes = f"test_msgs/A26 a\n{nested}{line}\nMSG: test_msgs/A0\nfloat64 x\n"
    huge = f"test_msgs/B[1000000000] b\n{line}\nMSG: test_msgs/B\nfloat64 x\n"
    service = "int64 a\n---\nint64 b\n"
    many = [("/a", explodes, DOUBLE), ("/b", huge, DOUBLE), ("/c", service, DOUBLE), ("/d", "float64 x\n", DOUBLE)]
    path = write_definitions(tmp_path / "bag.mcap", *many)
    begin = time.process_time()
    contents = read_topics(path)
    assert time.process_time() - begin < 1.0
    assert contents["/d"].fields["x"].tolist() == [1.5]
    for topic, why in (("/a", "67108864 values"), ("/b", "1000000000 values"), ("/c", "a service or an action")):
        assert any(f"topic {topic} is left out" in one and why in one for one in contents.warnings)
    assert recover(path, tmp_path / "whole").counts == dict.fromkeys(("/a", "/b", "/c", "/d"), 1)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_in_several_frames_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: str) -> None:
    pack = lz4.frame.compress if compression == "lz4" else zstandard.ZstdCompressor().compress

    def frames(content: bytes, *_: Any) -> bytes:
        skipped = b"\x50\x2a\x4d\x18" + struct.pack("<I", 3) + b"any"
        half = len(content) // 2
        packed: bytes = skipped + pack(content[:half]) + pack(content[half:])
        return packed

    monkeypatch.setattr(mcap.writer.zstandard if compression == "zstd" else mcap.writer.lz4.frame, "compress", frames)
    path = write(tmp_path / "bag.mcap", compression=CompressionType[compression.upper()])
    contents = read_topics(path)
    assert contents["/early"].log_time.size == Bag(path).raw(["/early"]).count == 60
    assert contents.warnings == ()


def test_a_chunk_that_is_there_twice_is_read_once_and_a_channel_described_twice_is_reported(tmp_path: Path) -> None:
    path = write(tmp_path / "bag.mcap")
    begin, end = chunk_offsets(path)[2:4]
    content = path.read_bytes()
    path.write_bytes(content[:end] + content[begin:end] + content[end:])
    contents = read_topics(path)
    assert contents["/early"].log_time.size == Bag(path).raw(["/early"]).count == 60
    assert any(f"the chunk at byte {end} is there twice" in warning for warning in contents.warnings)
    records = inputs()["OneMessage"]
    other = Channel(id=1, topic="/other", message_encoding="cdr", schema_id=1, metadata={})
    path.write_bytes(variant([*records, other, text_message("two", 1001)], ()))
    (warning,) = Bag(path).raw().warnings
    assert "channel 1 (/text, later /other) is described in two ways" in warning


def test_bytes_that_could_each_begin_a_chunk_do_not_take_long(tmp_path: Path) -> None:
    path = write(tmp_path / "bag.mcap")
    path.write_bytes(path.read_bytes()[: chunk_offsets(path)[3]] + b"\x06" * 30_000_000)
    begin = time.process_time()
    assert Bag(path).raw().count > 20
    assert time.process_time() - begin < 10.0


def test_control_characters_of_names_do_not_reach_the_terminal() -> None:
    assert printable("/x\x1b[2J\rt\u202e é\n") == "/x\\x1b[2J\\rt\\u202e é\n"


def test_messages_of_one_topic_in_two_encodings_are_not_decoded_as_one(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    cdr = Channel(id=1, topic="/text", message_encoding="cdr", schema_id=1, metadata={})
    other = Channel(id=2, topic="/text", message_encoding="json", schema_id=1, metadata={})
    records = [inputs()["OneMessage"][0], cdr, other, text_message("one", 5), text_message("two", 6, channel=2)]
    path.write_bytes(variant(records, ("ch", "st")))
    bag = Bag(path)
    assert bag.arrays()["/text"].fields["data"].tolist() == ["one"]
    assert any("messages of topic /text are left out" in warning for warning in bag.warnings)
