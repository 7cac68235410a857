# SPDX-License-Identifier: Apache-2.0
"""The jitter of a running rig, measured beside a timer and an echo."""

import json
import subprocess

import pytest

from abrace.processes.group import find_executable

pytestmark = pytest.mark.usefixtures("domain")


def measure(graph, *parameters: str) -> subprocess.CompletedProcess:
    given = [word for parameter in parameters for word in ("-p", parameter)]
    command = [find_executable("abrace_plant", "jitter"), "--ros-args", "-r", f"__ns:={graph.namespace}", *given]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_a_rig_is_measured_beside_a_timer_and_an_echo(graph, tmp_path):
    graph.start("plant")
    graph.until(lambda: "plant" in graph.statuses, "the rig")
    ended = measure(graph, "duration:=0.5", f"output:={tmp_path}")
    assert (ended.returncode, ended.stderr) == (0, "")
    found = json.loads((tmp_path / "jitter.json").read_text())
    # the period is the median of the rig's stamps: 2 ms, but on a busy machine, where samples come in bursts, less
    assert 0 < found["period"] < 0.1
    assert [found[name]["events"] for name in ("timer", "echo")] == 2 * [round(0.5 / found["period"])]
    assert found["rig"]["events"] > 100
    assert all(found[name]["worst_us"] >= found[name]["median_us"] > 0 for name in ("rig", "timer", "echo"))
    assert all(sum(found[name]["counts"]) == found[name]["events"] for name in ("rig", "timer", "echo"))
    assert len(found["rig"]["counts"]) == len(found["edges_us"]) - 1
    assert (tmp_path / "jitter.png").stat().st_size > 10_000
    assert [line.split()[0] for line in ended.stdout.splitlines()] == ["us", "rig", "timer", "echo", "wrote"]


def test_without_a_rig_it_says_so(graph):
    ended = measure(graph, "patience:=0.2")
    assert ended.returncode == 2
    assert ended.stderr == (f"jitter: no sample on {graph.namespace}/response within 0.2 s, expected a running rig\n")
