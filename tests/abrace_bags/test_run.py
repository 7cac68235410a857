# SPDX-License-Identifier: Apache-2.0
"""A bag's responses as a test of the rig: whole, finite and in order, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap_chunks import chunk_indexes
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from abrace_bags import Bag, BagWriter, describe, read_run, read_runs
from abrace_bags.stamps import MOST, StampStream
from abrace_core import AbraceError
from abrace_core.safety.wire import LOCKSTEP

if TYPE_CHECKING:
    from collections.abc import Sequence

RESPONSE = "abrace_interfaces/msg/Response"
MSG = Path(__file__).parents[2] / "src/abrace_interfaces/msg/Response.msg"
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(MSG.read_text(), RESPONSE))
TYPES: dict[str, Any] = dict(STORE.types)
DEFINITION = STORE.generate_msgdef(RESPONSE, ros_version=2)[0]
STEP = 4_000_000


def response(k: int, floors: int = 2, groups: int = 2) -> Any:
    """Sample k, whose values say what they are: tens for the quantity, ones for the place.

    The second group has two braces, which push by 0.25 more and less.
    """
    x = k / 1000
    time = TYPES["builtin_interfaces/msg/Time"](sec=5 + k * STEP // 10**9, nanosec=k * STEP % 10**9)
    header = TYPES["std_msgs/msg/Header"](stamp=time, frame_id="table")
    floor, group, braces = np.arange(floors), np.arange(groups), np.array([1, 2][:groups], dtype=np.uint8)
    brace = np.array([0, 0.75, 1.25][: sum(braces)])
    channels = (10 + floor + x, 20 + floor + x, 30 + group + x, 40 + brace + x, 50 + group + x)
    return TYPES[RESPONSE](header, k, 1, 0, 0, 3, braces, *channels, x, 0.0, "")


def write(
    directory: Path, messages: Sequence[Any], facts: dict[str, str], topics: Sequence[str] = ("/response",)
) -> Path:
    with BagWriter(directory, facts) as bag:
        for topic in topics:
            number = bag.add_topic(topic, RESPONSE, DEFINITION, "")
            for k, message in enumerate(messages):
                bag.write(number, bytes(STORE.serialize_cdr(message, RESPONSE)), k, k)
    return directory


def test_run_is_the_bag_with_named_channels(tmp_path: Path) -> None:
    facts = {"sample_period": "0.004", "rig": "two storeys"}
    run = read_run(write(tmp_path / "bag", [response(k) for k in range(7, 12)], facts))
    assert run.names == ("x1", "x2", "xf1", "xf2", "a1", "a2", "f1", "f2")
    np.testing.assert_allclose(run.outputs[0], np.array([10, 11, 30, 31, 20, 21, 40, 41]) + 0.007, rtol=1e-15)
    assert run.forces is not None
    np.testing.assert_allclose(run.forces[0], np.array([40, 40.75, 41.25]) + 0.007, rtol=1e-15)
    np.testing.assert_allclose(run.command[:, 1], 51 + np.arange(7, 12) / 1000, rtol=1e-15)
    np.testing.assert_array_equal(run.ground_acceleration, np.arange(7, 12) / 1000)
    np.testing.assert_array_equal(run.sequence, np.arange(7, 12))
    assert (run.floors, run.groups, run.braces, run.sample_period) == (2, 2, (1, 2), 0.004)
    assert run.facts == facts
    assert run.source == str(tmp_path / "bag")


def test_sample_period_is_the_stamps_where_the_facts_are_silent(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "bag", [response(k) for k in range(5)], {}))
    assert run.sample_period == pytest.approx(0.004, rel=1e-12)


@pytest.mark.parametrize("value", ["0", "-0.002", "nan", "inf", "2 ms", ""])
def test_sample_period_that_is_none_is_refused(tmp_path: Path, value: str) -> None:
    bag = write(tmp_path / "bag", [response(0)], {"sample_period": value})
    with pytest.raises(AbraceError, match=rf"bag: topic /response: fact sample_period is {value!r}, expected seconds"):
        read_run(bag)


@pytest.mark.parametrize(("field", "counts"), [("uint64 clipped", {"x1": 3, "a2": 1, "w": 1}), ("uint64 other", None)])
def test_channels_at_the_end_of_their_range_are_counted_where_the_bag_says_so(
    tmp_path: Path, field: str, counts: dict[str, int] | None
) -> None:
    arrays = "".join(f"float64[] {name}\n" for name in ("displacement", "acceleration", "stroke", "force", "command"))
    text = f"std_msgs/Header header\nuint64 sequence\n{arrays}float64 ground_acceleration\n{field}\n"
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, RESPONSE))
    definition = store.generate_msgdef(RESPONSE, ros_version=2)[0]
    with BagWriter(tmp_path / "bag", {"sample_period": "0.004"}) as bag:
        number = bag.add_topic("/response", RESPONSE, definition, "")
        for k, bits in enumerate([0, 0b1, 0b100_0001, 0b1_0001, 0]):
            sample = response(k, groups=1)
            values = (getattr(sample, name) for name in list(store.types[RESPONSE].__dataclass_fields__)[1:-2])
            message = store.types[RESPONSE](sample.header, *values, bits)
            bag.write(number, bytes(store.serialize_cdr(message, RESPONSE)), k, k)
    assert read_run(tmp_path / "bag").clipped_samples == counts


def test_single_sample_without_period_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match="stamps do not increase and the facts have no sample_period"):
        read_run(write(tmp_path / "bag", [response(0)], {}))


def samples(*numbers: tuple[int, Sequence[int]]) -> list[Any]:
    """Samples of these numbers in each run, at their times."""
    found = []
    for run, sequence in numbers:
        for k in sequence:
            found.append(response(k))
            found[-1].run = run
    return found


def test_a_sample_that_a_rig_in_lockstep_says_again_counts_once(tmp_path: Path) -> None:
    recorded = samples((1, [0, 0, 0, 1, 2]), (2, [0, 0, 1]))
    for one in recorded:
        one.flags = LOCKSTEP
    one, other = read_runs(write(tmp_path / "bag", recorded, {"sample_period": "0.004"}))
    assert (one.sequence.tolist(), other.sequence.tolist()) == ([0, 1, 2], [0, 1])
    recorded[1].header.stamp.nanosec += 1
    assert len(read_runs(write(tmp_path / "other", recorded, {"sample_period": "0.004"}))) == 4, "another sample"


@pytest.mark.parametrize(
    ("recorded", "complaint"),
    [
        ([(1, [3, 4, 6, 9])], "sample 4 is followed by sample 6, expected 5"),
        ([(1, [3, 4, 4, 5])], r"sample 4 is followed by sample 4 of another run \(the rig was activated again\)"),
        ([(1, [3, 2])], r"sample 3 is followed by sample 2 of another run \(the rig was activated again\)"),
        (
            [(1, [3, 4]), (2, [5, 6])],
            "sample 4 is followed by sample 5 of another run",
        ),
    ],
)
def test_a_bag_of_several_runs_is_no_run(tmp_path: Path, recorded: Any, complaint: str) -> None:
    bag = write(tmp_path / "bag", samples(*recorded), {"sample_period": "0.004"})
    with pytest.raises(AbraceError, match=f"bag: {complaint}"):
        read_run(bag)
    sequence = [k for _, numbers in recorded for k in numbers]
    assert [number for run in read_runs(bag) for number in run.sequence.tolist()] == sequence


def test_runs_end_where_samples_are_missing_and_say_so(tmp_path: Path) -> None:
    first, second = [*range(900), *range(950, 2000), *range(2001, 2100)], range(2100, 2300)
    bag = write(tmp_path / "bag", samples((1, first), (2, second)), {"sample_period": "0.004"})
    runs = read_runs(bag)
    assert [run.sequence[[0, -1]].tolist() for run in runs] == [[0, 899], [950, 1999], [2001, 2099], [2100, 2299]]
    assert all((np.diff(run.sequence) == 1).all() for run in runs)
    gap = f"{bag}, run 1 of 2: a gap after sample 899 (50 samples, 0.2 s) and 1 more; samples"
    for run, span in zip(
        runs, ("0 to 899 are used, 3.6 s", "950 to 1999 are used, 4.2 s", "2001 to 2099"), strict=False
    ):
        (warning,) = run.facts["warnings"]
        assert warning.startswith(f"{gap} {span}")
    assert "warnings" not in runs[3].facts
    longest = Bag(bag).tests()
    assert [run.sequence[0] for run in longest] == [950, 2100]
    assert longest[0].facts["warnings"] == runs[1].facts["warnings"]


@pytest.mark.parametrize("facts", [{}, {"sample_period": "0.004"}])
def test_a_run_of_one_sample_costs_no_other(tmp_path: Path, facts: dict[str, str]) -> None:
    runs = read_runs(write(tmp_path / "bag", samples((1, range(1000)), (2, [0])), facts))
    assert [(run.sequence.size, run.sample_period) for run in runs] == [(1000, 0.004), (1, 0.004)]


def test_stamps_decide_against_the_stated_sample_period_with_a_warning(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "bag", samples((1, range(1000))), {"sample_period": "0.02"}))
    assert run.sample_period == 0.004
    (warning,) = run.facts["warnings"]
    assert "sample_period is 0.02 s, but the samples' stamps are 0.004 s apart" in warning


STAMPS = np.arange(3000) * STEP + 5 * 10**9
JUMPING = {
    "good": (STAMPS, []),
    "set ahead": (STAMPS + 3 * 10**9 * (np.arange(3000) >= 1400), ["the clock jumps ahead by 3 s after sample 1399"]),
    "repeated": (
        np.where(np.arange(3000) == 7, STAMPS[6], STAMPS),
        ["the stamp of sample 7 is that of the sample before"],
    ),
    "late": (STAMPS + 10**8 * (np.arange(3000) == 2000), ["the stamp of sample 2000 is 0.1 s too late"]),
    "a stamp of 0": (STAMPS * (np.arange(3000) != 100), ["the stamp of sample 100 is 5.4 s too early"]),
}


def stamped(messages: list[Any], stamps: Sequence[int]) -> list[Any]:
    for message, stamp in zip(messages, stamps, strict=True):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), 10**9)
    return messages


@pytest.mark.parametrize("case", JUMPING)
def test_stamps_that_jump_do_not_decide_the_rate_and_are_named(tmp_path: Path, case: str) -> None:
    stamps, faults = JUMPING[case]
    bag = write(tmp_path / "bag", stamped([response(k) for k in range(3000)], stamps), {})
    run = read_run(bag)
    assert run.sample_period == 0.004
    told = [f"{bag}: {fault}; the sample rate by all stamps is 250 Hz" for fault in faults]
    assert run.facts.get("warnings", []) == told
    # by the counts at its end, and by its messages
    assert [describe(bag, check).contents["/response"].rate for check in (False, True)] == pytest.approx([250.0] * 2)


def test_a_stated_period_holds_and_only_large_jumps_of_stamps_are_named(tmp_path: Path) -> None:
    messages, facts = [response(k) for k in range(3000)], {"sample_period": "0.004"}
    jumping = STAMPS + 25_000_000 * (np.arange(3000) >= 900)
    assert "warnings" not in read_run(write(tmp_path / "small", stamped(messages, jumping), facts)).facts
    jumping += 500_000_000 * (np.arange(3000) >= 2000)
    (warning,) = read_run(write(tmp_path / "large", stamped(messages, jumping), facts)).facts["warnings"]
    assert "the clock jumps ahead by 0.5 s after sample 1999" in warning


def test_a_jump_is_named_in_the_run_in_which_it_is(tmp_path: Path) -> None:
    numbers = [*range(1000), *range(800)]
    stamps = np.r_[STAMPS[:1000], STAMPS[:800] + 60 * 10**9 + 10**9 * (np.arange(800) >= 300)]
    first, second = read_runs(write(tmp_path / "bag", stamped([response(k) for k in numbers], stamps), {}))
    assert "warnings" not in first.facts, "the pause between the runs is no jump"
    assert "run 2 of 2: the clock jumps ahead by 1 s after sample 299;" in second.facts["warnings"][0]


def test_of_a_long_stream_some_stamps_are_enough() -> None:
    stream, numbers = StampStream(), np.arange(200_000)
    stamps = numbers * STEP + 10**12 * (numbers >= 123_456)
    for begin in range(0, 200_000, 777):
        stream.add(stamps[begin : begin + 777], numbers[begin : begin + 777])
    found = stream.times()
    assert found.period == pytest.approx(0.004, rel=1e-9)
    assert len(stream) <= MOST


def test_a_rig_that_was_activated_again_gives_a_run_each_time(tmp_path: Path) -> None:
    numbers = [*range(928, 2000), *range(1000), *range(2000)]
    bag = write(tmp_path / "bag", [response(k) for k in numbers], {"sample_period": "0.004"})
    runs = read_runs(bag)
    assert [(int(run.sequence[0]), run.sequence.size) for run in runs] == [(928, 1072), (0, 1000), (0, 2000)]
    # the first record began late, at sample 928, and keeps its time
    assert [run.time[0] for run in runs] == pytest.approx([3.712, 0.0, 0.0], rel=1e-12)
    assert [run.time[-1] for run in runs] == pytest.approx([7.996, 3.996, 7.996], rel=1e-12)
    assert runs[1].source == f"{bag}, run 2 of 3"
    with pytest.raises(AbraceError, match="sample 1999 is followed by sample 0 of another run"):
        read_run(bag)


@pytest.mark.parametrize("sorted_by_time", [False, True])
def test_a_clock_that_was_set_back_costs_no_sample_and_is_reported(tmp_path: Path, sorted_by_time: bool) -> None:
    times = [10**10 + STEP * k - 10**9 * (k >= 1000) for k in range(2000)]
    order = np.argsort(times, kind="stable").tolist() if sorted_by_time else range(2000)
    with BagWriter(tmp_path / "bag", {"sample_period": "0.004"}, split_size=100_000) as bag:
        number = bag.add_topic("/response", RESPONSE, DEFINITION, "")
        for k in order:
            bag.write(number, bytes(STORE.serialize_cdr(response(k), RESPONSE)), times[k], times[k])
    run = read_run(tmp_path / "bag")
    assert run.sequence.tolist() == list(range(2000))
    np.testing.assert_array_equal(run.ground_acceleration, np.arange(2000) / 1000)
    (warning,) = run.facts["warnings"]
    assert "topic /response: " in warning
    assert ("in that of the numbers" if sorted_by_time else "the clock was set back") in warning


@pytest.mark.parametrize("name", ["displacement", "stroke", "acceleration", "force", "command", "ground_acceleration"])
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_value_that_is_not_finite_is_named(tmp_path: Path, name: str, value: float) -> None:
    messages = [response(k) for k in range(4)]
    if name == "ground_acceleration":
        messages[2].ground_acceleration = value
    else:
        getattr(messages[2], name)[1] = value
    with pytest.raises(AbraceError, match=rf"{name} of sample 2 is .*{value}.*, expected finite values"):
        read_run(write(tmp_path / "bag", messages, {}))


def test_sizes_that_change_or_disagree_are_refused(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match="displacement does not have the same number of values in all samples"):
        read_run(write(tmp_path / "changing", [response(0), response(1, floors=3)], {}))
    messages = [response(k) for k in range(3)]
    for message in messages:
        message.acceleration = np.zeros(3)
    with pytest.raises(AbraceError, match=r"displacement, acceleration have \[2, 3\] values, expected equal numbers"):
        read_run(write(tmp_path / "disagreeing", messages, {}))
    for message in messages:
        message.acceleration, message.braces = message.displacement, np.array([2, 2], dtype=np.uint8)
    with pytest.raises(AbraceError, match=r"braces \[2, 2\] of 2 groups with 3 forces, expected one of each brace"):
        read_run(write(tmp_path / "braces", messages, {}))


def test_topic_is_found_or_asked_for(tmp_path: Path) -> None:
    bag = write(tmp_path / "two", [response(k) for k in range(3)], {}, ["/a/response", "/b/response"])
    with pytest.raises(AbraceError, match="has 2 topics of responses, name one of /a/response, /b/response"):
        read_run(bag)
    assert read_run(bag, "/b/response").sequence.size == 3
    with pytest.raises(AbraceError, match="no topic /c/response of type abrace_interfaces/msg/Response"):
        read_run(bag, "/c/response")
    with pytest.raises(AbraceError, match="no topic of type abrace_interfaces/msg/Response"):
        read_run(write(tmp_path / "none", [], {}, []))
    with pytest.raises(AbraceError, match="topic /response: has no messages"):
        read_run(write(tmp_path / "empty", [], {}))


def test_hole_in_a_damaged_bag_is_refused_with_its_cause(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", [response(k) for k in range(2000)], {})
    file = bag / "bag_0.mcap"
    indexes = chunk_indexes(file)
    chunk = indexes[len(indexes) // 2]
    content = bytearray(file.read_bytes())
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(AbraceError, match=r"is followed by sample .*messages of /response are missing"):
        read_run(bag)
