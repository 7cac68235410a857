# SPDX-License-Identifier: Apache-2.0
"""What an operator does without `ros2`: abrace status, stop, clear and set on a running rig."""

import subprocess

import pytest

pytestmark = pytest.mark.usefixtures("domain")


def abrace(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and errors of the command."""
    command = ["abrace", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return ended.returncode, ended.stdout, ended.stderr


def status(*nodes: str) -> tuple[int, str]:
    """Exit code and table of `abrace status`; again where a busy machine let it find only some of the nodes."""
    for _ in range(5):
        code, table, _ = abrace("status")
        if all(f"{node} " in table for node in nodes):
            return code, table
    raise AssertionError(f"{', '.join(nodes)} not found: {table}")


def row(table: str, node: str) -> list[str]:
    """A node's line: name, rate, losses, state."""
    (line,) = [line for line in table.splitlines() if line.startswith(f"{node} ")]
    return line.split(maxsplit=3)


def test_an_operator_sees_stops_clears_and_sets_without_ros2(graph):
    plant, logger = f"{graph.namespace}/plant", f"{graph.namespace}/logger"
    graph.start("plant")
    graph.start("logger", output=str(graph.folder / "bag"))
    graph.until_matched("logger", response=1)
    code, table = status(plant, logger)
    assert code == 0
    _, rate, _, state = row(table, plant)
    assert float(rate) == pytest.approx(500, rel=0.3)
    assert state == "running"
    assert row(table, logger)[1:] == ["-", "0", "recording"]

    code, output, errors = abrace("stop")
    assert (code, errors) == (0, "")
    # a busy machine may not have heard the name of who pressed
    assert output.startswith(f"{plant}: stop pressed by ")
    graph.until_fault("plant", "protective stop: pressed by ")
    assert any("fault: protective stop: pressed by" in line for line in graph.output_of("plant")), "on its terminal"
    code, table = status(plant)
    assert code == 1
    assert row(table, plant)[3].startswith("fault: protective stop: pressed by ")
    code, output, errors = abrace("clear", "plant")
    assert (code, errors) == (0, "")
    assert output.startswith(f"{plant}: cleared: protective stop: pressed by ")
    graph.until(lambda: graph.statuses["plant"].message == "running", "the rig to run again")
    code, output, errors = abrace("clear", plant)
    assert (code, output) == (1, "")
    assert errors.startswith(f"{plant}: ")

    assert abrace("set", "plant", "sensor_faults", "[a1=zero]") == (0, f"{plant}: sensor_faults is [a1=zero]\n", "")
    graph.until_fault("plant", "a1")
    code, _, errors = abrace("set", "plant", "sensor_faults", "[a9=zero]")
    assert code == 1
    assert errors.startswith(f"{plant}: sensor_faults: refused: sensor fault")

    code, _, errors = abrace("clear", "plan")
    assert code == 2
    assert errors == f"abrace: node plan: not found, expected {logger} or {plant}, did you mean plant?\n"


def test_what_ros_cannot_take_is_one_line(monkeypatch):
    for value in ("{a: 1}", "a: b: c"):
        code, output, errors = abrace("set", "plant", "seed", value)
        assert (code, output) == (2, "")
        assert errors == f"abrace: value {value}: expected a number, a text, true or false, or a list of them\n"
    monkeypatch.setenv("ROS_DOMAIN_ID", "nine")
    code, output, errors = abrace("status")
    assert (code, output) == (2, "")
    assert errors == "abrace: ROS_DOMAIN_ID=nine, expected 0 to 232\n"
    assert len(errors.splitlines()) == 1


def test_where_nobody_listens_a_stop_says_so_and_the_domain_is_asked_for():
    code, output, errors = abrace("stop")
    assert (code, output) == (1, "")
    assert errors == "no rig has reported that it stops; press the stop button of the hardware\n"
    code, output, _ = abrace("status")
    assert (code, output) == (0, "no node reports; is ROS_DOMAIN_ID that of the rig?\n")
