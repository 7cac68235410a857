# SPDX-License-Identifier: Apache-2.0
"""The controller against its peers: a step of it, and its answer over DDS.

step_us            a sample from its bytes to the bytes of its command: unpacked, checked for gaps, LQG3's law, the
                   guard's limits, packed, the estimate advanced with the applied force; without DDS
loop               sample to command between two processes over DDS, measured by the sender of the sample: our node
                   `controller` against the bare echo of the same two messages, in turns in one run

python benchmarks/controller_speed.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.signals import command_names, response_names
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME, State
from abrace_core.safety.sample_gate import SampleGate
from abrace_core.safety.wire import LOCKSTEP, BraceCommands, Head, Responses
from abrace_lqg.active_controller import ActiveController
from abrace_lqg.design import design
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.reduction import balanced_truncation, typical_scales

if TYPE_CHECKING:
    from abrace_core.model.linear_model import LinearModel
    from abrace_plant.rig.model import Rig

HERE = Path(__file__).parent.resolve()
SOURCE = HERE.parent / "src"
PERIOD_NS = 2_000_000
STEPS, TURNS = 1000, 40
SETTLE, BLOCK, BLOCKS = 500, 250, 400
"""Answers not counted, and of each turn, and turns of each node: of 10 000 answers the 99 % swings between runs."""
QUANTILES = {"median": 50.0, "p99": 99.0, "p999": 99.9}


def rig_and_weights() -> tuple[Rig, Weights]:
    """The paper's rig and LQG3's weights."""
    rig = load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")
    return rig, load_weights(SOURCE / "abrace_lqg/config/lqg3.yaml")


def reduced(rig: Rig) -> LinearModel:
    """Eight states of the rig's model, the paper's order."""
    return balanced_truncation(rig.model, 8, typical_scales(rig.model, (0.3, 30.0), INTENSITY)).model


def lqg3(sample_rate: float = 500.0) -> Controller:
    """LQG3 on eight states and the two of the command's delay, at so many samples a second."""
    rig, weights = rig_and_weights()
    rig = replace(rig, sample_rate=sample_rate)
    made = design(reduced(rig), weights, 1 / rig.sample_rate)
    observer = made.correction, made.prediction
    return Controller("lqg3", made.controller, *observer, rig.capacity, "the rig's own", "lqg3", "not needed here")


def samples(count: int, first: int = 0) -> list[bytes]:
    """Responses of the three-storey rig in noise, as they come over DDS."""
    responses, random = Responses(), np.random.default_rng(1)
    found = []
    for sequence, values in enumerate(0.3 * random.standard_normal((count, 3)), first):
        # in lockstep nobody takes a pause between two samples for silence
        zeros, head = [0.0], Head(sequence, 1, 0, LOCKSTEP, State.RUNNING)
        arrays = 3 * zeros, values.tolist(), zeros, 2 * zeros, zeros
        found.append(responses.pack(sequence * PERIOD_NS, head, "", [2], *arrays, 0.0, 0.0))
    return found


def step_us(controller: Controller) -> float:
    """Microseconds of a sample, everything but DDS; the best of some turns."""
    law, groups = controller.law, len(controller.law.outputs)
    period = law.sample_period
    payloads, best = samples(STEPS), float("inf")
    for _ in range(TURNS):
        responses, commands, gate = Responses(), BraceCommands(), SampleGate()
        guard, safety = CommandGuard(controller.force_limit, [2.5e6] * groups, period, RAMP_TIME), gate.safety
        gate.configure([guard], period)
        gate.activate()
        active = ActiveController(controller, 0.0)
        active.reset(response_names(3, groups), command_names(groups), np.array(guard.value))
        begin = time.perf_counter()
        for payload in payloads:
            stamp, head, z = responses.unpack(payload)
            lost = gate.receive(stamp, head, "", time.monotonic())
            safety.act([active.force(z, max(lost, 0)).tolist()])
            force = guard.value
            commands.pack(stamp, head.run, head.sequence, force, safety.cause)
            active.advance(force)
        best = min(best, time.perf_counter() - begin)
        assert safety.state is State.RUNNING, safety.cause
        assert not gate.watch.old
    return 1e6 * best / STEPS


def loop_latency(controller: Controller) -> dict[str, float]:
    """Sample to command over DDS, our node's and the echo's."""
    from abrace.processes.group import find_executable

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "lqg3.yaml"
        save_controller(controller, file)
        node = find_executable("abrace_lqg", "controller")
        ours = [str(node), "--ros-args", "-r", "__ns:=/ours", "--params-file", str(file)]
        script = [sys.executable, str(HERE / "echo.py"), "0"]
        echo = [*script, "answer", "brace_command", "--ros-args", "-r", "__ns:=/echo"]
        answering = [subprocess.Popen(command) for command in (ours, echo)]
        try:
            asking = [sys.executable, str(Path(__file__).resolve()), "ask"]
            asked = subprocess.run(asking, check=True, stdout=subprocess.PIPE, timeout=600)
        finally:
            for process in answering:
                process.terminate()
            for process in answering:
                process.wait()
    found: dict[str, float] = json.loads(asked.stdout)
    return found


def ask() -> None:
    """Ask both in turns, one sample at a time, and print what their answers took."""
    import rclpy
    from rclpy.experimental import EventsExecutor

    from abrace_interfaces.msg import BraceCommand, Response
    from abrace_node.transport import STREAM_QOS

    rclpy.init()
    node = rclpy.create_node("ask")
    executor = EventsExecutor()
    executor.add_node(node)
    answers = 0

    def on_command(_: bytes) -> None:
        nonlocal answers
        answers += 1

    publishers, subscriptions = {}, []
    for who in ("ours", "echo"):
        publishers[who] = node.create_publisher(Response, f"/{who}/response", STREAM_QOS)
        topic = f"/{who}/brace_command"
        subscriptions.append(node.create_subscription(BraceCommand, topic, on_command, STREAM_QOS, raw=True))
    matched = (
        *(p.get_subscription_count for p in publishers.values()),
        *(s.get_publisher_count for s in subscriptions),
    )
    while not all(count() for count in matched):
        executor.spin_once(timeout_sec=0.1)
    settled = time.monotonic() + 1.0
    while time.monotonic() < settled:
        executor.spin_once(timeout_sec=0.1)

    payloads, taken = samples(SETTLE + BLOCKS * BLOCK), dict.fromkeys(publishers, 0)
    times: dict[str, list[int]] = {who: [] for who in publishers}

    def turn(who: str, count: int) -> None:
        for payload in payloads[taken[who] : taken[who] + count]:
            waited = answers
            begin = time.perf_counter_ns()
            publishers[who].publish(payload)
            while answers == waited:
                executor.spin_once(timeout_sec=0.1)
            times[who].append(time.perf_counter_ns() - begin)
        taken[who] += count

    for count in (SETTLE, *[BLOCK] * BLOCKS):
        for who in publishers:
            turn(who, count)
    found: dict[str, float] = {"answers": BLOCK * BLOCKS}
    for name, quantile in QUANTILES.items():
        ours, echo = (float(np.percentile(times[who][SETTLE:], quantile)) for who in ("ours", "echo"))
        found |= {f"{name}_us": ours / 1e3, f"echo_{name}_us": echo / 1e3, f"{name}_ratio": ours / echo}
    print(json.dumps(found))


def controller_speed() -> dict[str, Any]:
    """All of it, for bench.json."""
    controller = lqg3()
    return {
        "controller": {"step_us": step_us(controller), "states": controller.law.order},
        "loop": loop_latency(controller),
    }


def main() -> None:
    """Measure and print, on a ROS domain of its own."""
    from domain_coordinator import domain_id

    with domain_id() as domain:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        print(json.dumps(controller_speed(), indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["ask"]:
        ask()
    else:
        main()
