# SPDX-License-Identifier: Apache-2.0
"""The tests of the launch files on a machine without `ros2 launch`: the same arguments, nodes, order and ends.

    abrace run abrace_bringup closed_loop controller:=lqg3.yaml bag:=bags/first

The nodes' output is printed on the terminal, each line with the node's name.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from abrace.processes.group import ProcessGroup, find_executable, terminate_as_exception
from abrace.processes.parameter_file import parameter_file
from abrace_bringup import graphs
from abrace_bringup.arguments import read_arguments
from abrace_core.errors import AbraceError
from abrace_core.ros_arguments import check_environment

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from abrace_bringup.arguments import Argument
    from abrace_bringup.graphs import NodeSetup

PERIOD = 0.05
"""Seconds between polls of the nodes' output, and of whether one has ended."""
FOR_LAUNCH = "robot_state_publisher"
"""The argument for a node that only a machine with `ros2 launch` has."""


def closed_loop() -> int:
    """Entry point: rig, controller, ground motion and logger, from the first sample to the last."""
    return _main("closed_loop", graphs.CLOSED_LOOP, graphs.closed_loop, "controller:=lqg3.yaml bag:=bags/first")


def identification() -> int:
    """Entry point: a test for identification."""
    return _main("identification", graphs.IDENTIFICATION, graphs.identification, "drive:=table bag:=bags/table_noise")


def _main(
    name: str, table: Sequence[Argument], nodes: Callable[[Mapping[str, Any]], list[NodeSetup]], example: str
) -> int:
    """Run a test; returns the exit code: 0 it is over, or was stopped, 1 it is incomplete, 2 wrong arguments."""
    words = sys.argv[1:]
    if {"-h", "--help"} & set(words):
        rows = [f"  {argument.name}:={argument.default}\n        {argument.description}" for argument in table]
        command = f"abrace run abrace_bringup {name}"
        print("\n".join([f"usage: {command} NAME:=VALUE ...", f"example: {command} {example}\n", *rows]))
        return 0
    try:
        check_environment()
        values = _values(table, words)
        with terminate_as_exception(), ProcessGroup() as group, TemporaryDirectory() as folder:
            terminal = Terminal(Path(folder))
            try:
                problem = _carry_out(values, nodes(values), group, terminal)
            except (KeyboardInterrupt, BrokenPipeError):
                # Ctrl-C, or the reader of the output, such as `head`, has closed the pipe
                problem = ""
            finally:
                group.stop_all()
                _show_last(terminal)
            if problem:
                print(f"{name}: {problem}", file=sys.stderr)
            return int(bool(problem))
    except AbraceError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2


def _show_last(terminal: Terminal) -> None:
    """Show what the nodes printed at their ends; if its reader has left, what Python still writes is discarded, too."""
    try:
        terminal.show()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _values(table: Sequence[Argument], words: Sequence[str]) -> dict[str, Any]:
    """The values of arguments given as `name:=value`."""
    for word in words:
        if ":=" not in word:
            raise AbraceError(f"argument {word}: expected name:=value, as controller:=lqg3.yaml")
    given = dict(word.split(":=", 1) for word in words)
    values = read_arguments(table, {argument.name: argument.default for argument in table} | given, list(given))
    if values[FOR_LAUNCH]:
        raise AbraceError(f"{FOR_LAUNCH}:=true, expected false: that node needs `ros2 launch`")
    return values


def _carry_out(values: Mapping[str, Any], setups: Sequence[NodeSetup], group: ProcessGroup, terminal: Terminal) -> str:
    """Start the nodes, and wait until the first of them ends; returns what is wrong with the test then, or nothing."""
    commands = {setup.executable: _command(values, setup, terminal.folder) for setup in setups}
    for name, command in commands.items():
        group.start(name, command, terminal.folder / f"{name}.log")
    while not (ended := group.poll()):
        terminal.show()
        time.sleep(PERIOD)
    returncode = ended.returncode
    assert returncode is not None
    return graphs.end_of_node(ended.name, returncode, shutting_down=False) or ""


def _command(values: Mapping[str, Any], setup: NodeSetup, folder: Path) -> list[str]:
    """Program and arguments of a node; of files the later ones go before."""
    program = find_executable(setup.package, setup.executable)
    own = parameter_file(folder / f"{setup.executable}.yaml", setup.parameters)
    files = [str(own), *setup.files, *([values["parameters"]] if values["parameters"] else [])]
    named = ["-r", f"__ns:=/{values['namespace']}", "-r", f"__node:={setup.executable}"]
    enclave = ["--enclave", f"{values['enclaves']}/{setup.executable}"] if values["enclaves"] else []
    return [str(program), "--ros-args", *named, *enclave, *(word for file in files for word in ("--params-file", file))]


class Terminal:
    """What the nodes have printed to their logs in a `folder`, shown line by line with the name of the node."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._shown: dict[Path, int] = {}

    def show(self) -> None:
        """Print the lines that have come since the last time."""
        for log in sorted(self.folder.glob("*.log")):
            content = log.read_bytes()
            begin, end = self._shown.get(log, 0), content.rfind(b"\n") + 1
            for line in content[begin:end].decode(errors="replace").splitlines():
                print(f"[{log.stem}] {line}", flush=True)
            self._shown[log] = max(begin, end)
