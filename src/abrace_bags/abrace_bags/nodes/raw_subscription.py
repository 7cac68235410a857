"""A topic's messages as they come from the wire, with the middleware's times and numbers, received when asked for.

No executor spins the subscription: a callback for each message would cost more than writing it to a bag does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.type_hash import TypeHash
from rosbags.interfaces import QosDurability

from abrace_bags.nodes.endpoint import message_class, qos_profile
from abrace_bags.qos import common_qos, offered_qos
from abrace_bags.topic_choice import Publisher, common_definition
from abrace_core.errors import AbraceError
from abrace_core.sequence import SequenceCounter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rosbags.interfaces import Qos

DEPTH = 5000
"""Depth of the subscriptions: ten seconds of samples."""


class RawSubscription:
    """A subscription to one topic, with a QoS that all its publishers offer.

    Parameters
    ----------
    node
        Whose subscription it is; no executor spins it.
    topic
        Full name.
    publishers
        Of the topic, at least one.

    Attributes
    ----------
    definition
        Of its messages.
    lost
        Messages that were not received, by the publisher's own sequence numbers: while there is only one publisher.

    Raises
    ------
    AbraceError
        If the publishers are of different types, or theirs is not the installed one.
    """

    def __init__(self, node: Node, topic: str, publishers: Sequence[Publisher]) -> None:
        self._node = node
        self._topic = topic
        self.definition = common_definition(topic, publishers)
        self.lost = 0
        self._qos = common_qos([publisher.qos for publisher in publishers], DEPTH)
        self._subscription = self._subscribe(self._qos)
        self._numbers = SequenceCounter()

    @property
    def transient_local(self) -> bool:
        """Whether late subscribers, too, receive the last messages."""
        return self._qos.durability is QosDurability.TRANSIENT_LOCAL

    def count_publishers(self) -> int:
        """Publishers that it is matched with now."""
        count: int = self._subscription.get_publisher_count()
        if count != 1:
            # each publisher has numbers of its own, and a message does not tell its publisher
            self._numbers.restart()
        return count

    def follow(self, publishers: Sequence[Publisher], write: Callable[[bytes, int, int], None]) -> int:
        """Subscribe anew if one of the publishers offers less than the subscription asks for.

        What is published until the new subscription is matched is not received.

        Parameters
        ----------
        publishers
            Of the topic now.
        write
            For the messages received by the old subscription, as in `receive`.

        Returns
        -------
        int
            How many those were.

        Raises
        ------
        AbraceError
            If their type is not the one that is subscribed to.
        """
        now = common_definition(self._topic, publishers).type_name
        if now != self.definition.type_name:
            raise AbraceError(
                f"topic {self._topic}: is of type {now} now, expected {self.definition.type_name} as before"
            )
        qos = common_qos([publisher.qos for publisher in publishers], DEPTH)
        if common_qos([self._qos, qos], DEPTH) == self._qos:
            return 0
        new = self._subscribe(qos)
        received = self.receive(DEPTH, write)
        self._node.destroy_subscription(self._subscription)
        self._subscription, self._qos = new, qos
        return received

    def receive(self, most: int, write: Callable[[bytes, int, int], None]) -> int:
        """Receive the messages that have come.

        Parameters
        ----------
        most
            How many at most.
        write
            Called with the bytes of each, when it was received and when it was published [ns].

        Returns
        -------
        int
            How many those were.
        """
        message_type, handle = self._subscription.msg_type, self._subscription.handle
        numbers, count = self._numbers, 0
        missing = numbers.missing
        with handle:
            while count < most and (received := handle.take_message(message_type, True)) is not None:
                payload, info = received
                write(payload, info["received_timestamp"], info["source_timestamp"])
                numbers.add(info["publication_sequence_number"])
                count += 1
        if count and self.count_publishers() <= 1:
            self.lost += numbers.missing - missing
        return count

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)

    def _subscribe(self, qos: Qos) -> Subscription:
        message_type = message_class(self._topic, self.definition.type_name)
        return self._node.create_subscription(message_type, self._topic, _never_called, qos_profile(qos), raw=True)


def publishers_of(node: Node, topic: str) -> list[Publisher]:
    """The publishers of a topic, by its full name, that a node has discovered."""
    # a publisher from before ROS 2 Iron has no hash
    return [
        Publisher(
            one.topic_type,
            "" if one.topic_type_hash == TypeHash() else str(one.topic_type_hash),
            offered_qos(one.qos_profile),
        )
        for one in node.get_publishers_info_by_topic(topic)
    ]


def _never_called(message: bytes) -> None:
    """The callback that a subscription has to have."""
