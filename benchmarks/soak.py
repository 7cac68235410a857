# SPDX-License-Identifier: Apache-2.0
"""Endurance of the logger and of how nodes end: `make soak`. Writes results/soak.json and prints tables.

graph   10 minutes of the closed loop in real time at 500 Hz (plant, ground motion, controller, logger) while a process
        keeps one core busy: messages on three topics, those of them that were lost, share of a core that the
        logger takes
flood   the highest rate of one topic at which the logger loses nothing, against a subscription that writes nothing
ends    200 nodes of all kinds interrupted twice at random moments; where there is `ros2 launch` 50 launches with wrong
        arguments and 50 that get SIGTERM at random moments: crashes, exit codes, nodes left behind
wrong   10 000 messages of wrong content on every topic and service of every node, of the rig behind the bridge also
        what reaches the emulated device
lockstep  the closed loop in lockstep, 20 minutes: memory of every node, and two runs that have to be the same
campaign  one interrupted 20 times at random: results that are not those of one that was not
fragility a study whose workers, scheduler and command are killed 20 times: files that are not those of one undisturbed
hosts   controller and operator on another host than the rig, behind a link that is cut, delays and loses: cases that
        went as docs/network.md promises; needs root
joins   100 nodes that join a running rig and leave: how often it found no command in time
after   a stream of 1.8 million messages that nodes joined and left at its beginning: what it costs at both ends then,
        with the lifespan of a rig's streams and without
viewer  10 minutes with a viewer of all samples at 500 Hz, and 10 without, in turns: samples lost, 99.9 % of the loop;
        then one loop, 10 minutes with the viewer without an interruption, 5 minutes before and 5 after without
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

from after_a_join import after_a_join
from browser import CHROMIUM
from campaign_endurance import campaign_endurance
from controller_speed import lqg3
from ends import failures, measure
from fragility_endurance import fragility_endurance
from hosts import missing as no_hosts
from isolation import isolated
from joins import joins
from lockstep_endurance import MEMORY_LIMIT, lockstep_endurance
from logger_endurance import LOAD, cpu_seconds, flood_rates, running
from operator_page import GROWTH_LIMIT, HOUR, memory
from two_hosts import measured as two_hosts
from two_hosts import table as hosts_table
from viewer import RATIO_LIMIT, continuous, viewer_cost
from wrong_endurance import CAPACITY, RATE_STEP
from wrong_endurance import measure as wrong_messages

from abrace.campaign.course import run_campaign
from abrace.report.table import Table
from abrace_bags import read_topics
from abrace_bags.losses import lost_messages
from abrace_core.controller_file import save_controller
from abrace_core.files import write_text

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
    found = read_topics(bag, [f"/soak/{topic}" for topic in LOOP])
    recorded = {topic: found[f"/soak/{topic}"].log_time.size for topic in LOOP}
    lost = lost_messages(found.records)
    return {
        # the plant says how many samples it published; of what answers them the middleware's numbers tell
        "messages": step["samples"] + sum(recorded[topic] + lost[f"/soak/{topic}"] for topic in LOOP[1:]),
        "lost": step["samples"] - recorded["response"] + sum(lost[f"/soak/{topic}"] for topic in LOOP[1:]),
        "cpu_fraction": use.fraction,
        "seconds": step["run_seconds"],
        "recorded": recorded,
    }


def viewer_table(turns: Mapping[str, Any], continuous_run: Mapping[str, Any]) -> Table:
    """What `viewer.viewer_cost` and `viewer.continuous` give."""
    limit = f"{RATIO_LIMIT}"
    rows = (
        (f"samples lost of {turns['samples']}, with a viewer of them all", f"{turns['lost']}", "0"),
        ("samples that the viewer was not shown", f"{turns['not_shown']}", "0"),
        ("sample to command, 99.9 %, with over without a viewer", f"{turns['p999_ratio']:.2f}", limit),
        (f"samples lost of {continuous_run['samples']} without an interruption", f"{continuous_run['lost']}", "0"),
        ("99.9 % then, with over without a viewer", f"{continuous_run['p999_ratio']:.2f}", limit),
    )
    return Table("A viewer beside the loop", ("what", "reached", "asked"), rows)


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
        ends = measure()
        joined = joins()
        after = after_a_join()
        hosts: dict[str, Any] = {"not measured": no_hosts()} if no_hosts() else two_hosts()
        wrong = wrong_messages()
        lockstep = lockstep_endurance()
        campaign = campaign_endurance()
        viewer = viewer_cost()
        uninterrupted = continuous()
        page = memory(HOUR) if CHROMIUM is not None else None
        fragility = fragility_endurance()
    values = {
        "logger": logger,
        "ends": ends,
        "joins": joined,
        "after_a_join": after,
        "hosts": hosts,
        "wrong": wrong,
        "lockstep": lockstep,
        "campaign": campaign,
        "viewer": {**viewer, "continuous": uninterrupted},
        "page": page or {"not measured": "no chromium on this machine"},
        "fragility": fragility,
    }
    write_text("results/soak.json", json.dumps(values, indent=1) + "\n")
    bare = f"bare subscription {logger['bare_subscription_rate']:.0f}"
    rows = (
        (f"messages lost of {logger['messages']}", f"{logger['lost']}", "0", "-"),
        ("share of a core", f"{logger['cpu_fraction']:.3f}", "0.25", "-"),
        ("flood without a loss, messages a second", f"{logger['flood_rate']:.0f}", "-", bare),
    )
    print(Table("The logger's endurance", ("claim", "reached", "asked", "peer"), rows).text())
    counts = tuple(
        (name, key, str(count))
        for name, each in ends.items()
        for key, count in (each if isinstance(each, dict) else {each: ""}).items()
    )
    print(Table("How nodes and launches end", ("what", "", "count"), counts).text())
    joining = tuple((name.replace("_", " "), f"{value:g}") for name, value in joined.items())
    print(Table("Nodes that join a running rig", ("what", "reached"), joining).text())
    rows_after = tuple(
        (name.replace("_", " "), f"{one['publisher']:.2f}", f"{one['subscriber']:.2f}", f"{one['publish_us'][1]:.0f}")
        for name, one in after.items()
        if isinstance(one, dict)
    )
    columns = ("stream", "publisher, of a processor", "subscriber", "99.9 % in publish, us")
    print(Table(f"{after['messages']} messages after nodes joined", columns, rows_after).text())
    grown, at_device = lockstep["grown_mb"], {name.replace("_", " "): one for name, one in wrong["at_device"].items()}
    endured = (
        ("faults of a rig that nodes join", f"{joined['faults']}", "0"),
        (f"what acted that was not finite, after {wrong['messages']} wrong messages", f"{wrong['not_finite']}", "0"),
        ("greatest force then, N", f"{wrong['greatest_force']:.0f}", f"{CAPACITY:.0f}"),
        ("greatest step then, N", f"{wrong['worst_step']:.0f}", f"{RATE_STEP:.0f}"),
        *((f"{what} at the emulated device, of its limit", f"{share:.6f}", "1") for what, share in at_device.items()),
        ("nodes that died of them", f"{wrong['died']}", "0"),
        *((f"memory of {name}, MB more after the first minute", f"{mb:.2f}", "1") for name, mb in grown.items()),
        (f"differences between two runs of {lockstep['compared']} samples", f"{lockstep['different']}", "0"),
        (
            f"of {campaign['compared']} results of a campaign interrupted {campaign['interrupted']} times, different",
            f"{campaign['different']}",
            "0",
        ),
        (
            f"of {fragility['files']} files of a fragility study, {sum(fragility['kills'].values())} kills, different",
            f"{fragility['differing']}",
            "0",
        ),
    )
    print(Table("Nodes in the long run", ("what", "reached", "asked"), endured).text())
    if "rows" in hosts:
        print(hosts_table(hosts["rows"]).text())
    print(viewer_table(viewer, uninterrupted).text())
    if page:
        print(page_table(page).text())
    missed = (
        joined["faults"],
        hosts.get("as_promised") != hosts.get("cases"),
        wrong["not_finite"],
        wrong["greatest_force"] > CAPACITY,
        wrong["worst_step"] > RATE_STEP * (1 + 1e-12),
        max(at_device.values()) > 1 + 1e-9,
        wrong["died"],
        max(grown.values()) > MEMORY_LIMIT,
        lockstep["different"],
        campaign["different"],
        campaign["left"],
        viewer["lost"],
        viewer["p999_ratio"] > RATIO_LIMIT,
        uninterrupted["lost"],
        uninterrupted["p999_ratio"] > RATIO_LIMIT,
        page and max(page["growth"].values()) > GROWTH_LIMIT,
        fragility["differing"],
    )
    if any(missed):
        return 1
    return 1 if failures(ends) or logger["lost"] or logger["cpu_fraction"] >= 0.25 else 0


if __name__ == "__main__":
    sys.exit(main())
