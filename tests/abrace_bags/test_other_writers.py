# SPDX-License-Identifier: Apache-2.0
"""Bags that other programs wrote: every way that the format leaves open is read, whole and damaged."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import mcap.writer
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from mcap_chunks import chunk_offsets

from abrace_bags import read_facts, read_topics, recover
from abrace_bags.raw import read_raw
from abrace_core.errors import AbraceError

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


def test_chunk_that_passes_for_an_unknown_record_is_missed_by_topic(tmp_path: Path) -> None:
    options: dict[str, Any] = {"index_types": IndexType.NONE, "use_statistics": False}
    offset = chunk_offsets(write(tmp_path / "whole.mcap"))[2]
    path = write(tmp_path / "bag.mcap", **options)
    content = bytearray(path.read_bytes())
    content[offset] ^= 0x80
    path.write_bytes(content)
    contents = read_topics(path)
    lost = 60 - contents["/early"].log_time.size
    assert lost > 0
    assert any(f"/early: {lost} of the samples 0 to 59 are missing" in warning for warning in contents.warnings)


def test_header_that_passes_for_a_message_costs_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "bag.mcap")
    content = bytearray(path.read_bytes())
    content[8] ^= 4
    path.write_bytes(content)
    contents = read_topics(path)
    assert contents["/early"].log_time.size == 60
    assert any("damaged at byte 8 " in warning for warning in contents.warnings)


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
    assert any("/one is left out: has messages of" in warning for warning in read_topics(path).warnings)
    recovered = recover(path, tmp_path / "first")
    assert recovered.counts == {"/one": 2}
    assert any("is another test_msgs/msg/Odd" in warning for warning in recovered.warnings)


def test_messages_out_of_order_are_read_in_the_order_of_their_times(tmp_path: Path) -> None:
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("test_msgs/msg/Numbered", "ros2msg", NUMBERED.encode())
        topic = writer.register_channel("/numbers", "cdr", schema)
        for time in (50, 30, 90, 10):
            writer.add_message(topic, time, number(time), time)
        writer.finish()
    numbers = read_topics(tmp_path / "bag.mcap")["/numbers"]
    assert numbers.log_time.tolist() == numbers.fields["sequence"].tolist() == [10, 30, 50, 90]


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
    assert read_raw(tmp_path / "bag").count == 80
    assert recover(tmp_path / "bag", tmp_path / "whole").counts == {"/early": 60, "/late": 20}
    (tmp_path / "bag/bag_0.mcap").write_bytes(content)
    with pytest.raises(AbraceError, match=r"bag_0.mcap: .*; .*bag_1.mcap: "):
        read_topics(tmp_path / "bag")


def test_facts_come_from_the_first_file_that_has_them(tmp_path: Path) -> None:
    recover(write(tmp_path / "bag.mcap"), tmp_path / "bag")
    (tmp_path / "bag/bag_00.mcap").write_bytes(b"")
    (tmp_path / "bag/bag_0.mcap").rename(tmp_path / "bag/bag_1.mcap")
    assert read_facts(tmp_path / "bag") == {}


@pytest.mark.parametrize("text", ["a: 2001-99-99\n", "[1", "- 1", "{a: !!python/object:os.system x}"])
def test_metadata_that_makes_no_sense_is_a_warning(tmp_path: Path, text: str) -> None:
    write(tmp_path / "bag_0.mcap")
    (tmp_path / "metadata.yaml").write_text(text)
    (warning,) = read_topics(tmp_path).warnings
    assert "metadata.yaml: can't be read" in warning
    assert read_raw(tmp_path).count == 80


def test_one_very_long_text_among_many_short_ones_takes_no_room_for_all(tmp_path: Path) -> None:
    texts = ["short"] * 3000 + ["x" * 100_000] + [""]
    with (tmp_path / "bag.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        topic = writer.register_channel("/texts", "cdr", schema)
        for k, text in enumerate(texts):
            size = struct.pack("<I", len(text) + 1)
            writer.add_message(topic, k, b"\0\1\0\0" + size + text.encode() + b"\0", k)
        writer.finish()
    found = read_topics(tmp_path / "bag.mcap")["/texts"].fields["data"]
    assert found.tolist() == texts
    assert found.nbytes < 1e6, "1.2 GB if each had the length of the longest"
    np.testing.assert_array_equal(read_topics(tmp_path / "bag.mcap", end=3000)["/texts"].fields["data"], texts[:3000])


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
