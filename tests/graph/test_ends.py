# SPDX-License-Identifier: Apache-2.0
"""How nodes end, and what they refuse: signals, a killed logger, wrong parameters and files."""

import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from forked import run_node
from std_msgs.msg import Bool

from abrace.processes.group import find_executable
from abrace_bags import read_runs
from abrace_interfaces.msg import Response

NOISE = {"duration": 60.0}

pytestmark = pytest.mark.usefixtures("domain")


def test_signals_end_every_node_cleanly_and_the_bag_is_closed(graph):
    """Once, or again and again until the node has ended: under `ros2 launch` Ctrl-C comes twice."""
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag))
    graph.start("plant")
    graph.start("ground_motion", record="white_noise", **NOISE)
    graph.start("excitation", **NOISE)
    graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
    graph.play("ground_motion", "excitation")
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 100, "recorded responses")
    storms = {"excitation": False, "ground_motion": True, "plant": True, "logger": True}
    for name, storm in storms.items():
        number = signal.SIGINT if storm else signal.SIGTERM
        graph.may_end.add(name)
        os.kill(graph.started[name].group, number)
        while storm and graph.started[name].returncode is None:
            os.kill(graph.started[name].group, number)
        assert graph.ended(name) == 0, graph.output_of(name)
        assert "Traceback" not in "\n".join(graph.output_of(name))
        # at once, not after the 20 s in which nothing is heard from a killed one
        graph.until(lambda name=name: name not in graph.node.get_node_names(), f"{name} to leave the graph", 10.0)
    assert (bag / "metadata.yaml").is_file()
    assert sum(len(run.outputs) for run in read_runs(bag)) > 100


HANGING = """
import threading
from abrace_plant.devices.simulated import SimulatedRig

class Hanging(SimulatedRig):
    def make_safe(self):
        threading.Event().wait()

def load(path, rig):
    return Hanging(rig, 1, by_the_clock=True)
"""


def test_a_device_that_hangs_while_it_is_made_safe_ends_the_node_with_code_1_and_one_line(graph, tmp_path, monkeypatch):
    (tmp_path / "hanging.py").write_text(HANGING)
    (tmp_path / "hanging-1.dist-info").mkdir()
    (tmp_path / "hanging-1.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: hanging\nVersion: 1\n")
    (tmp_path / "hanging-1.dist-info/entry_points.txt").write_text("[abrace.devices]\nhanging = hanging:load\n")
    (tmp_path / "device.yaml").write_text("kind: hanging\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    responses = graph.listen(Response, "response")
    graph.start("sensor_bridge", device=str(tmp_path / "device.yaml"))
    graph.until(lambda: responses, "samples")
    assert graph.stop("sensor_bridge") == 1, graph.output_of("sensor_bridge")
    graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample: the rig itself has come to rest")
    (line,) = (line for line in graph.output_of("sensor_bridge") if "ERROR" in line or "FATAL" in line)
    assert line.endswith("not at rest after 4.2 s: the device was not made safe")


def test_a_run_by_the_clock_ends_though_its_last_sample_was_missed(graph):
    responses = graph.listen(Response, "response")
    graph.start("plant", duration=3.0, autostart=False)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=1)
    assert graph.change_state("plant", "activate")
    # a run begins anew with its second sample
    graph.until(lambda: len(responses) > 10, "samples")
    plant, begin = graph.started["plant"].group, time.monotonic()
    os.kill(plant, signal.SIGSTOP)
    graph.until(lambda: time.monotonic() > begin + 3.6, "the end of the run")
    os.kill(plant, signal.SIGCONT)
    assert graph.ended("plant") == 0
    graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample")
    assert responses[-1].sequence > 1499
    assert 1499 not in {response.sequence for response in responses}


def test_a_terminal_that_is_lost_ends_the_logger_with_a_whole_bag(graph):
    bag = graph.folder / "bag"
    command = ["abrace_bags", "logger", "--ros-args", "-r", f"__ns:={graph.namespace}", "-p", f"output:={bag}"]
    child, terminal = pty.fork()
    if child == 0:
        os.execvp("abrace", ["abrace", "run", *command])
    graph.until(lambda: "logger" in graph.statuses, "diagnostics")
    os.close(terminal)
    looks = []
    graph.until(lambda: looks.append(os.waitpid(child, os.WNOHANG)) or looks[-1][0], "its end")
    assert os.waitstatus_to_exitcode(looks[-1][1]) == 0
    assert (bag / "metadata.yaml").is_file()


def test_a_signal_ends_a_node_that_waits_for_its_life_cycle(graph):
    graph.start("plant", autostart=False)
    graph.until(lambda: "plant" in graph.statuses, "diagnostics")
    assert graph.stop("plant") == 0


def test_a_node_ends_with_the_process_that_it_is_bound_to(graph, monkeypatch):
    with subprocess.Popen(["sleep", "1000"]) as launch:
        monkeypatch.setenv("ABRACE_END_WITH", str(launch.pid))
        graph.start("logger", output=str(graph.folder / "bag"))
        graph.until(lambda: "logger" in graph.statuses, "diagnostics")
        launch.kill()
    assert graph.ended("logger") == 0
    assert (graph.folder / "bag/metadata.yaml").is_file()
    expect_refusal(run_node("abrace_plant", "plant"), f"ABRACE_END_WITH={launch.pid}", "has ended")
    monkeypatch.setenv("ABRACE_END_WITH", "launch")
    expect_refusal(run_node("abrace_plant", "plant"), "ABRACE_END_WITH=launch", "expected the number of a process")


@pytest.mark.parametrize("program", ["plant", "abrace status"])
def test_a_program_ends_though_its_dds_participant_does_not(graph, tmp_path, monkeypatch, program):
    """Where the listener of a participant is at work as it ends, the wheels' Fast DDS waits for ever, with a lock."""
    source, library = Path(__file__).parents[1] / "support/discovery_at_the_end.c", tmp_path / "discovery.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    monkeypatch.setenv("LD_PRELOAD", str(library))
    words = ["--ros-args", "-r", f"__ns:={graph.namespace}", "-p", "autostart:=false"]
    command = [find_executable("abrace_plant", "plant"), *words] if program == "plant" else program.split()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as ending:
        if program == "plant":
            graph.until(lambda: "plant" in graph.statuses, "diagnostics")
            ending.send_signal(signal.SIGINT)
        latest = time.monotonic() + 60.0
        while ending.poll() is None and time.monotonic() < latest:
            come = graph.node.create_subscription(Bool, "comes_and_goes", print, 1)
            time.sleep(0.2)
            graph.node.destroy_subscription(come)
        ending.kill()
        assert ending.stderr is not None
        assert ending.returncode == 0, ending.stderr.read()


WORKER = """
import os, signal, sys, time
from abrace_node.node import AbraceNode
from abrace_node.process import run
class Worker(AbraceNode):
    def __init__(self):
        if sys.argv[1] == "created":
            os.kill(os.getpid(), signal.SIGINT)
        super().__init__("worker", [])
    def work(self):
        try:
            print("working", flush=True)
            while True:
                time.sleep(0.1)  # a signal between a check for signals and a sleep does not interrupt that sleep
        finally:
            os.kill(os.getpid(), signal.SIGINT)
            print("cleaned up", flush=True)
sys.exit(run(Worker, ["worker"]))
"""


@pytest.mark.parametrize(("when", "output"), [("created", ""), ("working", "working\ncleaned up\n")])
def test_a_signal_interrupts_the_work_of_an_offline_node_and_a_second_one_not_its_cleaning_up(when, output):
    process = subprocess.Popen([sys.executable, "-c", WORKER, when], stdout=-1, stderr=-1, text=True)
    first = process.stdout.readline()
    if first:
        process.send_signal(signal.SIGINT)
    further, errors = process.communicate(timeout=120)
    assert first + further == output
    assert errors == "worker: stopped before it was done\n"
    assert process.returncode == 0


THREADS = """
import sys
import numpy, scipy.linalg
from threadpoolctl import threadpool_info
from abrace_node.node import AbraceNode
from abrace_node.process import run
class Worker(AbraceNode):
    def __init__(self):
        super().__init__("worker", [])
    def work(self):
        print({one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}, flush=True)
sys.exit(run(Worker, ["worker"]))
"""


def test_an_offline_node_uses_one_thread_for_linear_algebra(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    ended = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout == "{1}\n"


def expect_refusal(ended: subprocess.CompletedProcess, *expected: str) -> None:
    assert ended.returncode == 2, ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == 1, ended.stderr
    for text in expected:
        assert text in lines[0]
