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
from std_msgs.msg import String

from abrace.processes.group import find_executable
from abrace_bags import read_runs, read_topics
from abrace_core.node import TRANSIENT_LOCAL_QOS
from abrace_interfaces.msg import Response

RIG = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"
NOISE = {"duration": 60.0}

pytestmark = pytest.mark.usefixtures("domain")


@pytest.mark.parametrize(("number", "storm"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_signals_end_every_node_cleanly_and_the_bag_is_closed(graph, number, storm):
    """Once, or again and again until the node has ended: under `ros2 launch` Ctrl-C comes twice."""
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag))
    graph.start("plant")
    graph.start("ground_motion", record="white_noise", **NOISE)
    graph.start("excitation", **NOISE)
    graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 100, "recorded responses")
    for name in ("excitation", "ground_motion", "plant", "logger"):
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
    assert line.endswith("not at rest after 3.16 s: the device was not made safe")


def test_a_run_by_the_clock_ends_though_its_last_sample_was_missed(graph):
    responses = graph.listen(Response, "response")
    graph.start("plant", duration=4.0, autostart=False)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=1)
    assert graph.change_state("plant", "activate")
    graph.until(lambda: responses and responses[-1].sequence > 1000, "samples")
    plant, begin = graph.started["plant"].group, time.monotonic()
    os.kill(plant, signal.SIGSTOP)
    graph.until(lambda: time.monotonic() > begin + 2.2, "the end of the run")
    os.kill(plant, signal.SIGCONT)
    assert graph.ended("plant") == 0
    graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample")
    assert responses[-1].sequence > 1999
    assert 1999 not in {response.sequence for response in responses}


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


WORKER = """
import os, signal, sys, time
from abrace_core.node import AbraceNode, run
class Worker(AbraceNode):
    def __init__(self):
        if sys.argv[1] == "created":
            os.kill(os.getpid(), signal.SIGINT)
        super().__init__("worker", [])
    def work(self):
        try:
            print("working", flush=True)
            time.sleep(1000)
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
from abrace_core.node import AbraceNode, run
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


def test_a_latched_topic_that_was_published_before_is_recorded(graph):
    bag = graph.folder / "bag"
    heard = graph.listen(String, "robot_description", TRANSIENT_LOCAL_QOS)
    graph.start("plant")
    graph.until(lambda: heard, "the robot description")
    graph.start("logger", output=str(bag), topics=["robot_description", "joint_states"])
    graph.until(lambda: int(graph.values("logger").get("messages of robot_description", 0)) == 1, "its recording")
    graph.until(lambda: int(graph.values("logger").get("messages of joint_states", 0)) > 1, "joint states")
    assert graph.stop("logger") == 0
    topics = read_topics(bag)
    assert topics[f"{graph.namespace}/robot_description"].fields["data"][0] == heard[0].data
    assert set(topics) == {f"{graph.namespace}/robot_description", f"{graph.namespace}/joint_states"}


def run_node(package: str, executable: str, *arguments: object) -> subprocess.CompletedProcess:
    command = [str(find_executable(package, executable)), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def edited_rig(folder: Path, old: str, new: str) -> Path:
    text = RIG.read_text()
    assert old in text
    path = folder / "rig.yaml"
    path.write_text(text.replace(old, new, 1))
    return path


def expect_refusal(ended: subprocess.CompletedProcess, *expected: str) -> None:
    assert ended.returncode == 2, ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == 1, ended.stderr
    for text in expected:
        assert text in lines[0]


@pytest.mark.parametrize(
    ("node", "arguments", "expected"),
    [
        ("plant", ["-p", "duratio:=1.0"], ["parameter duratio: unknown", "duration"]),
        ("plant", ["-p", "duration:=long"], ["parameter duration: 'long'", "expected a number"]),
        ("plant", ["-p", "duration:=-1.0"], ["parameter duration: -1.0", "at least 0"]),
        ("plant", ["-p", "duration:=.nan"], ["parameter duration: nan"]),
        ("plant", ["-p", "wait_for:=[x]"], ["parameter wait_for", "brace_command, ground_motion"]),
        ("plant", ["-p", "rig:=none"], ["rig 'none': unknown", "ncree_three_storey"]),
        ("plant", ["-p", "rig:=none.yaml"], ["rig file none.yaml", "no such file"]),
        ("ground_motion", ["-p", "record:=none"], ["none", "el_centro"]),
        ("ground_motion", ["-p", "record:=./none.at2"], ["none.at2"]),
        ("ground_motion", ["-p", "record:=white_noise"], ["parameter duration", "white_noise"]),
        (
            "ground_motion",
            ["-p", "record:=white_noise", "-p", "duration:=9.0", "-p", "band:=[5.0]"],
            ["parameter band"],
        ),
        (
            "ground_motion",
            ["-p", "record:=el_centro", "-p", "peak_acceleration:=30.0"],
            ["exceeds the table's limits: acceleration 30 m/s^2 at 2.178 s", "limit is 10", "displacement 0.94"],
        ),
        (
            "ground_motion",
            ["-p", "record:=white_noise", "-p", "duration:=240.0", "-p", "band:=[0.0, 10.0]"],
            ["ground motion white_noise exceeds the table's limits: displacement", "a band that begins higher"],
        ),
        ("ground_motion", ["-p", "rig:=none"], ["rig 'none': unknown", "ncree_three_storey"]),
        ("logger", [], ["parameter output: not given", "-p output:=text", "new directory"]),
        ("logger", ["-p", "output:=/proc/none/bag"], ["/proc/none"]),
        ("logger", ["-p", "output:=b", "-p", "facts:=[no_equals]"], ["parameter facts", "key=value"]),
        ("logger", ["-p", "output:=b", "-p", "facts:=[a=1, a=2]"], ["parameter facts", "each key once"]),
        ("logger", ["-p", "output:=b", "-p", "attachments:=[none.yaml]"], ["attachment none.yaml"]),
        ("logger", ["-p", "output:=b", "-p", "pattern:=("], ["pattern", "regular expression"]),
        ("logger", ["-p", "output:=b", "-p", "split_duration:=1e300"], ["split_duration", "from 0.0 to"]),
    ],
)
def test_wrong_parameters_are_refused_in_one_line(tmp_path, monkeypatch, node, arguments, expected):
    monkeypatch.chdir(tmp_path)
    expect_refusal(
        run_node("abrace_bags" if node == "logger" else "abrace_plant", node, "--ros-args", *arguments), *expected
    )
    assert not list(tmp_path.iterdir())


def test_an_argument_that_is_no_parameter_is_refused():
    expect_refusal(run_node("abrace_plant", "plant", "rig.yaml"), "argument 'rig.yaml'", "-p name:=value")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("storey_height: 3.0", "storey_hight: 3.0", "building.storey_hight"),
        ("count: 2", "count: two", "braces.0.count"),
        ("lag: 0.0008", "lag: .nan", "braces.0.actuator.lag"),
        ("damping_ratios: [0.007993134, ", "damping_ratios: [", "building.damping_ratios: 2 numbers"),
        ("11220.377, ", "-11220.377, ", "building.masses.0"),
    ],
)
def test_a_wrong_rig_file_is_refused_in_one_line(tmp_path, old, new, expected):
    path = edited_rig(tmp_path, old, new)
    expect_refusal(run_node("abrace_plant", "plant", "--ros-args", "-p", f"rig:={path}"), str(path), expected)


def test_a_malformed_record_is_refused_with_its_line(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("time [s],acceleration [g]\n0.0,0.0\n0.01,much\n")
    ended = run_node("abrace_plant", "ground_motion", "--ros-args", "-p", f"record:={path}")
    expect_refusal(ended, str(path), "3")


def test_a_bag_that_exists_is_not_written_over(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("data")
    ended = run_node("abrace_bags", "logger", "--ros-args", "-p", f"output:={tmp_path / 'bag'}")
    expect_refusal(ended, "exists already")
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["precious"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("states: 1", "states: 2", "a_d"),
        ("c_d: [1.0]", "c_d: [.nan]", "c_d"),
        ("a_d: [0.5]", "a_d: [1.5]", "not stable"),
        ("p_d: [1.0, 0.0]", "p_d: [1.0]", "p_d"),
        ("measured: [a1]", "measured: []", "measured"),
        ("sample_period: 0.002", "sample_period: -0.002", "sample_period"),
    ],
)
def test_a_wrong_controller_file_is_refused_in_one_line(tmp_path, old, new, expected):
    text = (
        '/**:\n  ros__parameters:\n    name: "c"\n    model: "m"\n    weights: "w"\n    margins: "none"\n'
        "    sample_period: 0.002\n    measured: [a1]\n    commands: [U]\n    states: 1\n    force_limit: [100.0]\n"
        "    a_d: [0.5]\n    b_d: [1.0]\n    c_d: [1.0]\n    d_d: [0.0]\n    g_d: [0.0]\n    p_d: [1.0, 0.0]\n"
    )
    assert old in text
    path = tmp_path / "controller.yaml"
    path.write_text(text.replace(old, new))
    ended = run_node("abrace_lqg", "controller", "--ros-args", "--params-file", path)
    expect_refusal(ended, expected)


def test_a_controller_without_its_file_says_what_to_give():
    expected = "parameter name: not given, expected --params-file FILE, the controller file (YAML) that `design` wrote"
    expect_refusal(run_node("abrace_lqg", "controller"), expected)


def test_the_command_names_what_there_is_to_run():
    command = [str(find_executable("abrace_plant", "plant").parents[3] / "abrace/bin/abrace")]
    for arguments, expected in ((["abrace_plant", "plan"], "plant"), (["abrace_plan", "plant"], "abrace_plant")):
        ended = subprocess.run([*command, "run", *arguments], capture_output=True, text=True, timeout=120, check=False)
        expect_refusal(ended, expected)
