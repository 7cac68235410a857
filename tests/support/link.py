# SPDX-License-Identifier: Apache-2.0
"""An Ethernet link between two network namespaces, with delay, jitter, loss and cuts on demand.

    python link.py PROCESS PROCESS SOCKET

Each end is a TAP device in the namespace of a process, by its number; frames pass from one to the other through this
program. The Unix datagram socket takes conditions as JSON, {"delay": s, "jitter": s, "loss": share, "cut": bool}, with
defaults of zero and false, and answers with the moment [ns] from which they hold. (netem is not available in every
kernel.)
"""

from __future__ import annotations

import fcntl
import json
import os
import random
import select
import socket
import struct
import subprocess
import sys
import time
from collections import deque
from typing import Any

TUNSETIFF = 0x400454CA
TAP_WITHOUT_HEADER = 0x1002
LARGEST = 2048
PRIORITY = 60
"""Priority above that of the nodes, so that the link's delays are exact."""


def open_end(process: int, address: str) -> int:
    """The file of a TAP device, which becomes the Ethernet of the namespace of `process`."""
    tap = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    asked = struct.pack("16sH22x", b"", TAP_WITHOUT_HEADER)
    name = fcntl.ioctl(tap, TUNSETIFF, asked)[:16].rstrip(b"\0").decode()
    inside = ["nsenter", "--target", str(process), "--net", "ip"]
    for command in (
        ["ip", "link", "set", name, "netns", str(process), "name", "eth0"],
        [*inside, "address", "add", address, "dev", "eth0"],
        [*inside, "link", "set", "eth0", "up"],
    ):
        subprocess.run(command, check=True)
    return tap


class Direction:
    """Frames from one end to the other, in their order."""

    def __init__(self, source: int, target: int) -> None:
        self.source, self._target = source, target
        self._waiting: deque[tuple[float, bytes]] = deque()

    def take(self, conditions: dict[str, float], now: float) -> None:
        """Read the frames that have arrived."""
        while True:
            try:
                frame = os.read(self.source, LARGEST)
            except BlockingIOError:
                return
            if conditions.get("cut") or random.random() < conditions.get("loss", 0.0):
                continue
            due = now + conditions.get("delay", 0.0) + random.uniform(0.0, conditions.get("jitter", 0.0))
            if self._waiting:
                due = max(due, self._waiting[-1][0])
            self._waiting.append((due, frame))

    def give(self, now: float) -> float | None:
        """Write the frames that are due; returns the time at which the next one is due."""
        while self._waiting and self._waiting[0][0] <= now:
            try:
                os.write(self._target, self._waiting.popleft()[1])
            except OSError:  # the other end's queue is full, or it is not up yet: lost, as on a wire
                continue
        return self._waiting[0][0] if self._waiting else None

    def lose(self) -> None:
        """Drop the frames in transit."""
        self._waiting.clear()


def main() -> None:
    """Relay until standard input ends."""
    first, second, path = sys.argv[1:]
    ends = open_end(int(first), "10.0.0.1/24"), open_end(int(second), "10.0.0.2/24")
    directions = Direction(*ends), Direction(*reversed(ends))
    control = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    control.bind(path)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    print("ready", flush=True)
    conditions: dict[str, float] = {}
    wait: float | None = None
    sources: list[Any] = [*ends, control, 0]
    while True:
        readable, _, _ = select.select(sources, [], [], wait)
        if 0 in readable:
            return
        if control in readable:
            message, sender = control.recvfrom(LARGEST)
            conditions = json.loads(message)
            if conditions.get("cut"):
                for direction in directions:
                    direction.lose()
            control.sendto(str(time.time_ns()).encode(), sender)
        now = time.monotonic()
        for direction in directions:
            if direction.source in readable:
                direction.take(conditions, now)
        due = [due for direction in directions if (due := direction.give(now)) is not None]
        wait = max(0.0, min(due) - time.monotonic()) if due else None


if __name__ == "__main__":
    main()
