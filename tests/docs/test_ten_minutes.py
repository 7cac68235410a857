# SPDX-License-Identifier: Apache-2.0
"""The README's Python is run, and the ten minutes are followed, with real nodes in lockstep.

Two simulated tests of a minute take the place of `abrace demo`, which takes 90 s (`make verify PARTS=docs` runs it).
"""

import os
import re
import shlex
import subprocess
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from bag_of_run import write_bag
from documents import ROOT, blocks
from tutorials import lines, second_terminal

import abrace
from abrace_bags import read_run

RIG = "ncree_three_storey"
PAGE = "ten_minutes"
DEMO, CLOSED_LOOP = "abrace demo", "abrace run abrace_bringup closed_loop "
REAL_TIME = "duration:=20.0"
"""What the page gives its closed loops, which take 20 s and more in real time."""
LOCKSTEP = "/**/plant: {ros__parameters: {lockstep: true, wait_for: [brace_command, ground_motion]}}\n"
PLAYED, BRIEFLY = "--duration 6", "--duration 1"
"""What the page draws of its bags in motion, and how much is drawn here."""
QUICK = "duration:=2.0 free_decay:=0.5 parameters:=lockstep.yaml"
LONG = "duration:=900.0 free_decay:=8.0 parameters:=lockstep.yaml"
"""To be stopped; the fault can be cleared during the free decay."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with bags of the two white-noise tests."""
    folder = tmp_path_factory.mktemp("laboratory")
    write_bag(abrace.simulate(RIG, "white_noise", duration=64.0), folder / "bags/table_noise")
    write_bag(abrace.simulate(RIG, command="white_noise", duration=64.0), folder / "bags/command_noise")
    (folder / "lockstep.yaml").write_text(LOCKSTEP)
    return folder


@pytest.fixture(scope="module")
def readme(folder):
    """The names that the README's Python leaves, run in the folder."""
    (program,) = [block.text for block in blocks(ROOT / "README.md") if block.language == "python"]
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(program, "README.md", "exec"), names)
    return names


@pytest.fixture(scope="module")
def demo(folder, readme) -> Path:
    """The folder with those results of the demo that the page uses: model, controller, the last test's bag."""
    readme["found"].save(folder / "results/demo/model")
    (folder / "results/demo/lqg3").mkdir()
    readme["designed"].save(folder / "results/demo/lqg3/lqg3.yaml")
    quake = abrace.simulate(RIG, "el_centro", controller=readme["designed"], peak_acceleration=0.98, duration=12.0)
    write_bag(quake, folder / "bags/demo/day/controlled")
    return folder


def shell(command: str, folder: Path) -> str:
    """What a command prints; it has to end with 0."""
    ended = subprocess.run(["bash", "-ec", command], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, f"{command}\n{ended.stdout}{ended.stderr}"
    return ended.stdout


def test_the_python_of_the_readme_runs_and_its_controller_halves_the_response(readme):
    motion = {"record": "el_centro", "peak_acceleration": 0.98, "duration": 12.0}
    free, controlled = (abrace.simulate(RIG, **motion, controller=law) for law in (None, readme["designed"]))
    assert controlled.to_pandas()["x3"].std() < 0.5 * free.to_pandas()["x3"].std()


def test_the_lines_of_the_page_are_those_followed_here():
    given = lines(PAGE)
    assert given[0] == DEMO
    assert [re.split(r"[ =]", line)[:3] for line in given[1:5]] == [
        ["bag", "$(ls", "-d"], ["abrace", "bag", "info"], ["abrace", "bag", "plot"], ["abrace", "bag", "animate"]
    ]  # fmt: skip
    assert [line.startswith(CLOSED_LOOP) and REAL_TIME in line for line in given[5:]] == [True, False, True, False]
    assert [line.split()[1] for line in second_terminal(PAGE)] == ["status", "stop", "clear"]


def test_a_bag_is_described_drawn_and_shown_in_motion(demo):
    name, info, plot, animate = lines(PAGE)[1:5]
    assert PLAYED in animate
    printed = shell("\n".join([name, info, plot, animate.replace(PLAYED, BRIEFLY)]), demo)
    assert f"rig: {RIG}" in printed
    for file in ("first.png", "first.gif"):
        assert (demo / file).stat().st_size > 10_000, file


@pytest.mark.usefixtures("domain")
def test_the_loop_is_closed_stopped_and_cleared_from_a_second_terminal(demo):
    first, design, second, compared = lines(PAGE)[5:]
    shell(first.replace(REAL_TIME, QUICK), demo)
    run = read_run(demo / "bags/first")
    assert len(run.sequence) >= 2.5 * 500
    assert np.abs(run.command).max() > 100.0, "the controller commands the braces"
    assert "disk margin" in shell(design, demo)
    arguments = shlex.split(second.replace(REAL_TIME, LONG))
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
        status, stop, clear = second_terminal(PAGE)
        nodes = [f"/rig/{node} " for node in ("controller", "ground_motion", "logger", "plant")]
        tables = (shell(status, demo) for _ in range(5))  # a busy machine may find only some of the nodes
        assert any(all(node in table for node in nodes) for table in tables)
        assert shell(stop, demo).startswith("/rig/plant: stop pressed by ")
        assert shell(clear, demo).startswith("/rig/plant: cleared: protective stop: pressed by ")
        printed, _ = loop.communicate(timeout=120)
        assert loop.returncode == 1, "the first terminal's command ends with code 1"
    assert "protective stop: pressed by " in printed, "and its last lines say by whom"
    assert "the test is incomplete" in printed
    assert PLAYED in compared
    shell(compared.replace(PLAYED, BRIEFLY), demo)
    assert (demo / "both.gif").stat().st_size > 10_000
