# SPDX-License-Identifier: Apache-2.0
"""Bags larger than memory, and files that claim to be: what is not asked for is not read, no claim is believed."""

from __future__ import annotations

import contextlib
import resource
import tracemalloc
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard
from bag_contents import read_topics
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer
from mcap_chunks import chunk_indexes, chunk_offsets, without_end
from reference_messages import DEFINITIONS, RESPONSE, STRING, note, response_message, serialised

from abrace_bags import Bag, BagWriter, TopicParts, describe, file_attachments, merge, recover, trim, write_csv
from abrace_bags.mcap.chunk import unpack
from abrace_bags.mcap.records import LARGEST_CHUNK, DamagedError, record_bytes
from abrace_bags.playback import bag_to_replay

if TYPE_CHECKING:
    from collections.abc import Iterator

GB = 2**30
SAMPLES = 400
PER_CHUNK = 20


def write_bag(directory: Path, samples: int = SAMPLES, first: int = 0) -> Path:
    """Responses, 20 a chunk, stored as they are; returns the MCAP file."""
    with BagWriter(directory, {"rig": "ncree"}) as bag:
        topic = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], "")
        for k in range(samples):
            values = np.random.default_rng(k).normal(size=10)
            bag.write(topic, serialised(response_message(first + k, values, 1, k)), 1000 * k, 1000 * k)
            if k % PER_CHUNK == PER_CHUNK - 1:
                bag.flush()
    return directory / f"{directory.name}_0.mcap"


@contextlib.contextmanager
def memory(megabytes: int) -> Iterator[None]:
    """Let this process have no more than so much memory in addition to what it has."""
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + megabytes * 10**6, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def sequence(path: Path) -> list[int]:
    found: list[int] = read_topics(path)["/response"].fields["sequence"].tolist()
    return found


def sparse(path: Path, size: int) -> bytes:
    """Cut off the end of a bag's file, and give it this `size` by zeros; returns what is left of it."""
    content = path.read_bytes()
    content = without_end(content)
    path.write_bytes(content)
    with path.open("r+b") as file:
        file.truncate(size)
    return content


@pytest.mark.parametrize("byte", [4, 6], ids=["more than 1 GB", "more than 64 TB"])
def test_a_flipped_bit_of_a_length_in_a_large_file_costs_one_chunk(tmp_path: Path, byte: int) -> None:
    path = write_bag(tmp_path / "bag")
    offset = chunk_offsets(path)[7]
    content = sparse(path, GB + 10**8)
    with path.open("r+b") as file:
        file.seek(offset + byte)
        file.write(bytes([content[offset + byte] ^ 0x40]))
    with memory(300):
        contents = read_topics(path)
    found, warnings = contents["/response"].fields["sequence"].tolist(), contents.warnings
    lost = range(7 * PER_CHUNK, 8 * PER_CHUNK)
    assert sorted(set(range(SAMPLES)) - set(found)) == list(lost)
    assert any("20 of the samples 0 to 399 are missing" in warning for warning in warnings), warnings


def test_a_chunk_that_would_fill_the_memory_is_left_out(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor().compress(bytes(LARGEST_CHUNK + 1))
    bombs = [
        Chunk("zstd", packed, 1, 0, 0, LARGEST_CHUNK + 1),
        Chunk("zstd", packed, 1, 0, 0, 1000),
        Chunk("zstd", zstandard.ZstdCompressor().compress(b"x" * 1000), 1, 0, 0, 2**60),
        Chunk("lz4", b"packed", 1, 0, 0, 2**60),
    ]
    with memory(200):
        for bomb in bombs:
            with pytest.raises(DamagedError, match="does not unpack"):
                unpack(bomb)
    path = write_bag(tmp_path / "bag")
    whole = path.read_bytes()
    indexes = chunk_indexes(path)
    cut = without_end(whole)
    begin = indexes[3].chunk_start_offset
    path.write_bytes(cut[:begin] + record_bytes(bombs[0]) + cut[begin:])
    with memory(200):
        assert sequence(path) == list(range(SAMPLES))
        assert any("does not unpack" in warning for warning in read_topics(path).warnings)


def test_messages_after_the_end_of_time_are_left_out_and_the_others_recovered(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    times = [(5, 5), (2**63, 6), (7, 2**63), (2**64 - 1, 2**64 - 1), (9, 9)]
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema(STRING, "ros2msg", DEFINITIONS[STRING].encode())
        topic = writer.register_channel("/note", "cdr", schema)
        for log_time, publish_time in times:
            writer.add_message(topic, log_time, note(f"{log_time}"), publish_time)
        writer.finish()
    contents = read_topics(path)
    assert contents["/note"].fields["data"].tolist() == ["5", "9"]
    assert any("3 messages are left out: their times are 2^63 ns or more" in one for one in contents.warnings)
    recovered = recover(path, tmp_path / "whole")
    assert recovered.counts == {"/note": 2}
    assert any("3 messages are left out" in warning for warning in recovered.warnings)
    assert [message.log_time for message in bag_to_replay(str(path), [], 0.0, 0.0)] == [5, 9]


def test_a_description_reads_the_ends_alone_unless_it_is_to_check(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", first=928)
    whole = describe(tmp_path / "bag")
    (topic,) = whole.contents.values()
    assert (topic.messages, topic.first_number, topic.gaps, topic.missing, topic.lost) == (SAMPLES, 928, 0, 0, 0)
    assert (whole.begin, whole.end) == (0, 399_000)
    assert describe(tmp_path / "bag", check=True) == whole
    content = bytearray(path.read_bytes())
    content[chunk_offsets(path)[9] + 200] ^= 0xFF
    path.write_bytes(content)
    assert describe(tmp_path / "bag") == whole
    checked = describe(tmp_path / "bag", check=True)
    assert checked.contents["/response"].missing == PER_CHUNK
    assert any("20 of 400 messages of /response are missing" in warning for warning in checked.warnings)


def test_a_bag_is_replayed_recovered_and_exported_in_a_fraction_of_its_size(tmp_path: Path) -> None:
    text = np.random.default_rng(1).bytes(30_000).hex()
    with BagWriter(tmp_path / "bag", {}, split_size=5_000_000) as bag:
        topic = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k in range(250):
            bag.write(topic, note(text), k, k)
    (tmp_path / "bag/metadata.yaml").unlink()
    tracemalloc.start()
    try:
        assert sum(zlib.crc32(one.payload) > 0 for one in bag_to_replay(str(tmp_path / "bag"), [], 0.0, 0.0)) == 250
        assert recover(tmp_path / "bag", tmp_path / "whole").counts == {"/note": 250}
        assert merge(tmp_path / "both", [tmp_path / "bag", tmp_path / "whole"]).counts == {"/note": 500}
        assert trim(tmp_path / "whole", tmp_path / "part", [], 1e-7).counts == {"/note": 150}
        assert describe(tmp_path / "bag", check=True).contents["/note"].messages == 250
        replayed = tracemalloc.get_traced_memory()[1]
        write_csv(tmp_path / "out.csv", TopicParts(Bag(tmp_path / "bag").raw(["/note"])))
    finally:
        exported = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert replayed < 10e6, "of 30 MB"
    assert exported < 60e6, "parts of 4 MB, whose text takes four times as much"


def test_attachments_take_no_memory_until_they_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "record.bin").write_bytes(bytes(50_000_000))
    with BagWriter(tmp_path / "bag", {}, attachments=file_attachments([tmp_path / "record.bin"])) as bag:
        bag.write(bag.add_topic("/note", STRING, DEFINITIONS[STRING], ""), note("a"), 1, 1)
    path = tmp_path / "bag/bag_0.mcap"
    content = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:-20])
    tracemalloc.start()
    try:
        for one in (path, tmp_path / "cut.mcap"):
            opened = Bag(one)
            assert opened.arrays()["/note"].fields["data"].tolist() == ["a"]
            assert [(attachment.name, attachment.size) for attachment in opened.attachments] == [
                ("record.bin", 50_000_000)
            ]
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()
    assert opened.attachments[0].data == bytes(50_000_000)


def test_texts_take_a_small_multiple_of_their_bytes(tmp_path: Path) -> None:
    texts = [f"{k:05} " + "x" * (k % 1000) for k in range(16_000)]
    with BagWriter(tmp_path / "bag", {}) as bag:
        topic = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k, text in enumerate(texts):
            bag.write(topic, note(text), k, k)
    size = sum(map(len, texts))
    tracemalloc.start()
    try:
        found = Bag(tmp_path / "bag").arrays()["/note"].fields["data"]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.tolist() == texts
    assert peak < 5 * size, f"{peak / size:.1f} times the bytes of the texts"
