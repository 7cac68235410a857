# SPDX-License-Identifier: Apache-2.0
"""The QoS that streams are published with, as other nodes see it."""

from abrace_node.transport import lockstep_environment

TWO_SECONDS = 2_000_000_000
STREAMS = ("response", "joint_states", "ground_motion")


def lifespans(graph):
    """Of each stream [ns]."""
    graph.start("plant")
    graph.start("ground_motion")
    topics = {topic: graph.node.resolve_topic_name(topic) for topic in STREAMS}

    def offered():
        found = {topic: graph.node.get_publishers_info_by_topic(name) for topic, name in topics.items()}
        return found if all(found.values()) else None

    found = graph.until(offered, "all publishers")
    return {topic: one.qos_profile.lifespan.nanoseconds for topic, (one,) in found.items()}


def test_a_join_leaves_nothing_behind_in_the_streams_for_longer_than_two_seconds(graph):
    assert lifespans(graph) == dict.fromkeys(STREAMS, TWO_SECONDS)


def test_in_lockstep_a_message_waits_for_its_subscriber_as_long_as_it_takes(graph, monkeypatch):
    for name, value in lockstep_environment().items():
        monkeypatch.setenv(name, value)
    assert min(lifespans(graph).values()) > 1000 * TWO_SECONDS
