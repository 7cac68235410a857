# SPDX-License-Identifier: Apache-2.0
"""What an operator does without `ros2`: abrace status, stop, clear and set on a running rig."""

import re

import pytest
from forked import run_forked

pytestmark = pytest.mark.usefixtures("domain")


def abrace(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and errors of the command."""
    ended = run_forked(["abrace", *arguments])
    return ended.returncode, ended.stdout, ended.stderr


def until_shown(graph, *rows: tuple[str, ...]) -> int:
    """Wait until `abrace status` shows these rows: a node, patterns of its rate, losses and state; the exit code.

    A busy machine lets it find only some of the nodes in its time, or hear one of them only once.
    """

    def shown() -> tuple[int, str] | None:
        code, table, _ = abrace("status")
        seen.append(table)
        return (
            (code, table) if all(re.search("^" + " +".join(row) + "$", table, re.MULTILINE) for row in rows) else None
        )

    seen: list[str] = []
    try:
        return graph.until(shown, "the table")[0]
    except AssertionError as error:
        raise AssertionError(f"{rows}, last seen:\n{seen[-1]}") from error


def test_an_operator_sees_stops_clears_and_sets_without_ros2(graph):
    plant, logger = f"{graph.namespace}/plant", f"{graph.namespace}/logger"
    graph.start("plant")
    graph.start("logger", output=str(graph.folder / "bag"))
    graph.until_matched("logger", response=1)
    assert until_shown(graph, (plant, "[4-6]..", "[0-9]+", "running"), (logger, "-", "0", "recording")) == 0
    code, output, errors = abrace("stop")
    assert (code, errors) == (0, "")
    # a busy machine may not have heard the name of who pressed
    assert output.startswith(f"{plant}: stop pressed by ")
    graph.until_fault("plant", "protective stop: pressed by ")
    assert any("fault: protective stop: pressed by" in line for line in graph.output_of("plant")), "on its terminal"
    assert until_shown(graph, (plant, ".*", "fault: protective stop: pressed by .*")) == 1
    code, output, errors = abrace("clear", "plant")
    assert (code, errors) == (0, "")
    assert output.startswith(f"{plant}: cleared: protective stop: pressed by ")
    graph.until(lambda: graph.statuses["plant"].message == "running", "the rig to run again")
    assert abrace("deactivate", "plant") == (0, f"{plant}: disarmed\n", "")
    assert abrace("deactivate", "plant") == (0, f"{plant}: not armed\n", "")
    assert abrace("activate", plant) == (0, f"{plant}: armed\n", "")
    graph.until(lambda: graph.statuses["plant"].message == "running", "the rig to run once more")
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


def test_what_ros_cannot_take_is_one_line():
    for value in ("{a: 1}", "a: b: c"):
        code, output, errors = abrace("set", "plant", "seed", value)
        assert (code, output) == (2, "")
        assert errors == f"abrace: value {value}: expected a number, a text, true or false, or a list of them\n"


def test_where_nobody_listens_a_stop_says_so_and_the_domain_is_asked_for():
    code, output, errors = abrace("stop")
    assert (code, output) == (1, "")
    assert errors == "no rig has reported that it stops; press the stop button of the hardware\n"
    code, output, _ = abrace("status")
    assert (code, output) == (0, "no node reports; is ROS_DOMAIN_ID that of the rig?\n")
