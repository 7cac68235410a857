# SPDX-License-Identifier: Apache-2.0
"""Ends process groups; as a script, those of a `processes.ProcessGroup` whose own process has died.

Its standard input lists the running process groups: `+1234` when one starts, `-1234` when it has ended. A node that is
being started holds the other end of that pipe until it has written its own line. The input therefore ends only when the
owner, the process with the ProcessGroup, has ended (kill -9 included), and no node is missed. Only the standard library
is needed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

POLL_PERIOD = 0.01
"""Seconds between two checks of processes that are ending."""


def _runs_in(stat: Path, group: int) -> bool:
    """Whether the process of this /proc/PID/stat belongs to the group and is not a zombie."""
    try:
        state, _, process_group = stat.read_bytes().rpartition(b")")[2].split()[:3]
    except (OSError, ValueError):
        return False
    return int(process_group) == group and state not in b"ZX"


def is_running(group: int) -> bool:
    """Whether any process of the process group still runs; zombies do not count."""
    proc = Path("/proc")
    return _runs_in(proc / str(group) / "stat", group) or any(
        _runs_in(stat, group) for stat in proc.glob("[0-9]*/stat")
    )


def send(group: int, number: signal.Signals) -> None:
    """Send the signal `number` to every process of the `group`; does nothing if the group has ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def end(groups: Iterable[int], grace: float) -> None:
    """SIGINT, then SIGTERM, then SIGKILL to all of the groups, each time to those that still run `grace` seconds later.

    Parameters
    ----------
    groups
        Process groups.
    grace
        Time to wait after each signal [s].
    """
    running = [group for group in groups if is_running(group)]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for group in running:
            send(group, number)
        deadline = time.monotonic() + grace
        while (running := [group for group in running if is_running(group)]) and time.monotonic() < deadline:
            time.sleep(POLL_PERIOD)


def main() -> None:
    """Read the groups until the owner has ended, then end those that still run."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    groups: set[int] = set()
    for line in sys.stdin:
        if line.startswith("+"):
            groups.add(int(line))
        else:
            groups.discard(-int(line))
    end(groups, grace=float(sys.argv[1]))


if __name__ == "__main__":
    main()
