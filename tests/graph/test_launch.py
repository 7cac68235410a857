# SPDX-License-Identifier: Apache-2.0
"""The launch files with the real `ros2 launch`, where there is one: exit codes, nothing left behind, whole bags."""

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from abrace.processes.launcher import is_running
from abrace_bags import read_run
from abrace_interfaces.msg import Response
from abrace_node.transport import LOCKSTEP_STREAM_QOS

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
        path = file if file.endswith(".py") else LAUNCH / f"{file}.launch.py"
        command = [shutil.which("ros2"), "launch", path, *texts]
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


def test_nodes_end_with_a_launch_that_is_killed_and_the_bag_is_whole(graph, start_launch):
    launch = start_launch("identification", drive="command")
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 10, "recorded responses")
    os.kill(launch.pid, signal.SIGKILL)
    assert launch.wait(60) == -signal.SIGKILL
    graph.until(lambda: not is_running(launch.pid), "the end of all nodes")
    assert Path("bag/metadata.yaml").is_file()


def test_interrupts_of_terminal_and_launch_together_end_a_launch_cleanly(graph, start_launch):
    launch = start_launch("identification", drive="command")
    graph.until(lambda: int(graph.values("logger").get("messages of response", 0)) > 10, "recorded responses")
    for _ in range(2):
        os.killpg(launch.pid, signal.SIGINT)
    assert launch.wait(60) == 1, output()
    assert "the test was stopped before it was done" in output()
    assert not is_running(launch.pid)
    assert "Traceback" not in output()
    assert Path("bag/metadata.yaml").is_file()


TWICE = """
from launch import EventHandler, LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription, OpaqueFunction, RegisterEventHandler
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import PushRosNamespace
from launch_ros.events.lifecycle import StateTransition


def told(context):
    print(f"{context.locals.event.action.node_name} is {context.locals.event.goal_state}", flush=True)


def included(name, duration):
    given = {"drive": "command", "duration": duration, "free_decay": "0.5", "bag": name, "parameters": "lockstep.yaml"}
    file = PythonLaunchDescriptionSource("FILE")
    return GroupAction([PushRosNamespace(name), IncludeLaunchDescription(file, launch_arguments=given.items())])


def generate_launch_description():
    tell = OpaqueFunction(function=told)
    hear = EventHandler(matcher=lambda event: isinstance(event, StateTransition), entities=[tell])
    return LaunchDescription([RegisterEventHandler(hear), included("a", "4.0"), included("b", "16.0")])
"""


def test_two_tests_in_one_launch_file_both_go_to_their_end(start_launch):
    Path("two.launch.py").write_text(TWICE.replace("FILE", str(LAUNCH / "identification.launch.py")))
    Path("lockstep.yaml").write_text(
        "/**/plant:\n  ros__parameters: {lockstep: true, wait_for: [brace_command]}\n"
        "/**/logger:\n  ros__parameters: {lockstep: true}\n"
    )
    launch = start_launch("two.launch.py")
    assert launch.wait(120) == 0, output()
    assert [len(read_run(bag).sequence) > 500 * seconds for bag, seconds in (("a", 4), ("b", 16))] == [True, True]
    for name in ("a", "b"):
        assert any(line.startswith(f"/{name}/") and "/plant is active" in line for line in output().splitlines())
