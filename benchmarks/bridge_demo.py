# SPDX-License-Identifier: Apache-2.0
"""El Centro with LQG3 in real time through emulator and bridge: samples lost, answers too late, and how long they take.

lost_samples      ticks of the emulated target whose sample did not reach a listener of `response`
missed_deadlines  answers of controller and playback that came too late to act from the next sample on
median_us, ...    from a sample's instant to the arrival of the command that answers it: packet, bridge, DDS, law, DDS
intervals         deviations of the time between two samples, as they are received, from the period
timer, echo       a bare timer and a bare echo (a round trip over DDS) at the same period afterwards

python benchmarks/bridge_demo.py [SECONDS [RATE [PRIORITY]]]
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import rclpy
from controller_speed import SOURCE, reduced, rig_and_weights
from isolation import isolated
from timing import Delays, Listener, bare_timer

from abrace.nodes.graph_monitor import GraphMonitor
from abrace.processes.group import NodeProcess, ProcessGroup, find_executable
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.safety.wire import BraceCommands, Responses
from abrace_interfaces.msg import BraceCommand, Response
from abrace_lqg.design import design
from abrace_node import real_time
from abrace_node.transport import KEPT_STREAM_QOS

SECONDS, RATE, PRIORITY = 160.0, 500.0, 50
TARGET_PRIORITY = 20
"""Beyond that of the loops: a real target has a processor of its own."""
PATIENCE = 30.0
SETTLE = 1.0
"""Seconds of the run whose answers are not timed: what was published while nothing was spun comes all at once."""
BESIDE = 30.0
"""Seconds of timer and of echo, each."""
CONFIG = SOURCE / "abrace_plant/config"


class Watch(Listener):
    """Listens to samples and commands, and measures timer and echo."""

    def __init__(self) -> None:
        super().__init__("watch")
        self.received: list[int] = []
        self.sampled: dict[int, int] = {}
        self.answered: dict[int, int] = {}
        self._responses, self._commands = Responses(), BraceCommands()
        self.create_subscription(Response, "response", self._on_response, KEPT_STREAM_QOS, raw=True)
        self.create_subscription(BraceCommand, "brace_command", self._on_command, KEPT_STREAM_QOS, raw=True)

    def _on_response(self, payload: bytes) -> None:
        self.received.append(time.monotonic_ns())
        stamp, head, _ = self._responses.unpack(payload)
        self.sampled[head.sequence] = stamp

    def _on_command(self, payload: bytes) -> None:
        now = time.time_ns()
        self.answered[self._commands.unpack(payload)[1]] = now

    def intervals(self, period: float) -> Delays:
        """Deviations of the times between samples."""
        since = round(SETTLE / period)
        steps = np.diff(list(self.sampled)[since:])
        return Delays(np.abs(np.diff(self.received[since:]) / 1e9 - period * steps), int((steps - 1).sum()))

    def answers(self, period: float) -> Delays:
        """Times from samples to the commands that answer them."""
        since = round(SETTLE / period)
        asked = [number for number in self.sampled if number >= since]
        times = [1e-9 * (self.answered[n] - self.sampled[n]) for n in asked if n in self.answered]
        return Delays(np.array(times), len(asked) - len(times))


def start(group: ProcessGroup, name: str, package: str, *arguments: object) -> NodeProcess:
    """Start a program; its log is in the present folder."""
    command: list[str | Path] = [find_executable(package, name), *map(str, arguments)]
    return group.start(name, command, f"{name}.log")


def node_arguments(**parameters: object) -> list[str]:
    """ROS arguments of a node in the namespace of the demo."""
    given = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    return ["--ros-args", "-r", "__ns:=/bridge_demo", *given]


def controller_of(rate: float) -> Path:
    """LQG3 for this sample rate [Hz] as a file."""
    rig, weights = rig_and_weights()
    made = design(reduced(replace(rig, sample_rate=rate)), weights, 1 / rate)
    observer = made.correction, made.prediction
    controller = Controller(
        "lqg3", made.controller, *observer, rig.capacity, "the rig's own", "lqg3", "not needed here"
    )
    save_controller(controller, "lqg3.yaml")
    return Path("lqg3.yaml")


def bridge_demo(seconds: float = SECONDS, rate: float = RATE, priority: int = PRIORITY) -> dict[str, Any]:
    """Run it for `seconds` at a `rate` [Hz] with this `priority` of all loops, on a domain of one's own.

    Returns
    -------
    dict
        `fault` after which nothing acted, or nothing; `lost_samples`, `missed_deadlines`; of the answers `answers`,
        `median_us`, `p99_us`, `p999_us`, `p9999_us`, `worst_us`; the same of `intervals`, `timer` and `echo`;
        `emulator`: what it reports.
    """
    rig_file = Path("rig.yaml").resolve()
    text = (CONFIG / "ncree_three_storey.yaml").read_text(encoding="utf-8")
    rig_file.write_text(re.sub(r"sample_rate: \S+", f"sample_rate: {rate}", text), encoding="utf-8")
    device = CONFIG / "devices/emulator.yaml"
    loop = {"thread_priority": priority}
    names = ["controller", "ground_motion"]
    expected = {
        "sensor_bridge": {"subscribers of response": 3, "publishers of brace_command": 1},
        "controller": {"publishers of response": 1, "subscribers of brace_command": 2},
        "ground_motion": {"publishers of response": 1, "subscribers of ground_motion": 1},
    }
    with ProcessGroup() as group, GraphMonitor("/bridge_demo", ("sensor_bridge",), ("ground_motion",)) as monitor:
        start(
            group, "emulator", "abrace_plant", "--rig", rig_file, "--device", device,
            "--priority", priority + TARGET_PRIORITY, "--log", "emulator.json",
        )  # fmt: skip
        given = {"rig": rig_file, "device": device, "duration": seconds, "stop_heartbeat": 600.0}
        bridge = node_arguments(autostart="false", **given, **loop)
        start(group, "sensor_bridge", "abrace_plant", *bridge)
        start(
            group, "controller", "abrace_lqg", *node_arguments(**loop), "--params-file", controller_of(rate).resolve()
        )
        motion = {"record": "el_centro", "peak_acceleration": 0.980665, "duration": seconds}
        start(group, "ground_motion", "abrace_plant", *node_arguments(rig=rig_file, **motion, **loop))
        rclpy.init(args=["--ros-args", "-r", "__ns:=/bridge_demo"])
        watch = Watch()
        try:
            monitor.change_state("sensor_bridge", "configure", PATIENCE, group.raise_if_died)
            monitor.wait_until_matched(expected, PATIENCE, group.raise_if_died)
            real_time.apply(SimpleNamespace(cpu_affinity=[], lock_memory=False, **loop), print)
            monitor.change_state("sensor_bridge", "activate", PATIENCE, group.raise_if_died)
            monitor.play(PATIENCE, group.raise_if_died)
            while (ended := group.poll()) is None:
                watch.spin_until(lambda: False, time.monotonic() + 0.5)
            watch.spin_until(lambda: False, time.monotonic() + 0.5)
            done = "\n".join(ended.last_lines())
            counts = re.search(r"([0-9]+) samples, ([0-9]+) late answers", done)
            if ended.name != "sensor_bridge" or counts is None:
                raise ended.died()
            group.stop_all([*names, "sensor_bridge"])
            parts = {
                "intervals": watch.intervals(1 / rate),
                "timer": bare_timer(1 / rate, BESIDE),
                "echo": watch.echo(1 / rate, BESIDE),
            }
            answers = watch.answers(1 / rate).statistics()
            return {
                "fault": "".join(re.findall(r"fault: ([^;]+);", done)[:1]),
                "lost_samples": int(counts[1]) - len(watch.received),
                "missed_deadlines": int(counts[2]),
                "answers": answers.pop("events"),
                **{name: value for name, value in answers.items() if name != "missed"},
                **{name: part.statistics() for name, part in parts.items()},
                "emulator": json.loads(Path("emulator.json").read_text(encoding="utf-8")),
            }
        finally:
            watch.own_executor.shutdown()  # which would keep it in the graph, where the next one meets a namesake
            watch.destroy_node()
            rclpy.try_shutdown()


def main() -> None:
    """Measure and print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with isolated():
        given = [kind(text) for kind, text in zip((float, float, int), sys.argv[1:], strict=False)]
        print(json.dumps(bridge_demo(*given), indent=1))


if __name__ == "__main__":
    main()
