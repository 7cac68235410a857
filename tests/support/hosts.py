# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine: network namespaces with an Ethernet link between them, without common shared memory.

Requires root, `ip`, `unshare`, `nsenter` and /dev/net/tun.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import link

if TYPE_CHECKING:
    from collections.abc import Iterator

# ends with its standard input, and the namespaces with it
_HOLD = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec cat"
_HOST = ["unshare", "--net", "--mount", "sh", "-c", _HOLD]


def missing() -> str:
    """The reason why two hosts are not possible on this machine; empty: they are possible."""
    if os.geteuid():
        return "network namespaces need root"
    if lacking := [name for name in ("ip", "unshare", "nsenter") if shutil.which(name) is None]:
        return f"{', '.join(lacking)}: not installed (iproute2, util-linux)"
    if not Path("/dev/net/tun").exists():
        return "/dev/net/tun is not there"
    tried = subprocess.run(["unshare", "--net", "--mount", "true"], capture_output=True, text=True, check=False)
    return tried.stderr.strip()


def _held(stack: contextlib.ExitStack, command: list[str]) -> int:
    """Start a process that lives until its standard input ends, and wait until it is ready; returns its number."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    stack.enter_context(process)
    assert process.stdout is not None
    if process.stdout.readline() != b"ready\n":
        raise RuntimeError(f"{' '.join(command)}: it ended, see above")
    return process.pid


class Link:
    """Controls the link between the hosts by the socket of `link.py`; may be used from either host."""

    def __init__(self, path: Path | str) -> None:
        self._path = str(path)

    def set(self, **conditions: float) -> int:
        """Set the link's conditions: `delay`, `jitter` [s], `loss` (share), `cut`; those not given are reset.

        Returns the moment from which they hold, as time.time_ns.
        """
        with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
            asking.bind(f"{folder}/answer")
            asking.settimeout(5.0)
            asking.sendto(json.dumps(conditions).encode(), self._path)
            return int(asking.recv(32))


def on(host: int) -> list[str]:
    """The prefix with which a command runs on a host, given by the number of its process."""
    return ["nsenter", "--target", str(host), "--net", "--mount", f"--wd={Path.cwd()}"]


@contextlib.contextmanager
def two_hosts() -> Iterator[tuple[int, int, Path]]:
    """Two hosts, 10.0.0.1 and 10.0.0.2: the numbers of their processes, and the socket of their link."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        control = Path(folder, "link")
        first, second = _held(stack, _HOST), _held(stack, _HOST)
        _held(stack, [sys.executable, "-I", "-S", str(link.__file__), str(first), str(second), str(control)])
        yield first, second, control
