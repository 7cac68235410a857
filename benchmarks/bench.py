# SPDX-License-Identifier: Apache-2.0
"""Speed claims against their peers, measured in one run: `make bench`; some parts alone by `make bench PARTS=reading`.

Prints a table, and writes results/bench.json as each part ends; what an earlier run found of others stays.

simulation     50 000 closed-loop steps, linear and saturated, against scipy's lfilter and dlsim
plant_step     a sample of the simulated rig as the node `plant` takes it, against a round trip of the echo below
lockstep       the demo's closed loop (plant, ground motion, controller, logger, each a process of its own) against a
               bare echo of the same messages between two processes, and a bare graph of four, measured just before and
               just after; all of them with the least real-time priority, where allowed, and once more without
controller     a step of LQG3, its answer over DDS and the echo
studies        18 closed loops; 100 000 of 50 000 steps on all cores, linear and saturating, and a million of 5 000
               steps, from models to files
reading        1 000 000 responses to arrays, against `rosbags` and `mcap-ros2-support`
report         report.html of the demo: `abrace report` as a process of its own, its size, and a headless Chromium
               from opening it until all figures are drawn
campaign       what a test costs beside its samples, against bare starts of as many nodes
node_start     plant, controller and logger of a test until they are configured, in turns with three bare nodes
identification from bags of 600 s to the model, against scikit-rf's VectorFitting
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from bag_reading import bag_reading
from campaign_overhead import campaign_overhead
from claims import keep
from controller_speed import controller_speed, lqg3
from fragility_speed import fragility_speed
from identification_speed import identification_speed
from isolation import isolated
from node_start import node_start
from report_speed import report_rows, report_speed
from simulation import simulation_speed

from abrace.campaign.course import run_campaign
from abrace.report.table import Table
from abrace_core.files.installed import find_file
from abrace_core.files.writing import write_text
from abrace_core.model.controller_file import save_controller
from abrace_core.safety.rig_safety import RigSafety
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import RigLoop, rig_outputs
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

RESULTS = Path("results/bench.json")
HERE = Path(__file__).parent.resolve()
ECHO_COUNT = 20_000
PLANT_STEPS = 20_000
SAMPLE_RATE = 500.0
LEAST_PRIORITY = 1
"""SCHED_FIFO priority."""


def round_trips(priority: int, *answers: str, listeners: int = 0) -> float:
    """Round trips a second of bare processes that answer on these topics, with others that listen."""
    script = [sys.executable, str(HERE / "echo.py"), str(priority)]
    others = [[*script, "answer", topic] for topic in answers] + [[*script, "listen"]] * listeners
    with contextlib.ExitStack() as ending:
        for command in others:
            process = ending.enter_context(subprocess.Popen(command))
            ending.callback(process.terminate)
        asking = subprocess.run(
            [*script, "ask", str(ECHO_COUNT), str(listeners), *answers], check=True, capture_output=True, text=True
        )
    return float(asking.stdout)


def bare_rates(priority: int) -> tuple[float, float]:
    """Round trips a second of the echo, and of the bare graph of the lockstep graph's shape."""
    echo = round_trips(priority, "brace_command")
    return echo, round_trips(priority, "brace_command", "ground_motion", listeners=1)


def lockstep(priority: int) -> dict[str, Any]:
    """Samples a second of the lockstep graph; and round trips of an echo, and of a bare graph, before and after it.

    All loops have a SCHED_FIFO `priority`, where the machine allows it; 0: none.
    """
    save_controller(lqg3(), "lqg3.yaml")
    campaign = Path(f"lockstep_{priority}.yaml")  # its controller is the one beside it
    write_text(campaign, (HERE / "lockstep.yaml").read_text(encoding="utf-8") + f"thread_priority: {priority}\n")
    before = bare_rates(priority)
    results = run_campaign(campaign).results
    after = bare_rates(priority)
    (step,) = json.loads((results / "timing.json").read_text(encoding="utf-8"))["steps"]
    rate = step["samples"] / step["run_seconds"]
    echo, graph = ((one + other) / 2 for one, other in zip(before, after, strict=True))
    return {
        "thread_priority": priority,
        "samples_per_second": rate,
        "real_time_factor": rate / SAMPLE_RATE,
        "echo_per_second": echo,
        "ratio_to_echo": rate / echo,
        "bare_graph_per_second": graph,
        "ratio_to_bare_graph": rate / graph,
    }


def lockstep_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: a lockstep run with and without a priority, against the echo and the bare graph."""
    rows: list[tuple[str, ...]] = []
    for values, asked in ((found, "0.7 x"), (found["without_priority"], "-")):
        title = f"lockstep, thread_priority {values['thread_priority']}, x real time"
        reached = f"{values['real_time_factor']:.2f}"
        rows.append(
            (title, reached, asked, f"bare echo {values['echo_per_second']:.0f}/s", f"{values['ratio_to_echo']:.2f}")
        )
        peer = f"bare graph {values['bare_graph_per_second']:.0f}/s"
        rows.append(("", "", "-", peer, f"{values['ratio_to_bare_graph']:.2f}"))
    return rows


def plant_step() -> float:
    """Microseconds of a sample of a rig of 26 states, with forces of a fifth of its capacity and with sensor noise."""
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    modes = tuple(replace(rig.local_modes[2], frequency=150.0 + 10 * number) for number in range(6))
    rig = replace(rig, local_modes=rig.local_modes + modes)
    safety = RigSafety()
    safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
    safety.activate()
    loop = RigLoop(rig, SimulatedRig(rig, 1, by_the_clock=False), safety, 0.02, 10, 1, lockstep=True)
    forces = 0.2 * rig.capacity[0] * np.sin(0.05 * np.arange(PLANT_STEPS))
    loop.until_it_acts()
    begin = time.perf_counter()
    for force in forces.tolist():
        loop.step()
        loop.receive_command(1, loop.sequence, [force], "")
    took = time.perf_counter() - begin
    assert safety.acting, safety.cause
    return 1e6 * took / PLANT_STEPS


def simulation_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: both cases against each peer."""
    rows: list[tuple[str, ...]] = []
    for case, asked in (("linear", "60"), ("saturated", "30")):
        values = found[case]
        title = f"50 000 closed-loop steps, {case}, ms"
        for peer, ratio in (
            ("scipy lfilter, mode by mode", "ratio_to_lfilter"),
            ("scipy dlsim", "ratio_to_dlsim"),
        ):
            wanted = f"{asked} x" if ratio == "ratio_to_dlsim" else "-"
            rows.append((title, f"{1e3 * values['seconds']:.2f}", wanted, peer, f"{values[ratio]:.1f}"))
            title = ""
    return rows


def identification_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: reading, the whole fit, and the vector fits' times and errors."""
    peer = found["scikit_rf"]
    rows: list[tuple[str, ...]] = []
    rows.append(("reading a bag of 600 s, s", f"{found['read_seconds']:.2f}", "1", "-", "-"))
    rows.append(("from two tests of 600 s to the models, s", f"{found['fit_seconds']:.2f}", "3", "-", "-"))
    whole, alone = found["fit_seconds"] + found["judge_seconds"], found["vector_fitting_seconds"]
    columns = (f"by vector fitting {alone:.2f}", f"{alone / whole:.2f}")
    rows.append(("the same, and judged, s", f"{whole:.2f}", "0.2 x", *columns))
    ratio = f"{peer['time_ratio']:.2f}"
    rows.append(("vector fitting, s", f"{peer['our_seconds']:.2f}", "-", f"scikit-rf {peer['seconds']:.2f}", ratio))
    likely = peer["maximum_likelihood"]
    for what in ("frequency", "damping"):
        theirs = peer[f"{what}_error"]
        for method, ours in (("vector fitting", peer[f"our_{what}_error"]), ("identify", likely[f"{what}_error"])):
            columns = (f"scikit-rf {100 * theirs:.4f}", f"{theirs / ours:.2f}")
            rows.append((f"{method}: {what}, worst pole, %", f"{100 * ours:.4f}", "-", *columns))
    return rows


def bag_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: a large bag, against each peer."""
    rows: list[tuple[str, ...]] = []
    title = "reading 1 000 000 responses, s"
    for name, key in (("rosbags", "rosbags"), ("mcap-ros2-support", "mcap_ros2_support")):
        columns = f"{name} {found[f'{key}_seconds']:.1f}", f"{found[f'ratio_to_{key}']:.1f}"
        rows.append((title, f"{found['seconds']:.2f}", "2, 10 x", *columns))
        title = ""
    rows.append(("of it, a hundredth of the time, s", f"{found['time_range_seconds']:.3f}", "-", "-", "-"))
    return rows


def controller_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: a step, and the loop over DDS."""
    loop = found["loop"]
    median, slow = (f"bare echo {loop[key]:.0f}" for key in ("echo_median_us", "echo_p999_us"))
    return [
        ("a step of the controller, us", f"{found['controller']['step_us']:.1f}", "8", "-", "-"),
        ("sample to command, median, us", f"{loop['median_us']:.0f}", "1 x", median, f"{loop['median_ratio']:.2f}"),
        ("sample to command, 99.9 %, us", f"{loop['p999_us']:.0f}", "1.2 x", slow, f"{loop['p999_ratio']:.2f}"),
    ]


def studies_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: many closed loops."""
    return [
        ("18 closed loops of 10 000 steps, s", f"{found['seconds_18_loops']:.2f}", "0.5", "-", "-"),
        ("100 000 closed loops of 50 000 steps, s", f"{found['seconds_100000']:.0f}", "110", "-", "-"),
        ("the same, saturating, s", f"{found['seconds_100000_saturating']:.0f}", "180", "-", "-"),
        ("1 000 000 of 5 000 steps, resumed once, s", f"{found['seconds_million_short']:.0f}", "180", "-", "-"),
        ("memory of all processes in them, MB", f"{found['memory_mb']:.0f}", "2000", "-", "-"),
    ]


def plant_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: a sample of the rig."""
    step, trip = found["step_us"], found["round_trip_us"]
    asked, peer = f"{trip / 10:.1f}", f"round trip {trip:.0f} us"
    return [("a sample of the rig, us", f"{step:.1f}", asked, peer, f"{trip / step:.1f}")]


def campaign_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: what a test of a campaign costs beside its samples."""
    bare, cpu = f"3 bare nodes {found['bare_seconds']:.2f}", f"3 bare nodes {found['bare_cpu_seconds']:.2f}"
    ratio, cpu_ratio = f"{found['ratio_to_bare']:.1f}", f"{found['cpu_ratio_to_bare']:.1f}"
    return [
        ("between two tests of a campaign, s", f"{found['overhead_seconds']:.2f}", "1.5", bare, ratio),
        ("processors for a test, s", f"{found['cpu_seconds']:.2f}", "-", cpu, cpu_ratio),
        (f"tests lost of {found['tests']}", f"{found['lost_tests']}", "0", "-", "-"),
    ]


def start_rows(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: the start of a campaign's nodes."""
    return [
        (
            f"start of plant, controller, logger, {unit}",
            f"{one['nodes']:.2f}",
            "2 x",
            f"three bare nodes {one['bare']:.2f}",
            f"{ratio:.1f}",
        )
        for unit, one, ratio in (
            ("s", found["seconds"], found["ratio_to_bare"]),
            ("processors, s", found["cpu_seconds"], found["cpu_ratio_to_bare"]),
        )
    ]


class Part(NamedTuple):
    """What measures a part, and the rows that show it."""

    measure: Callable[[], dict[str, Any]]
    rows: Callable[[dict[str, Any]], Iterable[tuple[str, ...]]]


PARTS = {
    "simulation": Part(simulation_speed, simulation_rows),
    "plant_step": Part(
        lambda: {"step_us": plant_step(), "round_trip_us": 1e6 / round_trips(LEAST_PRIORITY, "brace_command")},
        plant_rows,
    ),
    "lockstep": Part(lambda: lockstep(LEAST_PRIORITY) | {"without_priority": lockstep(0)}, lockstep_rows),
    "reading": Part(bag_reading, bag_rows),
    "identification": Part(identification_speed, identification_rows),
    "controller": Part(controller_speed, controller_rows),
    "studies": Part(fragility_speed, studies_rows),
    "report": Part(report_speed, report_rows),
    "campaign": Part(campaign_overhead, campaign_rows),
    "node_start": Part(node_start, start_rows),
}


def main() -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description="Speed claims against their peers.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all without any")
    given = parser.parse_args().parts
    if unknown := [name for name in given if name not in PARTS]:
        parser.error(f"{', '.join(unknown)}: expected {', '.join(PARTS)}")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    rows: list[tuple[str, ...]] = []
    for name, part in PARTS.items():
        if given and name not in given:
            continue
        print(f"{name} ...", flush=True)
        begin = time.monotonic()
        with isolated():
            found = part.measure()
        print(f"{name}: {time.monotonic() - begin:.0f} s", flush=True)
        keep(RESULTS, {name: found})
        rows += part.rows(found)
    print(Table("Speed", ("claim", "reached", "asked", "peer", "ratio"), tuple(rows)).text())


if __name__ == "__main__":
    main()
