# SPDX-License-Identifier: Apache-2.0
"""The two threads of a node that streams: nothing holds up the loop, and a node that ends has come to rest before."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import get_parameter_value
from running_graph import may_have_priority
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Iterator

SHAKER = """
import gc, sys, threading, time
from std_msgs.msg import Int64
from std_srvs.srv import Trigger
from abrace_node.lifecycle import AbraceLifecycleNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_node.transport import STREAM_QOS

class Shaker(AbraceLifecycleNode):
    ticks = heard = ramp = 0
    resting = False

    def __init__(self):
        super().__init__("shaker", [Parameter("level", 1.0, "m/s^2", live=True)])

    def configure(self):
        self.publisher = self.publish_on(Int64, "ticks", STREAM_QOS)
        self.subscribe_to(Int64, "input", self.on_input, STREAM_QOS)
        self.create_service(Trigger, "~/threads", self.on_threads)
        self.loaded = [[k] for k in range(300_000)]

    def activate(self):
        self.ramp, self.resting, self.due = 100, False, time.monotonic()

    def come_to_rest(self):
        self.resting = True

    @property
    def at_rest(self):
        return self.ramp == 0

    def deactivate(self):
        print("deactivated at", self.ramp, flush=True)
        self.due = None

    def tick(self):
        self.ticks += 1
        self.ramp -= self.resting and self.ramp > 0
        self.due = time.monotonic() + 0.002
        self.ticking = threading.current_thread().name
        self.publisher.publish(Int64(data=self.ticks))
        self.report_fault(self.fault)

    def on_input(self, message):
        if message.data == 13:
            raise RuntimeError("a defect in the loop")
        self.hearing = threading.current_thread().name
        self.heard = message.data

    @property
    def fault(self):
        return "too much" if self.parameters.level > 9 else None

    def diagnose(self):
        self.diagnosing = threading.current_thread().name
        if self.parameters.level == 7:
            raise RuntimeError("a defect beside the loop")
        return self.fault, "running", {}

    def prepare_change(self, name, value):
        wanted = self.ticks + 100
        while self.ticks < wanted:
            pass
        return lambda: None

    def on_threads(self, request, response):
        threads = self.ticking, self.hearing, self.diagnosing, threading.current_thread().name
        response.message = " ".join(threads)
        response.success = len(gc.get_objects()) < len(self.loaded)
        return response

    def close(self):
        print("closed at", self.ramp, flush=True)

sys.exit(run(Shaker, ["shaker", *sys.argv[1:]]))
"""


def shared_memory(process: subprocess.Popen) -> set[str]:
    """Files of the middleware's messages in shared memory that a process has open."""
    opened = Path(f"/proc/{process.pid}/maps").read_text()
    return set(re.findall(r"/dev/shm/fastrtps_\S+", opened))


@pytest.fixture
def shaker(graph: Any) -> Iterator[subprocess.Popen]:
    """A node that ticks, and takes 100 ticks to come to rest."""
    command = [sys.executable, "-c", SHAKER, "--ros-args", "-r", f"__ns:={graph.namespace}"]
    command += ["-p", "thread_priority:=20", "-p", f"cpu_affinity:=[{min(os.sched_getaffinity(0))}]"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        graph.until(lambda: "shaker" in graph.statuses, "the node")
        yield process
        process.kill()


def test_the_loop_goes_on_while_services_work_and_comes_to_rest_before_it_is_deactivated(graph, shaker):
    ticks = graph.listen(Int64, "ticks")
    publisher = graph.publisher(Int64, "input")
    publisher.publish(Int64(data=7))
    graph.until(lambda: ticks, "the first tick")

    high = Parameter(name="level", value=get_parameter_value("10.0"))
    request = SetParameters.Request(parameters=[high])
    # the change is prepared until the loop has ticked a hundred times
    assert graph.call(SetParameters, "shaker/set_parameters", request).results[0].successful
    graph.until_fault("shaker", "too much")

    policies = [os.sched_getscheduler(int(task.name)) for task in Path(f"/proc/{shaker.pid}/task").iterdir()]
    assert set(policies) == {os.SCHED_FIFO if may_have_priority() else os.SCHED_OTHER}
    assert os.sched_getaffinity(shaker.pid) == {min(os.sched_getaffinity(0))}

    said = graph.call(Trigger, "shaker/threads", Trigger.Request())
    assert said.message == "MainThread MainThread services services"
    assert said.success, "what was configured is left out of the collections of garbage that hold up the loop"

    assert not shared_memory(shaker), "there a node that joins would hold up the loop"

    assert graph.change_state("shaker", "deactivate")
    shaker.send_signal(signal.SIGINT)
    output = shaker.communicate(timeout=120)[0].splitlines()
    assert [line for line in output if " at " in line] == ["deactivated at 0", "closed at 0"], output
    assert shaker.returncode == 0


def test_a_node_that_a_signal_ends_comes_to_rest_before(graph, shaker):
    ticks = graph.listen(Int64, "ticks")
    graph.until(lambda: ticks, "the first tick")
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGINT):
        shaker.send_signal(number)
    assert shaker.communicate(timeout=120)[0].splitlines()[-1] == "closed at 0"
    assert shaker.returncode == 0


@pytest.mark.parametrize("where", ["beside", "in"])
def test_a_node_that_an_error_ends_comes_to_rest_before(graph, shaker, where):
    ticks = graph.listen(Int64, "ticks")
    publisher = graph.publisher(Int64, "input")
    graph.until(lambda: ticks, "the first tick")
    if where == "in":
        publisher.publish(Int64(data=13))
    else:
        level = Parameter(name="level", value=get_parameter_value("7.0"))
        graph.call(SetParameters, "shaker/set_parameters", SetParameters.Request(parameters=[level]))
    output = shaker.communicate(timeout=120)[0].splitlines()
    assert "closed at 0" in output, output
    (line,) = [line for line in output if "defect" in line]
    assert re.search(rf"FATAL.*: RuntimeError: a defect {where} the loop \(<string>, line \d+, in \w+\)$", line), output
    assert shaker.returncode == 1


@pytest.fixture
def own_choice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A profile of the user's own, which chooses nothing."""
    profile = tmp_path / "own.xml"
    profile.write_text('<dds xmlns="http://www.eprosima.com"><profiles/></dds>')
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))


@pytest.mark.usefixtures("own_choice")
def test_whoever_has_a_profile_of_their_own_chooses_the_transports(shaker):
    assert shared_memory(shaker)
