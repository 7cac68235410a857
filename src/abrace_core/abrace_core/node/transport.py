# SPDX-License-Identifier: Apache-2.0
"""The Fast DDS profile of a node: `config/streams.xml` if its messages must not be delayed, else `shared_memory.xml`.

Before its first message to a listener in shared memory Fast DDS checks whether the listener is alive, and may sleep a
third of a second for the answer (`SharedMemGlobal::Port::healthy_check`): in `publish`, during a run, when a node
joins. Therefore nodes that stream use UDP alone. With UDP a reader that joins a running writer learns only from
heartbeats that it does not get the earlier samples. In lockstep, where delays do no harm, all nodes use shared memory.

A node that joins discovers the running nodes with their next announcement. With Fast DDS's default of 3 s the first
stop of a new sender would be that late, so the profiles set a shorter period.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

_PROFILES_FILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
CHOICES = (_PROFILES_FILE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
"""Environment variables by which users choose transports themselves."""

_THIS_HOST = """<builtin>
<metatrafficUnicastLocatorList><locator><udpv4/></locator></metatrafficUnicastLocatorList>
<initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>
"""
"""rmw_fastrtps 8.4's settings for ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, without the shared memory that it adds."""


def _installed(name: str) -> Path:
    return Path(get_package_share_directory("abrace_core")) / "config" / name


def lockstep_environment() -> dict[str, str]:
    """Environment variables for the processes of a lockstep run; none if one of CHOICES is set."""
    if any(name in os.environ for name in CHOICES):
        return {}
    return {_PROFILES_FILE: str(_installed("shared_memory.xml"))}


def is_lockstep() -> bool:
    """Whether this process has the `lockstep_environment`."""
    return os.environ.get(_PROFILES_FILE) == str(_installed("shared_memory.xml"))


@contextlib.contextmanager
def profile(streams: bool) -> Iterator[None]:
    """Set the DDS profile of the participant created within the block: of a node that `streams`, or of another one.

    No profile is set if the environment has one of CHOICES, nor for a node that streams if ROS_STATIC_PEERS is set and
    the discovery range is LOCALHOST.
    """
    reach = os.environ.get(_RANGE, "")
    local = streams and reach.upper() == "LOCALHOST"
    if any(name in os.environ for name in CHOICES) or (local and os.environ.get("ROS_STATIC_PEERS")):
        yield
        return
    installed = _installed("streams.xml" if streams else "shared_memory.xml")
    with tempfile.NamedTemporaryFile("w", prefix="abrace_", suffix=".xml") as file:
        os.environ[_PROFILES_FILE] = str(installed)
        if local:
            file.write(installed.read_text(encoding="utf-8").replace("<builtin>", _THIS_HOST))
            file.flush()
            os.environ.update({_PROFILES_FILE: file.name, _RANGE: "SYSTEM_DEFAULT"})
        try:
            yield
        finally:
            del os.environ[_PROFILES_FILE]
            if local:
                os.environ[_RANGE] = reach
