"""The loop's messages on the wire: the same to rclpy, whatever the size of the rig."""

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from abrace_core.errors import AbraceError
from abrace_core.wire import BraceCommands, Responses, pack_acceleration, read_header, unpack_acceleration
from abrace_interfaces.msg import BraceCommand, Response

finite = st.floats(allow_nan=False, width=64)
stamps = st.integers(0, 2**31 * 10**9 - 1)
sequences = st.integers(0, 2**64 - 1)
frames = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20)
sizes = st.tuples(st.integers(1, 7), st.integers(1, 4))


def time(stamp: int) -> Time:
    return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)


@st.composite
def responses(draw) -> Response:
    floors, groups = draw(sizes)
    message = Response(sequence=draw(sequences), ground_acceleration=draw(finite))
    message.header.stamp = time(draw(stamps))
    message.header.frame_id = draw(frames)
    for name, length in (
        ("displacement", floors),
        ("acceleration", floors),
        ("stroke", groups),
        ("force", groups),
        ("command", groups),
    ):
        setattr(message, name, draw(st.lists(finite, min_size=length, max_size=length)))
    return message


@given(responses(), responses())
def test_responses_are_read_as_rclpy_wrote_them_when_the_rig_changes_too(first, second):
    reader = Responses()
    for message in (first, second, first):
        stamp, sequence, z = reader.unpack(serialize_message(message))
        assert time(stamp) == message.header.stamp
        assert sequence == message.sequence
        assert z == (*message.displacement, *message.stroke, *message.acceleration, *message.force)
        assert (reader.floors, reader.groups) == (len(message.displacement), len(message.stroke))


@given(responses())
def test_rclpy_reads_responses_as_they_were_packed(message):
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    message.header.frame_id = "table"
    arrays = (message.displacement, message.acceleration, message.stroke, message.force, message.command)
    packed = Responses().pack(stamp, message.sequence, *arrays, message.ground_acceleration)
    assert deserialize_message(packed, Response) == message


@given(stamps, sequences, frames, st.lists(finite, max_size=4))
def test_commands_are_the_same_to_rclpy_both_ways(stamp, sequence, frame, force):
    message = BraceCommand(sequence=sequence, force=force)
    message.header.stamp = time(stamp)
    packed = BraceCommands().pack(stamp, sequence, force)
    assert deserialize_message(packed, BraceCommand) == message
    message.header.frame_id = frame
    assert BraceCommands().unpack(serialize_message(message)) == (sequence, tuple(force))


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
    packed = [Responses().pack(7, 8, x, x, u, u, u, 0.5) for _ in range(2)]
    assert packed[0] == packed[1]
    assert packed[0][22:28] == bytes(6), "padding after frame_id"


@given(responses(), st.data())
def test_a_cut_response_is_refused(message, data):
    whole = Responses().pack(
        5, 6, message.displacement, message.acceleration, message.stroke, message.force, message.command, 0.5
    )
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(AbraceError, match=r"Response|message"):
        Responses().unpack(cut)
    reader = Responses()
    reader.unpack(whole)
    with pytest.raises(AbraceError, match=r"Response|message"):
        reader.unpack(cut)


def test_cut_commands_and_accelerations_are_refused():
    command, acceleration = BraceCommands().pack(1, 2, [3.0, 4.0]), pack_acceleration(1, 2.0)
    for length in range(len(command)):
        with pytest.raises(AbraceError):
            BraceCommands().unpack(command[:length])
    for length in range(len(acceleration)):
        with pytest.raises(AbraceError):
            unpack_acceleration(acceleration[:length])


def test_arrays_that_do_not_belong_together_are_refused():
    message = Response(displacement=[1.0, 2.0], acceleration=[1.0], stroke=[1.0], force=[1.0], command=[1.0])
    with pytest.raises(AbraceError, match="expected floors, floors"):
        Responses().unpack(serialize_message(message))


def test_big_endian_messages_are_refused():
    with pytest.raises(AbraceError, match="little-endian"):
        read_header(b"\0\0" + pack_acceleration(1, 2.0)[2:])
