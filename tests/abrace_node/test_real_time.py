# SPDX-License-Identifier: Apache-2.0
"""What a node asks of the kernel: what it gets where that is allowed, and what it says where it is not."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest

from abrace_core import AbraceError
from abrace_node import real_time

SCRIPT = """
import json, os, sys, threading
from types import SimpleNamespace
from abrace_node import real_time

def state():
    return [os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, sorted(os.sched_getaffinity(0))]

found, warnings, go = {}, [], threading.Event()
def middleware():
    go.wait()
    found["middleware"] = state()
def sampling():
    real_time.above_the_loops(given)
    found["sampling"] = state()
def services(processors):
    real_time.beside_the_loop(processors)
    found["services"] = state()

processors = os.sched_getaffinity(0)
threads = [threading.Thread(target=middleware)]
threads[0].start()
given = SimpleNamespace(thread_priority=20, cpu_affinity=[min(processors)], lock_memory=True)
real_time.apply(given, warnings.append)
go.set()
threads += [threading.Thread(target=sampling), threading.Thread(target=services, args=[processors])]
for thread in threads[1:]:
    thread.start()
for thread in threads:
    thread.join()
found["loop"] = state()
locked = [int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmLck")]
opened = [os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
awake = "/dev/cpu_dma_latency" in opened
print(json.dumps({"warnings": warnings, "found": found, "locked": locked[0], "awake": awake}))
"""


def run(*before: str) -> dict:
    """What a process has after it asked for everything."""
    command = [*before, sys.executable, "-c", SCRIPT]
    return json.loads(subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout)


def test_the_loop_gets_its_priority_its_processor_and_memory_a_rigs_samples_one_more_and_services_one_less():
    result = run()
    if any("not allowed" in warning for warning in result["warnings"]):
        pytest.skip("this user may have no real-time priority")
    assert result["awake"] == (not result["warnings"]), "without the right there is a warning"
    everywhere = sorted(os.sched_getaffinity(0))
    ours = [os.SCHED_FIFO, 20, everywhere[:1]]
    others = {"sampling": [os.SCHED_FIFO, 21, everywhere[:1]], "services": [os.SCHED_FIFO, 19, everywhere]}
    assert result["found"] == {"loop": ours, "middleware": ours, **others}
    assert result["locked"] > 1000


@pytest.mark.skipif(not shutil.which("setpriv") or os.geteuid() != 0, reason="takes rights away from root")
def test_what_is_not_allowed_is_a_warning_that_says_what_to_do():
    result = run("setpriv", "--bounding-set", "-sys_nice,-ipc_lock")
    memory, priority, *_ = result["warnings"]
    assert "lock_memory is not allowed" in memory
    assert "'@realtime - memlock unlimited' >> /etc/security/limits.d/" in memory
    assert "thread_priority 20 is not allowed" in priority
    assert "'@realtime - rtprio 21' >> /etc/security/limits.d/" in priority
    assert result["locked"] == 0
    assert result["found"]["loop"] == [os.SCHED_OTHER, 0, sorted(os.sched_getaffinity(0))[:1]]


def test_processors_that_may_not_be_kept_awake_are_a_warning(monkeypatch, tmp_path):
    monkeypatch.setattr(real_time, "_WAKE_LATENCY", tmp_path / "cpu_dma_latency")
    warnings: list[str] = []
    real_time.keep_processors_awake(warnings.append)
    (warning,) = warnings
    assert "cpu_dma_latency: No such file or directory, expected write access (docs/computers.md)" in warning


def test_a_processor_that_is_not_there_is_refused():
    given = SimpleNamespace(thread_priority=0, cpu_affinity=[0, 4000], lock_memory=False)
    with pytest.raises(AbraceError, match=r"parameter cpu_affinity: \[0, 4000\], expected processors out of .*0"):
        real_time.apply(given, pytest.fail)
