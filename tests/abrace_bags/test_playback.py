# SPDX-License-Identifier: Apache-2.0
"""Which message of a bag is next, and when: by the clock or as samples are answered."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest
from rosbags.interfaces import QosDurability

from abrace_bags import BagWriter, RawMessage, RawMessages, RecordedTopic, message_definition
from abrace_bags.mcap.contents import TopicContent
from abrace_bags.playback import (
    Answers,
    BagPlayback,
    bag_to_replay,
    check_type,
    replayed_qos,
    response_topic,
)
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.topics import Selection
from abrace_core import AbraceError
from abrace_core.safety.wire import BraceCommands, Head, Responses

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

BEGIN = 1_795_000_000_000_000_000
RESPONSE, COMMAND, STRING = (
    "abrace_interfaces/msg/Response",
    "abrace_interfaces/msg/BraceCommand",
    "std_msgs/msg/String",
)


class Recorded(RawMessages):
    """Messages that are in no file."""

    content: Sequence[RawMessage]

    def __iter__(self) -> Iterator[RawMessage]:
        return iter(self.content)


def recorded(content: Sequence[RawMessage], found: dict[str, RecordedTopic] | None = None) -> RawMessages:
    """A bag of these messages."""
    bag = Recorded([], Selection(), {})
    counts = Counter(message.topic for message in content)
    times = [message.log_time for message in content]
    bag.content, bag.topics, bag.first, bag.last = content, found or {}, min(times), max(times)
    bag.contents = {name: TopicContent(counts[name]) for name in (*bag.topics, *counts)}
    return bag


def note(time: int, payload: bytes = b"", topic: str = "/note") -> RawMessage:
    return RawMessage(topic, payload, time, time)


def messages(*milliseconds: int) -> RawMessages:
    """Messages of these times, with their numbers as bytes."""
    return recorded([note(BEGIN + time * 1_000_000, bytes([k])) for k, time in enumerate(milliseconds)])


def topics(**types: str) -> dict[str, RecordedTopic]:
    """Topics in the namespace /lab."""
    return {f"/lab/{name}": RecordedTopic(f"/lab/{name}", kind) for name, kind in types.items()}


def write_notes(directory: Path, times: Sequence[int], flush: bool = False) -> Path:
    with BagWriter(directory, {}) as bag:
        topic = bag.add_topic("/note", STRING, "string data\n", "")
        for time in times:
            bag.write(topic, b"\0\1\0\0", BEGIN + time * 1_000_000, 0)
            if flush:
                bag.flush()
    return directory


def times(bag: RawMessages) -> list[int]:
    return [(message.log_time - BEGIN) // 1_000_000 for message in bag]


@pytest.mark.parametrize("flush", [False, True])
def test_a_part_begins_at_its_offset_and_ends_before_its_end(tmp_path: Path, flush: bool) -> None:
    path = write_notes(tmp_path / "bag", (0, 10, 10, 20, 30), flush)
    for offset, duration, expected in (
        (0.0, 0.0, [0, 10, 10, 20, 30]),
        (0.01, 0.0, [10, 10, 20, 30]),
        (0.005, 0.015, [10, 10]),
        (0.0, 1.0, [0, 10, 10, 20, 30]),
    ):
        part = bag_to_replay(str(path), [], offset, duration)
        assert times(part) == expected
        assert part.count == len(expected)
        assert [part.first, part.last] == [BEGIN + expected[k] * 1_000_000 for k in (0, -1)]


def test_a_part_without_a_message_is_refused(tmp_path: Path) -> None:
    path = str(write_notes(tmp_path / "bag", (0, 30)))
    with pytest.raises(AbraceError, match=r"no message from 0.031 s to the end, its messages span 0.030 s"):
        bag_to_replay(path, [], 0.031, 0.0)
    with pytest.raises(AbraceError, match=r"no message on the topics to replay from 0.01 s to 0.02 s"):
        bag_to_replay(path, ["note"], 0.01, 0.01)
    for offset in (0.0, 1.0):
        with pytest.raises(AbraceError, match="no message on the topics"):
            bag_to_replay(str(write_notes(tmp_path / f"empty{offset}", ())), [], offset, 0.0)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_are_due_at_their_distances_over_the_rate(rate: float) -> None:
    playback = BagPlayback(messages(0, 10, 250), rate)
    found = []
    while (due := playback.due(100.0)) is not None:
        found.append(due)
        playback.next_message()
    assert found == pytest.approx([100.0, 100.0 + 0.01 / rate, 100.0 + 0.25 / rate], abs=1e-9)
    assert playback.ended
    assert playback.played == 3


def test_a_sample_waits_for_the_command_with_its_number() -> None:
    responses, commands = Responses(), BraceCommands()
    samples = [responses.pack(0, Head(number, 1, 0, 0, 3), "", [1], *[[0.0]] * 5, 0.0, 0.0) for number in (41, 42)]
    content = [
        note(BEGIN, b"anything", "/lab/note"),
        note(BEGIN, samples[0], "/lab/response"),
        note(BEGIN + 1, samples[1], "/lab/response"),
        note(BEGIN + 2, b"the last", "/lab/note"),
    ]
    playback, answers = BagPlayback(recorded(content), 1.0), Answers("/lab/response")
    assert answers.missing is None
    assert list(answers.next_messages(playback)) == content[:2]
    assert answers.missing == 41
    assert not list(answers.next_messages(playback)), "the sample has not been answered"
    assert not answers.receive(commands.pack(0, 1, 40, [1.0]))
    assert answers.receive(commands.pack(0, 1, 41, [1.0]))
    assert answers.missing is None
    assert not answers.receive(commands.pack(0, 1, 41, [1.0])), "a second answer"
    assert list(answers.next_messages(playback)) == content[2:3]
    assert answers.receive(commands.pack(0, 1, 42, [1.0]))
    assert list(answers.next_messages(playback)) == content[3:]


def test_a_topic_is_replayed_with_its_qos_but_no_small_depth() -> None:
    transient_local = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL)
    assert replayed_qos(DEFAULT_QOS, 5000) == DEFAULT_QOS._replace(depth=5000)
    assert replayed_qos(DEFAULT_QOS._replace(depth=9000), 5000).depth == 9000
    assert replayed_qos(transient_local, 5000) == transient_local
    assert replayed_qos(transient_local._replace(depth=0), 5000).depth == 5000


def test_the_topic_of_responses_is_found_and_has_to_be_the_only_one() -> None:
    sample = [note(BEGIN, topic="/lab/response")]
    assert response_topic(recorded(sample, topics(response=RESPONSE, note=STRING))) == "/lab/response"
    with pytest.raises(AbraceError, match=r"2 topics of .* to replay \(/lab/one, /lab/two\), expected one"):
        response_topic(recorded(sample, topics(two=RESPONSE, one=RESPONSE)))
    with pytest.raises(AbraceError, match=r"0 topics of .* to replay \(none\), expected one"):
        response_topic(recorded(sample, topics(note=STRING)))
    with pytest.raises(AbraceError, match="/lab/brace_command answers /lab/response and can't be replayed as well"):
        response_topic(recorded(sample, topics(response=RESPONSE, brace_command=COMMAND)))


def test_inputs_of_a_rig_are_left_out_with_a_warning(tmp_path: Path) -> None:
    names = topics(
        response=RESPONSE,
        brace_command=COMMAND,
        force=COMMAND,
        ground_motion=STRING,
        emergency_stop=STRING,
        note=STRING,
    )
    with BagWriter(tmp_path / "bag", {}) as bag:
        for k, (name, topic) in enumerate(names.items()):
            bag.write(bag.add_topic(name, topic.type_name, "string data\n", ""), b"\0\1\0\0", k, k)
    found = bag_to_replay(str(tmp_path / "bag"), [], 0.0, 0.0)
    assert list(found.topics) == ["/lab/response", "/lab/note"]
    assert [message.topic for message in found] == ["/lab/response", "/lab/note"]
    assert found.count == 2
    (warning,) = found.warnings
    left_out = "/lab/brace_command, /lab/emergency_stop, /lab/force, /lab/ground_motion"
    assert warning.startswith(f"{left_out} left out: they command a rig")
    by_name = bag_to_replay(str(tmp_path / "bag"), ["force", "note"], 0.0, 0.0)
    assert (list(by_name.topics), by_name.warnings) == (["/lab/force", "/lab/note"], ())


def test_hidden_topics_are_left_out_unless_they_are_named(tmp_path: Path) -> None:
    feedback = "/lab/ground_motion/_action/feedback"
    with BagWriter(tmp_path / "bag", {}) as bag:
        for name, kind in ((feedback, "lab_msgs/action/Play_FeedbackMessage"), ("/_secret", STRING), ("/note", STRING)):
            bag.write(bag.add_topic(name, kind, "string data\n", ""), b"\0\1\0\0", 1, 1)
    found = bag_to_replay(str(tmp_path / "bag"), [], 0.0, 0.0)
    assert list(found.topics) == ["/note"]
    assert found.warnings[0].startswith(f"/_secret, {feedback} left out: they are hidden")
    assert list(bag_to_replay(str(tmp_path / "bag"), ["_secret"], 0.0, 0.0).topics) == ["/_secret"]


def test_a_type_that_is_another_one_here_is_refused() -> None:
    same = message_definition(STRING).type_hash
    for known in (same, ""):
        check_type(RecordedTopic("/note", STRING, known))
    with pytest.raises(AbraceError, match=f"topic /note: {STRING} was recorded as RIHS01_0, expected .*{same}"):
        check_type(RecordedTopic("/note", STRING, "RIHS01_0"))
    with pytest.raises(AbraceError, match="topic /note: message type odd_msgs/Odd is not installed"):
        check_type(RecordedTopic("/note", "odd_msgs/msg/Odd"))
