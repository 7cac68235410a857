# SPDX-License-Identifier: Apache-2.0
"""Exceptions in every callback and task of every live node, and calls with any content on every topic and service.

exceptions   places    callbacks and tasks, found by introspection
             planted   those in which an exception was raised
             clean     those whose exception took the one course, of nodes that ended with exit code 1 and one line
bounds       calls     messages and requests with values at and beyond their bounds, life cycle in random order
             deaths    nodes that ended
             deaf      nodes that answered no more
             the rest  as in wrong_endurance.py

python benchmarks/planted_everywhere.py exceptions | bounds [CALLS ON EACH TOPIC AND SERVICE]
"""

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any

from claims import Claim
from isolation import isolated
from planted_exceptions import planted_in_every_node
from running_graph import PATIENCE, graph_of_its_own
from wrong_endurance import CAPACITY, RATE_STEP, measure

from abrace_core.files.installed import find_file

CALLS = 70
"""On each of some 150 topics and services: 10^4 in all."""
RATE = 60.0


def exceptions() -> dict[str, Any]:
    """Values for verify.json."""
    with isolated(), graph_of_its_own("/planted") as graph:
        text = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig").read_text(encoding="utf-8")
        rig = graph.folder / "slow.yaml"
        rig.write_text(re.sub(r"(?m)^sample_rate:.*$", f"sample_rate: {RATE}", text), encoding="utf-8")
        codes = planted_in_every_node(graph, rig, 3 * PATIENCE)
        states, clean = [], 0
        for name, code in codes.items():
            found = json.loads((graph.folder / f"{name}.json").read_text(encoding="utf-8"))["places"].values()
            lines = (graph.folder / f"{name}.log").read_text(encoding="utf-8").splitlines()
            well = code.read_text(encoding="utf-8") == "1" and sum("FATAL" in line for line in lines) == 1
            states += found
            clean += well * sum(state == "caught" for state in found)
    return {"places": len(states), "planted": sum(state != "not called" for state in states), "clean": clean}


def bounds(calls: int = CALLS) -> dict[str, Any]:
    """Values for verify.json."""
    with isolated():
        found = measure(calls)
    kept = ("topics", "services", "not_finite", "greatest_force", "worst_step", "at_device", "samples", "faults")
    return {"calls": found["messages"], "deaths": found["died"], "deaf": found["deaf"]} | {
        name: found[name] for name in kept
    }


def verify_exceptions() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    found = exceptions()
    return found, [
        Claim(f"places with an exception, of {found['places']}", found["planted"], found["places"], "-", least=True),
        Claim("of which took the one course", found["clean"], found["places"], "-", least=True),
    ]


def verify_bounds() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    found = bounds()
    return found, [
        Claim("calls beyond all bounds", found["calls"], 1e4, "-", least=True),
        Claim("nodes that died of them", found["deaths"], 0, "-"),
        Claim("nodes that answered no more", found["deaf"], 0, "-"),
        Claim("samples at which what acted was not finite", found["not_finite"], 0, "-"),
        Claim("greatest force [N]", found["greatest_force"], CAPACITY, "capacity"),
        Claim("greatest step [N]", found["worst_step"] / (1 + 1e-12), RATE_STEP, "rate limit"),
        *(
            Claim(f"{name.replace('_', ' ')} at the emulated device, of its limit", share / (1 + 1e-9), 1.0, "-")
            for name, share in found["at_device"].items()
        ),
    ]


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    kind, *numbers = sys.argv[1:]
    print(json.dumps({"exceptions": exceptions, "bounds": bounds}[kind](*map(int, numbers)), indent=1))
