# SPDX-License-Identifier: Apache-2.0
"""A part of a bag, and several bags in one, as we and independent readers read them."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Any

import mcap.reader
import numpy as np
import pytest
from bag_contents import lost_messages
from reference_messages import DEFINITIONS, HASHES, RESPONSE, STRING, note, response_message, serialised
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from abrace_bags import (
    DEFAULT_QOS,
    Bag,
    BagWriter,
    CopiedBag,
    file_attachments,
    merge,
    message_definition,
    recover,
    trim,
)
from abrace_core import AbraceError

if TYPE_CHECKING:
    from pathlib import Path

MILLISECOND = 10**6
START = 1_700_000_000 * 10**9
LATCHED = DEFAULT_QOS._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)

Message = tuple[str, bytes, int, int]
"""Topic, payload, log time and publish time [ms] since the start."""


def sample(number: int) -> bytes:
    values = np.random.default_rng(number).normal(size=10)
    return bytes(serialised(response_message(number, values, 0, number)))


def samples(first: int, last: int) -> list[Message]:
    """A sample every 2 ms, each published 1 ms before it is logged."""
    return [("/lab/response", sample(k), 2 * k + 1, 2 * k) for k in range(first, last)]


def write(path: Path, messages: list[Message], facts: dict[str, str] | None = None, **options: Any) -> Path:
    """A bag of samples and notes, which are transient local."""
    with BagWriter(path, facts or {}, **options) as bag:
        numbers: dict[str, int] = {}
        for topic, payload, log_time, publish_time in messages:
            if topic not in numbers:
                kind, qos = (RESPONSE, DEFAULT_QOS) if "response" in topic else (STRING, LATCHED)
                numbers[topic] = bag.add_topic(topic, kind, DEFINITIONS[kind], HASHES[kind], qos)
            times = START + log_time * MILLISECOND, START + publish_time * MILLISECOND
            bag.write(numbers[topic], payload, *times)
    return path


def read(path: Path) -> list[Message]:
    """The messages as we read them: the same that rosbags and mcap read, in the order of the log times."""
    found = Bag(path)
    ours = [
        (topic, payload, (log - START) // MILLISECOND, (publish - START) // MILLISECOND)
        for topic, payload, log, publish in found.raw()
    ]
    assert not found.warnings
    with Reader(path) as reader:
        theirs = [(one.topic, bytes(raw), (time - START) // MILLISECOND) for one, time, raw in reader.messages()]
    assert theirs == [message[:3] for message in ours]
    (file,) = path.glob("*.mcap")
    with file.open("rb") as opened:
        messages = list(mcap.reader.make_reader(opened, validate_crcs=True).iter_messages(log_time_order=False))
    assert [
        (channel.topic, one.data, (one.log_time - START) // MILLISECOND, (one.publish_time - START) // MILLISECOND)
        for _, channel, one in messages
    ] == ours, "written in the order of the log times"
    return ours


def test_a_part_has_its_messages_and_all_else_of_the_bag(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("storeys: 3\n")
    facts, records = {"record": "el_centro"}, {"abrace_versions": {"mcap": "1"}}
    notes: list[Message] = [("/lab/note", note(f"{k}"), 250 * k, 250 * k) for k in range(4)]
    messages = sorted([*samples(0, 500), *notes], key=itemgetter(2))
    unordered = [*samples(0, 500), *notes]
    whole = write(tmp_path / "whole", unordered, facts, records=records, attachments=file_attachments([rig]))
    for topics, start_offset, duration in (
        ((), 0.0, 0.0),
        ((), 0.25, 0.5),
        (("response",), 0.0, 0.1),
        (("/lab/note", "response"), 0.9, 0.0),
        (("note",), 0.25, 0.25),
    ):
        part = tmp_path / f"{len(topics)}_{start_offset}_{duration}"
        copied = trim(whole, part, topics, start_offset, duration)
        chosen = [one for one in messages if not topics or any(one[0].endswith(topic) for topic in topics)]
        begin = chosen[0][2] + 1000 * start_offset
        end = begin + 1000 * duration if duration else 10_000
        expected = [one for one in chosen if begin <= one[2] < end]
        assert read(part) == expected
        assert copied.counts == {name: sum(one[0] == name for one in expected) for name in copied.counts}
        assert copied.warnings == ()
        found = Bag(part)
        assert (found.facts, found.metadata["abrace_versions"]) == (facts, records["abrace_versions"])
        assert [(one.name, one.data) for one in found.attachments] == [("rig.yaml", b"storeys: 3\n")]
        for name, topic in found.topics.items():
            original = Bag(whole).topics[name]
            assert (topic.definition, topic.type_hash, topic.qos) == (
                original.definition,
                original.type_hash,
                original.qos,
            )


def test_a_part_of_a_test_is_a_test(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", samples(0, 500), {"sample_period": "0.002"})
    trim(whole, tmp_path / "part", ["response"], 0.2, 0.4)
    (run,) = Bag(tmp_path / "part").runs()
    assert run.outputs.shape[0] == 200
    assert not lost_messages(Bag(tmp_path / "part").metadata)["/lab/response"]


def test_bags_of_one_test_come_together_in_the_order_of_their_times(tmp_path: Path) -> None:
    facts = {"rig": "ncree", "record": "el_centro"}
    rig = tmp_path / "rig.yaml"
    rig.write_text("storeys: 3\n")
    notes: list[Message] = [("/lab/note", note(f"{k}"), 100 * k, 100 * k) for k in range(10)]
    first = write(tmp_path / "rig", samples(0, 250), facts, attachments=file_attachments([rig]))
    second = write(tmp_path / "notes", notes, facts, attachments=file_attachments([rig]))
    third = write(tmp_path / "later", samples(250, 500), facts)
    copied = merge(tmp_path / "all", [third, second, first])
    assert read(tmp_path / "all") == sorted([*samples(0, 250), *samples(250, 500), *notes], key=itemgetter(2))
    assert copied == CopiedBag({"/lab/response": 500, "/lab/note": 10}, ())
    found = Bag(tmp_path / "all")
    assert found.facts == facts
    assert [(one.name, one.data) for one in found.attachments] == [("rig.yaml", b"storeys: 3\n")]
    assert found.topics["/lab/note"].offers == [LATCHED]


def test_what_differs_between_bags_is_kept_of_each_with_its_name(tmp_path: Path) -> None:
    bags = []
    for name in ("controlled", "uncontrolled"):
        model = tmp_path / name / "model.json"
        model.parent.mkdir()
        model.write_text(name[:3])
        facts = {"rig": "ncree", "controller": name, name: "yes"}
        options = {"records": {"notes": {"by": name}}, "attachments": file_attachments([model])}
        bags.append(write(tmp_path / "bags" / name, samples(0, 10), facts, **options))
    (warning,) = merge(tmp_path / "both", bags).warnings
    assert warning == f"topic /lab/response: {bags[0]} and {bags[1]} have messages of the same time, which are mixed"
    found = Bag(tmp_path / "both")
    assert found.facts == {
        "rig": "ncree",
        "controlled/controller": "controlled",
        "uncontrolled/controller": "uncontrolled",
        "controlled": "yes",
        "uncontrolled": "yes",
    }
    assert found.metadata["uncontrolled/notes"] == {"by": "uncontrolled"}
    assert {one.name: one.data for one in found.attachments} == {
        "controlled/model.json": b"con",
        "uncontrolled/model.json": b"unc",
    }


def test_bags_of_one_name_are_told_apart_and_offers_of_all_publishers_kept(tmp_path: Path) -> None:
    bags = [tmp_path / folder / "run" for folder in ("east", "west")]
    for bag, qos in zip(bags, (LATCHED, DEFAULT_QOS), strict=True):
        with BagWriter(bag, {"place": bag.parent.name}) as writer:
            topic = writer.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING], qos)
            for k in range(3):
                writer.write(topic, note(bag.parent.name), START + k, START)
    assert merge(tmp_path / "both", bags).warnings == (), "notes of two places may be mixed"
    found = Bag(tmp_path / "both")
    assert found.facts == {f"{bags[0]}/place": "east", f"{bags[1]}/place": "west"}
    assert found.topics["/note"].offers == [LATCHED, DEFAULT_QOS]


def test_a_recovered_bag_is_in_the_order_of_the_recording(tmp_path: Path) -> None:
    messages = [*samples(5, 10), *samples(0, 5)]
    recover(write(tmp_path / "bag", messages), tmp_path / "whole")
    with (tmp_path / "whole/whole_0.mcap").open("rb") as file:
        found = mcap.reader.make_reader(file).iter_messages(log_time_order=False)
        assert [one.data for _, _, one in found] == [payload for _, payload, *_ in messages]


def test_losses_of_the_bags_add_up(tmp_path: Path) -> None:
    for name, lost in (("one", 2), ("two", 3)):
        with BagWriter(tmp_path / name, {}) as bag:
            topic = bag.add_topic("/note", STRING, DEFINITIONS[STRING], HASHES[STRING])
            bag.write(topic, note("a"), START, START)
            bag.add_lost(topic, lost)
    merge(tmp_path / "both", [tmp_path / "one", tmp_path / "two"])
    assert lost_messages(Bag(tmp_path / "both").metadata) == {"/note": 5}
    assert Bag(tmp_path / "both").raw().count == 2


def test_copies_that_cannot_be_are_refused_and_leave_nothing(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", [*samples(0, 10), ("/lab/note", note("a"), 50, 50)])
    other = write(tmp_path / "other", samples(0, 10))
    with BagWriter(tmp_path / "odd", {}) as odd:
        imu = message_definition("std_msgs/msg/Header")
        odd.write(odd.add_topic("/lab/note", imu.type_name, imu.text, imu.type_hash), b"\0\1\0\0" + bytes(12), 1, 1)
    BagWriter(tmp_path / "empty", {}).close()
    before = sorted(path.name for path in tmp_path.iterdir())
    new, odd_type = tmp_path / "new", "topic /lab/note: std_msgs/msg/Header is not the std_msgs/msg/String of"
    for copy, complaint in (
        (lambda: trim(bag, other), f"bag {other} exists already, expected a new directory"),
        (lambda: trim(bag, bag), f"bag {bag} exists already"),
        (lambda: trim(bag, new, ["force"]), "no topic force in it"),
        (lambda: trim(bag, new, (), 1.0), "there is no message from 1 s to the end"),
        (lambda: trim(bag, new, (), 0.03, 0.01), "there is no message from 0.03 s to 0.04 s"),
        (lambda: trim(tmp_path / "none", new), "none: no such bag"),
        (lambda: merge(other, [bag]), f"bag {other} exists already"),
        (lambda: merge(new, [bag, tmp_path / "other/../bag"]), "is named twice"),
        (lambda: merge(new, [bag, tmp_path / "odd"]), odd_type),
        (lambda: merge(new, [tmp_path / "empty"]), "there is no message"),
    ):
        with pytest.raises(AbraceError) as raised:
            copy()
        assert complaint in str(raised.value)
        assert sorted(path.name for path in tmp_path.iterdir()) == before
