# SPDX-License-Identifier: Apache-2.0
"""The live display of a campaign: what stands on the terminal."""

import io

import pytest
from rich.console import Console

from abrace.campaign.display import Display, Graph, peaks_of
from abrace.report.node_table import NodeReport

VALUES = {"state": "running", "peak displacement": "0.0123", "peak force": "12000", "peak drift": "0.004"}
VALUES |= {"peak acceleration": "12.34", "peak table_displacement": "0.1234"}


def report(message: str, heard: float, *, failed: bool = False, lost: int | None = None) -> NodeReport:
    return NodeReport(message, failed, heard, 500.0, lost, 10, "", 1)


@pytest.fixture
def terminal():
    now = [100.0]
    console = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None)
    display = Display("day", [30.0, 60.0, 40.0], console, clock=lambda: now[0])

    def drawn() -> str:
        with console.capture() as captured:
            console.print(display.drawing())
        return captured.get()

    return display, now, drawn, console.file


def test_the_display_has_the_step_time_left_peaks_force_and_every_node(terminal):
    display, now, drawn, _ = terminal
    display.kept("noise")
    with display.step("shaken") as step:
        assert drawn().count("left") == 1, "of this step nobody knows yet"
        step.update(0.1, "1.0 x real time")
        now[0] += 20.0
        step.update(0.3, "1.0 x real time")
        nodes = {
            "plant": report("running", now[0]),
            "controller": report("fault: no response", now[0], failed=True),
            "logger": report("recording", now[0] - 5.0, lost=3),
        }
        display.see(Graph(nodes, peaks_of(VALUES), 24500.0))
        text = drawn()
    for expected in (
        "[2/3] shaken",
        "30%",
        "0:20, 1:10 left, 1.0 x real time",
        "peaks: drift 0.4, displacement 1.23, table 12.3 cm, acceleration 12.3 m/s²\n",
        "force: 12 of 24.5 kN, 49% of capacity",
        "all steps: about 1:50 left",
    ):
        assert expected in text, text
    assert len(text.splitlines()) == 8, "each line fits into 80 columns"
    lines = {line.split()[0]: line for line in text.splitlines()}
    assert lines["plant"].split() == ["plant", "500", "-", "running"]
    assert "fault: no response" in lines["controller"]
    assert lines["logger"].split(maxsplit=3)[2:] == ["3", "stale for 5 s; was: recording"]


def test_what_has_ended_stands_above_the_display_as_plain_lines(terminal):
    display, now, drawn, written = terminal
    with display:
        display.kept("noise")
        with display.step("shaken") as step:
            step.update(1.0, "6.3 x real time")
            now[0] += 83.0
        with pytest.raises(KeyboardInterrupt), display.step("model"):
            raise KeyboardInterrupt
    assert "[1/3] noise: complete, kept" in written.getvalue()
    assert "[2/3] shaken: done in 1:23, 6.3 x real time" in written.getvalue()
    assert "[3/3] model: stopped after 0:00" in written.getvalue()
    assert drawn() == "day\n"


def test_peaks_that_are_no_numbers_are_left_out():
    assert peaks_of({"peak force": "12", "peak drift": "x" * 5000, "peak acceleration": ""}) == {"force": 12.0}
