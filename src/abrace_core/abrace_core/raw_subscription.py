"""A topic's messages as they come from the wire, with the middleware's times and numbers, taken when it suits.

A subscription that no executor turns: a callback for each message would cost more than writing it to a bag does.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

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
    type_name
        Of its messages.

    Raises
    ------
    AbraceError
        If the publishers are of different types, or theirs is not installed.
    """

    def __init__(self, node: Node, topic: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        self._node = node
        self._topic = topic
        self.type_name = only_type(topic, publishers)
        self._subscription = self._subscribe(_offered_by_all(publishers))
        self._most_publishers = len(publishers)
        self._last = 0
        self._skipped = 0

    @property
    def latched(self) -> bool:
        """Whether what was said once holds on (transient local)."""
        return self._subscription.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL

    def count_publishers(self) -> int:
        """Publishers that it hears now."""
        count: int = self._subscription.get_publisher_count()
        self._most_publishers = max(self._most_publishers, count)
        return count

    @property
    def lost(self) -> int:
        """Messages lost, where one publisher alone has numbered them; else 0."""
        return self._skipped if self._most_publishers == 1 else 0

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
            If they are of different types.
        """
        only_type(self._topic, publishers)
        old = self._subscription
        qos, before = _offered_by_all(publishers), old.qos_profile
        less_reliable = before.reliability == ReliabilityPolicy.RELIABLE != qos.reliability
        less_kept = before.durability == DurabilityPolicy.TRANSIENT_LOCAL != qos.durability
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
        with handle:
            for number in range(most):
                taken = handle.take_message(message_type, True)
                if taken is None:
                    return number
                payload, info = taken
                write(payload, info["received_timestamp"], info["source_timestamp"])
                published = info["publication_sequence_number"]
                if self._last and published > self._last + 1:
                    self._skipped += published - self._last - 1
                self._last = published
        return most

    def close(self) -> None:
        """Hear no more."""
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self, qos: QoSProfile) -> Subscription:
        package, _, short_name = self.type_name.split("/")
        try:
            message_type = getattr(importlib.import_module(f"{package}.msg"), short_name)
        except (ImportError, AttributeError) as error:
            raise AbraceError(
                f"topic {self._topic}: message type {self.type_name} is not installed for Python"
            ) from error
        return self._node.create_subscription(message_type, self._topic, _never_called, qos, raw=True)


def only_type(topic: str, publishers: Sequence[TopicEndpointInfo]) -> str:
    """The type that all `publishers` of a `topic` have.

    Raises
    ------
    AbraceError
        If they have several.
    """
    types = {publisher.topic_type for publisher in publishers}
    if len(types) > 1:
        raise AbraceError(f"topic {topic}: has the types {', '.join(sorted(types))}, expected one")
    return str(types.pop())


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
