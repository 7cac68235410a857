# SPDX-License-Identifier: Apache-2.0
"""Nodes in whose callbacks and tasks exceptions are planted, each in a process of its own, a fork of one.

python planted_exceptions.py CASES.json
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import inspect
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


PR_SET_PDEATHSIG = 1
"""Of prctl: the signal that a process gets when its parent ends."""


@dataclass(frozen=True)
class Case:
    """A node with an exception planted in it.

    Parameters
    ----------
    name
        Of its log file `NAME.log`, of the file `NAME.code` with its exit code, and of the file `NAME.go`.
    module
        With the node's class.
    arguments
        Its ROS arguments.
    place
        Name of the method that raises at every call, once the file `NAME.go` is there; empty: each callback and task
        raises at its first call, none of which ends the node, and `NAME.json` has which they are.
    """

    name: str
    module: str
    arguments: list[str]
    place: str = ""


@contextlib.contextmanager
def hosted(cases: Sequence[Case], folder: Path) -> Iterator[None]:
    """Run nodes while the context lasts."""
    file = folder / "cases.json"
    file.write_text(json.dumps([asdict(case) for case in cases]))
    with subprocess.Popen([sys.executable, __file__, file.name], cwd=folder, stdin=subprocess.PIPE) as host:
        try:
            yield
        finally:
            assert host.stdin is not None
            host.stdin.close()


def planted_in_every_node(graph: Any, rig: Path, patience: float) -> dict[str, Path]:
    """Run every live node with `each_once`, in a `graph` whose rig is the slow one of a file; files with exit codes."""
    import numpy as np
    from running_graph import PACKAGES

    from abrace_core.model.controller_file import Controller, save_controller
    from abrace_core.model.linear_model import LinearModel
    from abrace_plant.rig.file import load_rig

    folder, its_rig, rate, none = graph.folder, ["-p", f"rig:={rig}"], load_rig(rig).sample_rate, np.zeros((1, 1))
    law = LinearModel(none, none, none, none, ("a1",), ("U",), 1 / rate)
    made = Controller("one", law, none, np.zeros((1, 2)), np.array([2e4]), "", "", "")
    save_controller(made, folder / "one.yaml")
    parameters = {
        "plant": its_rig,
        "sensor_bridge": ["-p", "device:=emulator", "-p", "stop_heartbeat:=1.0"],
        "ground_motion": its_rig,
        "controller": ["--params-file", "one.yaml"],
        "excitation": ["-p", "duration:=5.0", "-p", f"sample_rate:={rate}", "-p", "band:=[0.0, 20.0]"],
        "logger": ["-p", "output:=bag"],
        "supervisor": ["-p", "inputs:=[brace_command=controller]", "-p", "patience:=120.0"],
        "operator": ["-p", "port:=0"],
        "viewer": ["-p", "port:=0"],
    }
    cases = []
    for name, given in parameters.items():
        package = PACKAGES[name]
        streams = package in ("abrace_plant", "abrace_lqg", "abrace_sysid")
        space = ["-r", f"__ns:={graph.namespace}/{name}", *(["-p", "autostart:=false"] if streams else [])]
        cases.append(Case(name, f"{package}.nodes.{name}", [*space, *given]))
    running = ["-r", f"__ns:={graph.namespace}/ground_motion", *its_rig, "-p", "command_timeout:=10.0"]
    cases.append(Case("its_rig", "abrace_plant.nodes.plant", running, "show"))
    codes = {name: folder / f"{name}.code" for name in parameters}
    with hosted(cases, folder):
        for name, code in codes.items():
            graph.until(code.exists, f"the end of {name}", patience)
    return codes


class Planted(Exception):  # noqa: N818
    """What is planted."""


def label(act: Any, depth: int = 3) -> str:
    """The name of a callback; that of a wrapper or closure has the names of what it calls."""
    act = inspect.unwrap(act)
    inner = [getattr(act, "func", None), *getattr(act, "args", ())]
    inner += [cell.cell_contents for cell in getattr(act, "__closure__", None) or ()]
    names = [label(one, depth - 1) for one in inner if depth and callable(one)]
    return " ".join([getattr(act, "__qualname__", type(act).__name__), *names])


NOT_PLANTED = (
    "TwoThreads._spin",  # the thread in which the others are
    "TwoThreads.in_loop",  # sets an event, whatever is raised in what it calls
    "AbraceLifecycleNode.on_error",  # of a transition that failed for a known reason
    "PublisherEventCallbacks",  # rclpy's own, which log a QoS that does not match
    "SubscriptionEventCallbacks",
    "EventHandler",
)
"""Beginnings of names. They are looked at all the same: an exception in them is caught."""
ACTIONS = ("_goal_callback", "_handle_accepted_callback", "_cancel_callback")
"""Callbacks of an action server, which a waitable calls."""
LIFE_CYCLE = "AbraceLifecycleNode.on_"
KINDS = ("subscriptions", "timers", "services", "waitables", "guards")
LEAST_ROUNDS = 5
"""Of calls to everything: what a node defers is known once it has been deferred."""
PATIENCE = 60.0
"""Seconds within which each place has raised."""


def each_once(case: Case, own: type) -> type:
    """A node of which everything that `catching` gets, and so each callback and task, raises at its first call."""
    places: dict[str, str] = {}

    class Each(own):  # type: ignore[misc]
        over = False

        def __init__(self) -> None:
            super().__init__()
            for server in self.waitables:
                for attribute in ACTIONS:
                    if act := getattr(server, attribute, None):
                        setattr(server, attribute, self.raising(act))
            for timer in self.timers:
                timer.timer_period_ns = min(timer.timer_period_ns, 10**9)
                timer.reset()
            threading.Thread(target=stimulate, args=(self, case, places), daemon=True).start()

        def raising(self, act: Any) -> Any:
            name = label(act)
            # without a target it is never active
            if not name.startswith(NOT_PLANTED) and (case.name, name) != ("sensor_bridge", LIFE_CYCLE + "deactivate"):
                places.setdefault(name, "not called")

            def begin() -> None:
                if places.get(name) == "not called" and not self.over:
                    if self.life_cycle and "run_tick" in name:
                        self.due = None
                    places[name] = "raised"
                    raise Planted(name)

            @wraps(act)
            def call(*arguments: Any) -> Any:
                begin()
                return act(*arguments)

            @wraps(act)
            async def wait(*arguments: Any) -> Any:
                begin()
                return await act(*arguments)

            return wait if inspect.iscoroutinefunction(act) else call

        def catching(self, act: Any, otherwise: Any = None) -> Any:
            return super().catching(self.raising(act), otherwise)

        def fail(self, error: BaseException) -> None:
            if isinstance(error, Planted) and not self.over:
                places[str(error)] = "caught"
            else:
                self.over = True  # nothing is planted in how the node ends, which would not end it
                super().fail(error)

    Each.__name__, Each.__module__ = own.__name__, own.__module__
    return Each


def stimulate(node: Any, case: Case, places: dict[str, str]) -> None:
    """Have a node's callbacks called until each has raised; note them, then have the node fail."""
    import rclpy
    from lifecycle_msgs.srv import ChangeState
    from rclpy.action import ActionClient, ActionServer
    from rclpy.executors import SingleThreadedExecutor

    context = rclpy.Context()
    context.init()
    other = rclpy.create_node("other", namespace=node.get_namespace(), context=context, start_parameter_services=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(other)
    made: dict[str, Any] = {}
    latest, last = time.monotonic() + PATIENCE, {f"{LIFE_CYCLE}cleanup", f"{LIFE_CYCLE}shutdown"}
    rounds = 0

    def left() -> set[str]:
        return {name for name, state in places.copy().items() if state != "caught"}  # the node adds to them

    def ask(service_type: type, name: str, request: Any) -> None:
        client = made.get(name) or made.setdefault(name, other.create_client(service_type, name))
        if client.service_is_ready():
            client.call_async(request)

    while (left() or rounds < LEAST_ROUNDS) and time.monotonic() < latest and node.error is None:
        rounds += node.executor is not None
        for service in list(node.services):
            ask(service.srv_type, service.service_name, service.srv_type.Request())
        for one in list(node.subscriptions):
            if label(one.callback) in left():
                name = one.topic_name
                publisher = made.get(name) or made.setdefault(name, other.create_publisher(one.msg_type, name, 10))
                publisher.publish(one.msg_type())
        if node.life_cycle:
            caught = {name for name, state in places.copy().items() if state == "caught"}
            if left() <= {f"{LIFE_CYCLE}shutdown"}:
                transition = 7 if node.active else 6 if node.configured else 5
            elif node.active:
                transition = 0 if f"{LIFE_CYCLE}deactivate" in caught and not left() <= last else 4
            elif node.configured:
                transition = 2 if left() <= last else 3
            else:
                transition = 1
            if any("run_tick" in name for name in left()):
                node.due = time.monotonic()
                node.wake()
            request = ChangeState.Request()
            request.transition.id = transition
            if transition:
                ask(ChangeState, f"{node.get_name()}/change_state", request)
        for server in node.waitables:
            if isinstance(server, ActionServer):
                client = made.get("action") or made.setdefault(
                    "action", ActionClient(other, server.action_type, "play_ground_motion")
                )
                if client.server_is_ready():
                    sent = client.send_goal_async(server.action_type.Goal(record="el_centro"))
                    sent.add_done_callback(
                        lambda sent: sent.result() and sent.result().accepted and sent.result().cancel_goal_async()
                    )
        if hasattr(node, "ask"):
            node.ask("clear", "")
        until = time.monotonic() + 0.7
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=0.05)
    entities = [one for kind in KINDS for one in getattr(node, kind)]
    acts = [getattr(one, name) for one in entities for name in ("callback", "execute") if getattr(one, name, None)]
    found = {"places": places.copy(), "not caught": [label(act) for act in acts if not hasattr(act, "catches")]}
    Path(f"{case.name}.json").write_text(json.dumps(found))
    node.over = True
    node.fail(Planted("the last"))


def every_call(case: Case, own: type) -> type:
    """A node whose method `case.place` raises at every call, once it may."""
    method = getattr(own, case.place)

    def planted(*arguments: Any) -> Any:
        if Path(f"{case.name}.go").exists():
            raise Planted(case.place)
        return method(*arguments)

    planted.__name__ = case.place
    return type(own.__name__, (own,), {case.place: planted})


def main() -> None:
    """Fork a process for each case; they end with our standard input."""
    cases = [Case(**one) for one in json.loads(Path(sys.argv[1]).read_text())]
    modules = [importlib.import_module(case.module) for case in cases]
    processes: dict[int, Case] = {}
    for case, module in zip(cases, modules, strict=True):
        if process := os.fork():
            processes[process] = case
            continue
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        log = os.open(f"{case.name}.log", os.O_WRONLY | os.O_CREAT)
        for descriptor, target in ((log, 1), (log, 2), (os.open(os.devnull, os.O_RDONLY), 0)):
            os.dup2(descriptor, target)
        (own,) = (
            one
            for one in vars(module).values()
            if getattr(one, "__module__", "") == module.__name__ and hasattr(one, "get_logger")
        )
        from abrace_node.process import run

        planted = every_call if case.place else each_once
        os._exit(run(planted(case, own), [case.name, "--ros-args", *case.arguments]))

    def end() -> None:
        sys.stdin.read()
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)

    threading.Thread(target=end, daemon=True).start()
    for _ in cases:
        process, status = os.wait()
        Path(f"{processes[process].name}.part").write_text(str(os.waitstatus_to_exitcode(status)))
        Path(f"{processes[process].name}.part").rename(f"{processes[process].name}.code")


if __name__ == "__main__":
    main()
