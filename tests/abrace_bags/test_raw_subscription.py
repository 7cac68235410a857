"""What a raw subscription says was lost, and which publishers it takes: told apart without a middleware."""

from __future__ import annotations

from collections import deque
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_hash import TypeHash

from abrace_bags.nodes.raw_subscription import RawSubscription
from abrace_core.errors import AbraceError

UNKNOWN_HASH = TypeHash()


class Wire(nullcontext):
    """A subscription, and its handle: what waits, and how many publishers it hears."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: deque[int] = deque()
        self.publishers = 1
        self.msg_type = self.qos_profile = None
        self.handle = self

    def take_message(self, *_: object) -> tuple[bytes, dict[str, int]] | None:
        if not self.waiting:
            return None
        number = self.waiting.popleft()
        return b"", {"received_timestamp": 2, "source_timestamp": 1, "publication_sequence_number": number}

    def get_publisher_count(self) -> int:
        return self.publishers


def publisher(type_name: str = "std_msgs/msg/String", type_hash: TypeHash | None = None) -> TopicEndpointInfo:
    return TopicEndpointInfo(
        topic_type=type_name, qos_profile=QoSProfile(depth=1), topic_type_hash=type_hash or TypeHash()
    )


def subscribe(*publishers: TopicEndpointInfo) -> tuple[Wire, RawSubscription]:
    wire = Wire()
    node: Any = SimpleNamespace(create_subscription=lambda *_, **__: wire)
    return wire, RawSubscription(node, "/note", publishers or (publisher(),))


def hear(wire: Wire, subscription: RawSubscription, *numbers: int) -> None:
    wire.waiting.extend(numbers)
    taken: list[bytes] = []
    assert subscription.take(100, lambda payload, *_: taken.append(payload)) == len(numbers) == len(taken)


def test_what_the_numbers_leave_out_is_lost() -> None:
    wire, subscription = subscribe()
    hear(wire, subscription, 7, 8, 11)
    hear(wire, subscription, 14)
    assert subscription.lost == 4


def test_a_publisher_that_comes_back_has_numbers_of_its_own() -> None:
    wire, subscription = subscribe()
    hear(wire, subscription, 1, 2, 3)
    wire.publishers = 0
    assert subscription.count_publishers() == 0
    wire.publishers = 1
    hear(wire, subscription, 57, 58)
    assert subscription.lost == 0, "what it said before it was heard is not lost"
    hear(wire, subscription, 60)
    assert subscription.lost == 1


def test_losses_stay_said_when_a_second_publisher_comes_and_goes() -> None:
    wire, subscription = subscribe()
    hear(wire, subscription, 1, 5)
    wire.publishers = 2
    hear(wire, subscription, 6, 1, 7, 2, 9)
    assert subscription.lost == 3
    wire.publishers = 1
    hear(wire, subscription, 20, 22)
    assert subscription.lost == 4


def test_losses_of_a_publisher_that_has_gone_are_said() -> None:
    wire, subscription = subscribe()
    hear(wire, subscription, 1)
    wire.publishers = 0
    hear(wire, subscription, 4)
    assert subscription.lost == 2


def test_a_type_that_changes_is_refused() -> None:
    _, subscription = subscribe()
    with pytest.raises(AbraceError, match="/note: is of type std_msgs/msg/Bool now, expected std_msgs/msg/String"):
        subscription.follow([publisher("std_msgs/msg/Bool")], lambda *_: None)


def test_a_type_that_is_defined_otherwise_here_is_refused() -> None:
    with pytest.raises(AbraceError, match=r"String is published as RIHS01_0101.*, expected RIHS01_"):
        subscribe(publisher(type_hash=TypeHash(1, b"\1" * 32)))
    with pytest.raises(AbraceError, match=r"/note: .*no_such_msgs/Type is not installed"):
        subscribe(publisher("no_such_msgs/msg/Type"))
