# SPDX-License-Identifier: Apache-2.0
"""The launch files with the real `ros2 launch`, where there is one: exit codes, nothing left behind, whole bags."""

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from abrace.processes.orphan_guard import is_running
from abrace_bags import read_run
from abrace_core.node.conventions import LOCKSTEP_STREAM_QOS
from abrace_interfaces.msg import Response

LAUNCH = Path(__file__).parents[2] / "src/abrace_bringup/launch"

pytestmark = [
    pytest.mark.usefixtures("domain"),
    pytest.mark.skipif(not shutil.which("ros2"), reason="no ros2 launch: only where ROS 2 itself is installed"),
]


@pytest.fixture
def start_launch(graph, tmp_path, monkeypatch):
    """Starts `ros2 launch` with these arguments, in a process group of its own; kills what is left at the end."""
    monkeypatch.chdir(tmp_path)
    started = []

    def start(file: str, **arguments: object) -> subprocess.Popen:
        texts = [f"{name}:={value}" for name, value in arguments.items()]
        command = [shutil.which("ros2"), "launch", LAUNCH / f"{file}.launch.py", *texts]
        command += [f"namespace:={graph.namespace}", "bag:=bag"]
        # the output goes to a file: orphans would hold a pipe
        with (tmp_path / "log").open("wb") as log:
            started.append(subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True))
        return started[-1]

    yield start
    for process in started:
        if is_running(process.pid):
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def output() -> str:
    return Path("log").read_text()


def test_a_test_is_recorded_from_sample_0_to_its_end_whoever_listens(graph, start_launch):
    graph.listen(Response, "response", LOCKSTEP_STREAM_QOS)
    Path("lockstep.yaml").write_text(
        "/**/plant:\n  ros__parameters: {lockstep: true, wait_for: [brace_command, ground_motion]}\n"
        "/**/logger:\n  ros__parameters: {lockstep: true}\n"
        "/**/ground_motion:\n  ros__parameters: {period: 1.0, band: [2.0, 10.0]}\n"
        "/**/excitation:\n  ros__parameters: {period: 1.0, band: [2.0, 30.0]}\n"
    )
    launch = start_launch("identification", drive="both", duration=4.0, free_decay=0.5, parameters="lockstep.yaml")
    assert launch.wait(120) == 0, output()
    assert not is_running(launch.pid)
    run = read_run("bag")
    assert run.sequence[0] == 0
    assert len(run.sequence) == run.sequence[-1] + 1 > 4.0 * 500


def test_wrong_arguments_are_named_and_nothing_is_started(start_launch):
    launch = start_launch("identification", drive="both", duration="30s", recrod="x", free_decay=-1)
    assert launch.wait(60) == 1
    for mistake in ("recrod: unknown", "duration:=30s, expected", "free_decay:=-1, expected"):
        assert mistake in output()
    assert "Traceback" not in output()
    assert "process started" not in output()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, -signal.SIGTERM), (signal.SIGKILL, -signal.SIGKILL)])
def test_nodes_end_with_a_launch_that_is_killed_and_the_bag_is_whole(graph, start_launch, number, code):
    launch = start_launch("identification", drive="command")
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 10, "recorded responses")
    os.kill(launch.pid, number)
    assert launch.wait(60) == code
    graph.until(lambda: not is_running(launch.pid), "the end of all nodes")
    assert Path("bag/metadata.yaml").is_file()


def test_a_missing_rig_is_named(start_launch):
    launch = start_launch("identification", drive="command", plant="false", patience=8.0)
    assert launch.wait(60) == 1
    assert "excitation has 0 of 1 publishers of response" in output()
    assert not is_running(launch.pid)


def test_a_node_that_refuses_ends_the_launch(start_launch):
    Path("wrong.yaml").write_text("/**/logger:\n  ros__parameters: {split_size: -1}\n")
    launch = start_launch("identification", drive="command", parameters="wrong.yaml")
    assert launch.wait(60) == 1
    assert "logger: parameter split_size" in output()
    assert "logger has ended with exit code 2" in output()
    assert not is_running(launch.pid)


def test_interrupts_of_terminal_and_launch_together_end_a_launch_cleanly(graph, start_launch):
    launch = start_launch("identification", drive="command")
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 10, "recorded responses")
    for _ in range(2):
        os.killpg(launch.pid, signal.SIGINT)
    assert launch.wait(60) == 0, output()
    assert not is_running(launch.pid)
    assert "Traceback" not in output()
    assert Path("bag/metadata.yaml").is_file()
