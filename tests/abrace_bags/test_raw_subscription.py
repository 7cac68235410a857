"""Which messages a raw subscription counts as lost, and which publishers it refuses, without a middleware."""

from __future__ import annotations

from collections import deque
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
from rosbags.interfaces import QosDurability, QosReliability

from abrace_bags.nodes.raw_subscription import RawSubscription
from abrace_bags.qos import DEFAULT_QOS
from abrace_bags.topic_choice import Publisher
from abrace_core.errors import AbraceError


class Wire(nullcontext):
    """A subscription and its handle, with messages that have come and a number of publishers."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: deque[int] = deque()
        self.publishers = 1
        self.msg_type = None
        self.handle = self

    def take_message(self, *_: object) -> tuple[bytes, dict[str, int]] | None:
        if not self.waiting:
            return None
        number = self.waiting.popleft()
        return b"", {"received_timestamp": 2, "source_timestamp": 1, "publication_sequence_number": number}

    def get_publisher_count(self) -> int:
        return self.publishers


def publisher(type_name: str = "std_msgs/msg/String", type_hash: str = "", **qos: Any) -> Publisher:
    return Publisher(type_name, type_hash, DEFAULT_QOS._replace(**qos))


def subscribe(*publishers: Publisher) -> tuple[Wire, RawSubscription]:
    wire = Wire()
    node: Any = SimpleNamespace(create_subscription=lambda *_, **__: wire, destroy_subscription=lambda _: None)
    return wire, RawSubscription(node, "/note", publishers or (publisher(),))


def receive(wire: Wire, subscription: RawSubscription, *numbers: int) -> None:
    wire.waiting.extend(numbers)
    received: list[bytes] = []
    assert subscription.receive(100, lambda payload, *_: received.append(payload)) == len(numbers) == len(received)


def test_numbers_that_are_missing_are_lost_messages() -> None:
    wire, subscription = subscribe()
    receive(wire, subscription, 7, 8, 11)
    receive(wire, subscription, 14)
    assert subscription.lost == 4


def test_a_publisher_that_comes_back_has_numbers_of_its_own() -> None:
    wire, subscription = subscribe()
    receive(wire, subscription, 1, 2, 3)
    wire.publishers = 0
    assert subscription.count_publishers() == 0
    wire.publishers = 1
    receive(wire, subscription, 57, 58)
    assert subscription.lost == 0, "what it published before the match is not lost"
    receive(wire, subscription, 60)
    assert subscription.lost == 1


def test_losses_stay_when_a_second_publisher_comes_and_goes() -> None:
    wire, subscription = subscribe()
    receive(wire, subscription, 1, 5)
    wire.publishers = 2
    receive(wire, subscription, 6, 1, 7, 2, 9)
    assert subscription.lost == 3
    wire.publishers = 1
    receive(wire, subscription, 20, 22)
    assert subscription.lost == 4


def test_losses_of_a_publisher_that_has_gone_are_counted() -> None:
    wire, subscription = subscribe()
    receive(wire, subscription, 1)
    wire.publishers = 0
    receive(wire, subscription, 4)
    assert subscription.lost == 2


def test_a_type_that_changes_is_refused() -> None:
    _, subscription = subscribe()
    with pytest.raises(AbraceError, match="/note: is of type std_msgs/msg/Bool now, expected std_msgs/msg/String"):
        subscription.follow([publisher("std_msgs/msg/Bool")], lambda *_: None)


def test_a_type_that_is_defined_otherwise_here_is_refused() -> None:
    with pytest.raises(AbraceError, match=r"String is published as RIHS01_0101.*, expected RIHS01_"):
        subscribe(publisher(type_hash="RIHS01_0101"))
    with pytest.raises(AbraceError, match=r"/note: .*no_such_msgs/Type is not installed"):
        subscribe(publisher("no_such_msgs/msg/Type"))


def test_a_publisher_that_offers_less_is_followed_and_one_that_offers_more_is_not() -> None:
    wire, subscription = subscribe(publisher(durability=QosDurability.TRANSIENT_LOCAL))
    assert subscription.transient_local
    wire.waiting.extend((1, 2))
    assert subscription.follow([publisher()], lambda *_: None) == 2
    assert not subscription.transient_local
    wire.waiting.extend((3, 4, 5))
    assert subscription.follow([publisher(durability=QosDurability.TRANSIENT_LOCAL)], lambda *_: None) == 0
    assert subscription.follow([publisher(reliability=QosReliability.BEST_EFFORT)], lambda *_: None) == 3
