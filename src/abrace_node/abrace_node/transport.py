# SPDX-License-Identifier: Apache-2.0
"""Transport: the QoS of streams, the Fast DDS profile of a node, and how it leaves the graph.

The profile is `config/streams.xml` if the node's messages must not be delayed, else `shared_memory.xml`.

Before its first message to a listener in shared memory Fast DDS checks whether the listener is alive, and may sleep a
third of a second for the answer (`SharedMemGlobal::Port::healthy_check`): in `publish`, during a run, when a node
joins. Therefore nodes that stream use UDP alone. With UDP a reader that joins a running writer learns only from
heartbeats that it does not get the earlier samples. In lockstep, where delays do no harm, all nodes use shared memory.

A node that joins discovers the running nodes with their next announcement. With Fast DDS's default of 3 s the first
stop of a new sender would be that late, so the profiles set a shorter period.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from abrace_node.shared_memory import remove_stale_segments

STREAM_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of the rig's subscriptions to `brace_command` and `ground_motion`: only the newest late messages matter."""
KEPT_STREAM_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of subscriptions that must not miss a sample.

With a depth of ten, a logger that a busy machine delayed by some milliseconds lost samples of a lockstep run, and a
commander that joined a running rig lost samples one time in two: the 50 to 80 samples that are published during
discovery arrive all at once.
"""
_LIFESPAN, _MOST_KEPT = Duration(seconds=2), 1000
"""For how long, and how many messages, a publisher by the clock keeps what a subscriber has not acknowledged.

A subscriber that was killed acknowledges nothing until Fast DDS gives it up, 20 s later. All that waited for it alone
is then removed at once, the newest first, and each is looked for from the oldest on (`History::find_change_nts`). Its
cost is quadratic, and `publish` waits for it: 0.45 ms with the 500 messages of 1 s at 500 Hz, 0.9 ms with those of
1.5 s, 1.4 to 1.6 ms with those of 2 s, 3 to 10 ms with those of 3 s, 38 ms with those of 10 s. It comes at the same
moment in the rig and in those who command it: with 3 s on two processors the rig got no command for 3 to 7 samples, of
which commanders bridge 5; with 2 s for 0 to 4 in 188 kills. The rest of what is done for a killed node, 0.2 to 0.7 ms
in each process, holds up no publisher. The number is limited, too, for rigs at more than 500 Hz.

A subscriber that stands still for less than 2 s misses nothing. That is what a logger may need on a busy computer: it
waits for the disk in another thread. The time-out of killed nodes (their lease) is not the means: those of others, such
as foxglove_bridge, have their own, and with a shorter one a node that only stands still would be given up.

When a node joins, Fast DDS 2.14 may keep for ever some messages that all others acknowledge just then
(`StatefulWriter::check_acked_status` takes the new reader for one that has acknowledged all). With each heartbeat it
lists, and each subscriber goes through, the sequence numbers from the oldest of them to the present one
(`add_gaps_for_holes_in_history_`). Without a lifespan that took 80 % of a processor at either end after an hour.
"""
LOCKSTEP_STREAM_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of the samples of a lockstep run: none is overwritten; the rig keeps all and waits for slow subscribers."""

TRANSIENT_LOCAL_QOS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

PAUSE = 0.02
"""Seconds between the end of a node and that of its DDS participant: other processes handle the first meanwhile."""

LEAVE_TIMEOUT = 5.0
"""Seconds that a DDS participant has for its end.

Where another node's endpoint comes or goes just then, Fast DDS 2.14 of the wheels never ends it:
`DomainParticipantImpl::set_listener` waits for the listener that is at work, which waits for a lock of the first. It
would be let go, but the wheels are built for a C library without `pthread_cond_clockwait`, and a wait without a limit
returns at once there, with the lock. In some 600 ends of nodes that others left at the same time it was seen once.
"""

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
    return Path(get_package_share_directory("abrace_node")) / "config" / name


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

    Shared memory that killed nodes have left is removed before.
    No profile is set if the environment has one of CHOICES, nor for a node that streams if ROS_STATIC_PEERS is set and
    the discovery range is LOCALHOST.
    """
    remove_stale_segments()
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


def published_stream_qos(depth: int = KEPT_STREAM_QOS.depth) -> QoSProfile:
    """QoS of the publishers of streams: reliable, and by the clock what is not acknowledged is kept for 2 s.

    In a lockstep run nothing expires. The rig waits for a subscriber that is 5000 samples behind; once that one has got
    these, and not yet the answers to them, there are up to 5000 answers more.
    """
    if is_lockstep():
        return QoSProfile(depth=2 * depth, reliability=ReliabilityPolicy.RELIABLE)
    return QoSProfile(depth=min(depth, _MOST_KEPT), reliability=ReliabilityPolicy.RELIABLE, lifespan=_LIFESPAN)


def destroy(node: Node) -> None:
    """Destroy the only node of its context, so that no other process lists it any longer.

    Other processes receive the end of a node and that of its DDS participant in two threads. A busy process that is
    still handling the first when the second arrives lists the node for as long as it runs: 5 of 140 loggers that were
    ended by many signals. Therefore a second, hidden node keeps the participant a moment longer.

    A participant that has not ended after LEAVE_TIMEOUT is left as it is: to others it is one that was killed.
    """
    context, name = node.context.handle, node.get_name()
    with context:
        keeper = rclpy_implementation.Node(f"_{name}_leaves", node.get_namespace(), context, None, False, False)
    node.destroy_node()
    time.sleep(PAUSE)
    # in a thread, and by C: where Python calls it, no other thread has the interpreter meanwhile
    finalize = ctypes.CDLL("librcl.so").rcl_node_fini
    leaving = threading.Thread(target=finalize, args=(ctypes.c_void_p(keeper.pointer),), daemon=True)
    leaving.start()
    leaving.join(LEAVE_TIMEOUT)
    if leaving.is_alive():
        print(f"{name}: DDS does not end; others list this node for 20 s more", file=sys.stderr, flush=True)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(keeper))  # its destructor would wait as well
    else:
        keeper.destroy_when_not_in_use()
