# SPDX-License-Identifier: Apache-2.0
"""What rclpy makes a publisher or a subscription with: the class of its messages and its QoS profile."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from rosbags.interfaces import Qos, QosTime


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
