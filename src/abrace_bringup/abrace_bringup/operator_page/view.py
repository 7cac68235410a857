# SPDX-License-Identifier: Apache-2.0
"""What the page shows, for JSON: from the rig's last sample, what nodes report, and what a person has done."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from abrace.report.node_table import count_of
from abrace_core import signals
from abrace_core.safety.rig_safety import ACTING, State
from abrace_core.wire import LATE, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace.report.node_table import NodeReport, NodeReports
    from abrace_core.wire import Head
    from abrace_plant.rig.model import Rig

NO_SAMPLES = 0.5
"""Seconds without a sample after which the rig is shown as silent."""
GONE = 120.0
"""Seconds without a report after which a node is not shown any more."""
EVENTS = 50
"""Number of kept entries of what was done."""
LATENCIES = ("median", "99_percent", "worst")
_SHARE = re.compile(r"(-?\d{1,9}(?:\.\d+)?) %")

FLAGS = {
    SATURATED: "a command is cut to the capacity",
    RATE_LIMITED: "a command is held at the rate limit",
    TABLE_LIMITED: "the ground motion is cut to what the table can do",
    STOP_PRESSED: "a stop is pressed",
    LATE: "a sample came late",
}
"""Words for the flags of a sample that a person has to know."""


@dataclass(frozen=True)
class Last:
    """The last sample: `head`, `cause` of a fault or stop, `values` as in `Responses.unpack`, `when` it came [s]."""

    head: Head
    cause: str
    values: Sequence[float]
    floors: int
    groups: int
    when: float


class Events:
    """What was done by the page and what came of it, the last ones; read by several pages, each from its own number."""

    def __init__(self) -> None:
        self._kept: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self.number = 0

    def add(self, time: float, text: str, bad: bool = False) -> None:
        """Add a `text` about what happened at this `time` [s since 1970]; `bad`: it failed."""
        self._kept.append({"time": time, "text": text, "bad": bad, "number": self.number + 1})
        self.number += 1

    def since(self, number: int) -> list[dict[str, Any]]:
        """Those after the one of that `number`."""
        return [event for event in list(self._kept) if event["number"] > number]


def rig_view(rig: Rig) -> dict[str, Any]:
    """What does not change: name, floors, groups and their capacities [kN] of a `rig`."""
    groups = len(rig.braces)
    return {
        "name": rig.name,
        "floors": [f"floor {i + 1}" for i in range(rig.floors)],
        "groups": [f"braces {name.removeprefix('f')}".strip() for name in signals.numbered("f", groups)],
        "capacity": [group.actuator.capacity / 1e3 for group in rig.braces],
    }


def on_screen(values: Sequence[float], floors: int, groups: int) -> tuple[float, ...]:
    """Displacements [mm], accelerations [m/s^2] and forces [kN] of the `values` of a sample.

    `values` as in `Responses.unpack`, of so many `floors` and brace `groups`.
    """
    accelerations = values[floors + groups : 2 * floors + groups]
    forces = values[2 * floors + groups :]
    return (*[1e3 * x for x in values[:floors]], *accelerations, *[f / 1e3 for f in forces])


def sample_view(last: Last | None, rig: Rig, now: float) -> dict[str, Any]:
    """The rig's state by its `last` sample at `now` [s]; `wrong` where the parameter `rig` is not what runs."""
    if last is None or now - last.when > NO_SAMPLES:
        age = None if last is None else round(now - last.when, 1)
        return {"state": "no samples", "level": "lost", "age": age, "cause": "", "limited": [], "wrong": ""}
    state = State(last.head.state) if last.head.state in list(State) else State.UNCONFIGURED
    level = "acting" if state in ACTING else "fault" if state in (State.LATCHED, State.PROTECTIVE_STOP) else "rest"
    if state is State.RAMPING_DOWN:
        level = "fault" if last.cause else "acting"
    wrong = ""
    if (last.floors, last.groups) != (rig.floors, len(rig.braces)):
        wrong = (
            f"the rig that runs has {last.floors} floors and {last.groups} brace groups, parameter rig ({rig.name}) "
            f"has {rig.floors} and {len(rig.braces)}"
        )
    limited = [words for bit, words in FLAGS.items() if last.head.flags & bit]
    return {
        "state": state.words,
        "level": level,
        "age": 0.0,
        "cause": last.cause,
        "limited": limited,
        "wrong": wrong,
    }


def interlock_view(report: NodeReport | None) -> list[dict[str, Any]]:
    """The rig's interlocks by its `report`: name and greatest share of the limit [%], the nearest to it first."""
    found = []
    for key, value in (report.values if report else {}).items():
        share = _SHARE.match(value)
        if key.startswith("interlock ") and share:
            found.append({"name": key.removeprefix("interlock ").replace("_", " "), "share": float(share[1])})
    return sorted(found, key=lambda one: -one["share"])


def latency_view(reports: Mapping[str, NodeReport]) -> list[dict[str, Any]]:
    """Of each node that answers samples, by its `reports`: times from sample to answer [us], and how many were late."""
    found = []
    for name, report in sorted(reports.items()):
        for kind, words in (("answer", "receipt to command"), ("stamp_to_command", "sample to command")):
            times = [report.values.get(f"{kind}_{statistic}_us") for statistic in LATENCIES]
            if None not in times:
                found.append({"node": name, "what": words, "times": times, "late": report.values.get("late", "0")})
    return found


def recording_view(reports: Mapping[str, NodeReport], recorders: Sequence[str], now: float) -> list[dict[str, Any]]:
    """Of each of the `recorders`, by the `reports` at `now` [s]: state, file, messages and losses."""
    found = []
    for name in recorders:
        report = reports.get(name)
        if report is None:
            continue
        counts = {
            kind: sum(count_of(value) or 0 for key, value in report.values.items() if key.startswith(kind))
            for kind in ("messages of ", "lost of ")
        }
        found.append(
            {
                "node": name,
                "state": report.words(now),
                "bad": report.stale(now) or report.failed or counts["lost of "] > 0,
                "file": report.values.get("file", ""),
                "messages": counts["messages of "],
                "lost": counts["lost of "],
                "waits": report.values.get("not seen yet", ""),
            }
        )
    return found


def node_view(reports: NodeReports, offers: Mapping[str, frozenset[str]], now: float) -> list[dict[str, Any]]:
    """Each node's state by its `reports` at `now` [s], and what can be done to it by the services that it `offers`."""
    found = []
    for row in reports.rows(now):
        name = str(row["name"])
        report, offered = reports[name], offers.get(name, frozenset())
        actions = []
        if "change_state" in offered and not report.stale(now):
            actions.append("arm" if report.message in ("not active", "not configured") else "disarm")
        if report.failed and "clear_fault" in offered:
            actions.append("clear")
        found.append({**row, "actions": actions})
    return found
