# SPDX-License-Identifier: Apache-2.0
"""A rig on a computer that other programs keep busy."""

from __future__ import annotations

import os
import sys

import pytest
from running_graph import SLOW, may_have_priority

from abrace_interfaces.msg import Response

PRIORITY = 50
BUSY = """
import os, time
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({priority}))
end = time.monotonic() + 1.5
while time.monotonic() < end:
    pass
"""


@pytest.mark.alone
@pytest.mark.skipif(not may_have_priority(), reason="this user may not have real-time priorities")
def test_a_rig_that_cannot_hear_its_stop_buttons_stops_by_itself(graph):
    """Programs of the second thread's priority occupy all processors; the loop, one above, goes on."""
    graph.by_the_clock, rig = True, graph.slow_rig()
    samples: list[Response] = graph.listen(Response, "response")
    graph.start("plant", rig=rig, command_timeout=1.0, late_limit=1000)
    graph.start("excitation", rms=2500.0, duration=600.0, band=[0.5, 5.0], sample_rate=SLOW)
    graph.play("excitation")
    graph.until(lambda: samples and any(samples[-1].command), "a force")
    command = [sys.executable, "-c", BUSY.format(priority=PRIORITY - 1)]
    for number in range(os.cpu_count() or 1):
        graph.processes.start(f"busy_{number}", command, graph.folder / f"busy_{number}.log")
    graph.until(lambda: samples[-1].state == Response.LATCHED and not any(samples[-1].command), "the rig to stop")
    assert samples[-1].cause.startswith("stop buttons not polled for 0.5 s"), samples[-1].cause
