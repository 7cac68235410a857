"""Which message of a bag is next, and when: by a clock that can stop, again and again, or as samples are answered."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from rosbags.interfaces import QosDurability

from abrace_bags import message_definition
from abrace_bags.playback import (
    Answers,
    BagPlayback,
    check_clock,
    check_type,
    excerpt,
    replayed_qos,
    response_topic,
    sibling_topic,
    without_commands,
)
from abrace_bags.qos import DEFAULT_QOS, UNKNOWN_QOS
from abrace_bags.raw import RawBag, RawMessage, RecordedTopic
from abrace_core.errors import AbraceError
from abrace_core.wire import BraceCommands, Responses

if TYPE_CHECKING:
    from collections.abc import Sequence

BEGIN = 1_795_000_000_000_000_000
RESPONSE, COMMAND, STRING = (
    "abrace_interfaces/msg/Response",
    "abrace_interfaces/msg/BraceCommand",
    "std_msgs/msg/String",
)


def messages(*milliseconds: int) -> list[RawMessage]:
    """Messages of these times, with their numbers as bytes."""
    return [RawMessage("/note", bytes([k]), BEGIN + time * 1_000_000) for k, time in enumerate(milliseconds)]


def topics(**types: str) -> dict[str, RecordedTopic]:
    """Topics in the namespace /lab."""
    return {f"/lab/{name}": RecordedTopic(f"/lab/{name}", kind, "", UNKNOWN_QOS) for name, kind in types.items()}


def times(part: Sequence[RawMessage]) -> list[int]:
    return [(message.log_time - BEGIN) // 1_000_000 for message in part]


def test_an_excerpt_begins_at_its_offset_and_ends_before_its_end() -> None:
    whole = messages(0, 10, 10, 20, 30)
    assert times(excerpt(whole, 0.0, 0.0)) == [0, 10, 10, 20, 30]
    assert times(excerpt(whole, 0.01, 0.0)) == [10, 10, 20, 30]
    assert times(excerpt(whole, 0.005, 0.015)) == [10, 10]
    assert times(excerpt(whole, 0.0, 1.0)) == [0, 10, 10, 20, 30]


def test_an_excerpt_without_a_message_is_refused() -> None:
    with pytest.raises(AbraceError, match=r"no message from 0.031 s to the end, its messages span 0.030 s"):
        excerpt(messages(0, 30), 0.031, 0.0)
    with pytest.raises(AbraceError, match=r"no message from 0.01 s to 0.02 s"):
        excerpt(messages(0, 30), 0.01, 0.01)
    with pytest.raises(AbraceError, match="no message on the topics"):
        excerpt([], 0.0, 0.0)


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
    with pytest.raises(AbraceError, match="parameter loop: all messages to replay are of one time"):
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
    samples = [responses.pack(0, number, [0.0], [0.0], [0.0], [0.0], [0.0], 0.0) for number in (41, 42)]
    content = [
        RawMessage("/lab/note", b"anything", BEGIN),
        RawMessage("/lab/response", samples[0], BEGIN),
        RawMessage("/lab/response", samples[1], BEGIN + 1),
        RawMessage("/lab/note", b"the last", BEGIN + 2),
    ]
    playback, answers = BagPlayback(content, 1.0, loop=False), Answers("/lab/response")
    assert answers.missing is None
    assert list(answers.next_messages(playback)) == content[:2]
    assert answers.missing == 41
    assert not list(answers.next_messages(playback)), "the sample has not been answered"
    assert not answers.receive(commands.pack(0, 40, [1.0]))
    assert answers.receive(commands.pack(0, 41, [1.0]))
    assert answers.missing is None
    assert not answers.receive(commands.pack(0, 41, [1.0])), "a second answer"
    assert list(answers.next_messages(playback)) == content[2:3]
    assert answers.receive(commands.pack(0, 42, [1.0]))
    assert list(answers.next_messages(playback)) == content[3:]


def test_a_time_that_a_clock_cannot_hold_is_refused() -> None:
    check_clock("bag", topics(note=STRING), messages(0, 10))
    with pytest.raises(AbraceError, match="parameter clock: /clock can't have the times of bag, expected 1970 to 2038"):
        check_clock("bag", {}, [RawMessage("/note", b"", 2**31 * 10**9)])
    with pytest.raises(AbraceError, match="parameter clock: /clock of the bag is replayed"):
        check_clock("bag", {"/clock": RecordedTopic("/clock", STRING, "", UNKNOWN_QOS)}, messages(0))


def test_a_topic_is_replayed_with_its_qos_but_no_small_depth() -> None:
    transient_local = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL)
    assert replayed_qos(DEFAULT_QOS, 5000) == DEFAULT_QOS._replace(depth=5000)
    assert replayed_qos(DEFAULT_QOS._replace(depth=9000), 5000).depth == 9000
    assert replayed_qos(transient_local, 5000) == transient_local
    assert replayed_qos(transient_local._replace(depth=0), 5000).depth == 5000


def test_the_topic_of_responses_is_found_and_has_to_be_the_only_one() -> None:
    sample = [RawMessage("/lab/response", b"", BEGIN)]
    assert response_topic(topics(response=RESPONSE, note=STRING), sample) == "/lab/response"
    with pytest.raises(AbraceError, match=r"2 topics of .* to replay \(/lab/one, /lab/two\), expected one"):
        response_topic(topics(two=RESPONSE, one=RESPONSE), sample)
    with pytest.raises(AbraceError, match=r"0 topics of .* to replay \(none\), expected one"):
        response_topic(topics(note=STRING), sample)
    with pytest.raises(AbraceError, match="/lab/brace_command answers /lab/response and can't be replayed as well"):
        response_topic(topics(response=RESPONSE, brace_command=COMMAND), sample)


def test_a_part_without_a_response_has_nothing_to_answer() -> None:
    with pytest.raises(AbraceError, match="parameter lockstep: no message of /lab/response in the part"):
        response_topic(topics(response=RESPONSE, note=STRING), [RawMessage("/lab/note", b"", BEGIN)])


def test_inputs_of_a_rig_are_left_out_with_a_warning() -> None:
    recorded = topics(
        response=RESPONSE,
        brace_command=COMMAND,
        force=COMMAND,
        ground_motion=STRING,
        emergency_stop=STRING,
        note=STRING,
    )
    content = [RawMessage(name, b"", BEGIN + k) for k, name in enumerate(recorded)]
    bag = without_commands(RawBag(recorded, content, ("first",)))
    assert list(bag.topics) == ["/lab/response", "/lab/note"]
    assert [message.topic for message in bag.messages] == ["/lab/response", "/lab/note"]
    assert bag.warnings[0] == "first"
    assert bag.warnings[1].startswith(
        "/lab/brace_command, /lab/emergency_stop, /lab/force, /lab/ground_motion left out: a rig obeys them"
    )
    harmless = RawBag(topics(note=STRING), content[-1:], ())
    assert without_commands(harmless) == harmless


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
