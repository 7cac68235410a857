# SPDX-License-Identifier: Apache-2.0
"""A subscription that receives serialised messages, with the middleware's times and numbers, by polling.

No executor spins the subscription: a callback for each message would cost more than writing it to a bag.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from rosbags.interfaces import QosDurability, QosHistory

from abrace_bags.nodes.endpoint import common_definition, message_class, qos_profile
from abrace_bags.qos import common_qos
from abrace_bags.recording import EveryNth
from abrace_bags.sequence import SequenceCounter
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rosbags.interfaces import Qos

    from abrace_bags.nodes.endpoint import Publisher

    Received = tuple[bytes, dict[str, int]]
    """The bytes of a message, and the middleware's information about it."""

DEPTH = 5000
"""Messages that may wait in the middleware: ten seconds of samples."""
MEMORY = 64 * 1024 * 1024
"""Bytes of a topic's messages that may wait there, and `LEAST_DEPTH` messages however large they are."""
LEAST_DEPTH = 10


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
    keep_all
        Whether reliable publishers with the history "keep all" wait for this subscription; otherwise new messages
        replace old ones.
    every
        Of so many messages one is kept (`EveryNth`).

    Attributes
    ----------
    topic
        Full name.
    definition
        Of its messages.
    kept
        Messages that were received and kept.
    lost
        Messages that were not received and would have been kept, by the publisher's own sequence numbers: while there
        is only one publisher.

    Raises
    ------
    AbraceError
        If the publishers are of different types, or theirs is not the installed one.

    Notes
    -----
    Its QoS changes when a publisher comes that offers less, and its depth when messages are large. A new subscription
    then takes the place of the old one as soon as it has received a message, and each message is received once.
    """

    def __init__(self, node: Node, topic: str, publishers: Sequence[Publisher], keep_all: bool, every: int = 1) -> None:
        self._node = node
        self.topic = topic
        self.definition = common_definition(topic, publishers)
        self.kept = self.lost = 0
        self._alone = True
        self._thinning = EveryNth(every, self.definition.text) if every > 1 else None
        self._history = QosHistory.KEEP_ALL if keep_all else QosHistory.KEEP_LAST
        self._qos = common_qos([publisher.qos for publisher in publishers], DEPTH)
        self._subscription = self._subscribe()
        self._successor: Subscription | None = None
        self._received: deque[tuple[int, int]] = deque(maxlen=DEPTH)
        self._largest = 0
        self._numbers = SequenceCounter()

    @property
    def transient_local(self) -> bool:
        """Whether late subscribers, too, receive the last messages."""
        return self._qos.durability is QosDurability.TRANSIENT_LOCAL

    def count_publishers(self) -> int:
        """Publishers that it is matched with now."""
        count: int = (self._successor or self._subscription).get_publisher_count()
        self._alone = count <= 1
        if count != 1:
            # each publisher has numbers of its own, and a message does not tell its publisher
            self._numbers.restart()
        return count

    def follow(self, publishers: Sequence[Publisher]) -> None:
        """Subscribe again if one of the topic's `publishers` now offers a weaker QoS than the subscription requests.

        Raises
        ------
        AbraceError
            If their type is not the one that is subscribed to.
        """
        now = common_definition(self.topic, publishers).type_name
        if now != self.definition.type_name:
            raise AbraceError(
                f"topic {self.topic}: is of type {now} now, expected {self.definition.type_name} as before"
            )
        least = common_qos([self._qos, *(publisher.qos for publisher in publishers)], self._qos.depth)
        if least != self._qos:
            self._subscribe_anew(least)

    def receive(self, most: int, write: Callable[[bytes, int, int], None]) -> int:
        """Receive the messages that have come.

        Parameters
        ----------
        most
            How many at most, but while a new subscription takes the place of the old one.
        write
            Called with the bytes of each that is kept, when it was received and when it was published [ns].

        Returns
        -------
        int
            How many have come.
        """
        numbers, largest, thinning = self._numbers, self._largest, self._thinning
        lost = 0
        # a new subscription to a transient local topic receives the last messages again
        remembered = self._received if self._successor or self.transient_local else None
        messages = self._of_both(self._successor) if self._successor else _taken(self._subscription, most)
        count = 0
        for payload, info in messages:
            missing = max(numbers.add(info["publication_sequence_number"]), 0)
            keep = True
            if thinning is not None:
                keep, missing = thinning.add(payload, missing if self._alone else 0)
            if keep:
                write(payload, info["received_timestamp"], info["source_timestamp"])
                self.kept += 1
            lost += missing
            count += 1
            if len(payload) > largest:
                largest = len(payload)
            if remembered is not None:
                remembered.append(_key(payload, info))
        if count and self.count_publishers() <= 1:
            self.lost += lost
        if largest > self._largest:
            self._largest = largest
            if largest * self._qos.depth > MEMORY and self._qos.depth > LEAST_DEPTH:
                # half as many as fit: the next message is often a little larger
                self._subscribe_anew(self._qos._replace(depth=max(LEAST_DEPTH, MEMORY // (2 * largest))))
        return count

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)
        if self._successor is not None:
            self._node.destroy_subscription(self._successor)

    def _subscribe(self) -> Subscription:
        message_type = message_class(self.topic, self.definition.type_name)
        qos = qos_profile(self._qos._replace(history=self._history))
        return self._node.create_subscription(message_type, self.topic, _never_called, qos, raw=True)

    def _subscribe_anew(self, qos: Qos) -> None:
        if self._successor is not None:
            self._node.destroy_subscription(self._successor)
        self._qos = qos
        self._successor = self._subscribe()

    def _of_both(self, successor: Subscription) -> list[Received]:
        """Messages of the old subscription and, once it has received one, of its successor; each once."""
        # in this order: what was published before a message of the successor has come to the old one
        later = list(_taken(successor, DEPTH))
        messages = list(_taken(self._subscription, DEPTH))
        if later:
            self._node.destroy_subscription(self._subscription)
            self._subscription, self._successor = successor, None
            known = {*self._received, *(_key(*message) for message in messages)}
            messages += [message for message in later if _key(*message) not in known]
        return messages


def _taken(subscription: Subscription, most: int) -> Iterator[Received]:
    """The messages that have come, `most` of them."""
    message_type, handle = subscription.msg_type, subscription.handle
    with handle:
        for _ in range(most):
            received = handle.take_message(message_type, True)
            if received is None:
                return
            yield received


def _key(payload: bytes, info: dict[str, int]) -> tuple[int, int]:
    """A key that identifies a message received by two subscriptions."""
    return info["source_timestamp"], hash(payload)


def _never_called(message: bytes) -> None:
    """The callback that a subscription has to have."""
