# SPDX-License-Identifier: Apache-2.0
"""Endurance of the logger and the page: `make soak`; one of them alone by `make soak PARTS=page`.

Prints tables, and writes results/soak.json as each part ends; what an earlier run found of others stays.

logger  10 minutes of the closed loop in real time at 500 Hz (plant, ground motion, controller, logger) while a process
        keeps one core busy: messages on three topics, those of them that were lost, share of a core that the
        logger takes; and the highest rate of one topic at which it loses nothing, against a subscription that writes
        nothing
page    the operator's page open for an hour at 500 Hz: what its server and the browser grow by; needs Chromium
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from browser import CHROMIUM
from claims import keep
from controller_speed import lqg3
from isolation import isolated
from logger_endurance import LOAD, cpu_seconds, flood_rates, running
from operator_page import GROWTH_LIMIT, HOUR, memory

from abrace.campaign.course import run_campaign
from abrace.report.table import Table
from abrace_bags import Bag
from abrace_bags.mcap.contents import recorded_contents
from abrace_core.model.controller_file import save_controller

if TYPE_CHECKING:
    from collections.abc import Callable

RESULTS = Path("results/soak.json")
DURATION = 600.0
CAMPAIGN = """name: soak
rig: ncree_three_storey
lockstep: false
steps:
  - name: closed_loop
    test:
      duration: {duration}
      ground_motion: {{record: white_noise, rms: 0.1, band: [0.2, 30.0], seed: 1}}
      controller: lqg3.yaml
"""
LOOP = ("response", "brace_command", "ground_motion")


class LoggerUse:
    """Looks once a second at the processor time of the logger that runs in a namespace."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._looks: list[tuple[float, float]] = []

    def __enter__(self) -> LoggerUse:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def fraction(self) -> float:
        """Share of a core, from the first look to the last."""
        (begin, used), (end, used_in_all) = self._looks[0], self._looks[-1]
        return (used_in_all - used) / (end - begin)

    def _look(self) -> None:
        while not self._stop.wait(1.0):
            process = self._logger()
            if process is None:
                continue
            try:
                self._looks.append((os.times().elapsed, cpu_seconds(process)))
            except OSError:
                continue

    def _logger(self) -> int | None:
        for entry in Path("/proc").iterdir():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
            except OSError:
                continue
            if f"__ns:={self._namespace}".encode() in words and any(word.endswith(b"/logger") for word in words):
                return int(entry.name)
        return None


def record_graph(duration: float) -> dict[str, Any]:
    """The closed loop in real time for so many seconds while a process loads one core."""
    save_controller(lqg3(), "lqg3.yaml")
    campaign = Path("soak.yaml")
    campaign.write_text(CAMPAIGN.format(duration=duration), encoding="utf-8")
    with running(LOAD, Path("load.log")), LoggerUse("/soak") as use:
        results = run_campaign(campaign).results
    (step,) = json.loads((results / "timing.json").read_text(encoding="utf-8"))["steps"]
    (bag,) = Path("bags/soak").glob("*/closed_loop")
    opened = Bag(bag)
    found = opened.arrays([f"/soak/{topic}" for topic in LOOP])
    recorded = {topic: found[f"/soak/{topic}"].log_time.size for topic in LOOP}
    lost = {topic: one.lost or 0 for topic, one in recorded_contents(opened.metadata).items()}
    return {
        # the plant says how many samples it published; of what answers them the middleware's numbers tell
        "messages": step["samples"] + sum(recorded[topic] + lost[f"/soak/{topic}"] for topic in LOOP[1:]),
        "lost": step["samples"] - recorded["response"] + sum(lost[f"/soak/{topic}"] for topic in LOOP[1:]),
        "cpu_fraction": use.fraction,
        "seconds": step["run_seconds"],
        "recorded": recorded,
    }


def logger() -> tuple[dict[str, Any], Table, bool]:
    """Values, their table, and whether a claim is missed."""
    found = record_graph(DURATION) | flood_rates()
    bare = f"bare subscription {found['bare_subscription_rate']:.0f}"
    rows = (
        (f"messages lost of {found['messages']}", f"{found['lost']}", "0", "-"),
        ("share of a core", f"{found['cpu_fraction']:.3f}", "0.25", "-"),
        ("flood without a loss, messages a second", f"{found['flood_rate']:.0f}", "-", bare),
    )
    table = Table("The logger's endurance", ("claim", "reached", "asked", "peer"), rows)
    return found, table, found["lost"] > 0 or found["cpu_fraction"] >= 0.25


def page() -> tuple[dict[str, Any], Table, bool]:
    """Likewise."""
    found = memory(HOUR)
    title = f"The operator's page, open for {found['seconds']:.0f} s after the first minute"
    growth = found["growth"]
    rows = tuple(
        (f"growth of {name.replace('_', ' ')}", f"{share:.3f}", f"{GROWTH_LIMIT}") for name, share in growth.items()
    )
    return found, Table(title, ("memory", "reached", "asked"), rows), max(growth.values()) > GROWTH_LIMIT


PARTS: dict[str, Callable[[], tuple[dict[str, Any], Table, bool]]] = {"logger": logger, "page": page}


def main() -> int:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description="Endurance, in the long run.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all without any")
    given = parser.parse_args().parts
    if unknown := [name for name in given if name not in PARTS]:
        parser.error(f"{', '.join(unknown)}: expected {', '.join(PARTS)}")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    any_missed = False
    for name in given or PARTS:
        if name == "page" and CHROMIUM is None:
            print("page: not measured, there is no chromium on this machine")
            continue
        with isolated():
            found, table, missed = PARTS[name]()
        keep(RESULTS, {name: found})
        print(table.text())
        any_missed |= missed
    return int(any_missed)


if __name__ == "__main__":
    sys.exit(main())
