# SPDX-License-Identifier: Apache-2.0
"""Commands of the stages: run, followed, stopped; and the processes that they leave behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

MARK = "ABRACE_TEST_STAGE"
"""Variable of the environment that all processes of a stage inherit: the runner's number and the stage."""
GRACE = 20.0
"""Time to end by itself after an interrupt, or after the request for stacks [s]."""

stopping = threading.Event()
"""Somebody has interrupted the runner."""


def stop_when_asked() -> None:
    """Set `stopping` at an interrupt, a request to terminate and, but for `nohup`, at the terminal's end."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: stopping.set())


def mark(stage: str) -> str:
    """The mark of the processes of a `stage`."""
    return f"{os.getpid()}:{stage}"


def run(
    command: tuple[str, ...], environment: Mapping[str, str], limit: float, log: Path, stage: str, follow: bool
) -> str:
    """Run a `command`; its output goes to the end of `log` and, where it is followed, to the terminal.

    Returns
    -------
    str
        "" where it ended with 0, else how it ended: "exit code 3", "killed by SIGABRT", "not done after 600 s". In the
        last case the stacks of its Python programs are in the output.
    """
    # a `make` within another one would take part in its jobs
    inherited = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    end, how = time.monotonic() + limit, ""
    with log.open("ab") as output, log.open("rb") as written:
        written.seek(0, os.SEEK_END)
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**inherited, **environment, MARK: mark(stage)},
            start_new_session=True,
        )
        try:
            while True:
                ended = process.poll() is not None
                if follow:
                    sys.stdout.buffer.write(written.read())
                    sys.stdout.flush()
                if ended:
                    break
                if stopping.is_set():
                    how = "interrupted"
                    _end(process, signal.SIGINT)
                elif time.monotonic() > end:
                    how = f"not done after {limit:.0f} s"
                    # pytest and its workers write the stacks of their threads when they are told to abort
                    _end(process, signal.SIGABRT)
                time.sleep(0.1)
        finally:
            _end(process, signal.SIGKILL)
    if process.returncode < 0:
        return how or f"killed by {signal.Signals(-process.returncode).name}"
    return how or (f"exit code {process.returncode}" if process.returncode else "")


def _end(process: subprocess.Popen[bytes], first: signal.Signals) -> None:
    """End a process that still runs: by a signal to its group, and if that does not help at all, by SIGKILL."""
    for number in (first, signal.SIGKILL):
        if process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, number)
            with suppress(subprocess.TimeoutExpired):
                process.wait(GRACE)


def _marked() -> dict[int, tuple[int, str]]:
    """Of every process with a mark: its number, that of its runner, and the stage."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            for variable in (folder / "environ").read_bytes().split(b"\0"):
                name, _, value = variable.partition(b"=")
                if name == MARK.encode():
                    runner, _, stage = value.decode().partition(":")
                    found[int(folder.name)] = (int(runner), stage)
    return found


def _command_line(process: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()[:200]
    return ""


def left_by_earlier_runs() -> list[str]:
    """Processes of a runner that has ended itself, for a person to look at."""
    return [
        f"process {number} is left over from stage {stage} of an earlier run: {_command_line(number)}"
        for number, (runner, stage) in _marked().items()
        if not Path(f"/proc/{runner}").exists()
    ]


def end_leftovers(stage: str, patience: float = 3.0) -> list[str]:
    """Kill what a `stage` of this runner has left running after its end, and say what it was."""
    deadline = time.monotonic() + patience
    while left := [number for number, found in _marked().items() if found == (os.getpid(), stage)]:
        if time.monotonic() > deadline:
            break
        time.sleep(0.1)
    said = [f"process {number} did not end with stage {stage}, killed: {_command_line(number)}" for number in left]
    for number in left:
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    return said
