# SPDX-License-Identifier: Apache-2.0
"""Endurance of the logger, the nodes and the page: `make soak`. Writes results/soak.json and prints tables.

graph   10 minutes of the closed loop in real time at 500 Hz (plant, ground motion, controller, logger) while a process
        keeps one core busy: messages on three topics, those of them that were lost, share of a core that the
        logger takes
flood   the highest rate of one topic at which the logger loses nothing, against a subscription that writes nothing
wrong   10 000 messages of wrong content on every topic and service of every node, of the rig behind the bridge also
        what reaches the emulated device
page    the operator's page open for an hour at 500 Hz: what its server and the browser grow by; needs Chromium

python benchmarks/soak.py SECONDS    # another duration of the first
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from browser import CHROMIUM
from controller_speed import lqg3
from isolation import isolated
from logger_endurance import LOAD, cpu_seconds, flood_rates, running
from operator_page import GROWTH_LIMIT, HOUR, memory
from wrong_endurance import CAPACITY, RATE_STEP
from wrong_endurance import measure as wrong_messages

from abrace.campaign.course import run_campaign
from abrace.report.table import Table
from abrace_bags import Bag
from abrace_bags.mcap.contents import recorded_contents
from abrace_core.files.writing import write_text
from abrace_core.model.controller_file import save_controller

if TYPE_CHECKING:
    from collections.abc import Mapping

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


def page_table(page: Mapping[str, Any]) -> Table:
    """What `operator_page.memory` gives."""
    title = f"The operator's page, open for {page['seconds']:.0f} s after the first minute"
    growth = page["growth"].items()
    rows = tuple((f"growth of {name.replace('_', ' ')}", f"{share:.3f}", f"{GROWTH_LIMIT}") for name, share in growth)
    return Table(title, ("memory", "reached", "asked"), rows)


def main() -> int:
    """Measure, write, print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    duration = float(sys.argv[1]) if sys.argv[1:] else DURATION
    with isolated():
        logger = record_graph(duration)
        logger |= flood_rates()
        wrong = wrong_messages()
        page = memory(HOUR) if CHROMIUM is not None else None
    values = {
        "logger": logger,
        "wrong": wrong,
        "page": page or {"not measured": "no chromium on this machine"},
    }
    write_text("results/soak.json", json.dumps(values, indent=1) + "\n")
    bare = f"bare subscription {logger['bare_subscription_rate']:.0f}"
    rows = (
        (f"messages lost of {logger['messages']}", f"{logger['lost']}", "0", "-"),
        ("share of a core", f"{logger['cpu_fraction']:.3f}", "0.25", "-"),
        ("flood without a loss, messages a second", f"{logger['flood_rate']:.0f}", "-", bare),
    )
    print(Table("The logger's endurance", ("claim", "reached", "asked", "peer"), rows).text())
    at_device = {name.replace("_", " "): one for name, one in wrong["at_device"].items()}
    endured = (
        (f"what acted that was not finite, after {wrong['messages']} wrong messages", f"{wrong['not_finite']}", "0"),
        ("greatest force then, N", f"{wrong['greatest_force']:.0f}", f"{CAPACITY:.0f}"),
        ("greatest step then, N", f"{wrong['worst_step']:.0f}", f"{RATE_STEP:.0f}"),
        *((f"{what} at the emulated device, of its limit", f"{share:.6f}", "1") for what, share in at_device.items()),
        ("nodes that died of them", f"{wrong['died']}", "0"),
    )
    print(Table("Nodes in the long run", ("what", "reached", "asked"), endured).text())
    if page:
        print(page_table(page).text())
    missed = (
        logger["lost"],
        logger["cpu_fraction"] >= 0.25,
        wrong["not_finite"],
        wrong["greatest_force"] > CAPACITY,
        wrong["worst_step"] > RATE_STEP * (1 + 1e-12),
        max(at_device.values()) > 1 + 1e-9,
        wrong["died"],
        page and max(page["growth"].values()) > GROWTH_LIMIT,
    )
    return int(any(missed))


if __name__ == "__main__":
    sys.exit(main())
