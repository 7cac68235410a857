# SPDX-License-Identifier: Apache-2.0
"""MATLAB files and bags: the named array or field is read, and what cannot be one record is told."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_messages import DEFINITIONS, HASHES, RESPONSE, response_message, serialised
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from abrace_bags import BagWriter
from abrace_core.errors import AbraceError
from abrace_plant.records.files import read_record

G = 9.80665
VALUES = np.array([0.1, -0.2, 0.3, 0.25, -0.05])
TIMED = np.column_stack([0.02 * np.arange(5), VALUES])

# MATLAB ---------------------------------------------------------------------------------------------------------------


def saved(folder, **variables):
    scipy.io.savemat(folder / "quake.mat", variables)
    return folder / "quake.mat"


@pytest.mark.parametrize("version", ["5", "4"])
@pytest.mark.parametrize("values", [VALUES, VALUES[:, None], VALUES[None, :]])
def test_only_vector_of_a_matlab_file_is_the_record(tmp_path, version, values):
    scipy.io.savemat(tmp_path / "quake.mat", {"acc": values, "dt": 0.01, "site": "here"}, format=version)
    record = read_record(tmp_path / "quake.mat", unit="g", sample_period=0.01)
    assert (record.name, record.sample_period) == ("quake", 0.01)
    np.testing.assert_allclose(record.acceleration, VALUES * G, rtol=1e-15)


def test_compressed_matlab_file_with_integers_is_read(tmp_path):
    counts = np.array([1, -2, 3], np.int16)
    scipy.io.savemat(tmp_path / "A.MAT", {"acc": counts}, do_compression=True)
    record = read_record(tmp_path / "A.MAT", unit="cm/s^2", sample_period=0.01)
    np.testing.assert_allclose(record.acceleration, [0.01, -0.02, 0.03], rtol=1e-15)


def test_two_columns_of_a_matlab_file_are_time_and_acceleration(tmp_path):
    record = read_record(saved(tmp_path, record=TIMED), unit="m/s^2")
    assert record.sample_period == pytest.approx(0.02, rel=1e-12)
    np.testing.assert_array_equal(record.acceleration, VALUES)


@pytest.mark.parametrize(("channel", "factor"), [("a", 1.0), (" quake.ew", 2.0), ("quake.site.ns", 3.0)])
def test_channel_names_a_variable_or_a_field_of_a_struct(tmp_path, channel, factor):
    path = saved(tmp_path, a=VALUES, quake={"ew": 2 * VALUES, "site": {"ns": 3 * VALUES, "name": "here"}})
    record = read_record(path, "m/s^2", 0.01, channel)
    np.testing.assert_array_equal(record.acceleration, factor * VALUES)


SEVERAL = {"t": TIMED[:, 0], "q": {"a": VALUES}, "k": np.ones((3, 4)), "x": 1.0, "note": "text", "z": 1j * VALUES}


@pytest.mark.parametrize(
    ("variables", "channel", "message"),
    [
        (SEVERAL, None, r"2 series in it, expected channel as one of its arrays: t \(5\), q.a \(5\), k \(3 x 4\)$"),
        (SEVERAL, "b", r"no array 'b' of numbers in it, expected one of: t \(5\)"),
        (SEVERAL, "x", "no array 'x' of numbers in it"),
        (SEVERAL, "z", "no array 'z' of numbers in it"),
        (SEVERAL, "k", r"k is 3 x 4, expected a vector \(acceleration\) or two columns"),
        ({"note": "text"}, None, "0 series in it, expected channel as one of its arrays: none"),
        ({"a": [1.0, np.nan, 2.0]}, None, "a, row 2: nan, expected a finite acceleration"),
        ({"a": [1.0, 2.0, -np.inf]}, "a", "a, row 3: -inf, expected a finite acceleration"),
        ({"a": [[0, 1], [0.1, 2], [0.3, 3], [0.4, 4], [0.5, 5]]}, None, "a, row 3: time step 0.2 s, expected equal"),
        ({"a": [1.0, 1e308]}, None, "a value that overflows in m/s"),
    ],
)
def test_matlab_file_without_one_good_series_says_what_there_is(tmp_path, variables, channel, message):
    path = saved(tmp_path, **variables)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path, "g", 0.01, channel)


def test_matlab_states_neither_unit_nor_period(tmp_path):
    path = saved(tmp_path, a=VALUES)
    with pytest.raises(AbraceError, match="no unit in the file"):
        read_record(path, sample_period=0.01)
    with pytest.raises(AbraceError, match="no times in the file, expected sample_period"):
        read_record(path, unit="g")


@pytest.mark.parametrize(
    "content",
    [
        b"\x89HDF\r\n\x1a\n" + bytes(600),
        b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n",
        b"made elsewhere".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(10),
    ],
)
def test_matlab_file_of_version_7_3_says_how_to_save_it(tmp_path, content):
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(AbraceError, match=r"version 7\.3 \(HDF5\), expected one saved with save -v7"):
        read_record(tmp_path / "a.mat", "g", 0.01)


def test_truncated_matlab_file_is_told(tmp_path):
    path = saved(tmp_path, a=VALUES)
    whole = path.read_bytes()
    for size in (0, 5, 100, 127, 140, 190, len(whole) - 8):
        path.write_bytes(whole[:size])
        with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}: .*MATLAB"):
            read_record(path, "g", 0.01)


@settings(max_examples=5)
@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=30))
def test_matlab_values_are_read_as_written(tmp_path_factory, values):
    record = read_record(saved(tmp_path_factory.mktemp("m"), a=values), "m/s^2", 0.01)
    np.testing.assert_array_equal(record.acceleration, values)


# Bags -----------------------------------------------------------------------------------------------------------------

STORE = get_typestore(Stores.ROS2_JAZZY)
ACCELERATION = "geometry_msgs/msg/AccelStamped"
WRENCH = "geometry_msgs/msg/Vector3"
TWO = "sensor_msgs/msg/JointState"
START = 1_700_000_000_000_000_000
STEP = 2_000_000


def made(type_name, *fields):
    return STORE.types[type_name](*fields)


def header(nanoseconds):
    time = made("builtin_interfaces/msg/Time", nanoseconds // 10**9, nanoseconds % 10**9)
    return made("std_msgs/msg/Header", time, "")


def acceleration(nanoseconds, value):
    linear, angular = made(WRENCH, value, 0.0, 9.81), made(WRENCH, 0.0, 0.0, 0.0)
    return made(ACCELERATION, header(nanoseconds), made("geometry_msgs/msg/Accel", linear, angular))


def topic_of(bag, topic, type_name):
    definition = STORE.generate_msgdef(type_name, ros_version=2)[0]
    return bag.add_topic(topic, type_name, definition, STORE.hash_rihs01(type_name))


def write_bag(folder, values=VALUES, stamps=None):
    """A bag of stamped accelerations, vectors of two and bare vectors, logged 1 ms late at uneven times."""
    stamps = [START + STEP * k for k in range(len(values))] if stamps is None else stamps
    with BagWriter(folder, {}) as bag:
        motion = topic_of(bag, "/ground_motion", ACCELERATION)
        joints = topic_of(bag, "/rig/joints", TWO)
        bare = topic_of(bag, "/bare", WRENCH)
        for k, (stamp, value) in enumerate(zip(stamps, values, strict=True)):
            late = START + STEP * k + 1_000_000 + 400_000 * (k % 2)
            message = acceleration(stamp, value)
            bag.write(motion, bytes(STORE.serialize_cdr(message, ACCELERATION)), late, late)
            pair = made(TWO, header(stamp), ["a", "b"], np.array([value, 2 * value]), np.array([]), np.array([]))
            bag.write(joints, bytes(STORE.serialize_cdr(pair, TWO)), late, late)
            vector = made(WRENCH, value, 0.0, 0.0)
            bag.write(bare, bytes(STORE.serialize_cdr(vector, WRENCH)), START + STEP * k, START)
    return folder


@pytest.mark.parametrize(
    ("channel", "factor"),
    [
        ("ground_motion:accel.linear.x", 1.0),
        ("/ground_motion:accel.linear.x", 1.0),
        ("rig/joints:position[1]", 2.0),
        (" /rig/joints:position[0] ", 1.0),
        ("bare:x", 1.0),
    ],
)
def test_field_of_a_topic_is_the_record_at_its_stamps_or_log_times(tmp_path, channel, factor):
    bag = write_bag(tmp_path / "run_1.5")
    for path in (bag, bag / "run_1.5_0.mcap"):
        record = read_record(path, channel=channel)
        assert record.sample_period == pytest.approx(0.002, rel=1e-12)
        np.testing.assert_array_equal(record.acceleration, factor * VALUES)
    assert read_record(bag, "m/s^2", 0.002, channel).name == "run_1.5"
    assert read_record(str(bag / "run_1.5_0.mcap"), channel=channel).name == "run_1.5_0"


def test_bag_states_its_unit(tmp_path):
    with pytest.raises(AbraceError, match="the file states m/s\\^2, unit g was given"):
        read_record(write_bag(tmp_path / "bag"), unit="g", channel="bare:x")


LISTED = r"ground_motion: accel.linear.x, .*; rig/joints: position\[2\], .*; bare: x, y, z"


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        (None, f": a bag, expected channel as topic:field, one of {LISTED}"),
        ("bare", f": channel 'bare', expected channel as topic:field, one of {LISTED}"),
        ("bare:", "channel 'bare:', expected channel as topic:field"),
        ("bare:x[", r"channel 'bare:x\[', expected channel as topic:field"),
        (":x", "channel ':x', expected channel as topic:field"),
        ("bear:x", f"no topic 'bear' in it, expected one of {LISTED}"),
        ("bare:w", "no numbers 'w' in bare, expected one of x, y, z"),
        ("ground_motion:header.frame_id", "no numbers 'header.frame_id' in ground_motion, expected one of accel"),
        ("rig/joints:name", "no numbers 'name' in rig/joints, expected one of position"),
        ("rig/joints:position", r"has 2 numbers, expected one of position\[0\] to position\[1\]"),
        ("rig/joints:position[2]", r"has 2 numbers, expected one of position\[0\] to position\[1\]"),
        ("rig/joints:effort[0]", "has 0 numbers, expected one of another field"),
        ("bare:x[0]", r"bare:x is one number, expected it without \[0\]"),
    ],
)
def test_channel_of_a_bag_is_listed_where_it_is_missing_or_wrong(tmp_path, channel, message):
    path = write_bag(tmp_path / "bag")
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path, channel=channel)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([0, 1, 2, 4, 5], "ground_motion, message 4: time step 0.004 s, expected equal steps of 0.002 s"),
        ([0, 1, 2, 2, 3], "ground_motion, message 4: time step 0 s, expected equal steps of 0.002 s"),
        ([0, 1, 2, 0, 1], "ground_motion, message 4: time step -0.004 s"),
        ([0, 0, 0, 0, 0], "ground_motion, message 5: times that do not increase"),
        ([0], "ground_motion: 1 values, expected at least 2"),
        ([], "ground_motion: 0 values, expected at least 2"),
    ],
)
def test_missing_and_repeated_messages_are_told(tmp_path, steps, message):
    path = write_bag(tmp_path / "bag", VALUES[: len(steps)], [START + STEP * k for k in steps])
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path, channel="ground_motion:accel.linear.x")


JITTER = np.random.default_rng(1).integers(-300_000, 300_001, 2000)
"""[ns], +-0.3 ms at 500 Hz."""


def write_responses(folder, numbers, jitter):
    """A bag of responses with these numbers, sampled at 500 Hz with jitter [ns]; sample k has ground acceleration k."""
    with BagWriter(folder, {}) as bag:
        topic = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
        for number, late in zip(numbers, jitter, strict=False):
            stamp = START + STEP * number + int(late)
            message = response_message(number, np.full(10, float(number)), stamp // 10**9, stamp % 10**9)
            bag.write(topic, serialised(message), stamp, stamp)
    return folder


def test_bag_recorded_in_real_time_has_the_mean_step_of_its_stamps(tmp_path):
    stamps = [START + STEP * k + int(late) for k, late in enumerate(JITTER)]
    motion = write_bag(tmp_path / "motion", np.arange(2000.0), stamps)
    responses = write_responses(tmp_path / "responses", range(7, 2007), JITTER)
    for bag, channel, first in (
        (motion, "ground_motion:accel.linear.x", 0),
        (motion, "bare:x", 0),
        (responses, "response:ground_acceleration", 7),
    ):
        record = read_record(bag, channel=channel)
        assert record.sample_period == pytest.approx(0.002, rel=1e-4)
        np.testing.assert_array_equal(record.acceleration, np.arange(first, first + 2000))


@pytest.mark.parametrize("place", [1, 2, 1000, 1998])
def test_sample_missing_from_a_recording_in_real_time_is_refused(tmp_path, place):
    kept = [k for k in range(2000) if k != place]
    stamps = [START + STEP * k + int(JITTER[k]) for k in kept]
    path = write_bag(tmp_path / "motion", np.zeros(1999), stamps)
    with pytest.raises(
        AbraceError, match=rf"ground_motion, message {place + 1}: time step 0\.00.* expected equal steps"
    ):
        read_record(path, channel="ground_motion:accel.linear.x")
    path = write_responses(tmp_path / "responses", kept, JITTER)
    with pytest.raises(AbraceError, match=f"response, message {place + 1}: sample {place} is missing before it"):
        read_record(path, channel="response:ground_acceleration")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([0, 1, 5, 6, 9], "response, message 3: samples 2 to 4 are missing before it, expected consecutive numbers"),
        ([3, 4, 4, 5], "response, message 3: sample number 4 after 4, expected consecutive numbers of one run"),
        ([3, 4, 0, 1], "response, message 3: sample number 0 after 4, expected consecutive numbers of one run"),
    ],
)
def test_numbers_that_are_not_consecutive_are_named(tmp_path, numbers, message):
    with BagWriter(tmp_path / "bag", {}) as bag:
        topic = bag.add_topic("/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
        for k, number in enumerate(numbers):
            late = START + STEP * k
            bag.write(topic, serialised(response_message(number, VALUES[[0] * 10], late // 10**9, k)), late, late)
    with pytest.raises(AbraceError, match=f"^ground motion .*{message}"):
        read_record(tmp_path / "bag", channel="response:ground_acceleration")


def test_step_that_changes_during_a_recording_is_refused(tmp_path):
    stamps = START + np.cumsum(np.where(np.arange(400) < 200, STEP, 1.3 * STEP)).astype(int)
    path = write_bag(tmp_path / "bag", np.zeros(400), stamps.tolist())
    with pytest.raises(AbraceError, match=r"ground_motion, message \d+: .* s off equal steps of 0\.0023.* s, expected"):
        read_record(path, channel="ground_motion:accel.linear.x")


def test_value_that_is_no_number_is_told_by_message(tmp_path):
    path = write_bag(tmp_path / "bag", [0.0, 1.0, np.nan, 1.0])
    with pytest.raises(AbraceError, match="bare, message 3: nan, expected a finite acceleration"):
        read_record(path, channel="bare:x")


def test_bag_that_was_cut_off_is_not_whole(tmp_path):
    path = write_bag(tmp_path / "bag", np.zeros(500)) / "bag_0.mcap"
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rindex(b"serialized_metadata")])
    with pytest.raises(AbraceError, match=r"^ground motion .*bag_0.mcap: not whole: .*cut off or damaged"):
        read_record(path, channel="bare:x")


def test_bag_of_another_writer_without_checksums_is_read(tmp_path):
    with RosbagsWriter(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/ground_motion", ACCELERATION, typestore=STORE)
        for k, value in enumerate(VALUES):
            message = acceleration(START + STEP * k, value)
            bag.write(connection, START + k, bytes(STORE.serialize_cdr(message, ACCELERATION)))
    record = read_record(tmp_path / "other", channel="ground_motion:accel.linear.x")
    np.testing.assert_array_equal(record.acceleration, VALUES)


def test_directory_without_a_bag_and_file_that_is_none_are_told(tmp_path):
    (tmp_path / "folder.mat").mkdir()
    with pytest.raises(AbraceError, match=r"^ground motion .*folder.mat: no MCAP file in it, expected a bag directory"):
        read_record(tmp_path / "folder.mat", channel="a:b")
    (tmp_path / "a.mcap").write_bytes(b"SQLite format 3\0" * 9)
    with pytest.raises(AbraceError, match=r"^ground motion .*a.mcap: not an MCAP file"):
        read_record(tmp_path / "a.mcap", channel="a:b")
