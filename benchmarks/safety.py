# SPDX-License-Identifier: Apache-2.0
"""Safety, tried on running nodes over DDS: what may go wrong as cases, 20 runs each. For `make verify`.

pairs, pairs_covered        pairs of a state and an event, and those that a real RigSafety takes as docs/rig.md says
interlocks, interlocks_tripped  those of the paper's rig, and those that a planted fault trips before any other one
cases                       by name: runs, and those that passed
all_cases                   their number, the runs of all of them, those that passed, and those that failed in a stall
worst_step_over_rate_limit  of all of them: the greatest change of a command between two samples over what is allowed,
                            also as it reaches the emulated actuators
controller                  killed, stopped, flooding, behind `sensor_bridge` and emulator: runs, and those in which the
                            force was zero within `command_timeout` (10 samples), ramp (250) and 5 samples more
without_services            runs of `nothing_but_the_loop_in_its_thread`, in turns with it, in which nothing was called:
                            what is late in them is the machine's
while_stalled               of each: runs that failed, and in which the machine itself stalled for 1 ms or more
                            (machine_stalls.py); they count as failed
faults_before               of each: faults of the rig before the case did what it tries, cleared as a person would

python benchmarks/safety.py [RUNS [RUNS OF A CONTROLLER THAT FAILS [CASE ...]]]
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
import traceback
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from claims import Claim
from controller_speed import SOURCE
from interlock_margins import interlocks_tripped
from isolation import isolated
from machine_stalls import MachineStalls
from running_graph import Graph
from safety_by_the_clock import CONTROLLED, EXCITED, FAILURES, NOTHING_CALLED, Rig
from safety_cases import LOCKSTEP, plant_in_hand, walk_pairs, worst_step
from safety_graphs import GRAPHS
from state_table import EXPECTED, StateWalk, cells

from abrace.processes.group import ProcessGroup
from abrace_core import AbraceError
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

RUNS, CONTROLLER_RUNS = 20, 100
_numbers = itertools.count(1)


class Tries:
    """Runs cases, and keeps count.

    Attributes
    ----------
    found
        By name of a case: `passed`, `runs`, `while_stalled` and `faults_before`.
    worst_step
        Greatest of all runs.
    """

    def __init__(self, context: rclpy.Context, stalls: MachineStalls) -> None:
        self.found: dict[str, dict[str, int]] = {}
        self.worst_step = 0.0
        self._context, self._stalls = context, stalls

    def run(self, make: Callable[[Graph], Any], cases: Mapping[str, Callable[[Any], None]], runs: int) -> None:
        """Try `cases` in turns on a bench that `make` makes of a graph; after one that fails, on a new one."""
        left = [*cases.items()] * runs
        while left:
            name = f"safety_{next(_numbers)}"
            folder = Path(name).resolve()
            folder.mkdir()
            with ProcessGroup() as processes:
                graph = Graph(f"/{name}", folder, self._context, processes)
                try:
                    self._until_one_fails(graph, make, left)
                finally:
                    graph.close()

    def _until_one_fails(
        self, graph: Graph, make: Callable[[Graph], Any], left: list[tuple[str, Callable[[Any], None]]]
    ) -> None:
        bench = None
        while left:
            name, case = left.pop(0)
            counts = self.found.setdefault(name, {"passed": 0, "runs": 0, "while_stalled": 0, "faults_before": 0})
            counts["runs"] += 1
            began = time.monotonic()
            try:
                bench = bench or make(graph)
                bench.begin()
                case(bench)
                counts["passed"] += 1
            except (AssertionError, AbraceError) as error:
                where = traceback.extract_tb(error.__traceback__)[-1]
                print(f"{name}: {where.name}, line {where.lineno}: {error}", file=sys.stderr, flush=True)
                if stalls := self._stalls.since(began):
                    counts["while_stalled"] += 1
                    print(f"{name}: the machine stalled for {1e3 * max(stalls):.1f} ms", file=sys.stderr, flush=True)
                return
            finally:
                if bench is not None:
                    counts["faults_before"] += getattr(bench, "faults_before", 0)
                    at_device = getattr(bench, "worst_step_at_device", 0.0)
                    self.worst_step = max(self.worst_step, worst_step(bench.responses), at_device)
                took = time.monotonic() - began
                print(f"{name}: {_passed(counts)} passed ({took:.1f} s)", file=sys.stderr, flush=True)


def safety(runs: int = RUNS, controller_runs: int = CONTROLLER_RUNS, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All cases, or `only` those of these names; call it on a domain of one's own."""
    pairs, covered = walk_pairs(load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml"))
    context = rclpy.Context()
    context.init()

    def chosen(cases: Mapping[str, Callable[[Any], None]]) -> dict[str, Callable[[Any], None]]:
        return {name: case for name, case in cases.items() if not only or name in only}

    try:
        with MachineStalls() as stalls:
            rows, failing = Tries(context, stalls), Tries(context, stalls)
            rows.run(plant_in_hand, chosen(LOCKSTEP), runs)
            for make, cases in GRAPHS.items():
                rows.run(make, chosen(cases), runs)
            rows.run(partial(Rig, commander="excitation"), chosen(EXCITED), runs)
            if not only or CONTROLLED.keys() & set(only):
                rows.run(partial(Rig, commander="controller"), CONTROLLED, runs)
            bridged = partial(Rig, commander="controller", name="sensor_bridge")
            failing.run(bridged, chosen(FAILURES), controller_runs)
    finally:
        context.try_shutdown()
    without = rows.found.pop(NOTHING_CALLED, {})
    return {
        "pairs": pairs,
        "pairs_covered": covered,
        **interlocks_tripped(),
        "cases": rows.found,
        "all_cases": {
            "cases": len(rows.found),
            **{key: sum(one[key] for one in rows.found.values()) for key in ("runs", "passed", "while_stalled")},
        },
        "worst_step_over_rate_limit": max(rows.worst_step, failing.worst_step),
        "controller": failing.found,
        NOTHING_CALLED: without,
    }


def _passed(counts: dict[str, int]) -> str:
    return f"{counts['passed']} of {counts['runs']}"


def _runs(counts: dict[str, int]) -> str:
    return f"{counts['runs']} runs, {counts['while_stalled']} failed in a stall"


def claims_of(found: dict[str, Any]) -> list[Claim]:
    """What is asked for, and what was reached."""
    counted = {**found["cases"], **{f"controller {name}": one for name, one in found["controller"].items()}}
    return [
        Claim("safety: states with every event", found["pairs_covered"], found["pairs"], "the table", least=True),
        Claim(
            "safety: interlocks tripped by their own fault",
            found["interlocks_tripped"],
            found["interlocks"],
            "the paper's rig",
            least=True,
        ),
        *(
            Claim(
                f"safety: {name.replace('_', ' ')}",
                one["passed"],
                one["runs"],
                _runs(one) + (f"; without a service {_passed(found[NOTHING_CALLED])}" if name in CONTROLLED else ""),
                least=True,
            )
            for name, one in counted.items()
        ),
        Claim("safety: worst step over the rate limit", found["worst_step_over_rate_limit"], 1.0, "-"),
    ]


def verify_safety() -> tuple[dict[str, Any], list[Claim]]:
    """All of it, for verify.json."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        found = safety()
    return found, claims_of(found)


def verify_state_table() -> tuple[dict[str, int], list[Claim]]:
    """Every wrong cell of the table of states, planted in the machine, and those that the table by hand lets pass."""
    walk, wrong, survivors = StateWalk(), 0, list(StateWalk().differences())
    for state, event in cells(EXPECTED):
        count, passed = walk.planted(state, event)
        wrong += count
        survivors += passed
    values = {"cells": len(cells(EXPECTED)), "planted": wrong, "survivors": len(survivors)}
    return values, [Claim("wrong cells of the table of states that no test finds", len(survivors), 0, "-")]


def main() -> None:
    """The command of this file."""
    parser = argparse.ArgumentParser(description="what may go wrong, on running nodes")
    parser.add_argument("runs", type=int, nargs="?", default=RUNS)
    parser.add_argument("controller_runs", type=int, nargs="?", default=CONTROLLER_RUNS)
    parser.add_argument("cases", nargs="*", help="those alone")
    given = parser.parse_args()
    known = [name for cases in (LOCKSTEP, *GRAPHS.values(), EXCITED, CONTROLLED, FAILURES) for name in cases]
    if unknown := [name for name in given.cases if name not in known]:
        parser.error(f"{', '.join(unknown)}: expected {', '.join(known)}")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(safety(given.runs, given.controller_runs, tuple(given.cases)), indent=1))


if __name__ == "__main__":
    main()
