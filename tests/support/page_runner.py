# SPDX-License-Identifier: Apache-2.0
"""Runs a page of the documentation: its blocks in their order, in one folder, from what the page itself has made.

Files are written, Python is run in one program a page, commands in a shell. A ```text block is what the lines before it
print: each of its lines has to be there, `...` stands for anything.
"""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import traceback
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bag_of_run import write_bag
from documents import GENERATED, HEADS, Block, blocks
from laboratory import paper_tests

import abrace
from abrace.processes.group import find_executable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from multiprocessing.connection import Connection
    from pathlib import Path

RIG = "ncree_three_storey"
DAY = "bags/demo/20260101-120000"
"""The demo's bags in tests; `abrace demo` names the folder for the time."""
RUN = (*HEADS, "bag=", "day=")
"""First words of lines that are given to the shell."""
NOT_HERE = {
    r"source |make |sudo |pip |export |git |cd |autoload |openssl |groupadd |printf |echo ": "prepares the computer",
    r"ros2 |python -m colcon|rviz2 ": "needs ROS 2's own tools, which the wheels do not have",
    r".*(my_device\.yaml|=my_daq\.yaml)": "needs hardware",
    r"abrace run \w+ (operator|viewer|plant|\w+_bridge|emulator|logger|excitation|ground_motion|replay|controller)\b":
        "runs until it is stopped: tests/graph",
    r"abrace (status|stop|clear|play|set|activate) ": "needs a rig that runs: tests/graph, test_first_hour",
    r"abrace (status|stop)$": "needs a rig that runs: tests/graph, test_first_hour",
    r"abrace run abrace_bringup (closed_loop|identification) ": "real time: test_first_hour, tests/graph",
    r"abrace campaign (five_controllers|demo_bridge|five_storeys)": "takes minutes: make verify",
    r"python benchmarks/": "a benchmark of the repository",
    r"abrace demo": "takes minutes: `make verify PARTS=docs`; tests make its results from simulated tests",
}  # fmt: skip
"""Lines that are not run, by the reason."""
PLACEHOLDER = re.compile(r"\b(BAG|FILE|STEP|NODE|TIME|NAME|DIRECTORY|OUT|PACKAGE)\b")
"""A line with a word that the reader replaces is not run either."""
SKIP: dict[str, dict[str, str]] = {
    "CONTRIBUTING": {"python -m pytest ": "a test; test_architecture looks whether it is there"},
    "bags": {"abrace report results/demo": "needs the whole demo: make verify PARTS=docs"},
    "measured_data": {"abrace run abrace_sysid ambient": "the reader's data"},
    "test_day": {"abrace campaign my_day": "the reader's test day"},
    "your_own": {"abrace campaign examples/": "test_docs checks them"},
    "first_hour": {"abrace bag plot bags/second": "bags of real time: test_first_hour"},
}
"""Of a page: patterns of further lines that are not run, and why."""
PATIENCE = 600.0
"""Seconds after which a command that does not end is killed, and its page wrong."""
FORKS = multiprocessing.get_context("forkserver")
"""Processes that have imported what pages need: an import takes as long as most of what is run."""
OFFLINE = ("abrace_plant.nodes.record", "abrace_sysid.nodes.identify", "abrace_lqg.nodes.design")
FORKS.set_forkserver_preload(["page_runner", "matplotlib.pyplot", "pandas", "control", "abrace.cli", *OFFLINE])


@dataclass
class Followed:
    """What was run of a page, what was not and why, and what does not print what the page shows."""

    executed: int = 0
    skipped: dict[str, str] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


def is_followed(page: Path) -> bool:
    """Whether something on a page could be run."""
    some = any(block.language == "python" or block.name or lines(block) for block in blocks(page))
    return some and page.stem not in GENERATED


def make_demo(folder: Path) -> None:
    """The results of `abrace demo` that pages use, from simulated tests of a minute."""
    bags = [folder / DAY / name for name in ("table_noise", "command_noise")]
    for run, bag in zip(paper_tests(60.0, 2), bags, strict=True):
        write_bag(run, bag)
    found = abrace.identify(*bags)
    found.save(folder / "results/demo/model")
    designed = abrace.design(found, "lqg3")
    (folder / "results/demo/lqg3").mkdir()
    designed.save(folder / "results/demo/lqg3/lqg3.yaml")
    for name, law in (("uncontrolled", None), ("controlled", designed)):
        run = abrace.simulate(RIG, "el_centro", peak_acceleration=0.98, duration=12.0, controller=law)
        write_bag(run, folder / DAY / name)


def reason(line: str, skip: dict[str, str]) -> str:
    """Why a line is not run; empty: it is."""
    found = (why for pattern, why in {**skip, **NOT_HERE}.items() if re.match(pattern, line))
    return next(found, "a word that the reader replaces" if PLACEHOLDER.search(line) else "")


def lines(block: Block) -> list[str]:
    """The lines of a block that are given to a shell, continued ones joined, without comments."""
    joined = re.sub(r"\\\n\s*", "", block.text)
    cut = (re.split(r"\s+#\s", line)[0].strip() for line in joined.splitlines())
    return [line for line in cut if line.startswith(RUN) and (line.split()[0] in HEADS or "=" in line.split()[0])]


def follow(page: Path, folder: Path, skip: dict[str, str] | None = None) -> Followed:
    """Run the blocks of a `page` in a `folder`; `skip`: patterns of further lines that are not run, and why."""
    ours, theirs = FORKS.Pipe()
    interpreter = FORKS.Process(target=_interpret, args=(theirs, folder, dict(os.environ)))
    interpreter.start()
    theirs.close()
    with ours:
        followed = _follow(page, folder, skip or {}, ours)
    interpreter.join()
    return followed


def _follow(page: Path, folder: Path, skip: dict[str, str], interpreter: Connection) -> Followed:
    followed, printed, variables = Followed(), "", []
    for block in blocks(page):
        if block.name:
            (folder / block.name).write_text(block.text, encoding="utf-8")
            followed.executed += 1
        elif block.language == "python":
            if why := next((why for pattern, why in skip.items() if re.match(pattern, block.text)), ""):
                followed.skipped[block.text.splitlines()[0]] = why
                continue
            interpreter.send(block.text)
            right, shown = interpreter.recv()
            assert right, f"{block.text}\n{shown}"
            printed += shown
            followed.executed += 1
        elif block.language in ("", "bash"):
            for line in lines(block):
                if why := reason(line, skip):
                    followed.skipped[line] = why
                elif line.startswith(("bag=", "day=")):
                    variables.append(line)
                else:
                    printed += run_line(line, folder, variables)
                    followed.executed += 1
        elif block.language == "text" and printed:
            followed.wrong += [line for line in block.text.splitlines() if not _shown(line, printed)]
            printed = ""
    return followed


def _shown(line: str, printed: str) -> bool:
    """Whether a line is printed, up to spaces and what `...` stands for."""
    words = [re.escape(" ".join(part.split())) for part in line.split("...")]
    return not line.strip() or re.search(".*".join(words), " ".join(printed.split())) is not None


def _enter(folder: Path, variables: dict[str, str]) -> None:
    """Make a process that was forked one that was started in a `folder` with these environment variables."""
    os.environ.clear()
    os.environ.update(variables)
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    warnings.simplefilter("ignore")


def _interpret(pipe: Connection, folder: Path, variables: dict[str, str]) -> None:
    """Run each text that comes, with the names that those before it left; answer whether it ended, and its output."""
    _enter(folder, variables)
    names = {"__name__": "page"}
    with contextlib.suppress(EOFError):
        while True:
            text, output = pipe.recv(), io.StringIO()
            try:
                with contextlib.redirect_stdout(output):
                    exec(compile(text, "page", "exec"), names)
                pipe.send((True, output.getvalue()))
            except BaseException:  # the page's, shown by the test
                pipe.send((False, output.getvalue() + traceback.format_exc()))


def run_line(line: str, folder: Path, variables: Sequence[str] = ()) -> str:
    """What a line prints, after these lines that set variables; it has to end with 0."""
    script = "\n".join([*variables, line if not line.startswith("abrace ") else f"printf '%s\\0' {line}"])
    ended = subprocess.run(["bash", "-ec", script], cwd=folder, capture_output=True, text=True, check=False)
    if ended.returncode == 0 and line.startswith("abrace "):
        ended = _fork(ended.stdout.split("\0")[:-1], folder)
    assert ended.returncode == 0, f"{line}\n{ended.stdout}{ended.stderr}"
    return ended.stdout


def _fork(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command of abrace to its end; what it prints and its errors are one text."""
    program = shutil.which(words[0]) or ""
    if words[1] == "run":
        program, words = str(find_executable(*words[2:4])), words[3:]
    with tempfile.NamedTemporaryFile("r") as output:
        process = FORKS.Process(target=_command, args=([program, *words[1:]], folder, dict(os.environ), output.name))
        process.start()
        process.join(PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()
        return subprocess.CompletedProcess(words, process.exitcode or 0, output.read(), "")


def _command(words: list[str], folder: Path, variables: dict[str, str], output: str) -> None:
    """Run the Python script words[0] as if it had been started by these words."""
    _enter(folder, variables)
    file = os.open(output, os.O_WRONLY)
    os.dup2(file, 1)
    os.dup2(file, 2)
    sys.stdout, sys.stderr = open(1, "w", encoding="utf-8", buffering=1), open(2, "w", encoding="utf-8", buffering=1)  # noqa: SIM115
    sys.argv = words
    runpy.run_path(words[0], run_name="__main__")


def copied(demo: Path, folder: Path) -> Path:
    """A folder of its own with the demo's results."""
    return shutil.copytree(demo, folder)
