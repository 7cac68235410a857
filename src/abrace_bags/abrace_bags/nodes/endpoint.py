# SPDX-License-Identifier: Apache-2.0
"""Publishers found at discovery, and what rclpy makes a publisher or a subscription with: message class, QoS."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, NamedTuple

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.type_hash import TypeHash

from abrace_bags.definitions import MessageDefinition, message_definition
from abrace_bags.qos import offered_qos
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rclpy.node import Node
    from rosbags.interfaces import Qos, QosTime


class Publisher(NamedTuple):
    """A discovered publisher: its message type, that type's RIHS01 hash (empty if unknown), the QoS that it offers."""

    type_name: str
    type_hash: str
    qos: Qos


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


def common_definition(topic: str, publishers: Sequence[Publisher]) -> MessageDefinition:
    """The definition of the messages of all `publishers` of a `topic`, at least one.

    Raises
    ------
    AbraceError
        If they have several types, or theirs is not the installed one.
    """
    types = {publisher.type_name for publisher in publishers}
    if len(types) > 1:
        raise AbraceError(f"topic {topic}: has the types {', '.join(sorted(types))}, expected one")
    try:
        definition = message_definition(types.pop())
    except AbraceError as error:
        raise AbraceError(f"topic {topic}: {error}") from error
    hashes = {publisher.type_hash for publisher in publishers} - {""}
    if hashes - {definition.type_hash}:
        raise AbraceError(
            f"topic {topic}: {definition.type_name} is published as {', '.join(sorted(hashes))}, "
            f"expected {definition.type_hash} as it is installed here"
        )
    return definition


def message_class(topic: str, type_name: str) -> type:
    """The class of a topic's message type, as `std_msgs/msg/String`; an AbraceError if it is not installed."""
    package, kind, name = type_name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        found: type = (
            getattr(module, name.removesuffix("_FeedbackMessage")).Impl.FeedbackMessage
            if kind == "action"
            else getattr(module, name)
        )
    except (ImportError, AttributeError) as error:
        raise AbraceError(f"topic {topic}: message type {type_name} is not installed for Python ({error})") from error
    return found


def qos_profile(qos: Qos) -> QoSProfile:
    """The profile of a QoS: the inverse of `offered_qos`."""
    return QoSProfile(
        history=HistoryPolicy[qos.history.name],
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.name],
        durability=DurabilityPolicy[qos.durability.name],
        deadline=_duration(qos.deadline),
        lifespan=_duration(qos.lifespan),
        liveliness=LivelinessPolicy[qos.liveliness.name],
        liveliness_lease_duration=_duration(qos.liveliness_lease_duration),
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
    )


def _duration(time: QosTime) -> Duration:
    return Duration(seconds=time.sec, nanoseconds=time.nsec)
