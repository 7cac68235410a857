# SPDX-License-Identifier: Apache-2.0
"""Starts the processes of all ProcessGroups of a program, and ends them if that program has been killed.

As a script this module is a process of its own, the launcher. It imports a node of abrace when the first of its kind is
started; each one is then a fork, without the 0.3 to 1.5 s of processor time that the imports take. An offline node is a
fork that imports its modules itself: what acts on a rig has none of them. Any other program is executed. Each has the
arguments, folder and variables that it was asked for, and a session of its own; it is a child of the asking program.

Requests and answers are lines of JSON over a socket, which ends with the program (kill -9 included).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from importlib.metadata import distribution
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

POLL_PERIOD = 0.01
"""Seconds between two checks of processes that are ending."""
MOST_FILES = 16
"""That a request brings."""
NODE = "abrace_node.executable:main"
"""The entry point of nodes."""
LONGEST_COMMAND = 4000
"""Bytes of a fork's command line that other programs, such as ps, see."""
_IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PR_SET_CHILD_SUBREAPER, _PR_SET_NAME = 36, 15


class Launcher:
    """The launcher of this program."""

    def __init__(self) -> None:
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # what it starts becomes ours
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, " " * LONGEST_COMMAND],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,
            )

    @property
    def process(self) -> int:
        """Its process number."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self._socket.fileno() >= 0 and self._process.poll() is None

    def start(
        self,
        words: Sequence[str],
        variables: Mapping[str, str],
        files: Sequence[int],
        grace: float = 5.0,
        offline: bool = False,
    ) -> int:
        """Start a process in the present folder; returns its number, which is its group's.

        Parameters
        ----------
        words
            Program and arguments.
        variables
            Its environment.
        files
            Open files: its output, its errors, and others that it keeps open.
        grace
            Seconds between the signals that end it, should this program be killed.
        offline
            Whether it is an offline node.
        """
        request = [list(words), str(Path.cwd()), dict(variables), grace, offline]
        answer = b""
        try:
            text = (json.dumps(request) + "\n").encode()
            self._socket.sendall(text[socket.send_fds(self._socket, [text], files) :])
            while not answer.endswith(b"\n"):
                if not (part := self._socket.recv(64)):
                    raise BrokenPipeError(f"the launcher, process {self.process}, has ended")
                answer += part
        except BaseException:  # an answer that nobody reads; it ends what it has started
            self._socket.close()
            raise
        return int(answer)

    def close(self) -> None:
        """End it, once it has ended what it started."""
        self._socket.close()
        self._process.wait()

    def forget(self, group: int) -> None:
        """Note that a process group has ended."""
        with contextlib.suppress(OSError):
            self._socket.sendall(f"{group}\n".encode())


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
    """SIGINT, then SIGTERM, then SIGKILL to process `groups`, each time to those that run `grace` seconds later."""
    running = [group for group in groups if is_running(group)]
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for group in running:
            send(group, number)
        deadline = time.monotonic() + grace
        while (running := [group for group in running if is_running(group)]) and time.monotonic() < deadline:
            time.sleep(POLL_PERIOD)


def _entry_point(program: Path, variables: Mapping[str, str]) -> Callable[[], int] | None:
    """What an executable of abrace's calls, its modules imported; None: it is another program, or cannot be imported.

    Modules from another path than this process's are not imported.
    """
    package, name = program.parent.name or program.name, program.name
    if not package.startswith("abrace") or variables.get("PYTHONPATH") != os.environ.get("PYTHONPATH"):
        return None
    try:
        (found,) = distribution(package).entry_points.select(group="console_scripts", name=name)
        if found.value == NODE:
            module = importlib.import_module(f"{package}.nodes.{name}")
            vars(module).get("prepare", int)()
        entry: Callable[[], int] = found.load()
    except Exception:  # executed, it says what is wrong
        return None
    return entry


def _become(request: Sequence[Any], files: Sequence[int], entry: Callable[[], int] | None) -> NoReturn:
    """Be the process that was asked for."""
    words, folder, variables, *_ = request
    os.chdir(folder)
    output = os.open(os.devnull, os.O_RDONLY), *files[:2]
    for number, file in enumerate(output):
        os.dup2(file, number)
        os.close(file)
    entry = entry or _entry_point(Path(words[0]), variables)
    if entry is None:
        try:
            os.execvpe(words[0], words, variables)
        except OSError as error:
            os.write(2, f"{words[0]}: {error.strerror}\n".encode())
            os._exit(127)
    _rename(words)
    os.environ.clear()
    os.environ.update(variables)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
    sys.argv = words
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(entry())


def _rename(words: Sequence[str]) -> None:
    """Be `words` to programs that list processes: a fork has the command line of its origin."""
    ctypes.CDLL(None).prctl(_PR_SET_NAME, Path(words[0]).name.encode(), 0, 0, 0)
    begin, end = map(int, Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[45:47])
    line = "\0".join(words).encode()[: end - begin - 1]
    ctypes.memmove(begin, line.ljust(end - begin, b"\0"), end - begin)


def _serve() -> None:
    """Answer the requests on the standard input until it ends, then end what still runs."""
    not_ignored = [number for number in _IGNORED if signal.signal(number, signal.SIG_IGN) is not signal.SIG_IGN]
    groups: dict[int, float] = {}
    with socket.socket(fileno=0) as asking:
        while True:
            line, files, *_ = socket.recv_fds(asking, 1 << 16, MOST_FILES)
            while line and not line.endswith(b"\n") and (part := asking.recv(1 << 16)):
                line += part
            if not line.endswith(b"\n"):
                break
            *gone, last = map(json.loads, line.splitlines())
            for group in gone if files else [*gone, last]:
                groups.pop(group, None)
            if not files:
                continue
            entry = None if last[4] else _entry_point(Path(last[0][0]), last[2])
            gc.freeze()  # no process looks for garbage among what all of them have
            reading, writing = os.pipe()
            between = os.fork()
            if not between:
                if os.fork():
                    os._exit(0)
                os.setsid()
                for number in not_ignored:  # a handler of Python's would lose one that comes while it is executed
                    signal.signal(number, signal.SIG_DFL)
                os.write(writing, f"{os.getpid()}\n".encode())  # from now on it may be stopped
                for file in (reading, writing, asking.detach()):
                    os.close(file)
                _become(last, files, entry)
            os.close(writing)
            os.waitpid(between, 0)  # then its child is that of the program that asks
            with os.fdopen(reading, "rb") as answer:
                started = answer.readline()
            groups[int(started)] = last[3]
            asking.sendall(started)
            for file in files:
                os.close(file)
    end(groups, max(groups.values(), default=0.0))


if __name__ == "__main__":
    _serve()
