# SPDX-License-Identifier: Apache-2.0
"""Receives the stops of the laboratory and of the rig from publishers of any QoS, and identifies their senders.

rclpy does not report the publisher of a message. The C library rcl does: messages are taken from it, without an
executor.
"""

from __future__ import annotations

import ctypes
import time
from functools import cache
from typing import TYPE_CHECKING, ClassVar

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from abrace_core.safety.stop_senders import UNNAMED, StopSenders
from abrace_node.node import endpoint_names

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from rclpy.node import Node
    from rclpy.subscription import Subscription

TOPICS = ("/emergency_stop", "emergency_stop")
"""The topic of the whole laboratory, and the rig's own."""

_DEPTH = 5000
"""Messages kept until they are read: a rig that is being activated or deactivated does not read for some seconds, and
several operator's pages with ten messages a second each must not displace a stop that was sent once."""
_QOS = (
    QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE),
    QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
)
"""One for each kind of publisher: a volatile subscription misses the earlier message of a transient local publisher,
and a reliable subscription is not matched with a best-effort publisher."""


class _Gid(ctypes.Structure):
    _fields_: ClassVar = [("implementation", ctypes.c_char_p), ("data", ctypes.c_uint8 * 16)]


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t of ROS 2 Jazzy."""

    _fields_: ClassVar = [
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_number", ctypes.c_uint64),
        ("reception_number", ctypes.c_uint64),
        ("publisher", _Gid),
        ("from_intra_process", ctypes.c_bool),
    ]


@cache
def _rcl() -> ctypes.CDLL:
    library = ctypes.CDLL("librcl.so")
    library.rcl_take.argtypes = [ctypes.c_void_p] * 4
    return library


def _take_messages(subscription: Subscription) -> Iterator[tuple[bytes, int, bool]]:
    """Sender, number and content of the received messages."""
    data, info = ctypes.c_bool(), _MessageInfo()
    handle = subscription.handle
    with handle:
        for _ in range(_DEPTH):
            if _rcl().rcl_take(handle.pointer, ctypes.byref(data), ctypes.byref(info), None):
                return
            yield bytes(info.publisher.data), info.publication_number, data.value


class StopListener:
    """The stops that a node receives.

    Parameters
    ----------
    node
        The node that owns the subscriptions; its executor does not spin them.
    heartbeat
        As for `StopSenders` [s].
    """

    def __init__(self, node: Node, heartbeat: float) -> None:
        self._node = node
        self._topics = sorted({node.resolve_topic_name(topic) for topic in TOPICS})
        self._subscriptions = []
        for topic in self._topics:
            for qos in _QOS:
                subscription = node.create_subscription(Bool, topic, lambda _: None, qos)
                node._subscriptions.remove(subscription)
                self._subscriptions.append(subscription)
        self._senders = StopSenders(heartbeat, time.monotonic())

    def close(self) -> None:
        """Unsubscribe; the node does not destroy subscriptions that it does not know."""
        for subscription in self._subscriptions:
            subscription.destroy()

    def pressed_by(self) -> str:
        """The senders that ask for a stop now, as text; empty: none."""
        now = time.monotonic()
        for subscription in self._subscriptions:
            for sender, number, pressed in _take_messages(subscription):
                self._senders.hear(sender, self._name(sender), number, pressed, now)
        for unnamed in self._senders.unnamed:
            self._senders.rename(unnamed, self._name(unnamed))
        return self._senders.pressed_by(now)

    def forget_gone(self) -> None:
        """Forget the senders that have left the graph, because a person clears the stop."""
        self.pressed_by()  # what they sent before
        present = {
            bytes(one.endpoint_gid) for topic in self._topics for one in self._node.get_publishers_info_by_topic(topic)
        }
        gone = set(self._senders.senders) - present
        self._senders.forget(gone, time.monotonic())

    def _name(self, sender: Hashable) -> str:
        known = self._senders.name(sender)
        if known:
            return known
        for topic in self._topics:
            endpoints = self._node.get_publishers_info_by_topic(topic)
            for name in endpoint_names([one for one in endpoints if bytes(one.endpoint_gid) == sender]):
                return name
        return UNNAMED
