# SPDX-License-Identifier: Apache-2.0
"""How Fast DDS is set up for a node: by `config/streams.xml` if its messages must not wait, else `shared_memory.xml`.

Before its first message to a listener in shared memory Fast DDS asks whether it is alive, and may sleep a third of a
second for the answer (`SharedMemGlobal::Port::healthy_check`): in `publish`, in the middle of a run, when a node joins.
So nodes that stream take UDP alone. By UDP a reader that joins a running writer is told only by heartbeats that what is
older than itself is not for it. In lockstep, where nothing is late, all take shared memory.

A node that joins finds those that run by their next announcement only: at Fast DDS's 3 s a stop would be as late.
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
"""Environment variables by which people choose transports themselves."""

_THIS_HOST = """<builtin>
<metatrafficUnicastLocatorList><locator><udpv4/></locator></metatrafficUnicastLocatorList>
<initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>
"""
"""What rmw_fastrtps 8.4 does for ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, where it adds shared memory by itself."""


def _installed(name: str) -> Path:
    return Path(get_package_share_directory("abrace_core")) / "config" / name


def lockstep_environment() -> dict[str, str]:
    """Variables for the processes of a run in lockstep; none where the environment has one of CHOICES."""
    if any(name in os.environ for name in CHOICES):
        return {}
    return {_PROFILES_FILE: str(_installed("shared_memory.xml"))}


@contextlib.contextmanager
def profile(streams: bool) -> Iterator[None]:
    """Have the participant that this process makes meanwhile set up as a node's is that `streams`, or as another's.

    Not where the environment has one of CHOICES, nor for streams if static peers go with the discovery range LOCALHOST.
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
