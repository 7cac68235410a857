# SPDX-License-Identifier: Apache-2.0
"""The controller against its peers: a step of it, its answer over DDS, its gains and its discretisation.

step_us            a sample from its bytes to the bytes of its command: unpacked, checked for gaps, LQG3's law, the
                   guard's limits, packed, the estimate advanced with the applied force; without DDS
loop               sample to command between two processes over DDS, measured by the sender of the sample: our node
                   `controller` against the bare echo of the same two messages, in turns in one run
lqr_agreement      largest difference of LQG3's gains from python-control's lqr (method='scipy') for the same balanced
                   model and weights, over the largest gain; its lqe has no correlated noise: the filter is compared by
                   duality
tustin_agreement   the same of Eq. (13)'s frequency response against scipy's cont2discrete(method='bilinear')

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

from abrace_core.controller_file import Controller, save_controller
from abrace_core.linear_model import LinearModel
from abrace_core.safety.answering import Answering
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME, State
from abrace_core.signals import command_names, response_names
from abrace_core.wire import LOCKSTEP, BraceCommands, Head, Responses
from abrace_lqg.active_controller import ActiveController
from abrace_lqg.design import balanced, delayed, design
from abrace_lqg.riccati import kalman, regulator
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.reduction import balanced_truncation, typical_scales

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
        found.append(responses.pack(sequence * PERIOD_NS, head, "", [2], *arrays, 0.0))
    return found


def step_us(controller: Controller) -> float:
    """Microseconds of a sample, everything but DDS; the best of some turns."""
    law, groups = controller.law, len(controller.law.outputs)
    period = law.sample_period
    payloads, best = samples(STEPS), float("inf")
    for _ in range(TURNS):
        responses, commands, answering = Responses(), BraceCommands(), Answering()
        guard, safety = CommandGuard(controller.force_limit, [5e6] * groups, period, RAMP_TIME), answering.safety
        answering.configure([guard], period)
        answering.activate()
        active = ActiveController(controller, 0.0)
        active.reset(response_names(3, groups), command_names(groups), np.array(guard.value))
        begin = time.perf_counter()
        for payload in payloads:
            stamp, head, z = responses.unpack(payload)
            lost = answering.receive(stamp, head, "", time.monotonic())
            safety.act([active.force(z, max(lost, 0)).tolist()])
            force = guard.value
            commands.pack(stamp, head.run, head.sequence, force, safety.cause)
            active.advance(force)
        best = min(best, time.perf_counter() - begin)
        assert safety.state is State.RUNNING, safety.cause
        assert not answering.watch.old
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

    from abrace_core.node import STREAM_QOS
    from abrace_interfaces.msg import BraceCommand, Response

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


def lqr_agreement() -> dict[str, float]:
    """Largest difference of the gains, over the largest gain, with the rig's whole model and eight states of it."""
    import control

    rig, weights = rig_and_weights()
    found = {}
    for name, model in (("8_states", reduced(rig)), (f"{rig.model.order}_states", rig.model)):
        plant = balanced(delayed(model, 1 / rig.sample_rate))
        measured = plant.select(weights.measured)
        a, b, e, f = plant.a, plant.b[:, 1:], plant.b[:, :1], measured.d[:, :1]
        q, r = np.diag(weights.diagonal(plant.outputs)), np.diag(weights.diagonal(plant.inputs[1:]))
        v = weights.noise_to_excitation * np.eye(len(weights.measured))
        d = plant.d[:, 1:]
        state, cross = _symmetric(plant.c.T @ q @ plant.c), plant.c.T @ q @ d
        theirs = control.lqr(a, b, state, r + d.T @ q @ d, cross, method="scipy")[0]
        dual = control.lqr(a.T, measured.c.T, _symmetric(e @ e.T), v + f @ f.T, e @ f.T, method="scipy")[0].T
        found[f"{name}_regulator"] = _difference(regulator(a, b, plant.c, d, q, r), theirs)
        found[f"{name}_filter"] = _difference(kalman(a, e, measured.c, f, v), dual)
    return found


def tustin_agreement() -> float:
    """Largest difference of the sampled controllers' frequency responses, over their largest value."""
    from scipy import signal

    rig, weights = rig_and_weights()
    made = design(reduced(rig), weights, 1 / rig.sample_rate)
    law, continuous = made.controller, made.continuous
    parts = (continuous.a, continuous.b, continuous.c, continuous.d)
    a, b, c, d, period = signal.cont2discrete(parts, law.sample_period, method="bilinear")
    theirs = LinearModel(a, b, c, d, law.inputs, law.outputs, period)
    omega = np.geomspace(0.1, 1500.0, 500)
    return _difference(law.frequency_response(omega), theirs.frequency_response(omega))


def _symmetric(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    return (matrix + matrix.T) / 2


def _difference(ours: NDArray[Any], theirs: NDArray[Any]) -> float:
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def controller_speed() -> dict[str, Any]:
    """All of it, for bench.json."""
    controller = lqg3()
    agreement = lqr_agreement()
    return {
        "controller": {"step_us": step_us(controller), "states": controller.law.order},
        "loop": loop_latency(controller),
        "lqr_agreement": max(agreement.values()),
        "lqr_agreement_of": agreement,
        "tustin_agreement": tustin_agreement(),
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
