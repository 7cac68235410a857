# SPDX-License-Identifier: Apache-2.0
"""What needs two terminals in the first hour: the loop is run, stopped and cleared, with real nodes in lockstep."""

import os
import re
import shlex
import subprocess
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from documents import ROOT, blocks
from page_runner import copied, lines, not_printed, run_line

from abrace_bags import read_run

PAGE = ROOT / "docs/first_hour.md"
REAL_TIME = "duration:=20.0"
"""What the page gives its closed loops, which take 20 s and more in real time."""
LOCKSTEP = "/**/plant: {ros__parameters: {lockstep: true, wait_for: [brace_command, ground_motion]}}\n"
LONG = "duration:=900.0 free_decay:=12.0 parameters:=lockstep.yaml"
"""To be stopped; the fault can be cleared during the free decay."""


def shown_in_sentences(command: str) -> str:
    """What the page says in a sentence that `abrace COMMAND` prints."""
    found = re.search(rf"`abrace {command}`[^`]* prints `([^`]+)`", PAGE.read_text(encoding="utf-8"))
    assert found, command
    return found[1]


@pytest.fixture
def demo(made_demo: Path, tmp_path: Path) -> Path:
    folder = copied(made_demo, tmp_path / "laboratory")
    (folder / "lockstep.yaml").write_text(LOCKSTEP)
    return folder


@pytest.mark.usefixtures("domain")
def test_the_loop_is_closed_stopped_and_cleared_from_a_second_terminal(demo: Path) -> None:
    given = [line for block in blocks(PAGE) for line in lines(block)]
    first, second = (line for line in given if line.startswith("abrace run abrace_bringup closed_loop"))
    second = second.replace("lqg1.yaml", "demo/lqg3/lqg3.yaml")  # test_pages designs the other one
    assert first == second.replace("second", "first"), "one of them is run; to its own end: tests/graph"
    status, stop, clear = (line for line in given if re.match("abrace (status|stop|clear)", line))
    compared = given[-1]
    arguments = shlex.split(second.replace(REAL_TIME, LONG))
    (after_stop,) = (block.text for block in blocks(PAGE) if block.text.startswith("node "))
    after_stop = re.sub(r"\b500\b", "...", after_stop)  # in lockstep as many as the computer makes
    with ExitStack() as stack:
        loop = subprocess.Popen(
            arguments, cwd=demo, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        stack.enter_context(loop)
        stack.callback(loop.terminate)
        until_active = []
        for line in loop.stdout:
            until_active.append(line)
            if "activated" in line:
                break
        else:
            raise AssertionError("".join(until_active))
        nodes = [f"/rig/{node} " for node in ("controller", "ground_motion", "logger", "plant")]
        tables = (run_line(status, demo) for _ in range(5))  # a busy machine may find only some of the nodes
        assert any(all(node in table for node in nodes) for table in tables)
        assert not not_printed(shown_in_sentences("stop"), run_line(stop, demo))
        tables = (run_line(status, demo, code=1) for _ in range(5))
        assert any(not not_printed(after_stop, table) for table in tables), after_stop
        assert not not_printed(shown_in_sentences("clear plant"), run_line(clear, demo))
        printed, _ = loop.communicate(timeout=120)
        assert loop.returncode == 1, "the first terminal's command ends with code 1"
    assert "protective stop: pressed by " in printed, "and its last lines say by whom"
    assert "the test is incomplete" in printed
    assert np.abs(read_run(demo / "bags/second").command).max() > 100.0, "the controller commands the braces"
    run_line(compared, demo)
    assert (demo / shlex.split(compared)[-1]).stat().st_size > 10_000


@pytest.mark.usefixtures("domain")
def test_the_viewer_says_where_it_listens() -> None:
    page = blocks(ROOT / "docs/operator.md")
    shown = next(number for number, block in enumerate(page) if block.text.startswith("viewer: "))
    (command,) = lines(page[shown - 1])
    with subprocess.Popen(
        [*shlex.split(command), "--ros-args", "-p", "port:=0"], stdout=subprocess.PIPE, text=True
    ) as viewer:
        printed = viewer.stdout.readline()
        viewer.terminate()
    text, replaced = re.subn(r":8765$", ":...", page[shown].text.strip())
    assert replaced, "its usual port, which may be taken here"
    assert not not_printed(text, printed)
