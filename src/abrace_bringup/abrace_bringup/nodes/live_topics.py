# SPDX-License-Identifier: Apache-2.0
"""The topics of the running graph for a viewer: all are offered; the viewer subscribes to those that a client shows.

Streams are received with best effort: a rig never waits for a viewer, nor sends anything again for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import rclpy
from rosbags.interfaces import QosDurability, QosReliability

from abrace_bags.nodes.endpoint import common_definition, publishers_of
from abrace_bags.nodes.raw_subscription import RawSubscription
from abrace_core import AbraceError

if TYPE_CHECKING:
    from abrace_bags.nodes.endpoint import Publisher
    from abrace_bringup.viewing.server import ViewServer
    from abrace_node.node import AbraceNode

MOST_AT_ONCE = 1000
"""Messages received of a topic before the others' turn."""


class LiveTopics:
    """Offers the topics of the graph to a server's viewers.

    Parameters
    ----------
    node
        That discovers them.
    server
        Where viewers are.
    """

    def __init__(self, node: AbraceNode, server: ViewServer) -> None:
        self._node = node
        self._server = server
        self._offered: set[str] = set()
        self._subscriptions: dict[str, RawSubscription] = {}
        self._refused: dict[str, list[str]] = {}
        # no executor spins it: `receive` takes the messages
        self._input = rclpy.create_node(
            f"_{node.get_name()}_input",
            namespace=node.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )

    def discover(self) -> None:
        """Offer topics that have appeared; of a type that is not installed, or of several types, none."""
        for name, types in sorted(self._node.get_topic_names_and_types()):
            if "/_" in name or name in self._server.topics or self._refused.get(name) == types:
                continue
            if not (publishers := publishers_of(self._node, name)):
                continue
            try:
                definition = common_definition(name, publishers)
            except AbraceError as error:
                self._refused[name] = types
                self._node.get_logger().warning(f"{error}; it is not shown")
                continue
            self._server.offer(name, definition)
            self._offered.add(name)

    def subscribe(self) -> None:
        """Subscribe to the topics that clients show, and to no others."""
        wanted = {name for name in self._offered if self._server.wanted(name)}
        for name in set(self._subscriptions) - wanted:
            self._subscriptions.pop(name).close()
        for name in wanted:
            publishers = [_best_effort(one) for one in publishers_of(self._node, name)]
            if not publishers:
                continue
            try:
                if name in self._subscriptions:
                    self._subscriptions[name].follow(publishers)
                else:
                    self._subscriptions[name] = RawSubscription(self._input, name, publishers, keep_all=False)
            except AbraceError as error:
                self._node.get_logger().warning(f"{error}; it is no longer shown")
                self._subscriptions.pop(name).close()

    def receive(self) -> None:
        """Send viewers the messages that have come."""
        for name, subscription in self._subscriptions.items():
            latched = subscription.transient_local

            def write(payload: bytes, received: int, _: int) -> None:
                self._server.send(name, payload, received, latched)  # noqa: B023

            subscription.receive(MOST_AT_ONCE, write)

    @property
    def lost(self) -> int:
        """Messages of the topics that clients show which were not received."""
        return sum(subscription.lost for subscription in self._subscriptions.values())

    def close(self) -> None:
        """Leave the graph."""
        for subscription in self._subscriptions.values():
            subscription.close()
        self._subscriptions.clear()
        self._input.destroy_node()


def _best_effort(publisher: Publisher) -> Publisher:
    """QoS requested of a `publisher`; the last messages of a transient local one need reliable delivery."""
    if publisher.qos.durability is QosDurability.TRANSIENT_LOCAL:
        return publisher
    return publisher._replace(qos=publisher.qos._replace(reliability=QosReliability.BEST_EFFORT))
