# SPDX-License-Identifier: Apache-2.0
"""The overhead of a test in a campaign: 100 short tests in lockstep, and bare starts of as many nodes.

overhead_seconds  from the last sample of a test to the first one of the next, on average
cpu_seconds       of processors, for a test: of all its processes, its samples and its share of the report included
lost_tests        that are not whole, or of which a sample is not in the bag
bare_seconds, bare_cpu_seconds  of three processes at once that import rclpy, make a node and end
ratio_to_bare, cpu_ratio_to_bare

python benchmarks/campaign_overhead.py [TESTS]
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from isolation import isolated

TESTS = 100
NODES = 3
SECONDS = 2.0
"""Of the rig in a test, the shortest noise that there is."""
BARE_STARTS = 20
BARE = "import rclpy; rclpy.init(); node = rclpy.create_node('bare'); node.destroy_node(); rclpy.shutdown()"


def _cpu_seconds() -> float:
    """Of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _campaign(tests: int) -> str:
    noise = "record: white_noise, rms: 0.1, band: [0.1, 10.0]"
    steps = [
        f"  - {{name: t{number}, test: {{duration: {SECONDS}, ground_motion: {{{noise}, seed: {number}}}}}}}"
        for number in range(tests)
    ]
    return "\n".join(["name: short", "rig: ncree_three_storey", "lockstep: true", "steps:", *steps, ""])


def campaign_overhead(tests: int = TESTS) -> dict[str, Any]:
    """All of it; call it on a domain of one's own."""
    Path("short.yaml").write_text(_campaign(tests), encoding="utf-8")
    used = _cpu_seconds()
    subprocess.run(["abrace", "campaign", "short.yaml"], check=False, stdout=subprocess.DEVNULL)
    cpu = (_cpu_seconds() - used) / tests
    steps = json.loads(Path("results/short/timing.json").read_text(encoding="utf-8"))["steps"]
    used, begin = _cpu_seconds(), time.perf_counter()
    for _ in range(BARE_STARTS):
        started = [subprocess.Popen([sys.executable, "-c", BARE]) for _ in range(NODES)]
        for process in started:
            process.wait()
    bare, bare_cpu = (time.perf_counter() - begin) / BARE_STARTS, (_cpu_seconds() - used) / BARE_STARTS
    overhead = sum(step["wall_seconds"] - step["run_seconds"] for step in steps) / tests
    return {
        "tests": tests,
        "overhead_seconds": overhead,
        "cpu_seconds": cpu,
        "lost_tests": tests - sum(step["lost_samples"] == 0 for step in steps),
        "bare_seconds": bare,
        "bare_cpu_seconds": bare_cpu,
        "ratio_to_bare": overhead / bare,
        "cpu_ratio_to_bare": cpu / bare_cpu,
    }


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(campaign_overhead(*map(int, sys.argv[1:])), indent=1))
