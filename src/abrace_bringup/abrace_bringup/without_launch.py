# SPDX-License-Identifier: Apache-2.0
"""A graph as `abrace run` runs it, on a machine without `ros2 launch`: the same arguments, nodes, order and ends.

    abrace run abrace_bringup closed_loop controller:=lqg3.yaml bag:=bags/first

The nodes' output is printed on the terminal, each line with the node's name.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from abrace.processes.group import ProcessGroup, find_executable, terminate_as_exception
from abrace.processes.parameter_file import parameter_file
from abrace_bringup.graphs import GRAPHS, STOPPED, end_of_node, has_end
from abrace_core import AbraceError
from abrace_node.executable import check_environment

if TYPE_CHECKING:
    from abrace_bringup.graphs import Graph, NodeSetup

PERIOD = 0.05
"""Seconds between polls of the nodes' output, and of whether one has ended."""


def main() -> int:
    """Entry point of the executable of each graph.

    Returns
    -------
    int
        0: the test is over; 1: it is incomplete, or was stopped before its end; 2: wrong arguments.
    """
    graph, words = GRAPHS[Path(sys.argv[0]).name], sys.argv[1:]
    if {"-h", "--help"} & set(words):
        command = f"abrace run abrace_bringup {graph.name}"
        rows = [
            f"  {argument.name}:={argument.default}\n        {argument.description}" for argument in graph.arguments
        ]
        print("\n".join([f"usage: {command} NAME:=VALUE ...", f"example: {command} {graph.example}\n", *rows]))
        return 0
    try:
        check_environment()
        problem = _run(_nodes(graph, words))
    except AbraceError as error:
        print(f"{graph.name}: {error}", file=sys.stderr)
        return 2
    if problem:
        print(f"{graph.name}: {problem}", file=sys.stderr)
    return int(bool(problem))


def _nodes(graph: Graph, words: list[str]) -> list[NodeSetup]:
    """The nodes by arguments given as `name:=value`."""
    for word in words:
        if ":=" not in word:
            raise AbraceError(f"argument {word}: expected name:=value, as {graph.example.split()[0]}")
    given = dict(word.split(":=", 1) for word in words)
    return graph.nodes(given, list(given))


def _run(setups: list[NodeSetup]) -> str:
    """Run the nodes until the first of them ends; returns what is wrong with the test then, or nothing."""
    with terminate_as_exception(), ProcessGroup() as group, TemporaryDirectory() as folder:
        terminal = Terminal(Path(folder))
        try:
            commands = {setup.executable: _command(setup, terminal.folder) for setup in setups}
            for name, command in commands.items():
                group.start(name, command, terminal.folder / f"{name}.log")
            while not (ended := group.poll()):
                terminal.show()
                time.sleep(PERIOD)
            assert ended.returncode is not None
            return end_of_node(ended.name, ended.returncode, shutting_down=False) or ""
        except (KeyboardInterrupt, BrokenPipeError):
            # Ctrl-C, or the reader of the output, such as `head`, has closed the pipe
            return STOPPED if any(map(has_end, setups)) else ""
        finally:
            group.stop_all()
            terminal.show_last()


def _command(setup: NodeSetup, folder: Path) -> list[str]:
    """Program and arguments of a node; of files the later ones go before."""
    program = find_executable(setup.package, setup.executable)
    files = [parameter_file(folder / f"{setup.executable}.yaml", setup.parameters), *setup.files]
    named = ["-r", f"__ns:={setup.namespace}", "-r", f"__node:={setup.executable}"]
    enclave = ["--enclave", setup.enclave] if setup.enclave else []
    given = [word for file in files for word in ("--params-file", str(file))]
    return [str(program), "--ros-args", *named, *enclave, *given]


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

    def show_last(self) -> None:
        """Show what the nodes printed at their ends; if the reader has left, what Python still writes is discarded."""
        try:
            self.show()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
