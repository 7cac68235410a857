"""A topic's messages as they come from the wire, with the middleware's times and numbers, taken when it suits.

A subscription that no executor turns: a callback for each message would cost more than writing it to a bag does.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_hash import TypeHash

from abrace_bags.definitions import MessageDefinition, message_definition
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rclpy.topic_endpoint_info import TopicEndpointInfo

DEPTH = 5000
"""Messages that may wait to be taken: ten seconds of samples."""


class RawSubscription:
    """Messages of one topic, subscribed to as its publishers offer it.

    Parameters
    ----------
    node
        Whose subscription it is; no executor turns it.
    topic
        Full name.
    publishers
        Of the topic, at least one.

    Attributes
    ----------
    definition
        Of its messages.
    lost
        Messages that did not come, as far as the publisher's own numbers tell: while there is one publisher alone.

    Raises
    ------
    AbraceError
        If the publishers are of different types, or theirs is not the one that is installed.
    """

    def __init__(self, node: Node, topic: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        self._node = node
        self._topic = topic
        self.definition = published_definition(topic, publishers)
        self.lost = 0
        self._subscription = self._subscribe(_offered_by_all(publishers))
        self._last = 0

    @property
    def latched(self) -> bool:
        """Whether what was said once holds on (transient local)."""
        return self._subscription.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL

    def count_publishers(self) -> int:
        """Publishers that it hears now."""
        count: int = self._subscription.get_publisher_count()
        if count != 1:
            # each publisher has numbers of its own, and a message does not say whose its number is
            self._last = 0
        return count

    def follow(self, publishers: Sequence[TopicEndpointInfo], write: Callable[[bytes, int, int], None]) -> int:
        """Subscribe anew where a publisher has come that offers less than the subscription asks for.

        What the others publish until the new subscription is matched does not come.

        Parameters
        ----------
        publishers
            Of the topic now.
        write
            Takes what has come until then, as in `take`.

        Returns
        -------
        int
            Messages taken then.

        Raises
        ------
        AbraceError
            If their type is not the one that is subscribed to.
        """
        now = published_definition(self._topic, publishers).type_name
        if now != self.definition.type_name:
            raise AbraceError(
                f"topic {self._topic}: is of type {now} now, expected {self.definition.type_name} as before"
            )
        old = self._subscription
        qos, asked = _offered_by_all(publishers), old.qos_profile
        less_reliable = asked.reliability == ReliabilityPolicy.RELIABLE != qos.reliability
        less_kept = asked.durability == DurabilityPolicy.TRANSIENT_LOCAL != qos.durability
        if not (less_reliable or less_kept):
            return 0
        new = self._subscribe(qos)
        taken = self.take(DEPTH, write)
        self._subscription = new
        self._node.destroy_subscription(old)
        return taken

    def take(self, most: int, write: Callable[[bytes, int, int], None]) -> int:
        """Take the messages that have come.

        Parameters
        ----------
        most
            How many at most.
        write
            Takes the bytes of each, when it arrived and when it was published [ns].

        Returns
        -------
        int
            How many those were.
        """
        message_type, handle = self._subscription.msg_type, self._subscription.handle
        last, skipped, number = self._last, 0, 0
        with handle:
            while number < most and (taken := handle.take_message(message_type, True)) is not None:
                payload, info = taken
                write(payload, info["received_timestamp"], info["source_timestamp"])
                published = info["publication_sequence_number"]
                if last and published > last + 1:
                    skipped += published - last - 1
                last = published
                number += 1
        if number:
            self._last = last
            self.lost += skipped if self.count_publishers() <= 1 else 0
        return number

    def close(self) -> None:
        """Hear no more."""
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self, qos: QoSProfile) -> Subscription:
        package, _, short_name = self.definition.type_name.split("/")
        try:
            message_type = getattr(importlib.import_module(f"{package}.msg"), short_name)
        except (ImportError, AttributeError) as error:
            raise AbraceError(
                f"topic {self._topic}: message type {self.definition.type_name} is not installed for Python"
            ) from error
        return self._node.create_subscription(message_type, self._topic, _never_called, qos, raw=True)


def published_definition(topic: str, publishers: Sequence[TopicEndpointInfo]) -> MessageDefinition:
    """The definition of the messages that all `publishers` of a `topic` have.

    Raises
    ------
    AbraceError
        If they have several types, or theirs is not the one that is installed.
    """
    types = {publisher.topic_type for publisher in publishers}
    if len(types) > 1:
        raise AbraceError(f"topic {topic}: has the types {', '.join(sorted(types))}, expected one")
    try:
        definition = message_definition(types.pop())
    except AbraceError as error:
        raise AbraceError(f"topic {topic}: {error}") from error
    # a publisher from before ROS 2 Iron tells no hash
    hashes = {str(publisher.topic_type_hash) for publisher in publishers} - {str(TypeHash())}
    if hashes - {definition.type_hash}:
        raise AbraceError(
            f"topic {topic}: {definition.type_name} is published as {', '.join(sorted(hashes))}, "
            f"expected {definition.type_hash} as it is installed here"
        )
    return definition


def _offered_by_all(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """The most that all publishers offer."""
    offered = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    kept = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def _never_called(message: bytes) -> None:
    """The callback that a subscription has to have."""
