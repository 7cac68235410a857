# SPDX-License-Identifier: Apache-2.0
"""Truncated and damaged bags: what every door gives of what is whole, wrong messages, and unreported losses.

A bag's file is truncated at random lengths, and copies of it get one flipped bit at random places. Each copy goes
through the doors: `Bag.arrays`, `recover`, `csv` and `replay`. Messages are whole if the damage does not touch their
chunk; every message that is read must be one of the bag's.

cuts            files read: equal numbers of truncated ones and of ones with a flipped bit
recovered       those of which every door gave all messages that are whole
tracebacks      doors that ended with another error than an AbraceError
wrong_values    messages that are not in the bag, or came twice
unreported      topics with missing messages that no warning and no error names
read_fraction   share of the whole messages of all files that the worst door gave

python benchmarks/bag_damage.py BAG
"""

from __future__ import annotations

import csv
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bag_contents import read_topics
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from abrace_bags import Bag, TopicParts, recover, write_csv
from abrace_bags.playback import BagPlayback, bag_to_replay
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from abrace_core.files.progress import Step

    Found = Counter[tuple[str, int]]
    """Messages by topic and log time."""

SEED = 6


def damage(bag: Path, cuts: int = 50, flips: int = 50, shown: Step | None = None) -> dict[str, Any]:
    """Read `bag`, which has a single file, with `cuts` random truncations and `flips` random flipped bits."""
    (path,) = bag.glob("*.mcap")
    content = path.read_bytes()
    payloads = {(message.topic, message.log_time): message.payload for message in Bag(path).raw()}
    chunks = chunk_messages(path)
    chosen = np.random.default_rng(SEED)
    places = [(length, None) for length in chosen.integers(1, len(content), cuts).tolist()]
    places += zip(*(chosen.integers(0, end, flips).tolist() for end in (len(content), 8)), strict=True)
    result = {"cuts": len(places), "recovered": 0, "tracebacks": 0, "wrong_values": 0, "unreported": 0}
    given = whole = 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (place, bit) in enumerate(places):
            damaged = bytearray(content[: place if bit is None else None])
            if bit is not None:
                damaged[place] ^= 1 << bit
            file = Path(folder) / f"damaged_{number}.mcap"
            file.write_bytes(damaged)
            expected: Found = Counter()
            for begin, end, messages in chunks:
                if end <= place if bit is None else not begin <= place < end:
                    expected += messages
            found = [_opened(door, file, payloads, result) for door in (_arrays, _recovered, _exported, _replayed)]
            least = min((one & expected).total() for one in found)
            given, whole = given + least, whole + expected.total()
            result["recovered"] += least == expected.total()
            if shown is not None:
                shown.update(number / len(places))
    return {**result, "read_fraction": given / whole}


def _opened(
    door: Callable[[Path, dict[tuple[str, int], bytes]], tuple[Found, Iterable[str], int]],
    file: Path,
    payloads: dict[tuple[str, int], bytes],
    result: dict[str, int],
) -> Found:
    """What a `door` gives of a damaged `file`; what is wrong with it is counted in `result`."""
    try:
        found, warnings, wrong = door(file, payloads)
    except AbraceError:
        return Counter()
    except Exception as error:
        print(f"{door.__name__}: {type(error).__name__}: {error}", file=sys.stderr)
        result["tracebacks"] += 1
        return Counter()
    result["wrong_values"] += wrong + (found - Counter(payloads.keys())).total()
    for topic in {topic for topic, _ in payloads}:
        missing = any(one[0] == topic and not found[one] for one in payloads)
        result["unreported"] += missing and not any(topic in warning or "cut off" in warning for warning in warnings)
    return found


def _arrays(file: Path, _: dict[tuple[str, int], bytes]) -> tuple[Found, Iterable[str], int]:
    contents = read_topics(file)
    return _timed({topic: one.log_time.tolist() for topic, one in contents.items()}), contents.warnings, 0


def _recovered(file: Path, payloads: dict[tuple[str, int], bytes]) -> tuple[Found, Iterable[str], int]:
    copied = recover(file, file.with_suffix(""))
    messages = list(Bag(file.with_suffix("")).raw())
    wrong = sum(payloads.get((one.topic, one.log_time)) != one.payload for one in messages)
    return Counter((one.topic, one.log_time) for one in messages), copied.warnings, wrong


def _exported(file: Path, _: dict[tuple[str, int], bytes]) -> tuple[Found, Iterable[str], int]:
    times: dict[str, list[int]] = {}
    bag = Bag(file)
    topics = list(bag.topics)
    warnings = [*bag.warnings]
    for topic in topics:
        parts = TopicParts(bag.raw([topic]))
        write_csv(file.with_suffix(".csv"), parts)
        warnings += [f"{topic}: {warning}" for warning in parts.warnings]
        with file.with_suffix(".csv").open(newline="") as table:
            times[topic] = [int(row["log_time"]) for row in csv.DictReader(table)]
    return _timed(times), warnings, 0


def _replayed(file: Path, payloads: dict[tuple[str, int], bytes]) -> tuple[Found, Iterable[str], int]:
    bag = bag_to_replay(str(file), list(Bag(file).topics), 0.0, 0.0)  # by name: a rig's inputs are left out otherwise
    playback = BagPlayback(bag, 1.0)
    messages = [playback.next_message() for _ in range(bag.count)]
    wrong = sum(payloads.get((one.topic, one.log_time)) != one.payload for one in messages)
    return Counter((one.topic, one.log_time) for one in messages), bag.warnings, wrong


def _timed(times: dict[str, list[int]]) -> Found:
    return Counter((topic, time) for topic, of_topic in times.items() for time in of_topic)


def chunk_messages(path: Path) -> list[tuple[int, int, Found]]:
    """For each chunk: offset of its first byte, offset after its last byte, its messages, as read by `mcap`."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        file.seek(0)
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    positions = sorted((index.chunk_start_offset, index.chunk_length) for index in summary.chunk_indexes)
    found = []
    for (offset, length), chunk in zip(positions, chunks, strict=True):
        messages = [record for record in breakup_chunk(chunk) if isinstance(record, Message)]
        found.append((offset, offset + length, Counter((topics[one.channel_id], one.log_time) for one in messages)))
    return found


def packed_as(bag: Path, compression: CompressionType) -> Path:
    """A bag beside `bag`, of the same messages in chunks of this `compression`."""
    (path,) = bag.glob("*.mcap")
    copy = bag.with_name(f"{bag.name}_{compression.name.lower()}")
    copy.mkdir()
    with path.open("rb") as file, (copy / f"{copy.name}_0.mcap").open("wb") as output:
        writer = Writer(output, 8192, compression, enable_data_crcs=True)
        writer.start("ros2", "abrace")
        numbers: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                numbers[channel.id] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
            times = message.log_time, message.data, message.publish_time, message.sequence
            writer.add_message(numbers[channel.id], *times)
        writer.finish()
    return copy


if __name__ == "__main__":
    print(json.dumps(damage(Path(sys.argv[1])), indent=1))
