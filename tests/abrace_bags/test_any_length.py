# SPDX-License-Identifier: Apache-2.0
"""Bags larger than memory, and files that claim to be: what is not asked for is not read, no claim is believed."""

from __future__ import annotations

import contextlib
import resource
import shutil
import tracemalloc
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer
from mcap_chunks import chunk_indexes, chunk_offsets
from reference_messages import DEFINITIONS, RESPONSE, STRING, note, response_message, serialised

from abrace_bags import BagWriter, read_facts, read_topics, recover
from abrace_bags.description import describe
from abrace_bags.export import write_csv
from abrace_bags.mcap.chunk import unpack
from abrace_bags.mcap.records import LARGEST_CHUNK, DamagedError, record_bytes
from abrace_bags.parts import TopicParts
from abrace_bags.playback import bag_to_replay

if TYPE_CHECKING:
    from collections.abc import Iterator

GB = 2**30
SAMPLES = 400
PER_CHUNK = 20


def write_bag(directory: Path, samples: int = SAMPLES, first: int = 0) -> Path:
    """Responses, 20 a chunk, stored as they are; returns the MCAP file."""
    with BagWriter(directory, {"rig": "ncree"}, compression="none") as bag:
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
    content = content[: content.rindex(b"serialized_metadata") - 30]
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
    cut = whole[: whole.rindex(b"serialized_metadata") - 30]
    begin = indexes[3].chunk_start_offset
    path.write_bytes(cut[:begin] + record_bytes(bombs[0]) + cut[begin:])
    with memory(200):
        assert sequence(path) == list(range(SAMPLES))
        assert any("does not unpack" in warning for warning in read_topics(path).warnings)


def test_a_flipped_bit_anywhere_in_a_sparse_gigabyte_costs_no_more_than_its_chunk(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    chunks = [(one.chunk_start_offset, one.chunk_start_offset + one.chunk_length) for one in chunk_indexes(path)]
    content = sparse(path, GB)
    chosen = np.random.default_rng(3)
    costly = 0
    for _ in range(6):
        offset, bit = int(chosen.integers(30, chunks[-1][1])), 1 << int(chosen.integers(8))
        with path.open("r+b", buffering=0) as file, memory(300):
            file.seek(offset)
            file.write(bytes([content[offset] ^ bit]))
            found = sequence(path)
            file.seek(offset)
            file.write(bytes([content[offset]]))
        untouched = SAMPLES - PER_CHUNK * sum(begin <= offset < end for begin, end in chunks)
        costly += untouched < SAMPLES
        assert len(found) >= untouched, f"byte {offset}"
        assert len(set(found)) == len(found), f"byte {offset}"
        assert set(found) <= set(range(SAMPLES)), f"byte {offset}"
    assert costly > 2, "most bits are in chunks"


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
    assert [message.log_time for message in bag_to_replay(str(path), [], 0.0, 0.0).read()] == [5, 9]


@pytest.mark.parametrize("closed", [True, False])
def test_a_copied_file_is_not_read_twice(tmp_path: Path, closed: bool) -> None:
    path = write_bag(tmp_path / "bag")
    if not closed:
        (tmp_path / "bag/metadata.yaml").unlink()
    shutil.copy(path, path.with_name("bag_0 (copy).mcap"))
    shutil.copy(path, path.with_name("old.mcap"))
    contents = read_topics(tmp_path / "bag")
    assert contents["/response"].fields["sequence"].tolist() == list(range(SAMPLES))
    assert [warning.split(": is not read")[0] for warning in contents.warnings] == [
        str(path.with_name(name)) for name in ("bag_0 (copy).mcap", "old.mcap")
    ]
    assert recover(tmp_path / "bag", tmp_path / "whole").counts == {"/response": SAMPLES}
    assert describe(tmp_path / "bag").topics[0].count == SAMPLES


def test_facts_of_a_foreign_file_are_looked_for_in_its_index(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1000)
        writer.start("ros2")
        topic = writer.register_channel("/note", "cdr", writer.register_schema(STRING, "ros2msg", b"string data\n"))
        for k in range(1000):
            writer.add_message(topic, k, note("x" * 100), k)
        writer.add_metadata("someone's", {"key": "text"})
        writer.finish()
    content = bytearray(path.read_bytes())
    for offset in chunk_offsets(path)[1:]:  # reading on behind one of them would end there
        content[offset + 1 : offset + 9] = b"\xff" * 8
    path.write_bytes(content)
    assert read_facts(path) == {}
    with path.open("r+b") as file:  # without an index the file is walked through, damage ends it
        file.truncate(len(content) - 30)
    assert read_facts(path) == {}


def spoil(path: Path, kept: range) -> None:
    """Damage all chunks but those of these numbers."""
    content = bytearray(path.read_bytes())
    for number, offset in enumerate(chunk_offsets(path)):
        if number not in kept:
            content[offset + 200] ^= 0xFF
    path.write_bytes(content)


def test_replay_and_export_of_a_part_read_its_chunks_alone(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", first=928)
    spoil(path, range(4))
    part = bag_to_replay(str(tmp_path / "bag"), [], 20e-6, 40e-6)
    assert (part.count, part.warnings) == (40, ())
    assert [message.log_time for message in part.read()] == list(range(20_000, 60_000, 1000))
    parts = TopicParts(tmp_path / "bag", "/response", 20_000, 60_000)
    assert [number for one in parts for number in one.fields["sequence"].tolist()] == list(range(948, 988))
    assert parts.warnings == []
    assert bag_to_replay(str(tmp_path / "bag"), [], 0.0, 0.0).warnings, "could fail"


def test_a_description_reads_the_ends_alone_unless_it_is_to_check(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", first=928)
    whole = describe(tmp_path / "bag")
    (topic,) = whole.topics
    assert (topic.count, topic.first, topic.gaps, topic.missing, topic.lost) == (SAMPLES, 928, 0, 0, 0)
    assert (whole.begin, whole.end) == (0, 399_000)
    assert describe(tmp_path / "bag", check=True) == whole
    content = bytearray(path.read_bytes())
    content[chunk_offsets(path)[9] + 200] ^= 0xFF
    path.write_bytes(content)
    assert describe(tmp_path / "bag") == whole
    checked = describe(tmp_path / "bag", check=True)
    assert checked.topics[0].missing == PER_CHUNK
    assert any("20 of 400 messages of /response are missing" in warning for warning in checked.warnings)


def test_a_bag_is_replayed_recovered_and_exported_in_a_fraction_of_its_size(tmp_path: Path) -> None:
    text = np.random.default_rng(1).bytes(30_000).hex()
    with BagWriter(tmp_path / "bag", {}, compression="none", split_size=10_000_000) as bag:
        topic = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k in range(500):
            bag.write(topic, note(text), k, k)
    (tmp_path / "bag/metadata.yaml").unlink()
    tracemalloc.start()
    try:
        assert (
            sum(zlib.crc32(one.payload) > 0 for one in bag_to_replay(str(tmp_path / "bag"), [], 0.0, 0.0).read()) == 500
        )
        assert recover(tmp_path / "bag", tmp_path / "whole").counts == {"/note": 500}
        assert describe(tmp_path / "bag", check=True).topics[0].count == 500
        replayed = tracemalloc.get_traced_memory()[1]
        write_csv(tmp_path / "out.csv", TopicParts(tmp_path / "bag", "/note"))
    finally:
        exported = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert replayed < 10e6, "of 30 MB"
    assert exported < 60e6, "parts of 4 MB, whose text takes four times as much"
