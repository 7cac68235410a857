# SPDX-License-Identifier: Apache-2.0
"""Starting, watching and stopping the processes of a test, so that none outlives it.

Every node runs in a session of its own: Ctrl-C at the terminal reaches only this process, which stops the nodes in an
order that lets the logger close its bag last. Signals go to a node's whole process group, including its children. The
`launcher` starts them, and ends them if this process is killed before it could stop them (kill -9).
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import signal
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.processes.launcher import POLL_PERIOD, Launcher, end, send
from abrace_core import AbraceError, RunFailed
from abrace_core.files.suggestion import expected_of
from abrace_node.executable import NO_ROS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

PACKAGE_MARKERS = Path("share/ament_index/resource_index/packages")
FULL = 1 << 20
"""Free bytes below which a disk is full."""
LAST_THREADS = 1.0
"""Seconds for which an ended process may still have threads."""


@cache
def launcher() -> Launcher:
    """The launcher of this program; it starts when it is first needed, and ends with the program."""
    made = Launcher()
    atexit.register(made.close)
    return made


def find_executable(package: str, executable: str) -> Path:
    """`lib/<package>/<executable>` under the first prefix of AMENT_PREFIX_PATH that has it.

    Raises
    ------
    AbraceError
        If there is none; the message names the package's executables, or the packages that have executables.
    """
    if not prefixes():
        raise AbraceError(NO_ROS)
    for prefix in prefixes():
        path = prefix / "lib" / package / executable
        if _is_executable(path):
            return path
    if found := executables(package):
        raise AbraceError(f"package {package} has no executable {executable!r}, {expected_of(executable, found)}")
    packages = {marker.name for prefix in prefixes() for marker in (prefix / PACKAGE_MARKERS).glob("*")}
    if package in packages:
        raise AbraceError(f"package {package} has no executables, expected {executable!r} in lib/{package}")
    raise AbraceError(f"no package {package!r} in AMENT_PREFIX_PATH, {expected_of(package, packages_with_nodes())}")


def packages_with_nodes() -> set[str]:
    """The packages that have executables, without ROS's own message generators."""
    found = {marker.name for prefix in prefixes() for marker in (prefix / PACKAGE_MARKERS).glob("*")}
    return {package for package in found if not package.startswith("rosidl_") and executables(package)}


def executables(package: str) -> set[str]:
    """The executables of a `package`."""
    folders = (prefix / "lib" / package for prefix in prefixes())
    return {path.name for folder in folders for path in folder.glob("*") if _is_executable(path)}


def prefixes() -> list[Path]:
    """The folders of AMENT_PREFIX_PATH, in which packages are installed."""
    return [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]


def _is_executable(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


class NodeDied(RunFailed):
    """A node ended by itself.

    Its name, exit code or minus the number of the signal that ended it, and the end of its output.
    """

    def __init__(self, name: str, returncode: int, log_file: Path, last_lines: Sequence[str]) -> None:
        how = f"exit code {returncode}" if returncode >= 0 else f"ended by {signal.Signals(-returncode).name}"
        if shutil.disk_usage(log_file.parent).free < FULL:
            how += ", no space left on the disk"
        last = next((line.strip() for line in reversed(last_lines) if line.strip()), "it printed nothing")
        super().__init__(f"{name} died ({how}): {last} (all it printed: {log_file})")
        self.name, self.returncode, self.last_lines = name, returncode, tuple(last_lines)


class NodeProcess:
    """A process that a ProcessGroup started; `group` is its process group, which is the process's own number."""

    def __init__(self, name: str, log_file: Path, group: int) -> None:
        self.name = name
        self.log_file = log_file
        self.group = group
        self._returncode: int | None = None

    @property
    def returncode(self) -> int | None:
        """Exit code, or minus the number of the signal that ended it; None while it runs."""
        if self._returncode is None:
            # the process is left unreaped, so that its group's number is not used again before `reap`
            ended = os.waitid(os.P_PID, self.group, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            if ended is not None:
                self._returncode = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
        return self._returncode

    def reap(self) -> None:
        """Release an ended process and keep its exit code; its last threads may still be ending."""
        deadline = time.monotonic() + LAST_THREADS
        while self.returncode is None and time.monotonic() < deadline:
            time.sleep(POLL_PERIOD)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self.group, os.WNOHANG)

    def last_lines(self, count: int = 10) -> list[str]:
        """The last `count` lines of its output."""
        with self.log_file.open("rb") as log:
            log.seek(0, os.SEEK_END)
            log.seek(max(0, log.tell() - 500 * count))
            lines = log.read().decode(errors="replace").splitlines()
        return lines[-count:]

    def died(self) -> NodeDied:
        """The error to raise for this process, which has ended."""
        returncode = self.returncode
        assert returncode is not None, f"{self.name} runs"
        return NodeDied(self.name, returncode, self.log_file, self.last_lines())


class ProcessGroup:
    """The processes of a test: a context manager that leaves none behind.

    When the block ends, by an error or not, all are stopped, the last started first. A second Ctrl-C during that stop
    kills them at once.

    Parameters
    ----------
    grace
        Time to wait after SIGINT, and again after SIGTERM and SIGKILL, when a process is stopped [s].
    held
        Open files, such as a lock, that every process inherits: they stay open until the last one has ended.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder, ProcessGroup() as group:
    ...     node = group.start("hello", ["echo", "hello"], Path(folder) / "hello.log")
    ...     ended = None
    ...     while ended is None:
    ...         ended = group.poll()
    ...     ended.name, ended.returncode, ended.last_lines()
    ('hello', 0, ['hello'])
    """

    def __init__(self, grace: float = 5.0, held: Sequence[int] = ()) -> None:
        self._grace = grace
        self._held = held
        self._processes: dict[str, NodeProcess] = {}
        self._ended: list[NodeProcess] = []

    def __enter__(self) -> ProcessGroup:
        """Start the launcher, if it does not run yet."""
        if not launcher().runs:
            launcher.cache_clear()
        self._launcher = launcher()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop every process."""
        try:
            self.stop_all()
        except BaseException:
            for process in self._processes.values():
                send(process.group, signal.SIGKILL)
            raise

    def start(
        self,
        name: str,
        argv: Sequence[str | Path],
        log_file: Path | str,
        environment: Mapping[str, str] | None = None,
        offline: bool = False,
    ) -> NodeProcess:
        """Start a process in a session of its own.

        Parameters
        ----------
        name
            Name of the process; can be used again once it has been stopped.
        argv
            Program and arguments.
        log_file
            Receives its output, errors included; an existing file is replaced.
        environment
            Variables in addition to this process's.
        offline
            Whether it is an offline node: then it has no modules in common with those that act on a rig.

        Raises
        ------
        AbraceError
            If the program does not exist, or the log file cannot be written.
        """
        log_file = Path(log_file)
        if name in self._processes:
            raise AbraceError(f"cannot start {name}: a process of that name is already running")
        variables = {**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})}
        program = str(argv[0])
        if shutil.which(program, path=variables.get("PATH")) is None:
            raise AbraceError(f"cannot start {name}: {program}, expected a program")
        try:
            log_file.parent.mkdir(parents=True, exist_ok=True)
            log = log_file.open("wb")
        except OSError as error:
            raise AbraceError(f"cannot write {log_file}: {error.strerror}") from error
        try:
            with log:
                files = [log.fileno(), log.fileno(), *self._held]
                group = self._launcher.start(list(map(str, argv)), variables, files, self._grace, offline)
        except OSError as error:
            raise RunFailed(f"cannot start {name}: {error}") from error
        process = self._processes[name] = NodeProcess(name, log_file, group)
        return process

    def poll(self) -> NodeProcess | None:
        """The first process that has ended without being stopped, or None."""
        self._look()
        return self._ended[0] if self._ended else None

    def raise_if_died(self, may_finish: Collection[str] = ()) -> None:
        """Raise NodeDied for the first process that ended without a stop.

        Those named in `may_finish` may end by themselves with exit code 0.
        """
        self._look()
        for process in self._ended:
            if process.name not in may_finish or process.returncode != 0:
                raise process.died()

    def _look(self) -> None:
        for process in self._processes.values():
            if process not in self._ended and process.returncode is not None:
                self._ended.append(process)

    def stop(self, name: str, grace: float | None = None) -> NodeProcess:
        """Stop the process `name` and all that it started: SIGINT, after `grace` [s] SIGTERM, after `grace` SIGKILL.

        Returns
        -------
        NodeProcess
            With its exit code.
        """
        process = self._processes[name]
        self.stop_together([name], grace)
        return process

    def stop_together(self, names: Collection[str], grace: float | None = None) -> None:
        """Stop the processes of these `names` at the same time; `grace` as in `stop`."""
        processes = [self._processes[name] for name in names]
        end([process.group for process in processes], self._grace if grace is None else grace)
        for process in processes:
            process.reap()
            self._launcher.forget(process.group)
            del self._processes[process.name]
            if process in self._ended:
                self._ended.remove(process)

    def stop_all(self, order: Sequence[str] = (), grace: float | None = None) -> None:
        """Stop every process: those in `order` first, then the others, the last started first; `grace` as in `stop`."""
        others = [name for name in reversed(self._processes) if name not in order]
        for name in [name for name in order if name in self._processes] + others:
            self.stop(name, grace)


class Terminated(SystemExit):
    """SIGTERM or SIGHUP was received; ends the program with the usual exit code, 128 plus the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)


@contextlib.contextmanager
def terminate_as_exception() -> Iterator[None]:
    """Raise Terminated on SIGTERM and SIGHUP within the block, so that every `with` cleans up; in the main thread only.

    A signal that was ignored before (nohup) stays ignored.
    """

    def terminate(number: int, _frame: object) -> None:
        raise Terminated(number)

    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, terminate) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
