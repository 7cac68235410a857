# SPDX-License-Identifier: Apache-2.0
"""Bags: written ones are read back whole, by us and by independent readers, and damage is never read as good."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import mcap.reader
import mcap.stream_reader
import numpy as np
import pytest
import yaml
from bag_contents import read_topics
from mcap.writer import Writer
from reference_messages import DEFINITIONS, HASHES, RESPONSE, STRING, TYPES, note, response_message, serialised
from rosbags.rosbag2 import Reader

from abrace_bags import DEFAULT_QOS, Bag, BagWriter, recover
from abrace_core import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

FACTS = {"rig": "ncree: three storeys\nsecond line", "sample_period": "0.002", "empty": "", "größe": "½ #1"}
FIELDS = ("displacement", "acceleration", "stroke", "force", "command", "ground_acceleration")
START = 1_700_000_000_000_000_000


def response(k: int) -> Any:
    return response_message(k, np.random.default_rng(k).normal(size=10), k // 500, k % 500 * 2_000_000)


def write_bag(directory: Path, samples: int, flush_every: int = 10**9) -> list[Any]:
    """A bag of responses, and of a string after every fifth of them; returns the responses."""
    messages = [response(k) for k in range(samples)]
    with BagWriter(directory, FACTS) as bag:
        number = bag.add_topic(
            "/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE], DEFAULT_QOS._replace(depth=50)
        )
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
        for k, message in enumerate(messages):
            bag.write(number, serialised(message), START + 2_000_000 * k, START + 2_000_000 * k - 70_000)
            if k % 5 == 0:
                bag.write(notes, note(f"note {k}"), START + 2_000_000 * k + 1, START)
            if k % flush_every == flush_every - 1:
                bag.flush()
    return messages


def mcap_of(directory: Path) -> Path:
    return directory / f"{directory.name}_0.mcap"


def check_values(fields: dict[str, Any], messages: list[Any]) -> None:
    """Every value of these fields is that of the message of its sequence."""
    for i, k in enumerate(fields["sequence"]):
        message = messages[int(k)]
        assert fields["header.frame_id"][i] == "table"
        assert fields["header.stamp.sec"][i] == message.header.stamp.sec
        assert fields["header.stamp.nanosec"][i] == message.header.stamp.nanosec
        for name in FIELDS:
            np.testing.assert_array_equal(fields[name][i], getattr(message, name))


def test_bag_reads_back_value_for_value(tmp_path: Path) -> None:
    messages = write_bag(tmp_path / "bag", 1000)
    contents = read_topics(tmp_path / "bag")
    assert contents.warnings == ()
    assert contents.facts == FACTS
    assert set(contents) == {"/response", "/note"}
    found = contents["/response"]
    assert found.type_name == RESPONSE
    np.testing.assert_array_equal(found.fields["sequence"], np.arange(1000))
    assert found.fields["force"].shape == (1000, 1)
    assert found.fields["displacement"].dtype == np.float64
    check_values(found.fields, messages)
    np.testing.assert_array_equal(found.log_time, START + 2_000_000 * np.arange(1000))
    np.testing.assert_array_equal(found.publish_time, found.log_time - 70_000)
    assert list(contents["/note"].fields["data"]) == [f"note {k}" for k in range(0, 1000, 5)]


def test_a_bag_says_on_which_distribution_it_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    write_bag(tmp_path / "bag", 10)
    with Reader(tmp_path / "bag") as reader:
        assert reader.ros_distro == "kilted"


def test_metadata_is_what_rosbag2_writes(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 10)
    with Reader(tmp_path / "bag") as reader:
        connection = next(c for c in reader.connections if c.topic == "/response")
        assert connection.msgtype == RESPONSE
        assert connection.digest == HASHES[RESPONSE]
        assert connection.msgcount == 10
        (qos,) = connection.ext.offered_qos_profiles
        assert (qos.depth, qos.reliability.name, qos.durability.name) == (50, "RELIABLE", "VOLATILE")
        assert reader.start_time == START
        assert reader.duration == 9 * 2_000_000 + 1
        assert reader.ros_distro == "jazzy"
    text = (tmp_path / "bag/metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["custom_data"] == FACTS
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert "&" not in text, "rosbag2 writes no YAML anchors"
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]


def test_mcap_reads_our_file_with_profile_qos_hash_and_facts(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 10)
    with mcap_of(tmp_path / "bag").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        channel = next(c for c in summary.channels.values() if c.topic == "/response")
        schema = summary.schemas[channel.schema_id]
        assert (schema.name, schema.encoding, channel.message_encoding) == (RESPONSE, "ros2msg", "cdr")
        assert schema.data.decode() == DEFINITIONS[RESPONSE]
        assert channel.metadata["topic_type_hash"] == HASHES[RESPONSE]
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["depth"] == 50
        assert sum(1 for _ in reader.iter_messages()) == 12
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert FACTS.items() <= metadata["abrace"].items()


def test_bag_without_messages_is_a_bag(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 0)
    contents = read_topics(tmp_path / "bag")
    assert contents.warnings == ()
    assert contents["/response"].log_time.shape == (0,)
    assert contents["/response"].fields["header.stamp.sec"].shape == (0,)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 0


def test_existing_directory_is_refused_and_untouched(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 3)
    before = mcap_of(tmp_path / "bag").read_bytes()
    with pytest.raises(AbraceError, match="exists already"):
        BagWriter(tmp_path / "bag", {})
    assert mcap_of(tmp_path / "bag").read_bytes() == before


def test_killed_writer_leaves_all_that_was_flushed(tmp_path: Path) -> None:
    code = f"""
import os, signal
from abrace_bags import BagWriter
bag = BagWriter({str(tmp_path / "bag")!r}, {FACTS!r})
number = bag.add_topic("/note", {STRING!r}, {DEFINITIONS[STRING]!r}, "")
payload = {serialised(TYPES[STRING](data="whole"), STRING)!r}
for k in range(100):
    bag.write(number, payload, k, k)
bag.flush()
bag.write(number, payload, 100, 100)
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    contents = read_topics(tmp_path / "bag")
    assert contents.facts == Bag(tmp_path / "bag").facts == FACTS
    np.testing.assert_array_equal(contents["/note"].log_time, np.arange(100))
    assert set(contents["/note"].fields["data"]) == {"whole"}
    assert "cut off or damaged" in contents.warnings[0]


def test_damaged_facts_are_left_out_with_a_warning(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", 3)
    path = mcap_of(tmp_path / "bag")
    path.write_bytes(path.read_bytes().replace(b"three storeys", b"seven storeys", 1))
    damaged = Bag(path)
    assert damaged.facts == {}
    assert "facts do not match their checksum" in damaged.warnings[0]


def test_missing_bag_topic_and_file_are_reported(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match=r"nothing: no such bag"):
        read_topics(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(AbraceError, match=r"empty: no MCAP or sqlite3 file in it"):
        Bag(tmp_path / "empty")
    write_bag(tmp_path / "bag", 3)
    with pytest.raises(AbraceError, match=r"bag: no topic /respons in it, .*did you mean /response\?$"):
        read_topics(tmp_path / "bag", ["/respons"])


def test_topic_that_cannot_be_read_is_reported_or_refused_if_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(STRING, "ros2msg", DEFINITIONS[STRING].encode())
        good = writer.register_channel("/good", "cdr", schema)
        short = writer.register_channel("/short", "cdr", schema)
        empty = writer.register_channel("/empty", "cdr", schema)
        writer.add_message(empty, 1, b"", 1)
        odd = writer.register_channel("/odd", "json", writer.register_schema("odd", "jsonschema", b"{}"))
        writer.add_message(good, 1, serialised(TYPES[STRING](data="ok"), STRING), 1)
        writer.add_message(short, 1, b"\0\1\0\0\xff\0\0\0a", 1)
        writer.add_message(odd, 1, b"{}", 1)
        writer.finish()
    contents = read_topics(path)
    assert list(contents) == ["/good"]
    assert any("/short is left out: message 0" in warning for warning in contents.warnings)
    assert any("/empty is left out: message 0" in warning for warning in contents.warnings)
    assert any("/odd is left out" in warning and "'json'" in warning for warning in contents.warnings)
    assert recover(path, tmp_path / "whole").counts == {"/good": 1, "/short": 1, "/empty": 1, "/odd": 1}
    for bag in (path, tmp_path / "whole"):
        assert [message.payload for message in Bag(bag).raw(["/odd"])] == [b"{}"]
    with pytest.raises(AbraceError, match=r"topic /odd can't be read: its messages are written as 'json'"):
        read_topics(path, ["/odd"])
