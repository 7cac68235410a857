# SPDX-License-Identifier: Apache-2.0
"""Runs abrace's nodes and commands to their end, started as a ProcessGroup starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.processes.group import NodeProcess, find_executable, launcher
from abrace.processes.launcher import send

if TYPE_CHECKING:
    from collections.abc import Sequence


def run_forked(words: Sequence[str | Path], timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run a node or a command to its end, in the present folder; subprocess.TimeoutExpired after `timeout` seconds."""
    with tempfile.NamedTemporaryFile("r") as output, tempfile.NamedTemporaryFile("r") as errors:
        group = launcher().start(list(map(str, words)), os.environ, [output.fileno(), errors.fileno()])
        process = NodeProcess(str(words[0]), Path(output.name), group)
        deadline = time.monotonic() + timeout
        try:
            while process.returncode is None:
                if time.monotonic() > deadline:
                    raise subprocess.TimeoutExpired(list(map(str, words)), timeout)
                time.sleep(0.002)
        finally:
            send(group, signal.SIGKILL)
            process.reap()
            launcher().forget(group)
        for file in (output, errors):
            file.seek(0)
        return subprocess.CompletedProcess(words, process.returncode or 0, output.read(), errors.read())


def run_node(package: str, executable: str, *words: object, **parameters: object) -> subprocess.CompletedProcess[str]:
    """Run a node to its end, with these further words or with these parameters."""
    given = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    arguments = ["--ros-args", *given] if given else []
    return run_forked([find_executable(package, executable), *arguments, *map(str, words)])
