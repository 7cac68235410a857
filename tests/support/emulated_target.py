# SPDX-License-Identifier: Apache-2.0
"""The emulator as a process of its own, and what it is asked and says while it runs."""

from __future__ import annotations

import json
import socket
from typing import TYPE_CHECKING, Any

from udp_target import CONFIG, free_ports

from abrace.processes.group import find_executable

if TYPE_CHECKING:
    from pathlib import Path

TICKING = "emulator: ticking"
"""What the emulator prints once it sends samples."""


class EmulatedTarget:
    """The hardware of a device file; whoever makes this starts its `command`.

    Parameters
    ----------
    device, rig
        Files.
    priority
        SCHED_FIFO priority of its loop.
    """

    def __init__(
        self,
        device: Path,
        rig: Path = CONFIG / "ncree_three_storey.yaml",
        priority: int = 50,
    ) -> None:
        (self._port,) = free_ports(1)
        self.command: list[str | Path] = [
            find_executable("abrace_plant", "emulator"),
            "--rig",
            str(rig),
            "--device",
            str(device),
        ]
        self.command += ["--control", str(self._port), "--priority", str(priority)]

    def ask(self, text: str) -> str:
        """Have a fault begin, or the report."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            asking.settimeout(10)
            asking.sendto(text.encode(), ("127.0.0.1", self._port))
            return asking.recv(4096).decode()

    def report(self) -> dict[str, Any]:
        """Its counts."""
        found: dict[str, Any] = json.loads(self.ask("report"))
        return found
