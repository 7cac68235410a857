# SPDX-License-Identifier: Apache-2.0
"""Topics of which one of several messages was recorded: what is missing, what the readers and tools make of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from mcap.reader import make_reader
from reference_messages import DEFINITIONS, HASHES, RESPONSE, STRING, note, response_message, serialised

from abrace import identify_ambient
from abrace.bag_command import bag_information
from abrace_bags import Bag, BagWriter, describe, merge, read_run, read_runs, recover, trim
from abrace_bags.playback import response_topic
from abrace_bags.recording import EveryNth, parse_every
from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_sysid.examination import prepared
from abrace_sysid.recorded.test import Test
from abrace_sysid.validation import compare

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

TOPIC = "/lab/response"
FACTS = {"every of /lab/response": "5", "sample_period": "0.002"}
SAMPLES = range(0, 500, 5)


def sample(number: int) -> bytes:
    values = np.random.default_rng(number).normal(size=10)
    values[8] = 0.0  # the command
    return serialised(response_message(number, values, 9 + number // 500, number % 500 * 2_000_000))


def write(path: Path, numbers: Sequence[int] = SAMPLES, facts: dict[str, str] | None = None) -> Path:
    with BagWriter(path, FACTS if facts is None else facts) as bag:
        topic = bag.add_topic(TOPIC, RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
        for number in numbers:
            bag.write(topic, sample(number), 2_000_000 * number, 2_000_000 * number)
    return path


def chunk_end(file: Path) -> int:
    """Where the only chunk of a `file` ends."""
    with file.open("rb") as opened:
        summary = make_reader(opened).get_summary()
    assert summary is not None
    (chunk,) = summary.chunk_indexes
    return chunk.chunk_start_offset + chunk.chunk_length


def test_those_are_kept_whose_number_it_divides_and_a_lost_one_of_these_is_lost() -> None:
    every = EveryNth(5, DEFINITIONS[RESPONSE])
    received = [0, 1, 2, 6, 7, 8, 9, 10, 15, 31, 32, 3, 5]
    found = [
        every.add(sample(number), missing)
        for number, missing in zip(received, [0, 0, 0, 3, 0, 0, 0, 0, 4, 15, 0, 0, 1], strict=True)
    ]
    assert [number for number, (kept, _) in zip(received, found, strict=True) if kept] == [0, 10, 15, 5]
    assert {number: lost for number, (_, lost) in zip(received, found, strict=True) if lost} == {6: 1, 31: 3}
    assert every.add(sample(22), 1) == (False, 1), "of the 16 numbers that are left out one message was published"
    assert every.add(b"", 2) == (True, 2)


def test_messages_without_numbers_are_counted() -> None:
    every = EveryNth(3, DEFINITIONS[STRING])
    assert [every.add(note("said"), missing) for missing in (0, 0, 0, 0, 2, 1, 4)] == [
        *((True, 0), (False, 0), (False, 0), (True, 0)),
        *((True, 0), (False, 0), (False, 2)),
    ]


@pytest.mark.parametrize(
    "text", ["response", "=5", "response=", "response=0", "response=-1", "response=2.5", "response=²"]
)
def test_what_says_of_no_topic_how_many_are_kept_is_refused(text: str) -> None:
    with pytest.raises(AbraceError, match=r"parameter every: '.*', expected topic=n, one of n messages, as response=5"):
        parse_every([text])
    with pytest.raises(AbraceError, match=r"parameter every: .*, expected each topic once"):
        parse_every(["response=2", "response=3"])


@pytest.mark.parametrize("check", [False, True])
def test_numbers_that_were_left_out_are_not_missing_and_the_rate_is_that_of_the_record(
    tmp_path: Path, check: bool
) -> None:
    found = describe(write(tmp_path / "bag", [number for number in SAMPLES if number not in (20, 25, 60)]), check)
    topic = found.contents[TOPIC]
    assert (topic.messages, topic.gaps, topic.missing) == (97, 2, 3)
    assert topic.rate == pytest.approx(100.0)
    assert found.warnings == ()
    assert "every of /lab/response: 5" in bag_information(tmp_path / "bag", check).splitlines()


def test_a_bag_that_was_cut_off_has_the_same_numbers_missing(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", [0, 5, 10, 20, 25])
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: chunk_end(file)])
    missing = f"topic {TOPIC}: 1 of the samples 0 to 25 are missing, later ones are not known"
    assert any(missing in warning for warning in describe(bag).warnings)
    opened = Bag(bag)
    opened.arrays()
    assert any(missing in warning for warning in opened.warnings)


def test_a_run_has_the_period_of_the_record_and_says_that_motion_is_folded(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "bag"))
    assert run.sample_period == pytest.approx(0.01)
    np.testing.assert_array_equal(run.sequence, np.arange(100))
    np.testing.assert_allclose(run.time, 0.002 * np.array(SAMPLES), atol=1e-12)
    assert run.facts["every"] == 5
    (warning,) = run.facts["warnings"]
    assert warning.endswith(
        "one of 5 samples was recorded, without a filter: motion above 50 Hz is folded into what is below"
    )
    assert read_run(write(tmp_path / "silent", facts={"every of /lab/response": "5"})).sample_period == pytest.approx(
        0.01
    )


def test_a_gap_in_the_record_is_told_in_the_rigs_numbers(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", [*range(0, 100, 5), *range(110, 500, 5)])
    with pytest.raises(AbraceError, match="sample 95 is followed by sample 110, expected 100"):
        read_run(bag)
    first, _ = read_runs(bag)
    assert (
        "a gap after sample 95 (2 samples, 0.02 s); samples 0 to 95 are used, 0.2 s of 0.98"
        in first.facts["warnings"][1]
    )


def test_what_needs_the_inputs_between_the_samples_refuses_the_record(tmp_path: Path) -> None:
    run = read_run(write(tmp_path / "bag"))
    refused = (
        r"bag: of 5 samples one was recorded: what the inputs did between them is not known, and motion above 50 Hz"
    )
    with pytest.raises(AbraceError, match=refused):
        prepared(Test.of(run), {"w": (1.0, 10.0)})
    model = LinearModel([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=("w", "U"), outputs=("x1",))
    with pytest.raises(AbraceError, match=refused):
        compare(run, model)


def test_an_ambient_test_is_taken_with_a_word(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(0, 20_000, 5))
    with pytest.warns(UserWarning, match="motion above 50 Hz is folded"):
        identify_ambient(bag, band=(1.0, 40.0))


def test_copies_keep_what_is_said_of_their_topics_and_bags_that_differ_are_not_merged(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", facts={**FACTS, "every of /note": "2"})
    recover(bag, tmp_path / "recovered")
    trim(bag, tmp_path / "trimmed", ["response"], 0.1, 0.2)
    for copy in ("recovered", "trimmed"):
        assert Bag(tmp_path / copy).facts == FACTS
        assert describe(tmp_path / copy).contents[TOPIC].missing == 0
    later = write(tmp_path / "later", range(1000, 1100), {"sample_period": "0.002"})
    with pytest.raises(
        AbraceError, match=r"later: topic /lab/response: one of 1 messages, expected one of 5 as in the"
    ):
        merge(tmp_path / "merged", [bag, later])


def test_no_controller_answers_a_part_of_the_samples(tmp_path: Path) -> None:
    with pytest.raises(AbraceError, match="of 5 samples of /lab/response one was recorded, expected all"):
        response_topic(Bag(write(tmp_path / "bag")).raw())
