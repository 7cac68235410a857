# SPDX-License-Identifier: Apache-2.0
"""Which message of a bag is next, and when: by a clock that can stop, again and again, or as samples are answered."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest
from rosbags.interfaces import QosDurability

from abrace_bags import BagWriter, message_definition
from abrace_bags.playback import (
    Answers,
    BagPlayback,
    bag_to_replay,
    check_clock,
    check_type,
    replayed_qos,
    response_topic,
    sibling_topic,
)
from abrace_bags.qos import DEFAULT_QOS, UNKNOWN_QOS
from abrace_bags.raw import RawBag, RecordedTopic
from abrace_bags.survey import RawMessage
from abrace_core.errors import AbraceError
from abrace_core.wire import BraceCommands, Head, Responses

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

BEGIN = 1_795_000_000_000_000_000
RESPONSE, COMMAND, STRING = (
    "abrace_interfaces/msg/Response",
    "abrace_interfaces/msg/BraceCommand",
    "std_msgs/msg/String",
)


def recorded(content: Sequence[RawMessage], found: dict[str, RecordedTopic] | None = None) -> RawBag:
    """A bag of these messages."""
    counts = Counter(message.topic for message in content)
    times = [message.log_time for message in content]
    return RawBag(found or {}, lambda: iter(content), counts, min(times), max(times), ())


def note(time: int, payload: bytes = b"", topic: str = "/note") -> RawMessage:
    return RawMessage(topic, payload, time, time)


def messages(*milliseconds: int) -> RawBag:
    """Messages of these times, with their numbers as bytes."""
    return recorded([note(BEGIN + time * 1_000_000, bytes([k])) for k, time in enumerate(milliseconds)])


def topics(**types: str) -> dict[str, RecordedTopic]:
    """Topics in the namespace /lab."""
    return {f"/lab/{name}": RecordedTopic(f"/lab/{name}", kind, "", UNKNOWN_QOS) for name, kind in types.items()}


def write_notes(directory: Path, times: Sequence[int], flush: bool = False) -> Path:
    with BagWriter(directory, {}) as bag:
        topic = bag.add_topic("/note", STRING, "string data\n", "")
        for time in times:
            bag.write(topic, b"\0\1\0\0", BEGIN + time * 1_000_000, 0)
            if flush:
                bag.flush()
    return directory


def times(bag: RawBag) -> list[int]:
    return [(message.log_time - BEGIN) // 1_000_000 for message in bag.read()]


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
    with pytest.raises(AbraceError, match=r"no message from 0.01 s to 0.02 s"):
        bag_to_replay(path, ["note"], 0.01, 0.01)
    for offset in (0.0, 1.0):
        with pytest.raises(AbraceError, match="no message on the topics"):
            bag_to_replay(str(write_notes(tmp_path / f"empty{offset}", ())), [], offset, 0.0)


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_messages_are_due_at_their_distances_over_the_rate(rate: float) -> None:
    playback = BagPlayback(messages(0, 10, 250), rate, loop=False)
    assert playback.due is None, "the clock has not been started"
    playback.start_clock(100.0)
    found = []
    while playback.due is not None:
        found.append(playback.due)
        playback.next_message()
    assert found == pytest.approx([100.0, 100.0 + 0.01 / rate, 100.0 + 0.25 / rate], abs=1e-9)
    assert playback.ended
    assert playback.played == 3


def test_a_stopped_clock_keeps_the_time_to_the_next_message() -> None:
    playback = BagPlayback(messages(0, 100), 1.0, loop=False)
    playback.start_clock(10.0)
    playback.next_message()
    playback.stop_clock(10.04)
    assert playback.due is None
    assert playback.bag_time(70.0) == BEGIN + 40_000_000
    playback.start_clock(90.0)
    assert playback.due == pytest.approx(90.06, abs=1e-9)
    assert playback.bag_time(90.01) == pytest.approx(BEGIN + 50_000_000, abs=1000)


def test_bag_time_goes_with_the_rate_and_stays_within_the_messages() -> None:
    playback = BagPlayback(messages(0, 100), 2.0, loop=False)
    assert playback.bag_time(5.0) == BEGIN
    playback.start_clock(10.0)
    assert playback.bag_time(10.02) == pytest.approx(BEGIN + 40_000_000, abs=1000)
    assert playback.bag_time(99.0) == BEGIN + 100_000_000


def test_the_clock_goes_on_from_a_message_stepped_to() -> None:
    playback = BagPlayback(messages(0, 100, 130), 1.0, loop=False)
    assert playback.step().payload == b"\0"
    assert playback.step().payload == b"\1"
    assert playback.bag_time(50.0) == BEGIN + 100_000_000
    playback.start_clock(60.0)
    assert playback.due == pytest.approx(60.03, abs=1e-9)


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_a_round_of_a_loop_begins_one_mean_interval_after_the_last_message(rate: float) -> None:
    playback = BagPlayback(messages(0, 10, 40), rate, loop=True)
    playback.start_clock(7.0)
    found = []
    for _ in range(7):
        assert playback.due is not None
        found.append((playback.due - 7.0) * rate)
        playback.next_message()
    assert found == pytest.approx([0.0, 0.01, 0.04, 0.06, 0.07, 0.10, 0.12], abs=1e-9)
    assert not playback.ended
    assert playback.played == 7
    assert playback.fraction == pytest.approx(1 / 3)


def test_a_loop_of_one_instant_is_refused() -> None:
    with pytest.raises(AbraceError, match="parameter loop: all messages to replay have the same time"):
        BagPlayback(messages(5, 5), 1.0, loop=True)


def test_bag_time_does_not_go_back_for_a_message_that_was_overdue() -> None:
    playback = BagPlayback(messages(0, 100, 200), 1.0, loop=False)
    playback.start_clock(10.0)
    playback.stop_clock(10.15)
    for expected in (150, 150, 200):
        playback.step()
        assert playback.bag_time(99.0) == BEGIN + expected * 1_000_000


def test_bag_time_begins_anew_with_each_round_of_steps() -> None:
    playback = BagPlayback(messages(0, 100, 200), 1.0, loop=True)
    found = []
    for _ in range(6):
        playback.step()
        found.append((playback.bag_time(99.0) - BEGIN) // 1_000_000)
    assert found == [0, 100, 0, 0, 100, 0], "with the last message the next round has begun"


def test_a_sample_waits_for_the_command_with_its_number() -> None:
    responses, commands = Responses(), BraceCommands()
    samples = [responses.pack(0, Head(number, 1, 0, 0, 3), "", [1], *[[0.0]] * 5, 0.0) for number in (41, 42)]
    content = [
        note(BEGIN, b"anything", "/lab/note"),
        note(BEGIN, samples[0], "/lab/response"),
        note(BEGIN + 1, samples[1], "/lab/response"),
        note(BEGIN + 2, b"the last", "/lab/note"),
    ]
    playback, answers = BagPlayback(recorded(content), 1.0, loop=False), Answers("/lab/response")
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


def test_a_time_that_a_clock_cannot_hold_is_refused() -> None:
    check_clock("bag", recorded([note(BEGIN)], topics(note=STRING)))
    with pytest.raises(AbraceError, match="parameter clock: /clock can't have the times of bag, expected 1970 to 2038"):
        check_clock("bag", recorded([note(2**31 * 10**9)]))
    with pytest.raises(AbraceError, match="parameter clock: /clock of the bag is replayed"):
        check_clock("bag", recorded([note(BEGIN)], {"/clock": RecordedTopic("/clock", STRING, "", UNKNOWN_QOS)}))


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


def test_a_part_without_a_response_has_nothing_to_answer() -> None:
    with pytest.raises(AbraceError, match="parameter lockstep: no message of /lab/response in the part"):
        response_topic(recorded([note(BEGIN)], topics(response=RESPONSE, note=STRING)))


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
    assert [message.topic for message in found.read()] == ["/lab/response", "/lab/note"]
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


def test_the_answers_are_in_the_namespace_of_the_samples() -> None:
    assert sibling_topic("/lab/east/measured", "brace_command") == "/lab/east/brace_command"
    assert sibling_topic("/response", "brace_command") == "/brace_command"


def test_a_type_that_is_another_one_here_is_refused() -> None:
    same = message_definition(STRING).type_hash
    for known in (same, ""):
        check_type(RecordedTopic("/note", STRING, known, UNKNOWN_QOS))
    with pytest.raises(AbraceError, match=f"topic /note: {STRING} was recorded as RIHS01_0, expected .*{same}"):
        check_type(RecordedTopic("/note", STRING, "RIHS01_0", UNKNOWN_QOS))
    with pytest.raises(AbraceError, match="topic /note: message type odd_msgs/Odd is not installed"):
        check_type(RecordedTopic("/note", "odd_msgs/msg/Odd", "", UNKNOWN_QOS))
