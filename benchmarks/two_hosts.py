# SPDX-License-Identifier: Apache-2.0
"""The real rig's graph on two hosts, and what disturbs the link between them. As root.

The hosts are network namespaces on this machine with a link of their own (`tests/support/hosts.py`). The rig's host has
the emulated actuators and sensors, `sensor_bridge`, `ground_motion` and the logger; the other one the controller and
the operator, who presses the stop button, clears faults and lets the table shake again. What the rig did is measured in
the logger's bag, and at the emulator; each case is judged by what docs/network.md promises.

cases, as_promised   how many were run, and those in which all went as promised
while_stalled        those that did not, and in which the machine itself stalled (machine_stalls.py)

python benchmarks/two_hosts.py          # all cases, some 7 minutes: prints the table, writes results/two_hosts.json
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from controller_speed import lqg3, reduced, rig_and_weights
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from emulated_target import TICKING
from hosts import Link, missing, on, two_hosts
from isolation import isolated
from joins import Node
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from machine_stalls import MachineStalls
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from udp_target import CONFIG

from abrace.processes.group import ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace.report.table import Table
from abrace_bags import read_topics
from abrace_core.controller_file import save_controller
from abrace_core.files import write_text
from abrace_core.node import DIAGNOSTICS
from abrace_core.node.conventions import TRANSIENT_LOCAL_QOS
from abrace_core.node.transport import profile
from abrace_core.safety.rig_safety import ACTING, RAMP_TIME, State
from abrace_interfaces.msg import Response
from abrace_lqg.analysis.margins import margins
from abrace_lqg.design import design

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

RATE = 500
PERIOD = 1.0 / RATE
RATE_STEP = 5.0e6 / RATE
"""Greatest step of the command between two samples [N], by the rig's rate limit."""
PATIENCE = 40.0
DRIVEN = 1000.0
"""Command that counts as force on [N]."""
SHAKEN: dict[str, Any] = {"record": "white_noise", "duration": 600.0, "rms": 0.3, "band": [1.0, 10.0]}
"""Motion of the table; above 1 Hz a stop leaves it near its middle."""
REPAIR = 0.004
"""Time after which a lost message is sent again [s], by streams.xml."""
MARGIN = 5
"""Samples beyond the time-out within which a fault has to be latched."""
STOP_PERIOD = 0.01
"""Seconds between the rig's looks at its stop buttons."""
REPAIRS = 10
"""Repairs that a stop may need on a link that loses messages; at 5 % loss more are needed once in 10^13 stops."""
WATCHDOG = 0.1
"""Seconds without a sample that are a fault of the controller."""
RIG = ("sensor_bridge", "ground_motion")
"""Nodes on the rig's host that can move something."""


@dataclass(frozen=True)
class Case:
    """A disturbance of the link while force is on.

    Parameters
    ----------
    name
        What happens.
    seconds
        For how long.
    conditions
        Of the link, as `Link.set` takes them.
    press
        Whether the operator presses the stop button as it begins, and releases it when all is over.
    command_timeout
        Of the rig [s].
    """

    name: str
    seconds: float
    conditions: dict[str, float] = field(default_factory=dict)
    press: bool = False
    command_timeout: float = 0.02

    @property
    def silence(self) -> float:
        """The longest time without an answer at the rig [s]; infinite where chance decides about it."""
        if "loss" in self.conditions:
            return float("inf")
        if "cut" in self.conditions:
            return self.seconds + REPAIR
        return 2.0 * (self.conditions.get("delay", 0.0) + self.conditions.get("jitter", 0.0))

    @property
    def expected(self) -> str:
        """What the rig has to do: `go on`, `fault`, `stop`; or `safe`: go on, or a fault."""
        if self.press and "cut" not in self.conditions:
            return "stop"
        if "loss" in self.conditions:
            return "safe"
        if self.silence + PERIOD > self.command_timeout:
            return "fault"
        return "go on" if self.silence < delay_margin() or "cut" in self.conditions else "safe"


LINKS = (
    Case("nothing", 10.0),
    Case("cut for 10 ms", 0.01, {"cut": True}),
    Case("cut for 50 ms", 0.05, {"cut": True}),
    Case("cut for 1 s", 1.0, {"cut": True}),
    Case("cut for 10 s", 10.0, {"cut": True}),
    Case("cut for 30 s", 30.0, {"cut": True}),
    Case("delay 5 ms", 10.0, {"delay": 0.005}),
    Case("delay 15 ms", 10.0, {"delay": 0.015}),
    Case("jitter 0 to 5 ms", 10.0, {"jitter": 0.005}),
    Case("1 % loss", 10.0, {"loss": 0.01}),
    Case("5 % loss", 10.0, {"loss": 0.05}),
    Case("stop pressed", 1.0, press=True),
    Case("stop pressed, 5 % loss", 2.0, {"loss": 0.05}, press=True),
    Case("stop pressed, cut for 1 s", 1.0, {"cut": True}, press=True),
)
LONGER = 0.05
CASES = (
    *LINKS,
    *(
        replace(case, command_timeout=LONGER)
        for case in LINKS
        if case.name in ("cut for 10 ms", "delay 15 ms", "1 % loss", "5 % loss")
    ),
)


LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Operator(Node):
    """Watches, starts the signal, presses and releases the stop button, clears: all from the other host."""

    def __init__(self, link: Link) -> None:
        with profile(streams=True):  # else a press that the link loses is sent again after up to 3 s
            super().__init__("operator")
        self.link = link
        self.response = Response()
        self.heard = self.shaken = 0.0
        self.status: dict[str, DiagnosticStatus] = {}
        # the last sample alone: what a busy machine lets wait would be old
        self.node.create_subscription(Response, "response", self._on_response, LATEST)
        self.listen(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, raw=False)
        self.button = self.node.create_publisher(Bool, "/emergency_stop", TRANSIENT_LOCAL_QOS)
        names = ("controller", *RIG)
        self.clears = {name: self.node.create_client(Trigger, f"{name}/clear_fault") for name in reversed(names)}
        self.changes = {name: self.node.create_client(ChangeState, f"{name}/change_state") for name in names}

    def _on_response(self, response: Response) -> None:
        self.response, self.heard = response, time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.status.update({status.name.partition(":")[0]: status for status in message.status})

    def wait(self, holds: Callable[[], Any], what: str) -> None:
        """Spin until `holds()`, with patience."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}; {'; '.join(f'{k}: {s.message}' for k, s in self.status.items())}")
            self.executor.spin_once(timeout_sec=0.02)

    def for_seconds(self, seconds: float) -> None:
        """Spin so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=min(left, 0.02))

    def ask(self, client: Any, request: Any) -> bool:
        """Call a service, again where its answer was lost; whether it succeeded."""
        self.wait(client.service_is_ready, client.srv_name)
        begin = asked = time.monotonic()
        answer = client.call_async(request)

        def answered() -> bool:
            nonlocal answer, asked
            if not answer.done() and time.monotonic() > asked + 3.0:
                answer, asked = client.call_async(request), time.monotonic()
            return answer.done()

        self.wait(answered, client.srv_name)
        if (took := time.monotonic() - begin) > 1.0:
            print(f"two hosts: {client.srv_name} answered after {took:.1f} s", file=sys.stderr, flush=True)
        return bool(answer.result().success)

    def all_there(self) -> None:
        """Have the nodes configured, wait until everyone has found everyone, and begin."""
        for name in self.changes:
            self.take(name, Transition.TRANSITION_CONFIGURE)
        # the rig listens three times at each of its two stop topics, the commanders never
        self.wait(lambda: self.button.get_subscription_count() == 3, "the rig's ears for the stop")
        for name, topic in (
            ("controller", "response"),
            ("ground_motion", "response"),
            ("sensor_bridge", "brace_command"),
            ("sensor_bridge", "ground_motion"),
        ):
            self.wait(lambda: self.value(name, f"publishers of {topic}") == "1", f"{name} to find {topic}")  # noqa: B023
        for name in ("controller", "ground_motion", "sensor_bridge"):
            self.take(name, Transition.TRANSITION_ACTIVATE)

    def value(self, name: str, key: str) -> str:
        """From the last diagnostics of a node."""
        status = self.status.get(name)
        return next((entry.value for entry in status.values if entry.key == key), "") if status else ""

    def shake(self) -> None:
        """Clear what is latched, and have the table shake anew."""
        self.clear()
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            self.take("ground_motion", transition)
        self.shaken = time.monotonic()

    def until_pushing(self) -> None:
        """Wait until the braces push; a fault before that, of a machine that is busy, is cleared."""

        def pushes() -> bool:
            if self.response.state not in ACTING:
                self.shake()
            return time.monotonic() > self.shaken + 2.0 and abs(self.response.command[0]) > DRIVEN

        self.wait(pushes, "force on")

    def take(self, name: str, number: int) -> None:
        """Take a node through a transition."""
        self.ask(self.changes[name], ChangeState.Request(transition=Transition(id=number)))

    def clear(self) -> None:
        """Clear every latched fault, as soon as that is accepted."""

        def cleared() -> bool:
            for client in self.clears.values():
                self.ask(client, Trigger.Request())
            self.for_seconds(0.1)
            return bool(self.response.state == Response.RUNNING)

        self.wait(cleared, "the faults to be cleared")

    def counts(self) -> dict[str, int]:
        """Late commands at the rig, lost and old samples at the commander, so far."""
        keys = {"late_commands": "sensor_bridge", "lost": "controller", "old": "controller"}
        for name in keys.values():
            self.status.pop(name, None)
        self.wait(lambda: set(keys.values()) <= set(self.status), "diagnostics")
        return {key: int(self.value(name, key)) for key, name in keys.items()}

    def run(self, case: Case) -> dict[str, Any]:
        """One case: when it began and ended, by the clock that both hosts share, and what the commander said."""
        print(f"two hosts: {setting_of(case)}: {case.name}", file=sys.stderr, flush=True)
        self.shake()
        before = self.counts()
        self.until_pushing()
        begin = time.monotonic()
        began = self.link.set(**case.conditions)
        if case.press:
            self.button.publish(Bool(data=True))
        self.for_seconds(case.seconds)
        self.link.set()
        restored = time.monotonic()
        self.wait(lambda: self.heard > restored, "samples of the rig")
        heard_again = time.monotonic() - restored
        self.for_seconds(1.0 + RAMP_TIME)
        counts = {key: count - before[key] for key, count in self.counts().items()}
        controller = self.status["controller"].message
        ended, rest = time.time_ns(), time.monotonic()
        if case.press:
            self.button.publish(Bool(data=False))
            self.wait(lambda: self.response.state == Response.LATCHED, "the release to be heard")
        asked = time.monotonic()
        self.clear()
        return {
            **asdict(case),
            "expected": case.expected,
            "began": began,
            "ended": ended,
            "began_monotonic": begin,
            "ended_monotonic": rest,
            "controller": controller,
            "heard_again_s": heard_again,
            "cleared_s": time.monotonic() - asked,
            **counts,
        }


def operate(cases: Sequence[Case], rig: int, link: Link) -> list[dict[str, Any]]:
    """Cases of one setting, run on the operator's host; `rig` is the number of the other host's process."""
    (setting,) = {setting_of(case) for case in cases}
    save_controller(lqg3(), "lqg3.yaml")
    by_hand: dict[str, Any] = {"autostart": False, "thread_priority": 50}
    with ProcessGroup() as processes:

        def start(package: str, name: str, host: list[str], *arguments: str | Path, **parameters: Any) -> None:
            file = parameter_file(Path(f"{name}.yaml"), parameters)
            command: list[str | Path] = [*host, find_executable(package, name), "--ros-args", "--params-file", file]
            processes.start(name, [*command, *arguments], Path(f"{setting}_{name}.log"))

        device = CONFIG / "devices/emulator.yaml"
        emulator: list[str | Path] = [*on(rig), find_executable("abrace_plant", "emulator"), "--priority", "70"]
        emulator += ["--rig", CONFIG / "ncree_three_storey.yaml", "--device", device, "--log", emulator_log(setting)]
        target = processes.start("emulator", emulator, Path(f"{setting}_emulator.log"))
        operator = Operator(link)
        try:
            operator.wait(lambda: TICKING in target.last_lines(), "the emulator")
            start("abrace_bags", "logger", on(rig), output=setting, topics=["response"])
            timeout = cases[0].command_timeout
            start("abrace_plant", "sensor_bridge", on(rig), device=str(device), command_timeout=timeout, **by_hand)
            start("abrace_plant", "ground_motion", on(rig), **SHAKEN, **by_hand)
            start("abrace_lqg", "controller", [], "--params-file", Path("lqg3.yaml"), **by_hand)
            operator.all_there()
            return [operator.run(case) for case in cases]
        finally:
            link.set()
            operator.close()


def emulator_log(setting: str) -> Path:
    """Where the emulator writes its counts at the end."""
    return Path(f"{setting}_emulator.json")


@cache
def delay_margin() -> float:
    """The delay at which the loop with LQG3 becomes unstable [s]."""
    rig, weights = rig_and_weights()
    made = design(reduced(rig), weights, 1.0 / rig.sample_rate)
    return margins(made.design_model, made.controller).delay


def setting_of(case: Case) -> str:
    """The name of the graph that a case needs."""
    return f"timeout_{case.command_timeout:g}"


def measure(row: dict[str, Any], response: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the rig did in a case, from its responses' fields."""
    stamp = response["stamp"]
    during = (stamp >= row["began"]) & (stamp <= row["ended"])
    command, state = response["command"][during], response["state"][during]
    since = (stamp[during] - row["began"]) * 1e-6
    acting = np.isin(state, ACTING)
    steps = np.abs(np.diff(response["command"])) / np.diff(response["sequence"])
    found: dict[str, Any] = {
        "worst_step_over_limit": float(steps[during[1:]].max() / RATE_STEP),
        "greatest_force": float(np.abs(command).max()),
        "fault_ms": None,
        "zero_ms": None,
        "cause": "",
    }
    if not acting.all():
        fault = int(np.argmin(acting))
        released = command[fault:]
        zero = int(np.flatnonzero(released)[-1]) + 1 if released.any() else 0
        found |= {
            "fault_ms": float(since[fault]),
            # of samples that the rig could not take: the ramp began meanwhile
            "gap_ms": float(since[fault] - since[max(fault - 1, 0)]),
            "zero_ms": float(since[min(fault + zero, len(since) - 1)]),
            "force_at_fault": float(released[0]),
            # the command until the fault's sample was given before, and so was the one that begins with it
            "falls_only": bool((np.diff(np.abs(released[1:])) <= 0).all()),
            "at_zero_until_cleared": not released[zero:].any() and zero < len(released) and not acting[fault:].any(),
            "cause": str(response["cause"][during][fault]),
            "state_at_end": int(state[-1]),
        }
    return found


def problems(row: dict[str, Any]) -> list[str]:
    """What did not go as docs/network.md promises, from a case's measured values; empty: all did."""
    case = Case(**{name: row[name] for name in Case.__dataclass_fields__})
    timeout, fault = 1e3 * case.command_timeout, row["fault_ms"]
    found = [] if row["worst_step_over_limit"] <= 1.0 + 1e-9 else ["a step beyond the rate limit"]
    if row["worst_step_at_device"] > 1.0 + 1e-9:
        found.append("a step beyond the rate limit at the device")
    if case.expected == "go on" and fault is not None:
        found.append(f"a fault: {row['cause']}")
    if case.expected in ("fault", "stop") and fault is None:
        found.append("it went on")
    if ("no response for more than" in row["controller"]) != (case.silence > WATCHDOG and "cut" in case.conditions):
        found.append(f"the controller: {row['controller']}")
    if fault is None:
        return found
    if not row["falls_only"]:
        found.append("the force rose after the fault")
    if not row["at_zero_until_cleared"]:
        found.append("force on before the fault was cleared")
    margin = 1e3 * MARGIN * PERIOD
    if not 1e3 * RAMP_TIME - row["gap_ms"] - margin <= row["zero_ms"] - fault <= 1e3 * RAMP_TIME + margin:
        found.append(f"a ramp of {row['zero_ms'] - fault:.0f} ms")
    if case.expected == "fault":
        if not row["cause"].startswith("no brace_command for"):
            found.append(f"another cause: {row['cause']}")
        if not timeout - 2e3 * PERIOD <= fault <= timeout + margin:
            found.append(f"a fault after {fault:.0f} ms")
    if case.expected == "stop":
        latest = STOP_PERIOD + (2 + MARGIN) * PERIOD + REPAIR * (REPAIRS if "loss" in case.conditions else 0)
        if "protective stop: pressed by" not in row["cause"]:
            found.append(f"another cause: {row['cause']}")
        if fault > 1e3 * latest:
            found.append(f"a stop after {fault:.0f} ms")
    if row["state_at_end"] != (State.PROTECTIVE_STOP if case.press else State.LATCHED):
        found.append(f"at the end {State(row['state_at_end']).words}")
    return found


def recorded(bag: Path) -> dict[str, np.ndarray]:
    """The responses of a bag: (samples,) stamp [ns], sequence, state, command [N], cause."""
    fields = read_topics(bag, ["/response"])["/response"].fields
    stamp = fields["header.stamp.sec"] * np.int64(10**9) + fields["header.stamp.nanosec"]
    found = {"stamp": stamp, "command": fields["command"][:, 0], "sequence": fields["sequence"].astype(np.int64)}
    return found | {name: fields[name] for name in ("state", "cause")}


def run_cases(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Run the cases in the present folder; returns what was measured of each, and its `problems`."""
    rows: list[dict[str, Any]] = []
    with two_hosts() as (rig, desk, control), MachineStalls() as stalls:
        for setting in dict.fromkeys(map(setting_of, cases)):
            chosen = [case for case in cases if setting_of(case) == setting]
            # nodes look for each other on the whole link
            environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "OMP_NUM_THREADS": "1"}
            command = [*on(desk), sys.executable, __file__, "operate", str(rig), str(control), f"{setting}.json"]
            asked = json.dumps([asdict(case) for case in chosen])
            subprocess.run(command, input=asked, env=environment, text=True, check=True)
            response = recorded(Path(setting))
            device = json.loads(emulator_log(setting).read_bytes())["worst_step_over_rate_limit"]
            for row in json.loads(Path(f"{setting}.json").read_bytes()):
                row |= measure(row, response) | {"worst_step_at_device": device}
                stalled = stalls.since(row["began_monotonic"], row["ended_monotonic"])
                rows.append(row | {"problems": problems(row), "stalls_ms": [1e3 * stall for stall in stalled]})
    return rows


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """What was measured, for people."""

    def milliseconds(value: float | None) -> str:
        return "-" if value is None else f"{value:.0f}"

    return Table(
        "Two hosts: what the rig does, ms after the disturbance began",
        (
            "disturbance",
            "time-out",
            "fault",
            "force zero",
            "step / limit",
            "late",
            "lost",
            "rig",
            "controller",
            "not as promised",
        ),
        tuple(
            (
                row["name"],
                f"{row['command_timeout']:g}",
                milliseconds(row["fault_ms"]),
                milliseconds(row["zero_ms"]),
                f"{row['worst_step_over_limit']:.2f}",
                str(row["late_commands"]),
                str(row["lost"]),
                row["cause"] or "-",
                row["controller"].partition("; ")[0],
                "; ".join(row["problems"]) or "-",
            )
            for row in rows
        ),
    )


def measured() -> dict[str, Any]:
    """All cases; call it where nodes may leave files."""
    rows = run_cases(CASES)
    failed = [row for row in rows if row["problems"]]
    return {
        "cases": len(rows),
        "as_promised": len(rows) - len(failed),
        "while_stalled": sum(bool(row["stalls_ms"]) for row in failed),
        "rows": rows,
    }


def main() -> int:
    """Measure, write, print."""
    if reason := missing():
        print(f"two_hosts: {reason}", file=sys.stderr)
        return 2
    with isolated() as here:
        found = measured()
        write_text(here / "results/two_hosts.json", json.dumps(found, indent=1) + "\n")
    print(table(found["rows"]).text())
    return 0 if found["as_promised"] == found["cases"] else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["operate"]:
        rig_host, socket_path, output = sys.argv[2:]
        asked_cases = [Case(**case) for case in json.load(sys.stdin)]
        write_text(output, json.dumps(operate(asked_cases, int(rig_host), Link(socket_path))))
    else:
        sys.exit(main())
