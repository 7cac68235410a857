# SPDX-License-Identifier: Apache-2.0
"""How nodes and launches end: interrupted twice, started with wrong arguments, killed. For `make soak`."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from controller_speed import lqg3

from abrace.processes.group import find_executable
from abrace.processes.orphan_guard import is_running
from abrace.processes.parameter_file import parameter_file
from abrace_core.controller_file import save_controller

PATIENCE = 30.0
"""Seconds within which a process has to end after the signal."""
NODES: dict[str, tuple[str, dict[str, Any]]] = {
    "plant": ("abrace_plant", {}),
    "ground_motion": ("abrace_plant", {"record": "white_noise", "duration": 60.0}),
    "controller": ("abrace_lqg", {}),
    "excitation": ("abrace_sysid", {"duration": 60.0}),
    "logger": ("abrace_bags", {}),
    "supervisor": ("abrace", {"inputs": ["brace_command=nobody"], "plant": False, "patience": 60.0}),
    "characterize": ("abrace_plant", {"output": "characteristics"}),
}
"""Every kind: real time, life cycle, by the clock and by callbacks, offline."""
WRONG = (
    ("duration:=30s",),
    ("free_decay:=-1", "patience:=x"),
    ("plant:=maybe",),
    ("drive:=tabel",),
    ("bag:=/",),
    ("rig:=none.yaml",),
    ("parameters:=none.yaml",),
    ("recrod:=el_centro",),
    ("namespace:=2",),
)
CRASHES = ("Traceback", "terminate called", "Fatal")


def interrupt_twice(count: int) -> dict[str, Any]:
    """Graphs of all kinds of nodes, each of which gets two SIGINTs at a random moment; `count` nodes in all."""
    moments = random.Random(1)
    save_controller(lqg3(), "lqg3.yaml")
    crashed, codes, number, running = 0, 0, 0, 0
    while number < count:
        chosen = list(NODES)[: count - number]
        folder = Path(f"interrupted_{number}").resolve()
        folder.mkdir()
        due: list[tuple[float, str]] = []
        processes = {}
        with ExitStack() as stack:
            for name in chosen:
                log = stack.enter_context((folder / f"{name}.log").open("wb"))
                processes[name] = subprocess.Popen(
                    _command(name, folder), cwd=folder, stdout=log, stderr=log, start_new_session=True
                )
                # in its first 0.2 s, more on a busy machine, Python itself is still starting
                first = time.monotonic() + moments.uniform(0.8, 4.0)
                due += [(first, name), (first + moments.choice((0.0, 0.001, 0.005, 0.02, 0.1)), name)]
        for moment, name in sorted(due):
            time.sleep(max(0.0, moment - time.monotonic()))
            processes[name].send_signal(signal.SIGINT)
        for name, process in processes.items():
            running += not _ended(process)
            output = (folder / f"{name}.log").read_text(errors="replace")
            codes += process.returncode != 0
            if process.returncode or any(text in output for text in CRASHES):
                crashed += 1
                print(f"{folder.name}: {name} ended with {process.returncode}: {output[-500:]}")
        number += len(chosen)
    return {"nodes": number, "crashed": crashed, "codes_not_0": codes, "left_running": running}


def _command(name: str, folder: Path) -> list[str]:
    package, parameters = NODES[name]
    parameters = {**parameters, **({"output": str(folder / "bag")} if name == "logger" else {})}
    file = Path("lqg3.yaml").resolve()
    if name != "controller":
        file = parameter_file(folder / f"{name}.yaml", parameters)
    command = [find_executable(package, name), "--ros-args", "-r", f"__ns:=/{folder.name}", "--params-file", file]
    return [str(word) for word in command]


def _ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether the process and its group have ended, in time; what has not is killed."""
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None or is_running(process.pid):
        if time.monotonic() > deadline:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return False
        time.sleep(0.02)
    return True


def launch_wrongly(count: int) -> dict[str, Any]:
    """Launches with wrong arguments: none may start a node, each ends with 1."""
    started = codes = left = 0
    for k in range(count):
        log = Path(f"wrong_{k}.log")
        process = _launch(log, f"wrong_{k}", *WRONG[k % len(WRONG)])
        left += not _ended(process)
        codes += process.returncode != 1
        started += "process started" in log.read_text()
    return {"launches": count, "started_nodes": started, "codes_not_1": codes, "left_nodes": left}


def launch_and_kill(count: int) -> dict[str, Any]:
    """Launches that get SIGTERM at a random moment: no node may stay, each bag is closed."""
    moments = random.Random(2)
    left = crashed = open_bags = codes = 0
    for k in range(count):
        log, bag = Path(f"killed_{k}.log"), Path(f"killed_{k}")
        process = _launch(log, bag.name)
        time.sleep(moments.uniform(0.5, 8.0))
        process.terminate()
        left += not _ended(process)
        codes += process.returncode != -signal.SIGTERM
        open_bags += bag.exists() and not (bag / "metadata.yaml").is_file()
        output = log.read_text(errors="replace")
        if any(text in output for text in CRASHES):
            crashed += 1
            print(f"{bag}: {output[-1500:]}")
    return {
        "launches": count,
        "left_nodes": left,
        "crashed": crashed,
        "open_bags": open_bags,
        "codes_not_sigterm": codes,
    }


def _launch(log: Path, bag: str, *arguments: str) -> subprocess.Popen[bytes]:
    command = ["ros2", "launch", "abrace_bringup", "identification.launch.py", "drive:=command", f"bag:={bag}"]
    with log.open("wb") as output:
        return subprocess.Popen([*command, *arguments], stdout=output, stderr=output, start_new_session=True)


def measure(interrupts: int = 200, launches: int = 50) -> dict[str, Any]:
    """All of it; launches where there is `ros2 launch`."""
    found: dict[str, Any] = {"interrupted_twice": interrupt_twice(interrupts)}
    if shutil.which("ros2") is None:
        return {**found, "launches": "skipped: no ros2 launch on this machine"}
    return {**found, "launched_wrongly": launch_wrongly(launches), "launches_killed": launch_and_kill(launches)}


def failures(found: dict[str, Any]) -> int:
    """How many of `measure` did not end as they should."""
    return sum(
        count
        for each in found.values()
        if isinstance(each, dict)
        for name, count in each.items()
        if name not in ("nodes", "launches")
    )
