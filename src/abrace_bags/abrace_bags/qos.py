"""The QoS with which a recorded topic was offered, from the words and numbers that rosbag2's versions have for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

_WORDS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
"""By number: up to ROS 2 Iron bags have numbers, then words."""
DEEPEST = 2**31 - 1
"""Messages that a publisher can keep."""
_FOREVER = 2**63 - 1


@dataclass(frozen=True)
class RecordedQos:
    """How a topic was offered.

    Parameters
    ----------
    reliable
        Whether lost messages were sent again.
    latched
        Whether late subscribers got the last messages (transient local).
    keep_all
        Whether as many messages were kept as there was room for.
    depth
        Messages kept; 0: not known.
    manual_liveliness
        Whether the publisher said by itself that it was alive (manual by topic).
    deadline, lifespan, lease
        Between messages, of a message, and of the liveliness [ns]; 0: no end.
    """

    reliable: bool = True
    latched: bool = False
    keep_all: bool = False
    depth: int = 0
    manual_liveliness: bool = False
    deadline: int = 0
    lifespan: int = 0
    lease: int = 0


def recorded_qos(text: str) -> RecordedQos:
    """The QoS of a topic from the YAML in its bag.

    Parameters
    ----------
    text
        A list of profiles, one for each publisher, as `offered_qos_profiles` holds it; may be empty.

    Raises
    ------
    AbraceError
        If it is no such list.
    """
    try:
        profiles = yaml.safe_load(text) or []
        if not isinstance(profiles, list) or not all(isinstance(profile, Mapping) for profile in profiles):
            raise AbraceError(f"QoS: {text!r}, expected a list of profiles")
        return combined_qos([offer(profile) for profile in profiles])
    except (yaml.YAMLError, KeyError, TypeError, ValueError, IndexError) as error:
        raise AbraceError(f"QoS: {' '.join(str(error).split())}, expected rosbag2's names and values") from error


def offer(profile: Mapping[str, Any]) -> RecordedQos:
    """What one publisher offered.

    Parameters
    ----------
    profile
        In rosbag2's words or numbers.

    Raises
    ------
    KeyError, TypeError, ValueError, IndexError
        If they are none.
    """
    return RecordedQos(
        reliable=_word(profile, "reliability") != "best_effort",
        latched=_word(profile, "durability") == "transient_local",
        keep_all=_word(profile, "history") == "keep_all",
        depth=min(_not_negative(profile.get("depth", 0)), DEEPEST),
        manual_liveliness=_word(profile, "liveliness") == "manual_by_topic",
        deadline=_nanoseconds(profile.get("deadline")),
        lifespan=_nanoseconds(profile.get("lifespan")),
        lease=_nanoseconds(profile.get("liveliness_lease_duration")),
    )


def combined_qos(offers: Sequence[RecordedQos]) -> RecordedQos:
    """One offer that every subscriber to any of the `offers` can take; without any, a reliable publisher's."""
    if not offers:
        return RecordedQos()
    return RecordedQos(
        reliable=any(one.reliable for one in offers),
        latched=any(one.latched for one in offers),
        keep_all=any(one.keep_all for one in offers),
        depth=max(one.depth for one in offers),
        manual_liveliness=any(one.manual_liveliness for one in offers),
        deadline=min((one.deadline for one in offers), key=_length),
        lifespan=max((one.lifespan for one in offers), key=_length),
        lease=min((one.lease for one in offers), key=_length),
    )


def _word(profile: Mapping[str, Any], name: str) -> str:
    value = profile.get(name, "unknown")
    return _WORDS[name][_not_negative(value)] if isinstance(value, int) else str(value)


def _not_negative(value: Any) -> int:
    number = int(value)
    if number < 0:
        raise ValueError(f"{number} is less than 0")
    return number


def _nanoseconds(duration: Mapping[str, int] | None) -> int:
    """0 for what has no end, which is 0, or the latest time of 63 bits or of 32."""
    if duration is None:
        return 0
    seconds, nanoseconds = _not_negative(duration["sec"]), _not_negative(duration["nsec"])
    total = seconds * 10**9 + nanoseconds
    return 0 if seconds >= 2**31 - 1 or total >= _FOREVER else total


def _length(nanoseconds: int) -> int:
    return nanoseconds or _FOREVER
