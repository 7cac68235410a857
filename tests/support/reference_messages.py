# SPDX-License-Identifier: Apache-2.0
"""Messages, definitions and type hashes made by `rosbags`, which is independent of abrace, for the tests of bags."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESPONSE = "abrace_interfaces/msg/Response"
STRING = "std_msgs/msg/String"
MSG = Path(__file__).parents[2] / "src/abrace_interfaces/msg/Response.msg"
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(MSG.read_text(), RESPONSE))
TYPES: dict[str, Any] = dict(STORE.types)
DEFINITIONS = {name: STORE.generate_msgdef(name, ros_version=2)[0] for name in (RESPONSE, STRING)}
HASHES = {name: STORE.hash_rihs01(name) for name in (RESPONSE, STRING)}


def response_message(sequence: int, values: NDArray[Any], seconds: int, nanoseconds: int) -> Any:
    """A response of the three-storey rig with ten values."""
    header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](seconds, nanoseconds), "table")
    channels = (values[:3], values[3:6], values[6:7], values[7:8], values[8:9])
    return TYPES[RESPONSE](header, sequence, 1, 0, 0, 3, np.array([1], dtype=np.uint8), *channels, values[9], 0.0, "")


def serialised(message: Any, type_name: str = RESPONSE) -> bytes:
    """A message, serialised as CDR."""
    return bytes(STORE.serialize_cdr(message, type_name))


def note(text: str) -> bytes:
    """A `std_msgs/String`, serialised as CDR."""
    return serialised(TYPES[STRING](data=text), STRING)
