# SPDX-License-Identifier: Apache-2.0
"""The operator's page in headless Chromium against the running graph: from a click to zero command; its memory.

passed, runs            clicks on STOP, and those after which the command was zero for good within 50 ms and the ramp
click_to_stop_ms_worst, click_to_stop_ms_median  from a click to zero command, less the ramp
repeated                clicks repeated, because the rig had a fault before them: the machine was held up

The click is when it is given to the browser; the force is that of an excitation by the clock.

python benchmarks/operator_page.py [RUNS]
python benchmarks/operator_page.py memory [SECONDS]
python benchmarks/operator_page.py pictures FOLDER
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sys
import time
from typing import TYPE_CHECKING, Any

import psutil  # type: ignore[import-untyped]
from browser import CHROMIUM
from claims import Claim
from controller_speed import lqg3
from driven_browser import DrivenBrowser, Tab
from isolation import isolated
from running_graph import graph_of_its_own
from safety_by_the_clock import Rig

from abrace_core import AbraceError
from abrace_core.model.controller_file import save_controller
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from running_graph import Graph

RUNS = 100
TRIES = 3
"""Of each click, where the rig has a fault before it: that of a machine that stood still."""
WITHIN = 50.0
"""Milliseconds."""
FORCE = 2e3
"""Newtons with which the braces push when STOP is clicked."""
WARM_UP = 60.0
"""Seconds after which memory is measured first: all traces are full."""
HOUR = 3600.0
"""Seconds for which the page is open in `make soak`."""
GROWTH_LIMIT = 0.05
"""Share by which server and page may grow in that time."""
PARTS = 6
"""Measurements of memory after the first."""


def page_address(graph: Graph, name: str = "operator") -> str:
    """The address of the page that a node serves."""
    lines = graph.until(
        lambda: [line for line in graph.output_of(name) if "the page is " in line], f"{name} to serve its page"
    )
    return str(lines[0]).rpartition(" ")[2]


@contextlib.contextmanager
def opened() -> Iterator[tuple[Rig, Tab, DrivenBrowser]]:
    """A rig that somebody commands, and the page in a browser."""
    if CHROMIUM is None:
        raise AbraceError("no chromium on this machine, expected it for the operator's page")
    with graph_of_its_own("/page") as graph, DrivenBrowser() as browser:
        rig = Rig(graph, "excitation")
        graph.start("operator", port=0)
        tab = browser.open(page_address(graph))
        tab.until_shown("#state", "ncree_three_storey")
        yield rig, tab, browser


def click_to_stop(rig: Rig, tab: Tab) -> float | None:
    """Milliseconds from a click on STOP to zero command, less the ramp; None: the machine was held up before."""
    x, y = tab.middle("#stop")
    tab.mouse("mouseMoved", x, y)
    try:
        rig.begin()
        rig.until_driven(FORCE)
    except AssertionError as error:
        print(f"not driven: {error}; {rig.graph.reported()}", file=sys.stderr, flush=True)
        return None
    clicked = time.time_ns()
    tab.mouse("mousePressed", x, y, wait=False)
    stopped = Response.PROTECTIVE_STOP
    rig.graph.until(lambda: rig.last.state == stopped and not rig.last.command[0], "the protective stop")
    tab.mouse("mouseReleased", x, y)
    samples = list(rig.responses)
    cause = next(one.cause for one in samples if one.state == Response.RAMPING_DOWN)
    rest = list(itertools.takewhile(lambda one: not one.command[0], reversed(samples)))
    tab.until_shown("#stop-note", "PRESSED")
    for _ in range(2):
        tab.click("#release")
    rig.graph.until(lambda: rig.last.state == Response.LATCHED, "STOP to be released")
    return (_stamp(rest[-1]) - clicked) / 1e6 - 1e3 * RAMP_TIME if "pressed by" in cause else None


def _stamp(sample: Response) -> int:
    return int(10**9 * sample.header.stamp.sec + sample.header.stamp.nanosec)


def stops(runs: int = RUNS) -> dict[str, Any]:
    """So many clicks; call it on a domain of one's own."""
    taken: list[float] = []
    repeated = 0
    with opened() as (rig, tab, _):
        for _ in range(TRIES * runs):
            found = click_to_stop(rig, tab)
            if found is None:
                repeated += 1
                print("repeated: the machine was held up, and that is a fault", file=sys.stderr, flush=True)
                continue
            taken.append(found)
            print(f"click {len(taken)} of {runs}: {found:.1f} ms", file=sys.stderr, flush=True)
            if len(taken) == runs:
                break
    return {
        "passed": sum(one <= WITHIN for one in taken),
        "runs": runs,
        "click_to_stop_ms_worst": round(max(taken), 1),
        "click_to_stop_ms_median": round(sorted(taken)[len(taken) // 2], 1),
        "repeated": repeated,
    }


def memory(seconds: float) -> dict[str, Any]:
    """What the server and the page grow by in so many seconds after the first minute; MB."""
    with opened() as (rig, tab, browser):
        server = psutil.Process(rig.graph.started["operator"].group)

        def measured() -> dict[str, float]:
            tab.command("HeapProfiler.collectGarbage")
            heap = float(tab.evaluate("performance.memory.usedJSHeapSize"))
            children = psutil.Process(browser.process.pid).children(recursive=True)
            pages = [one for one in children if "--type=renderer" in one.cmdline()]
            rendered = max(one.memory_full_info().uss for one in pages)
            found = {"server": server.memory_full_info().uss, "page_heap": heap, "page_process": rendered}
            return {name: round(value / 1e6, 2) for name, value in found.items()}

        def left_open(until: float) -> None:
            while time.monotonic() < until:
                rig.graph.executor.spin_once(timeout_sec=0.1)
                del rig.responses[:-1], rig.commands[:-1]
            tab.evaluate("1")

        begin = time.monotonic() + WARM_UP
        left_open(begin)
        first = last = measured()
        for part in range(1, PARTS + 1):
            left_open(begin + seconds * part / PARTS)
            last = measured()
            print(f"{seconds * part / PARTS:.0f} s of {seconds:.0f} s: {last} MB", flush=True)
    growth = {name: round(last[name] / first[name] - 1, 4) for name in first}
    return {"seconds": seconds, "first": first, "last": last, "growth": growth}


def pictures(folder: Path) -> None:
    """The page in El Centro with LQG3, stopped, and without its server; in lockstep, as the machine may be busy."""
    with graph_of_its_own("/rig") as graph, DrivenBrowser() as browser:
        save_controller(lqg3(), graph.folder / "lqg3.yaml")
        graph.start("logger", output="bags/el_centro", topics=["response", "brace_command", "ground_motion"])
        graph.start("operator", port=0)
        tab = browser.open(page_address(graph))
        graph.start("controller", "--params-file", graph.folder / "lqg3.yaml")
        graph.start("ground_motion", record="el_centro", peak_acceleration=0.98)
        graph.start("plant", lockstep=True, wait_for=["brace_command", "ground_motion"])
        graph.play("ground_motion")
        graph.until(lambda: float(graph.values("ground_motion").get("elapsed", "0")) > 15, "15 s of El Centro")
        tab.until("document.querySelectorAll('#latency td').length > 0")
        tab.screenshot(folder / "operator.png")
        tab.mouse("mousePressed", *tab.middle("#stop"))
        tab.until_shown("#state", "protective stop")
        tab.screenshot(folder / "operator_stopped.png")
        graph.stop("operator")
        tab.until_shown("#state", "no connection")
        tab.screenshot(folder / "operator_no_connection.png")


def verify_operator() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        found = stops()
    claims = [
        Claim("operator: STOP within 50 ms and the ramp", found["passed"], found["runs"], "clicks", least=True),
        Claim("operator: worst, click to stop [ms]", found["click_to_stop_ms_worst"], WITHIN, "less the ramp"),
    ]
    return found, claims


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated() as here:
        match sys.argv[1:]:
            case ["memory", *given]:
                print(json.dumps(memory(float(given[0]) if given else HOUR), indent=1))
            case ["pictures", file]:
                pictures(here / file)
            case given:
                print(json.dumps(stops(int(given[0]) if given else RUNS), indent=1))
