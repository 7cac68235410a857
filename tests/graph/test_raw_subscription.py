# SPDX-License-Identifier: Apache-2.0
"""A raw subscription over real DDS: which messages it counts as lost, which publishers it refuses or follows."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability
from std_msgs.msg import String, UInt8MultiArray

from abrace_bags.nodes.endpoint import Publisher, publishers_of
from abrace_bags.nodes.raw_subscription import DEPTH, MEMORY, RawSubscription
from abrace_bags.qos import DEFAULT_QOS
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 60.0
KEPT = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
TRANSIENT_LOCAL = QoSProfile(
    depth=5, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def until(holds: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline, f"waited {PATIENCE:g} s for {what}"
        time.sleep(0.005)


class Topic:
    """A topic of its own: publishers on one node, a raw subscription on another, and what that has received."""

    def __init__(self, name: str, context: rclpy.Context, here: rclpy.Context, message_type: type) -> None:
        self.name, self.message_type = name, message_type
        self.publishing = rclpy.create_node("publishing", context=here)
        self.receiving = rclpy.create_node("receiving", context=context)
        self.received: list[bytes] = []
        self.subscription: Any = None

    def publisher(self, qos: QoSProfile = KEPT) -> Any:
        """A publisher, matched with the subscription if there is one already."""
        publishers = self.publishing.count_publishers(self.name)
        publisher = self.publishing.create_publisher(self.message_type, self.name, qos)
        until(lambda: len(publishers_of(self.receiving, self.name)) == publishers + 1, "its discovery")
        if self.subscription is None:
            self.subscription = RawSubscription(
                self.receiving, self.name, publishers_of(self.receiving, self.name), False
            )
        self.subscription.follow(publishers_of(self.receiving, self.name))
        until(publisher.get_subscription_count, "a match")
        until(lambda: self.subscription.count_publishers() == publishers + 1, "a match of the subscription")
        return publisher

    def leave(self, publisher: Any) -> None:
        """Destroy a publisher."""
        before = len(publishers_of(self.receiving, self.name))
        self.publishing.destroy_publisher(publisher)
        until(lambda: len(publishers_of(self.receiving, self.name)) == before - 1, "the publisher's end")

    def receive(self, count: int) -> None:
        """Receive until there are so many messages in all."""

        def enough() -> bool:
            self.subscription.receive(DEPTH, lambda payload, *_: self.received.append(payload))
            return len(self.received) >= count

        until(enough, f"{count} messages")
        assert len(self.received) == count

    def close(self) -> None:
        self.publishing.destroy_node()
        self.receiving.destroy_node()


def texts(topic: Topic) -> list[str]:
    return [payload[8:-1].decode() for payload in topic.received]


def say(publisher: Any, *said: object) -> None:
    for one in said:
        publisher.publish(String(data=str(one)))
    assert publisher.wait_for_all_acked()


@pytest.fixture
def topic(request: pytest.FixtureRequest, domain: int, context: rclpy.Context) -> Iterator[Topic]:
    here = rclpy.Context()
    here.init(domain_id=domain)
    topic = Topic(f"/{request.node.name.partition('[')[0]}", context, here, getattr(request, "param", String))
    try:
        yield topic
    finally:
        topic.close()
        here.try_shutdown()


def test_messages_that_the_middleware_dropped_are_lost(topic: Topic) -> None:
    publisher = topic.publisher()
    say(publisher, "first")
    topic.receive(1)
    assert topic.subscription.lost == 0
    say(publisher, *range(DEPTH + 3))
    topic.receive(1 + DEPTH)
    assert topic.subscription.lost == 3
    say(publisher, *range(DEPTH + 2))
    topic.leave(publisher)
    topic.receive(1 + 2 * DEPTH)
    assert topic.subscription.lost == 5, "of a publisher that has gone, too"


def test_each_publisher_has_numbers_of_its_own(topic: Topic) -> None:
    first = topic.publisher()
    say(first, 1, 2, 3)
    topic.receive(3)
    second = topic.publisher()
    say(first, 4)
    say(second, 5)
    say(first, 6)
    topic.receive(6)
    topic.leave(first)
    say(second, 7)
    topic.receive(7)
    topic.leave(second)
    third = topic.publisher()
    say(third, *range(20))
    topic.receive(27)
    assert topic.subscription.lost == 0


def test_a_publisher_that_offers_less_is_followed_and_nothing_is_lost_or_doubled(topic: Topic) -> None:
    first = topic.publisher(TRANSIENT_LOCAL)
    assert topic.subscription.transient_local
    say(first, 1, 2)
    topic.receive(2)
    second = topic.publisher(QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    assert not topic.subscription.transient_local
    say(first, 3)
    say(second, 4)
    topic.receive(4)
    topic.publisher(TRANSIENT_LOCAL)
    say(first, 5)
    topic.receive(5)
    assert texts(topic) == ["1", "2", "3", "4", "5"]


@pytest.mark.parametrize("topic", [UInt8MultiArray], indirect=True)
@pytest.mark.parametrize("qos", [KEPT, TRANSIENT_LOCAL])
def test_large_messages_that_wait_are_few_and_each_is_received_once(topic: Topic, qos: QoSProfile) -> None:
    size = 2_000_000
    publisher = topic.publisher(qos)

    def publish(numbers: range) -> None:
        for number in numbers:
            publisher.publish(UInt8MultiArray(data=bytes([number]) * size))
            assert publisher.wait_for_all_acked()

    publish(range(5))
    topic.receive(5)
    publish(range(5, 10))
    topic.receive(10)
    assert [payload[-1] for payload in topic.received] == list(range(10))
    publish(range(10, 60))
    topic.receive(10 + MEMORY // (2 * (size + 100)))
    assert topic.received[-1][-1] == 59
    assert topic.subscription.lost == 60 - len(topic.received)


def test_a_type_that_changes_or_is_defined_otherwise_here_is_refused(topic: Topic) -> None:
    def offer(type_name: str, type_hash: str = "") -> Publisher:
        return Publisher(type_name, type_hash, DEFAULT_QOS._replace(durability=QosDurability.VOLATILE))

    topic.publisher()
    with pytest.raises(
        AbraceError, match=f"{topic.name}: is of type std_msgs/msg/Bool now, expected std_msgs/msg/String"
    ):
        topic.subscription.follow([offer("std_msgs/msg/Bool")])
    with pytest.raises(AbraceError, match=r"String is published as RIHS01_0101.*, expected RIHS01_"):
        RawSubscription(topic.receiving, topic.name, [offer("std_msgs/msg/String", "RIHS01_0101")], False)
    with pytest.raises(AbraceError, match=rf"{topic.name}: .*no_such_msgs/Type is not installed"):
        RawSubscription(topic.receiving, topic.name, [offer("no_such_msgs/msg/Type")], False)
