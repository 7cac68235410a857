# SPDX-License-Identifier: Apache-2.0
"""The QoS that publishers of a topic offer: of live ones, in a bag, and of the one that replays them.

`rosbags.interfaces.Qos` holds a profile. Bags store it as YAML, by names, up to ROS 2 Iron by numbers, which `rosbags`
reads. What it has to write them would take each logger 0.07 s to import.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from abrace_core import AbraceError
from abrace_core.files.reading import load_yaml

if TYPE_CHECKING:
    from collections.abc import Sequence

_LATEST = 2**63 - 1
_FOREVER = QosTime(*divmod(_LATEST, 10**9))
_GREATEST_DEPTH = 2**31 - 1

DEFAULT_QOS = Qos(
    history=QosHistory.KEEP_LAST,
    depth=10,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.VOLATILE,
    deadline=_FOREVER,
    lifespan=_FOREVER,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_FOREVER,
    avoid_ros_namespace_conventions=False,
)
"""A reliable publisher of depth 10."""
UNKNOWN_QOS = DEFAULT_QOS._replace(depth=0)
"""Of a topic whose QoS is not in the bag: reliable, of unknown depth."""


def offered_qos(profile: Any) -> Qos:
    """The QoS of a live publisher, for `BagWriter.add_topic`.

    Parameters
    ----------
    profile
        An `rclpy.qos.QoSProfile`.
    """
    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=_time(profile.deadline.nanoseconds),
        lifespan=_time(profile.lifespan.nanoseconds),
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=_time(profile.liveliness_lease_duration.nanoseconds),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def in_words(qos: Qos) -> dict[str, Any]:
    """The profile `qos` with rosbag2's names, as plain values for YAML."""

    def plain(value: Any) -> Any:
        if isinstance(value, Enum):
            return value.name.lower()
        return value._asdict() if isinstance(value, QosTime) else value

    return {name: plain(value) for name, value in qos._asdict().items()}


def parse_qos(text: str) -> list[Qos]:
    """The profiles of a topic's publishers, from the `offered_qos_profiles` of a bag.

    Parameters
    ----------
    text
        YAML, a list of profiles; may be empty.

    Raises
    ------
    AbraceError
        If it is no such list.
    """
    # takes 0.07 s, which only replay and recovery need
    from rosbags.rosbag2.metadata import parse_qos as parse

    try:
        profiles = parse(load_yaml(text, yaml.SafeLoader) or [])
        numbers = [number for one in profiles for number in (one.depth, *one.deadline, *one.lifespan)]
        if not all(isinstance(number, int) for number in numbers):
            raise TypeError(f"{text!r} has {numbers}")
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise AbraceError(f"QoS: {' '.join(str(error).split())}, expected rosbag2's names and values") from error
    return profiles


def combined_qos(offers: Sequence[Qos]) -> Qos:
    """The QoS with which one publisher serves the subscribers of several; `UNKNOWN_QOS` for none.

    Parameters
    ----------
    offers
        Of each publisher. A time of 0, or from 2^31 - 1 s or 2^63 - 1 ns on, means no end.

    Raises
    ------
    AbraceError
        If a depth or a time is negative.
    """
    if not offers:
        return UNKNOWN_QOS
    times = [time for one in offers for time in (one.deadline, one.lifespan, one.liveliness_lease_duration)]
    least = min(*(one.depth for one in offers), *(number for time in times for number in time))
    if least < 0:
        raise AbraceError(f"QoS: {least} is less than 0, expected rosbag2's names and values")
    keep_all = any(one.history is QosHistory.KEEP_ALL for one in offers)
    best_effort = all(one.reliability is QosReliability.BEST_EFFORT for one in offers)
    transient_local = any(one.durability is QosDurability.TRANSIENT_LOCAL for one in offers)
    manual = any(one.liveliness is QosLiveliness.MANUAL_BY_TOPIC for one in offers)
    return Qos(
        history=QosHistory.KEEP_ALL if keep_all else QosHistory.KEEP_LAST,
        depth=min(max(one.depth for one in offers), _GREATEST_DEPTH),
        reliability=QosReliability.BEST_EFFORT if best_effort else QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE,
        deadline=_time(min(_nanoseconds(one.deadline) for one in offers)),
        lifespan=_time(max(_nanoseconds(one.lifespan) for one in offers)),
        liveliness=QosLiveliness.MANUAL_BY_TOPIC if manual else QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_time(min(_nanoseconds(one.liveliness_lease_duration) for one in offers)),
        avoid_ros_namespace_conventions=False,
    )


def common_qos(offers: Sequence[Qos], depth: int) -> Qos:
    """The QoS for a subscriber, of this `depth`, to several publishers, of which each has one of the `offers`."""
    reliable = all(one.reliability is QosReliability.RELIABLE for one in offers)
    transient_local = all(one.durability is QosDurability.TRANSIENT_LOCAL for one in offers)
    return UNKNOWN_QOS._replace(
        depth=depth,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE,
    )


def _time(nanoseconds: int) -> QosTime:
    return QosTime(*divmod(nanoseconds, 10**9))


def _nanoseconds(time: QosTime) -> int:
    """2^63 - 1 for a time without an end."""
    total = time.sec * 10**9 + time.nsec
    return total if 0 < total < _LATEST and time.sec < 2**31 - 1 else _LATEST
