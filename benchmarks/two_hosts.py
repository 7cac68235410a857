# SPDX-License-Identifier: Apache-2.0
"""A rig on one host, its commander and operator on another, and what disturbs the link between them. As root.

The hosts are network namespaces on this machine with a link of their own (`tests/support/hosts.py`). The rig's host has
`plant`, by the clock, and a logger; the other one `excitation`, with force on, and the operator, who presses the stop
button, clears faults and starts the signal again. What the rig did is measured in the logger's bag.

python benchmarks/two_hosts.py          # all cases, some 7 minutes: prints the table, writes results/two_hosts.json
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hosts import Link, missing, on, two_hosts
from isolation import isolated
from joins import Node
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.processes.group import ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace.report.table import Table
from abrace_bags import read_topics
from abrace_core.files import write_text
from abrace_core.node import DIAGNOSTICS
from abrace_core.node.conventions import TRANSIENT_LOCAL_QOS
from abrace_core.node.transport import profile
from abrace_core.safety.rig_safety import ACTING, RAMP_TIME
from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

RATE = 500
RATE_STEP = 5.0e6 / RATE
"""Greatest step of the command between two samples [N], by the rig's rate limit."""
PATIENCE = 40.0
DRIVEN = 1000.0
"""Command that counts as force on [N]."""


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


class Operator(Node):
    """Watches, starts the signal, presses and releases the stop button, clears: all from the other host."""

    def __init__(self, link: Link) -> None:
        with profile(streams=True):  # else a press that the link loses is sent again after up to 3 s
            super().__init__("operator")
        self.link = link
        self.response = Response()
        self.heard = 0.0
        self.driven = 0
        self.status: dict[str, DiagnosticStatus] = {}
        self.listen(Response, "response", self._on_response, raw=False)
        self.listen(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, raw=False)
        self.button = self.node.create_publisher(Bool, "/emergency_stop", TRANSIENT_LOCAL_QOS)
        self.clears = {
            name: self.node.create_client(Trigger, f"{name}/clear_fault") for name in ("excitation", "plant")
        }
        self.change_state = self.node.create_client(ChangeState, "excitation/change_state")

    def _on_response(self, response: Response) -> None:
        self.response, self.heard = response, time.monotonic()
        self.driven += abs(response.command[0]) > DRIVEN

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
        answer, asked = client.call_async(request), time.monotonic()

        def answered() -> bool:
            nonlocal answer, asked
            if not answer.done() and time.monotonic() > asked + 3.0:
                answer, asked = client.call_async(request), time.monotonic()
            return answer.done()

        self.wait(answered, client.srv_name)
        return bool(answer.result().success)

    def all_there(self) -> None:
        """Wait until everyone has found everyone."""
        self.wait(lambda: self.node.count_publishers("brace_command") == 1, "the commander")
        # the rig listens three times at each of its two stop topics, the commander never
        self.wait(lambda: self.button.get_subscription_count() == 3, "the rig's ears for the stop")
        self.wait(lambda: self.value("excitation", "publishers of response") == "1", "the commander's match")
        self.wait(lambda: self.value("plant", "publishers of brace_command") == "1", "the rig's match")

    def value(self, name: str, key: str) -> str:
        """From the last diagnostics of a node."""
        status = self.status.get(name)
        return next((entry.value for entry in status.values if entry.key == key), "") if status else ""

    def force_on(self) -> None:
        """Clear what is latched, and have the signal begin anew; again where a machine that is busy lets it go."""
        driven = self.driven
        while self.driven < driven + RATE // 2 or self.response.state not in ACTING:
            self.wait(lambda: time.monotonic() - self.heard < 0.1, "samples of the rig")
            self.transition(Transition.TRANSITION_DEACTIVATE)
            self.clear()
            self.transition(Transition.TRANSITION_ACTIVATE)
            driven, latest = self.driven, time.monotonic() + 3.0
            self.wait(lambda: self.driven >= driven + RATE // 2 or time.monotonic() > latest, "force on")  # noqa: B023

    def transition(self, number: int) -> None:
        """Take the commander through a transition."""
        self.ask(self.change_state, ChangeState.Request(transition=Transition(id=number)))

    def clear(self) -> None:
        """Clear every latched fault, as soon as that is accepted."""
        running = [Response.RUNNING]

        def cleared() -> bool:
            for client in self.clears.values():
                self.ask(client, Trigger.Request())
            self.for_seconds(0.1)
            return self.response.state in running

        self.wait(cleared, "the faults to be cleared")

    def counts(self) -> dict[str, int]:
        """Late commands at the rig, lost and old samples at the commander, so far."""
        keys = {"late_commands": "plant", "lost": "excitation", "old": "excitation"}
        for name in ("plant", "excitation"):
            self.status.pop(name, None)
        self.wait(lambda: {"plant", "excitation"} <= set(self.status), "diagnostics")
        return {key: int(self.value(name, key)) for key, name in keys.items()}

    def run(self, case: Case) -> dict[str, Any]:
        """One case: when it began and ended, by the clock that both hosts share, and what the commander said."""
        print(f"two hosts: {setting_of(case)}: {case.name}", file=sys.stderr, flush=True)
        self.force_on()
        before = self.counts()
        self.link.set(**case.conditions)
        began = time.time_ns()
        if case.press:
            self.button.publish(Bool(data=True))
        self.for_seconds(case.seconds)
        self.link.set()
        restored = time.monotonic()
        self.wait(lambda: self.heard > restored, "samples of the rig")
        heard_again = time.monotonic() - restored
        self.for_seconds(1.0 + RAMP_TIME)
        counts = {key: count - before[key] for key, count in self.counts().items()}
        commander = self.status["excitation"].message
        ended = time.time_ns()
        if case.press:
            self.button.publish(Bool(data=False))
            self.wait(lambda: self.response.state == Response.LATCHED, "the release to be heard")
        begin = time.monotonic()
        self.clear()
        return {
            **asdict(case),
            "began": began,
            "ended": ended,
            "commander": commander,
            "heard_again_s": heard_again,
            "cleared_s": time.monotonic() - begin,
            **counts,
        }


def operate(cases: Sequence[Case], rig: int, link: Link) -> list[dict[str, Any]]:
    """Cases of one setting, run on the operator's host; `rig` is the number of the other host's process."""
    (setting,) = {setting_of(case) for case in cases}
    priority: dict[str, Any] = {"thread_priority": 50}
    with ProcessGroup() as processes:

        def start(package: str, name: str, host: list[str], **parameters: Any) -> None:
            file = parameter_file(Path(f"{name}.yaml"), parameters)
            command: list[str | Path] = [*host, find_executable(package, name), "--ros-args", "--params-file", file]
            processes.start(name, command, Path(f"{setting}_{name}.log"))

        start("abrace_bags", "logger", on(rig), output=setting, topics=["response"])
        start("abrace_sysid", "excitation", [], autostart=False, rms=3000.0, **priority)
        start("abrace_plant", "plant", on(rig), command_timeout=cases[0].command_timeout, **priority)
        operator = Operator(link)
        try:
            operator.transition(Transition.TRANSITION_CONFIGURE)
            operator.all_there()
            operator.transition(Transition.TRANSITION_ACTIVATE)
            return [operator.run(case) for case in cases]
        finally:
            link.set()
            operator.close()


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
            "zero_ms": float(since[min(fault + zero, len(since) - 1)]),
            "force_at_fault": float(released[0]),
            # the command until the fault's sample was given before, and so was the one that begins with it
            "falls_only": bool((np.diff(np.abs(released[1:])) <= 0).all()),
            "at_zero_until_cleared": not released[zero:].any() and zero < len(released) and not acting[fault:].any(),
            "cause": str(response["cause"][during][fault]),
            "state_at_end": int(state[-1]),
        }
    return found


def recorded(bag: Path) -> dict[str, np.ndarray]:
    """The responses of a bag: (samples,) stamp [ns], sequence, state, command [N], cause."""
    fields = read_topics(bag, ["/response"])["/response"].fields
    stamp = fields["header.stamp.sec"] * np.int64(10**9) + fields["header.stamp.nanosec"]
    found = {"stamp": stamp, "command": fields["command"][:, 0], "sequence": fields["sequence"].astype(np.int64)}
    return found | {name: fields[name] for name in ("state", "cause")}


def run_cases(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Run the cases in the present folder; returns what was measured of each."""
    rows = []
    with two_hosts() as (rig, desk, control):
        for setting in dict.fromkeys(map(setting_of, cases)):
            chosen = [case for case in cases if setting_of(case) == setting]
            # nodes look for each other on the whole link
            environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "OMP_NUM_THREADS": "1"}
            command = [*on(desk), sys.executable, __file__, "operate", str(rig), str(control), f"{setting}.json"]
            asked = json.dumps([asdict(case) for case in chosen])
            subprocess.run(command, input=asked, env=environment, text=True, check=True)
            response = recorded(Path(setting))
            rows += [row | measure(row, response) for row in json.loads(Path(f"{setting}.json").read_bytes())]
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
            "commander",
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
                row["commander"].partition("; deactivate")[0],
            )
            for row in rows
        ),
    )


def main() -> int:
    """Measure, write, print."""
    if reason := missing():
        print(f"two_hosts: {reason}", file=sys.stderr)
        return 2
    with isolated() as here:
        rows = run_cases(CASES)
        write_text(here / "results/two_hosts.json", json.dumps(rows, indent=1) + "\n")
    print(table(rows).text())
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["operate"]:
        rig_host, socket_path, output = sys.argv[2:]
        asked_cases = [Case(**case) for case in json.load(sys.stdin)]
        write_text(output, json.dumps(operate(asked_cases, int(rig_host), Link(socket_path))))
    else:
        sys.exit(main())
