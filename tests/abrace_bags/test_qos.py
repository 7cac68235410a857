# SPDX-License-Identifier: Apache-2.0
"""QoS of publishers: of live ones, as bags of every rosbag2 version have it, and combined of several."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9

from abrace_bags import offered_qos
from abrace_bags.qos import DEFAULT_QOS, UNKNOWN_QOS, combined_qos, common_qos, in_words, parse_qos
from abrace_core import AbraceError

BEST_EFFORT = DEFAULT_QOS._replace(reliability=QosReliability.BEST_EFFORT)
TRANSIENT_LOCAL = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL)
PROFILE = in_words(DEFAULT_QOS)


@pytest.mark.parametrize(
    ("profiles", "expected"),
    [
        ([], UNKNOWN_QOS),
        ([PROFILE], DEFAULT_QOS),
        ([{**PROFILE, "reliability": "best_effort"}], BEST_EFFORT),
        (
            [{**PROFILE, "history": 1, "depth": 4, "reliability": 2, "durability": 1}],
            BEST_EFFORT._replace(durability=QosDurability.TRANSIENT_LOCAL, depth=4),
        ),
        ([{**PROFILE, "history": "unknown", "depth": 0}], UNKNOWN_QOS),
        ([{**PROFILE, "reliability": "of a later version"}, {**PROFILE, "durability": 17}], DEFAULT_QOS),
        (
            [{**PROFILE, "history": 2, "liveliness": 3}],
            DEFAULT_QOS._replace(history=QosHistory.KEEP_ALL, liveliness=QosLiveliness.MANUAL_BY_TOPIC),
        ),
        ([{**PROFILE, "reliability": "best_effort"}, PROFILE], DEFAULT_QOS),
        ([{**PROFILE, "durability": "transient_local", "depth": 1}, PROFILE], TRANSIENT_LOCAL),
        (
            [
                {**PROFILE, "deadline": {"sec": 1, "nsec": 5}, "lifespan": {"sec": 2, "nsec": 0}},
                {**PROFILE, "deadline": {"sec": 9223372036, "nsec": 854775807}, "lifespan": {"sec": 3, "nsec": 0}},
            ],
            DEFAULT_QOS._replace(deadline=QosTime(1, 5), lifespan=QosTime(3, 0)),
        ),
        ([{**PROFILE, "liveliness_lease_duration": {"sec": 2147483647, "nsec": 4294967295}}], DEFAULT_QOS),
        ([{**PROFILE, "deadline": {"sec": 0, "nsec": 0}, "lifespan": {"sec": 0, "nsec": 0}}], DEFAULT_QOS),
        ([{**PROFILE, "depth": 2**40}], DEFAULT_QOS._replace(depth=2**31 - 1)),
    ],
)
def test_one_publisher_can_serve_the_subscribers_of_all_recorded_ones(
    profiles: list[dict[str, Any]], expected: Qos
) -> None:
    assert combined_qos(parse_qos(yaml.safe_dump(profiles))) == expected


@pytest.mark.parametrize(
    "text",
    [
        "a: 1",
        "- 3",
        "[",
        "- {deadline: {sec: 1}}",
        "- {depth: many}",
        "- {depth: .inf}",
        "- {deadline: 3}",
        "[" * 100_000,
        yaml.safe_dump([{**PROFILE, "depth": -1}]),
        yaml.safe_dump([{**PROFILE, "depth": "many"}]),
        yaml.safe_dump([{**PROFILE, "lifespan": {"sec": -1, "nsec": 0}}]),
    ],
)
def test_qos_that_makes_no_sense_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(AbraceError, match=r"^QoS: [^\n]*, expected [^\n]*$"):
        combined_qos(parse_qos(text))


def test_qos_is_written_in_rosbag2s_words_and_read_again() -> None:
    profiles = [DEFAULT_QOS, BEST_EFFORT._replace(history=QosHistory.UNKNOWN, depth=0, deadline=QosTime(1, 500))]
    words = [in_words(profile) for profile in profiles]
    assert words == dump_qos_v9(profiles)
    assert [list(one) for one in words] == [list(one) for one in dump_qos_v9(profiles)], "in the same order"
    assert parse_qos(yaml.safe_dump(words)) == profiles


def test_a_subscriber_may_ask_for_what_all_publishers_offer() -> None:
    assert common_qos([TRANSIENT_LOCAL, TRANSIENT_LOCAL], 7) == TRANSIENT_LOCAL._replace(depth=7)
    assert common_qos([TRANSIENT_LOCAL, DEFAULT_QOS], 7) == DEFAULT_QOS._replace(depth=7)
    assert common_qos([BEST_EFFORT, DEFAULT_QOS], 7) == BEST_EFFORT._replace(depth=7)
    short = DEFAULT_QOS._replace(lifespan=QosTime(10, 0))
    assert common_qos([short], 7) == DEFAULT_QOS._replace(depth=7), "a late message is recorded all the same"


def test_qos_of_rclpy_goes_there_and_back() -> None:
    rclpy_qos = pytest.importorskip("rclpy.qos")
    duration = pytest.importorskip("rclpy.duration")
    endpoint = pytest.importorskip("abrace_bags.nodes.endpoint")
    profile = rclpy_qos.QoSProfile(
        depth=7,
        reliability=rclpy_qos.ReliabilityPolicy.BEST_EFFORT,
        durability=rclpy_qos.DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=rclpy_qos.LivelinessPolicy.AUTOMATIC,
        deadline=duration.Duration(seconds=1, nanoseconds=500),
    )
    qos = offered_qos(profile)
    assert (qos.history, qos.depth, qos.deadline) == (QosHistory.KEEP_LAST, 7, QosTime(1, 500))
    assert (qos.reliability, qos.durability) == (QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL)
    assert endpoint.qos_profile(qos) == profile
