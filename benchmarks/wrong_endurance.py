# SPDX-License-Identifier: Apache-2.0
"""Endurance of all nodes: messages of right types and wrong content on every topic and service that their graph has.

Beside these up to 1000 samples are answered in right form, with any finite values, by a sender that is alone.

One graph with all nodes around `sensor_bridge`, whose device is the emulator, and a viewer's client and an operator's
page that are open; another with `plant` and those that drive it. Offline programs are in neither: they subscribe to
nothing and offer no service.

topics, services, messages  how many were tried, and the messages of all
repeated                    calls of services of a node that was cleaned up before it answered
samples, acting             of the rigs, and those of them with a force
faults                      times that they were stopped by these messages, and made to act again
not_finite                  samples at which what acted was not finite, and commands at the emulator
greatest_force, worst_step  of what acted [N], the latter in a sample period; capacity and rate limit allow 24516.625
                            and 10000
worst_between               the two samples between which it changed most
at_device                   greatest command at the emulator before it limits that, of force or table, over the greatest
                            that the rig has; greatest step from tick to tick, of force over the rate limit, of the
                            table over its limit of jerk: 1 is allowed
died                        nodes; the measurement ends where one does
deaf                        nodes that do not answer a request of their parameters afterwards

python benchmarks/planted_everywhere.py bounds [CALLS] measures it alone.
"""

from __future__ import annotations

import asyncio
import json
import random
import re
import shutil
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from bag_of_run import write_bag
from controller_speed import lqg3
from emulated_target import TICKING, EmulatedTarget
from foxglove_client import FoxgloveClient
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from operator_page import page_address
from rcl_interfaces.srv import ListParameters
from running_graph import STREAMING, TRANSITIONS, graph_of_its_own
from safety_by_the_clock import TARGET_PRIORITY
from std_srvs.srv import Trigger
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect
from udp_target import CONFIG, device_file
from wrong_messages import WrongMessages

from abrace_core.files.progress import Progress
from abrace_core.model.controller_file import save_controller
from abrace_core.model.run import Run
from abrace_core.safety.rig_safety import ACTING
from abrace_interfaces.msg import Response
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from pathlib import Path

    from running_graph import Graph

SAMPLE_RATE = 500.0
CAPACITY, RATE_LIMIT = 24516.625, 2.5e6
RATE_STEP = RATE_LIMIT / SAMPLE_RATE
MOST_ANSWERS = 1000
"""Every sixth of them stops the rig, which then needs a second."""
OFFLINE = {
    "ambient",
    "characterize",
    "check_sensors",
    "design",
    "emulator",
    "identify",
    "identify_data",
    "record",
    "recover",
    "validate",
}
"""Programs that subscribe to nothing and offer no service."""
ANSWER = 10.0
"""Seconds within which a node answers on a busy machine."""
LONG = 1e5
"""Seconds that no measurement lasts."""
REPLAYED_SAMPLES = 60_000
"""In the bag that is replayed: some 100 minutes, as slowly as it is."""
REPLAYED = ("/replayed/", "/stepped/")
"""Beginnings of the topics of the replay by the clock, and of that in lockstep."""
AT_ITS_END = "interlocks.table_displacement"
"""Cause of the fault of a table that a person has to move to the middle."""


class Bridge:
    """The emulator and its device file, with a calibration that may be written."""

    def __init__(self, graph: Graph, rig: Path) -> None:
        self.graph, self.rig_file, self.rig = graph, rig, load_rig(rig)
        parts = CONFIG / "device_parts"
        self.file = device_file(graph.folder, timeout=0.02, calibrated=True)
        shutil.copy(parts / "calibration.yaml", graph.folder)
        text = self.file.read_text(encoding="utf-8")
        self.file.write_text(text.replace(f"calibration: {parts}/", "calibration: "), encoding="utf-8")
        self.found = {"command": 0.0, "step": 0.0, "table_step": 0.0}
        self.not_finite = 0
        self.start()

    def start(self) -> None:
        """Start the emulator, its table in the middle."""
        self.target = EmulatedTarget(self.file, self.rig_file, TARGET_PRIORITY)
        process = self.graph.processes.start("emulator", self.target.command, self.graph.folder / "emulator.log")
        self.graph.until(lambda: TICKING in process.last_lines(), "the emulator")

    def note(self) -> None:
        """Keep the greatest values so far."""
        report = self.target.report()
        table_step = report["worst_table_step"] * self.rig.sample_rate / self.rig.table.peak_jerk
        for name, value in (
            ("command", report["worst_command"]),
            ("step", report["worst_step_over_rate_limit"]),
            ("table_step", table_step),
        ):
            self.found[name] = max(self.found[name], value)
        self.not_finite += report["dropped"].get("not_finite", 0)

    def start_again(self) -> None:
        """A person has moved the table to the middle."""
        self.note()
        self.graph.processes.stop("emulator")
        self.start()


class Driven:
    """A rig and those that drive it, and a person who knows no better than to make it act again."""

    def __init__(self, graph: Graph, name: str, wrong: WrongMessages, sample_rate: float) -> None:
        self.graph, self.name, self.wrong = graph, name, wrong
        graph.by_the_clock = True
        rig = graph.folder / "rig.yaml"
        text = (CONFIG / "ncree_three_storey.yaml").read_text(encoding="utf-8")
        rig.write_text(re.sub(r"(?m)^sample_rate: \S+", f"sample_rate: {sample_rate}", text), encoding="utf-8")
        self.bridge = Bridge(graph, rig) if name == "sensor_bridge" else None
        graph.start(name, rig=str(rig), **({"device": str(self.bridge.file)} if self.bridge else {}))
        played: dict[str, Any] = {"duration": 3600.0}
        graph.start("excitation", rms=3000.0, sample_rate=sample_rate, **played)
        graph.start("ground_motion", rig=str(rig), record="white_noise", rms=0.1, band=[0.3, 10.0], **played)

    def acts(self) -> bool:
        """Whether commands act; if not they are made to."""
        self.go_on()
        rig = self.wrong.rig
        return rig.state in ACTING and any(rig.command)

    def clear(self) -> None:
        """Clear what there is; a table that stands where its interlock would trip is moved first."""
        self.wrong.spin(0.01)
        if self.wrong.rig.state in (*ACTING, Response.ARMING):
            return
        self.wrong.until(lambda: self.wrong.rig.state != Response.RAMPING_DOWN, "the rig to come to rest")
        said = [self.clear_fault(name) for name in STREAMING[::-1] if name in self.graph.started]
        if any(AT_ITS_END in text for text in (self.wrong.rig.cause, *said)):
            self.move_table()
        self.wrong.spin(0.01)

    def go_on(self) -> None:
        """Clear what there is, and play the signals again if they are over."""
        self.clear()
        if self.wrong.rig.state in ACTING and not any(self.wrong.rig.command):
            self.take("ground_motion", "deactivate", "cleanup", "configure", "activate")  # its action's calls are lost
            self.take("excitation", "activate")
            for name in ("excitation", "ground_motion"):
                self.wrong.call(Trigger, f"{name}/play", Trigger.Request())

    def move_table(self) -> None:
        """Move the table to the middle, as docs/rig.md says."""
        self.take(self.name, "deactivate", "cleanup")
        if self.bridge:
            self.bridge.start_again()
        self.clear_fault(self.name)
        self.take(self.name, "configure", "activate")

    def take(self, name: str, *transitions: str) -> None:
        """Take a node through transitions, as far as it goes."""
        for transition in transitions:
            request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
            self.wrong.call(ChangeState, f"{name}/change_state", request)

    def clear_fault(self, name: str) -> str:
        """Clear the fault of a node, if it can be cleared; what it answers."""
        return str(self.wrong.call(Trigger, f"{name}/clear_fault", Trigger.Request()).message)


def start_others(graph: Graph, wrong: WrongMessages, sample_rate: float) -> None:
    """All other nodes, each where it has something to do."""
    folder = graph.folder
    save_controller(lqg3(sample_rate), folder / "lqg3.yaml")
    # two senders are a fault: the controller receives the rig's samples, but its own commands reach no node
    graph.start("controller", "--params-file", folder / "lqg3.yaml", "-r", "brace_command:=unheard")
    # called otherwise, so that the supervisor waits for a logger
    graph.start("logger", name="recorder", output=str(folder / "bag"))
    unheard = ("-r", "response:=spare/response", "-r", "brace_command:=spare/brace_command")
    graph.start("excitation", *unheard, name="spare", autostart=False, sample_rate=sample_rate)
    graph.start("supervisor", inputs=["brace_command=spare"], plant=False, patience=LONG)
    graph.start("operator", port=0)
    graph.start("viewer", port=0)
    nothing, count = np.zeros((REPLAYED_SAMPLES, 8)), np.arange(REPLAYED_SAMPLES, dtype=np.uint64)
    at_rest = Run("at rest", 0.002, count, 3, 1, nothing, nothing[:, 0], nothing[:, :1], braces=(1,))
    write_bag(at_rest, folder / "replayed")
    slow: dict[str, Any] = {"bag": str(folder / "replayed"), "rate": 0.02}
    graph.start("replay", "-r", f"/response:={REPLAYED[0]}response", **slow)
    lockstep = {"lockstep": True, "lockstep_timeout": LONG}
    graph.start("replay", "-r", f"/response:={REPLAYED[1]}response", name="stepping", **slow, **lockstep)
    for name in REPLAYED:
        wrong.listen(f"{name}response")


def open_pages(graph: Graph, wrong: WrongMessages) -> None:
    """A client of the viewer and a page of the operator, in a process of their own."""
    (line,) = graph.until(lambda: [one for one in graph.output_of("viewer") if "ws://" in one], "the viewer")
    command = [sys.executable, __file__, "watch", line.rpartition(":")[2], page_address(graph)]
    graph.started["watcher"] = graph.processes.start("watcher", command, graph.folder / "watcher.log")
    graph.until(lambda: int(graph.values("viewer").get("topics", 0)), "the viewer to offer topics")
    graph.until(lambda: graph.values("operator").get("pages") == "1", "the page")
    subscribed = f"{graph.namespace}/robot_description"
    wrong.until(lambda: wrong.node.count_subscribers(subscribed), "the viewer to show every topic")


def watch(port: str, page: str) -> None:
    """Show every topic in the viewer but those that are replayed, and keep the operator's page open.

    A replay ends where somebody else publishes its samples, as we do on every topic with a subscriber.
    """

    async def keep_open() -> None:
        address, headers = page.replace("http", "ws") + "live", {"Origin": page.rstrip("/")}
        message = None
        while message is None:  # a busy machine may need longer for the token than the server waits
            live = await websocket_connect(HTTPRequest(address, headers=headers, connect_timeout=0, request_timeout=0))
            await live.write_message('{"token": ""}')
            message = await live.read_message()
        while message is not None:
            content = json.loads(message)
            if "number" in content:
                await live.write_message(json.dumps({"got": content["number"]}))
            message = await live.read_message()

    threading.Thread(target=lambda: asyncio.run(keep_open()), daemon=True).start()
    with FoxgloveClient(int(port)) as client:
        shown: set[str] = set()
        while True:
            time.sleep(0.2)
            new = {name for name in client.channels if not name.startswith(REPLAYED)} - shown
            client.subscribe(*new)
            shown |= new
            for topic in shown:
                client.messages[topic].clear()


def answers(graph: Graph, name: str) -> bool:
    """Whether a node still answers."""
    answer = graph.ask(ListParameters, f"{name}/list_parameters", ListParameters.Request())
    end = time.monotonic() + ANSWER
    while not answer.done() and time.monotonic() < end:
        graph.executor.spin_once(timeout_sec=0.02)
    return answer.done()


def wrong_endurance(
    graph: Graph, rig: str, messages: int, chance: random.Random, sample_rate: float = SAMPLE_RATE
) -> dict[str, Any]:
    """So many `messages` on each topic and service of a graph: with all nodes around `sensor_bridge`, or `plant`."""
    progress, died = Progress(4), 0
    wrong = WrongMessages(graph, chance)
    try:
        driven = Driven(graph, rig, wrong, sample_rate)
        if rig == "sensor_bridge":
            start_others(graph, wrong, sample_rate)
        reporting = set(graph.started)
        graph.until(lambda: reporting <= graph.statuses.keys(), f"all of {', '.join(sorted(reporting))}")
        if rig == "sensor_bridge":
            open_pages(graph, wrong)
            graph.until(lambda: graph.state("spare") == "inactive", "the supervisor to wait for a logger")
        wrong.until(lambda: wrong.last, "samples")
        graph.until(driven.acts, "the rig to act")
        with progress.step(f"topics of {rig}'s graph") as step:
            wrong.send(messages, driven.go_on, step.update)
        with progress.step(f"answers to {rig}'s samples") as step:
            for name in ("excitation", "ground_motion"):
                driven.take(name, "deactivate")
            wrong.answer(min(messages, MOST_ANSWERS), driven.clear, step.update)
            graph.until(driven.acts, "the rig to act")
        with progress.step(f"services of the others in {rig}'s graph") as step:
            driven.take(rig, "deactivate")  # the machine has other work
            wrong.ask(lambda name: name not in STREAMING, messages, lambda: None, step.update)
        if rig == "sensor_bridge":
            graph.until(lambda: graph.values("operator").get("pages") == "1", "the page, which must still be open")
        deaf = sum(not answers(graph, name) for name in reporting - set(STREAMING))
        for name in graph.started.keys() - set(STREAMING):
            died += graph.stop(name) != 0 and name != "watcher"
            del graph.started[name]
        driven.clear()
        driven.take(rig, "activate")
        graph.until(driven.acts, "the rig to act")
        # in the other graph are the same drivers
        wanted = ("plant",) if rig == "plant" else STREAMING
        with progress.step(f"services of {', '.join(wanted)}") as step:
            wrong.ask(lambda name: name in wanted, messages, driven.go_on, step.update)
        # each of them still does what it is for
        graph.until(driven.acts, "the rig to act")
        deaf += sum(not answers(graph, name) for name in reporting & set(STREAMING))
        found: dict[str, Any] = {
            "programs": sorted(graph.executables),
            "nodes": sorted(reporting),
            "topics": dict(wrong.topics),
            "services": dict(wrong.services),
            "repeated": wrong.repeated,
            "samples": wrong.samples,
            "acting": wrong.acting,
            "faults": wrong.faults,
            "not_finite": wrong.not_finite,
            "greatest_force": wrong.greatest,
            "worst_step": wrong.worst_step,
            "worst_between": wrong.worst_between,
            "deaf": deaf,
            "died": died + sum(process.returncode is not None for process in graph.started.values()),
        }
        if driven.bridge:
            driven.bridge.note()
            found["at_device"] = driven.bridge.found
            found["not_finite"] += driven.bridge.not_finite
        return found
    finally:
        wrong.close()


def measure(messages: int) -> dict[str, Any]:
    """Both graphs, so many `messages` on each topic and service; call it on a domain of one's own."""
    found = {}
    for rig in ("sensor_bridge", "plant"):
        with graph_of_its_own(f"/wrong_{rig}") as graph:
            found[rig] = wrong_endurance(graph, rig, messages, random.Random(1))
    both = list(found.values())
    worst = max(both, key=lambda one: float(one["worst_step"]))
    return {
        **{name: sum(len(one[name]) for one in both) for name in ("topics", "services")},
        "messages": sum(sum(one[name].values()) for one in both for name in ("topics", "services")),
        **{
            name: sum(one[name] for one in both)
            for name in ("repeated", "samples", "acting", "faults", "not_finite", "died", "deaf")
        },
        "greatest_force": max(one["greatest_force"] for one in both),
        **{name: worst[name] for name in ("worst_step", "worst_between")},
        "at_device": found["sensor_bridge"]["at_device"],
        "found": found,
    }


if __name__ == "__main__":
    watch(*sys.argv[2:])  # as `watch PORT PAGE`
