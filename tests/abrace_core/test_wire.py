# SPDX-License-Identifier: Apache-2.0
"""The loop's messages on the wire: the same to rclpy, whatever the size of the rig."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from abrace_core import AbraceError
from abrace_core.safety.wire import (
    LONGEST_TEXT,
    BraceCommands,
    Head,
    Responses,
    pack_acceleration,
    read_header,
    unpack_acceleration,
)
from abrace_interfaces.msg import BraceCommand, Response

finite = st.floats(allow_nan=False, width=64)
forces = st.floats(-1e9, 1e9)
stamps = st.integers(0, 2**31 * 10**9 - 1)
sequences = st.integers(0, 2**64 - 1)
frames = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20)
texts = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF).filter(str.isprintable), max_size=20)
ARRAYS = ("braces", "displacement", "acceleration", "stroke", "force", "command")
sizes = st.tuples(st.integers(1, 7), st.integers(1, 4))


def time(stamp: int) -> Time:
    return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)


@st.composite
def responses(draw) -> Response:
    floors, groups = draw(sizes)
    message = Response(
        run=draw(sequences),
        sequence=draw(sequences),
        clipped=draw(sequences),
        flags=draw(st.integers(0, 2**32 - 1)),
        state=draw(st.integers(0, 255)),
        ground_acceleration=draw(finite),
        table_displacement=draw(finite),
        cause=draw(texts),
    )
    message.header.stamp = time(draw(stamps))
    message.header.frame_id = draw(frames)
    message.braces = draw(st.lists(st.integers(1, 3), min_size=groups, max_size=groups))
    for name, length in (
        ("displacement", floors),
        ("acceleration", floors),
        ("stroke", groups),
        ("force", sum(message.braces)),
        ("command", groups),
    ):
        numbers = forces if name == "force" else finite
        setattr(message, name, draw(st.lists(numbers, min_size=length, max_size=length)))
    return message


def head(message: Response) -> Head:
    return Head(message.sequence, message.run, message.clipped, message.flags, message.state)


@given(responses(), responses())
def test_responses_are_read_as_rclpy_wrote_them_when_the_rig_changes_too(first, second):
    reader = Responses()
    for message in (first, second, first):
        payload = serialize_message(message)
        stamp, found, z = reader.unpack(payload)
        assert time(stamp) == message.header.stamp
        assert found == head(message)
        assert reader.cause(payload) == message.cause
        assert reader.table_displacement == message.table_displacement
        assert reader.command == tuple(message.command)
        others = (*message.displacement, *message.stroke, *message.acceleration)
        assert z[: len(others)] == others
        ends = np.cumsum(message.braces, dtype=int).tolist()
        means = [np.mean(message.force[end - count : end]) for count, end in zip(message.braces, ends, strict=True)]
        assert z[len(others) :] == pytest.approx(means, rel=1e-12)
        assert (reader.floors, reader.groups) == (len(message.displacement), len(message.stroke))


@given(responses())
def test_rclpy_reads_responses_as_they_were_packed(message):
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    message.header.frame_id = "table"
    arrays = tuple(getattr(message, name) for name in ARRAYS)
    packer = Responses()
    for _ in range(2):
        packed = packer.pack(
            stamp, head(message), message.cause, *arrays, message.ground_acceleration, message.table_displacement
        )
        assert deserialize_message(packed, Response) == message


@given(stamps, sequences, sequences, frames, st.lists(finite, max_size=4), texts)
def test_commands_are_the_same_to_rclpy_both_ways(stamp, run, sequence, frame, force, fault):
    message = BraceCommand(run=run, sequence=sequence, force=force, fault=fault)
    message.header.stamp = time(stamp)
    packed = BraceCommands().pack(stamp, run, sequence, force, fault)
    assert deserialize_message(packed, BraceCommand) == message
    message.header.frame_id = frame
    assert BraceCommands().unpack(serialize_message(message)) == (run, sequence, tuple(force), fault)


@given(stamps, frames, finite)
def test_ground_accelerations_are_the_same_to_rclpy_both_ways(stamp, frame, acceleration):
    message = AccelStamped()
    message.header.stamp = time(stamp)
    message.header.frame_id = "table"
    message.accel.linear.x = acceleration
    assert deserialize_message(pack_acceleration(stamp, acceleration), AccelStamped) == message
    message.header.frame_id = frame
    assert unpack_acceleration(serialize_message(message)) == (stamp, acceleration)


def test_packed_messages_have_no_stray_bytes():
    x, u = [0.5, 0.25, 0.125], [1.0]
    packed = [Responses().pack(7, Head(8, 1, 0, 0, 3), "", [1], x, x, u, u, u, 0.5, 0.25) for _ in range(2)]
    assert packed[0] == packed[1]
    assert packed[0][22:28] == bytes(6), "padding after frame_id"


@given(responses(), st.data())
def test_a_cut_response_is_refused(message, data):
    arrays = tuple(getattr(message, name) for name in ARRAYS)
    whole = Responses().pack(5, head(message), message.cause, *arrays, 0.5, 0.25)
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    reader = Responses()
    reader.unpack(whole)
    for one in (Responses(), reader):
        with pytest.raises(AbraceError, match=r"Response|message"):  # noqa: PT012, either of both may find it
            one.unpack(cut)
            one.cause(cut)


def test_cut_commands_and_accelerations_are_refused():
    command, acceleration = BraceCommands().pack(1, 2, 3, [3.0, 4.0], "why"), pack_acceleration(1, 2.0)
    for length in range(len(command)):
        with pytest.raises(AbraceError):
            BraceCommands().unpack(command[:length])
    for length in range(len(acceleration)):
        with pytest.raises(AbraceError):
            unpack_acceleration(acceleration[:length])


def test_of_a_sender_s_text_one_line_of_limited_length_is_kept():
    given = "a\n\x1b[2J\u2028" + "\u00e4" * 10**6
    _, _, _, fault = BraceCommands().unpack(serialize_message(BraceCommand(force=[1.0], fault=given)))
    assert fault.startswith("a  [2J \u00e4\u00e4"), "no control characters for a terminal"
    assert len(fault) < LONGEST_TEXT, "the rig passes it on in every sample"
    message = Response(displacement=[1.0], acceleration=[1.0], cause=given)
    responses = Responses()
    responses.unpack(serialize_message(message))
    assert responses.cause(serialize_message(message)) == fault


@pytest.mark.parametrize("floors", [0, 1])
@pytest.mark.parametrize("groups", [0, 1])
def test_a_rig_without_floors_or_braces_is_read(floors, groups):
    zeros = [0.0]
    message = Response(displacement=floors * zeros, acceleration=floors * zeros, braces=groups * [1])
    message.stroke = message.force = message.command = groups * zeros
    _, head, z = Responses().unpack(serialize_message(message))
    assert head == Head(0, 0, 0, 0, 0)
    assert z == (0.0,) * (2 * floors + 2 * groups)


def test_arrays_that_do_not_belong_together_are_refused():
    message = Response(displacement=[1.0, 2.0], acceleration=[1.0], stroke=[1.0], force=[1.0], command=[1.0])
    for braces in ([1], [], [0], [1, 1]):
        message.braces = braces
        with pytest.raises(AbraceError, match="expected floors, floors"):
            Responses().unpack(serialize_message(message))
    message.acceleration = [1.0, 2.0]
    for braces in ([2], [], [0], [1, 1]):
        message.braces = braces
        with pytest.raises(AbraceError, match="expected floors, floors"):
            Responses().unpack(serialize_message(message))


def test_big_endian_messages_are_refused():
    with pytest.raises(AbraceError, match="little-endian"):
        read_header(b"\0\0" + pack_acceleration(1, 2.0)[2:])
