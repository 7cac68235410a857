# SPDX-License-Identifier: Apache-2.0
"""Between two tests of a campaign: plant, controller and logger from their start until all are configured and heard.

Beside three bare nodes at once, each a process that imports rclpy and makes a node.

seconds, cpu_seconds    `nodes` and `bare`, medians of turns; the first turn, in which modules are imported, apart
ratio_to_bare, cpu_ratio_to_bare   of the nodes

python benchmarks/node_start.py [TURNS]
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from isolation import isolated

from abrace.nodes.graph_monitor import GraphMonitor
from abrace.processes.group import ProcessGroup, find_executable, launcher
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel

TURNS = 10
PATIENCE = 60.0
BARE = (
    "import os, rclpy, time; rclpy.init(); node = rclpy.create_node('bare'); "
    "print(time.time(), time.process_time(), flush=True); os._exit(0)"
)
NAMESPACE = "/started"
WORDS = ("--ros-args", "-r", f"__ns:={NAMESPACE}")
NODES = {"plant": "abrace_plant", "controller": "abrace_lqg", "logger": "abrace_bags"}
TICKS = os.sysconf("SC_CLK_TCK")


def node_start(turns: int = TURNS) -> dict[str, Any]:
    """All of it; call it in a folder and on a domain of one's own."""
    none = np.zeros((1, 1))
    law = LinearModel(none, none, none, none, ("a1",), ("U",), 0.002)
    save_controller(Controller("one", law, none, np.zeros((1, 2)), np.array([2e4]), "", "", ""), Path("one.yaml"))
    first, *later = ((_bare(), _nodes(turn)) for turn in range(turns + 1))
    wall, cpu = (
        {name: statistics.median(turn[j][i] for turn in later) for j, name in enumerate(("bare", "nodes"))}
        for i in (0, 1)
    )
    return {
        "first_seconds": first[1][0],
        "seconds": wall,
        "cpu_seconds": cpu,
        "ratio_to_bare": wall["nodes"] / wall["bare"],
        "cpu_ratio_to_bare": cpu["nodes"] / cpu["bare"],
    }


def _bare() -> tuple[float, float]:
    """Seconds by the clock and of processors until three bare nodes, started together, have all been made."""
    begin = time.time()
    started = [
        subprocess.Popen([sys.executable, "-c", BARE], stdout=subprocess.PIPE, text=True) for _ in range(len(NODES))
    ]
    ends = [tuple(map(float, process.communicate()[0].split())) for process in started]
    return max(end for end, _ in ends) - begin, sum(cpu for _, cpu in ends)


def _nodes(turn: int) -> tuple[float, float]:
    """As `_bare`, of the nodes of a campaign's test."""
    given = {"plant": ["-p", "autostart:=false"], "logger": ["-p", f"output:=start_{turn}"]}
    given["controller"] = ["-p", "autostart:=false", "--params-file", "one.yaml"]
    with ProcessGroup() as group, GraphMonitor(NAMESPACE, ("plant", "controller")) as monitor:
        begin, before = time.time(), _processor_time(launcher().process)
        processes = [launcher().process]
        for name, package in NODES.items():
            words: list[str | Path] = [find_executable(package, name), *WORDS, *given[name]]
            processes.append(group.start(name, words, f"{name}.log").group)
        for name in ("plant", "controller"):
            monitor.change_state(name, "configure", PATIENCE, group.raise_if_died)
        monitor.wait_until_heard("logger", PATIENCE, group.raise_if_died)
        return time.time() - begin, sum(map(_processor_time, processes)) - before


def _processor_time(process: int) -> float:
    """Seconds of processors that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(node_start(*map(int, sys.argv[1:])), indent=1))
