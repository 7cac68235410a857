# SPDX-License-Identifier: Apache-2.0
"""What the page shows, for JSON: from the rig's last sample, what nodes report, and what a person has done."""

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING, Any

from abrace.report.node_table import count_of
from abrace_bringup.page.samples import names_of
from abrace_core.model.signals import command_names, numbered
from abrace_core.safety.rig_safety import ACTING, State
from abrace_core.safety.wire import LATE, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace.report.node_table import NodeReport, NodeReports
    from abrace_bringup.page.samples import Samples
    from abrace_plant.rig.model import Rig

NO_SAMPLES = 0.5
"""Seconds without a sample after which the rig is shown as silent."""
GONE = 120.0
"""Seconds without a report after which a node is not shown any more."""
EVENTS = 50
"""Number of kept entries of what was done."""
LATENCIES = ("median", "99_percent", "worst")
_CHANNEL = re.compile(r"[xa]\d+|w|[fU]\d*")
_SHARE = re.compile(r"(-?\d{1,9}(?:\.\d+)?) %")

FLAGS = {
    SATURATED: "a command is cut to the capacity",
    RATE_LIMITED: "a command is held at the rate limit",
    TABLE_LIMITED: "the ground motion is cut to what the table can do",
    STOP_PRESSED: "a stop is pressed",
    LATE: "a sample came late",
}
"""Words for the flags of a sample that a person has to know."""


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
    """What does not change of a `rig`: its name, what is drawn of it, and the channels of its traces.

    Heights of the floors above the table [m], and of each brace group: its name, floor, cosine and capacity [kN].
    """
    names = names_of(rig.floors, rig.groups)
    return {
        "name": rig.name,
        "heights": rig.storey_heights.cumsum().tolist(),
        "groups": [
            {"name": name, "floor": group.floor, "cosine": group.cosine, "capacity": group.actuator.capacity / 1e3}
            for name, group in zip(numbered("f", len(rig.braces)), rig.braces, strict=True)
        ],
        "channels": list(_shown(names, rig)),
    }


def _shown(names: Sequence[str], rig: Rig) -> dict[str, int]:
    """The channels that pages show of a `rig`, and their columns: all that are measured but strokes, and commands."""
    known = {*rig.recorded_names, *rig.channel_names, *command_names(rig.groups)}
    return {name: names.index(name) for name in names if _CHANNEL.fullmatch(name) and name in known}


def on_screen(samples: Samples, rig: Rig) -> NDArray[np.float64]:
    """Displacements [mm], accelerations [m/s^2], forces and commands of a brace [kN], (samples, channels).

    The channels of `samples` are those that `rig_view` says of the `rig`.
    """
    shown = _shown(samples.names, rig)
    factors = [{"x": 1e3, "f": 1e-3, "U": 1e-3}.get(name[0], 1.0) for name in shown]
    return samples.values[:, list(shown.values())] * factors


def sample_view(last: Samples | None, age: float, rig: Rig) -> dict[str, Any]:
    """The rig's state by its `last` samples of this `age` [s]; `wrong` where the parameter `rig` is not what runs."""
    if last is None or age > NO_SAMPLES:
        old = None if last is None else round(age, 1)
        return {"state": "no samples", "level": "lost", "age": old, "cause": "", "limited": [], "wrong": ""}
    state = State(last.state) if last.state in list(State) else State.UNCONFIGURED
    stopped = (State.LATCHED, State.PROTECTIVE_STOP, State.NOT_AT_REST)
    level = "acting" if state in ACTING else "fault" if state in stopped else "rest"
    if state is State.RAMPING_DOWN:
        level = "fault" if last.cause else "acting"
    wrong = ""
    if (last.floors, last.groups) != (rig.floors, len(rig.braces)):
        wrong = (
            f"the rig that runs has {last.floors} floors and {last.groups} brace groups, parameter rig ({rig.name}) "
            f"has {rig.floors} and {len(rig.braces)}"
        )
    limited = [words for bit, words in FLAGS.items() if last.flags & bit]
    cause = last.cause if state not in ACTING else ""
    return {"state": state.words, "level": level, "age": 0.0, "cause": cause, "limited": limited, "wrong": wrong}


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
            active = report.values.get("life cycle") == "active"
            actions.append("disarm" if active else "arm")
            if active and "play" in offered and report.values.get("signal") != "playing":
                actions.append("play")
        if report.failed and "clear_fault" in offered:
            actions.append("clear")
        found.append({**row, "actions": actions})
    return found
