# SPDX-License-Identifier: Apache-2.0
"""Topics and ranges of time: the messages that are asked for, whole, without reading the rest of the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mcap.reader
import numpy as np
import pytest
from mcap_chunks import chunk_offsets
from mcap_ros2.decoder import DecoderFactory
from reference_messages import DEFINITIONS, RESPONSE, STORE, STRING, note, response_message, serialised
from rosbags.highlevel import AnyReader

from abrace_bags import BagWriter, read_topics
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

FIELDS = ("displacement", "acceleration", "stroke", "force", "command", "ground_acceleration")


def write_bag(directory: Path, samples: int = 400, seed: int = 0) -> Path:
    """Responses every 10 ns, a chunk for each 50 of them; a note in the fifth chunk alone."""
    source = np.random.default_rng(seed)
    with BagWriter(directory, {"run": "selected"}) as bag:
        responses = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], "")
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k in range(samples):
            x = source.normal(size=10) * 10.0 ** source.integers(-300, 300, 10)
            message = response_message(k, x, int(source.integers(-(2**31), 2**31)), k)
            bag.write(responses, serialised(message), 10 * k, 10 * k + 1)
            if k == 210:
                bag.write(notes, note("here"), 2100, 2100)
            if k % 50 == 49:
                bag.flush()
    return directory / f"{directory.name}_0.mcap"


def spoil(path: Path, numbers: set[int]) -> None:
    """Damage the chunks of these numbers: reading them gives a warning."""
    content = bytearray(path.read_bytes())
    for number in numbers:
        content[chunk_offsets(path)[number] + 100] ^= 0xFF
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("begin", "end", "samples"),
    [
        (None, None, range(400)),
        (1000, 2000, range(100, 200)),
        (1001, 2001, range(101, 201)),
        (3990, None, range(399, 400)),
        (None, 1, range(1)),
        (-5, 10, range(1)),
        (2000, 2000, range(0)),
        (9999, 99999, range(0)),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_range_of_time_has_its_begin_and_not_its_end(
    tmp_path: Path, begin: int | None, end: int | None, samples: range, indexed: bool
) -> None:
    path = write_bag(tmp_path / "bag")
    if not indexed:
        content = path.read_bytes()
        path.write_bytes(content[: content.rindex(b"serialized_metadata")])
    contents = read_topics(path, begin=begin, end=end)
    assert contents["/response"].fields.get("sequence", np.empty(0)).tolist() == list(samples)
    assert contents["/response"].log_time.tolist() == [10 * k for k in samples]
    assert contents["/note"].log_time.size == (210 in samples)
    assert contents.facts == {"run": "selected"}


def test_chunks_outside_the_range_of_time_are_not_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    spoil(path, set(range(8)) - {2, 3})
    contents = read_topics(path, begin=1000, end=2000)
    assert contents.warnings == ()
    assert contents["/response"].fields["sequence"].tolist() == list(range(100, 200))
    assert any("chunk" in warning for warning in read_topics(path, begin=990, end=2000).warnings), "could fail"


def test_chunks_without_the_topic_are_not_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    spoil(path, set(range(8)) - {4})
    contents = read_topics(path, ["/note"])
    assert contents.warnings == ()
    assert contents["/note"].fields["data"].tolist() == ["here"]
    assert contents.facts == {"run": "selected"}


def test_damaged_chunk_of_the_range_is_left_out_and_counted(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag")
    spoil(path, {2})
    contents = read_topics(path, ["/response"], 1000, 2000)
    assert contents["/response"].fields["sequence"].tolist() == list(range(150, 200))
    assert any("50 of 400 messages of /response are missing" in warning for warning in contents.warnings)


def test_topic_that_is_not_there_is_an_error_that_names_those_that_are(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    with pytest.raises(AbraceError, match=r"no topic /other in it, expected one of /note, /response"):
        read_topics(tmp_path / "bag", ["/other"])


@pytest.mark.parametrize("seed", [1, 2])
def test_three_readers_agree_value_for_value_in_a_range_of_time(tmp_path: Path, seed: int) -> None:
    path = write_bag(tmp_path / "bag", seed=seed)
    ours = read_topics(path, ["/response"], 1230, 3450)["/response"]
    with AnyReader([tmp_path / "bag"], default_typestore=STORE) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == "/response"]
        theirs = [(time, reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages(chosen, 1230, 3450)]
    with path.open("rb") as file:
        others = [
            (message.log_time, message.publish_time, decoded)
            for _, _, message, decoded in mcap.reader.make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages(["/response"], starting_at=1230, ending_before=3450)
        ]
    assert ours.log_time.tolist() == [time for time, _ in theirs] == [time for time, _, _ in others]
    assert ours.publish_time.tolist() == [time for _, time, _ in others]
    for messages in ([message for _, message in theirs], [message for _, _, message in others]):
        assert ours.fields["header.stamp.sec"].tolist() == [message.header.stamp.sec for message in messages]
        assert ours.fields["sequence"].tolist() == [message.sequence for message in messages]
        for name in FIELDS:
            np.testing.assert_array_equal(ours.fields[name], np.array([getattr(one, name) for one in messages]))
