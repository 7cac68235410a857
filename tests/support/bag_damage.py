# SPDX-License-Identifier: Apache-2.0
"""Truncated and damaged bags: the share of intact messages that is read, wrong messages, and unreported losses.

A bag's file is truncated at random lengths, and copies of it get one flipped bit at random places. Each copy is read;
every message read must be one of the bag's. Messages are intact if the damage does not touch their chunk.

damaged_files   files read: equal numbers of truncated ones and of ones with a flipped bit
tracebacks      reads that ended with another error than an AbraceError
wrong_values    messages read that are not in the bag, or were read twice
unreported      topics with missing messages that no warning and no error names
least_read      least share of the intact messages of one file that was read
read_fraction   share of the intact messages of all files that was read

python tests/support/bag_damage.py BAG
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from abrace_bags import read_topics
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_bags import TopicArrays
    from abrace_core.progress import Step

SEED = 6


def damage(bag: Path, cuts: int = 1000, flips: int = 1000, shown: Step | None = None) -> dict[str, Any]:
    """Read `bag`, which has a single file, with `cuts` random truncations and `flips` random flipped bits."""
    (path,) = bag.glob("*.mcap")
    content = path.read_bytes()
    contents = read_topics(path)
    whole = {topic: fingerprints(messages) for topic, messages in contents.items()}
    chunks = chunk_messages(path)
    chosen = np.random.default_rng(SEED)
    cut_lengths = chosen.integers(1, len(content), cuts)
    offsets, bits = chosen.integers(0, len(content), flips), chosen.integers(0, 8, flips)
    found = {"damaged_files": 0, "tracebacks": 0, "wrong_values": 0, "unreported": 0}
    fractions, read_messages, whole_messages = [], 0, 0
    with tempfile.TemporaryDirectory() as folder:
        damaged = Path(folder) / "damaged.mcap"

        def read_once(expected: int) -> None:
            nonlocal read_messages, whole_messages
            outcome, count = read_damaged(damaged, whole)
            found["damaged_files"] += 1
            if shown is not None:
                shown.update(found["damaged_files"] / (cuts + flips))
            for name, number in outcome.items():
                found[name] += number
            read_messages += min(count, expected)
            whole_messages += expected
            if expected:
                fractions.append(min(count / expected, 1.0))

        for length in cut_lengths.tolist():
            damaged.write_bytes(content[:length])
            read_once(sum(count for _, end, count in chunks if end <= length))
        for offset, bit in zip(offsets.tolist(), bits.tolist(), strict=True):
            flipped = bytearray(content)
            flipped[offset] ^= 1 << bit
            damaged.write_bytes(flipped)
            read_once(sum(count for begin, end, count in chunks if not begin <= offset < end))
    return {**found, "least_read": min(fractions), "read_fraction": read_messages / whole_messages}


def read_damaged(path: Path, whole: dict[str, NDArray[np.uint64]]) -> tuple[dict[str, int], int]:
    """What is wrong with what is read of a damaged file, by name, and the messages that are right."""
    try:
        contents = read_topics(path)
    except AbraceError:
        return {}, 0
    except Exception as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return {"tracebacks": 1}, 0
    wrong, right, unreported = 0, 0, 0
    for topic, messages in contents.items():
        read = fingerprints(messages)
        good = np.isin(np.unique(read), whole.get(topic, np.empty(0, np.uint64)))
        right += int(good.sum())
        wrong += read.size - int(good.sum())
    for topic, expected in whole.items():
        missing = expected.size - (contents[topic].log_time.size if topic in contents else 0)
        unreported += bool(missing and topic in contents and not any(topic in warning for warning in contents.warnings))
        unreported += bool(missing and not contents.warnings)
    return {"wrong_values": wrong, "unreported": unreported}, right


def fingerprints(messages: TopicArrays) -> NDArray[np.uint64]:
    """(messages,) a number for each message, different for messages of different content."""
    columns = [messages.log_time.astype("<i8"), messages.publish_time.astype("<i8")]
    for values in messages.fields.values():
        if values.dtype.kind in "OU":
            texts = [str(value.tolist() if isinstance(value, np.ndarray) else value) for value in values]
            columns.append(np.array([hash(text) for text in texts], "<i8"))
        else:
            columns.append(values)
    total = np.zeros(messages.log_time.size, np.uint64)
    for values in columns:
        rows = np.ascontiguousarray(values.reshape(len(values), int(np.prod(values.shape[1:]))))
        for column in rows.T:
            bits = np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}").astype(np.uint64)
            total = (total ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            total ^= total >> np.uint64(29)
    return total


def chunk_messages(path: Path) -> list[tuple[int, int, int]]:
    """For each chunk: offset of its first byte, offset after its last byte, number of messages, as read by `mcap`."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        file.seek(0)
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]
    counts = [sum(isinstance(record, Message) for record in breakup_chunk(chunk)) for chunk in chunks]
    positions = sorted((index.chunk_start_offset, index.chunk_length) for index in summary.chunk_indexes)
    return [(offset, offset + length, count) for (offset, length), count in zip(positions, counts, strict=True)]


if __name__ == "__main__":
    print(json.dumps(damage(Path(sys.argv[1])), indent=1))
