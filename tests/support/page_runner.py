# SPDX-License-Identifier: Apache-2.0
"""Runs a page of the documentation: its blocks in their order, in one folder, from what the page itself has made.

Files are written, Python is run in one program a page, commands in a shell. What a page shows of their output is
compared:

- a ```text block, with all that the blocks between it and the ```text block before it print: its lines have to be there
  in their order, each number with all its digits; `...` stands for anything;
- a comment behind an expression or a print that begins as a value does (`run.period  # 0.002 s`), with that line alone,
  a number to the digits that are shown.

A ```text block with nothing printed before it is wrong, unless `ELSEWHERE` says what compares it.
"""

from __future__ import annotations

import ast
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
import tokenize
import traceback
import warnings
from dataclasses import dataclass, field
from decimal import Decimal
from typing import TYPE_CHECKING

from bag_of_run import write_bag
from documents import GENERATED, HEADS, Block, blocks
from laboratory import paper_tests

import abrace
from abrace.processes.group import find_executable

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
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
    "measured_data": {"abrace run abrace_sysid ambient .*:=bags/": "the reader's data"},
    "test_day": {"abrace campaign my_day": "the reader's test day"},
    "your_own": {"abrace campaign examples/": "test_docs checks them"},
    "first_hour": {"abrace bag plot bags/second": "bags of real time: test_first_hour"},
}
"""Of a page: patterns of further lines that are not run, and why."""
FAILS = {r"abrace campaign day\.yaml --check": 2, r"abrace run abrace_plant ground_motion .*:=30\.0$": 2}
"""Exit codes, other than 0, of lines that are refused."""
DEMO = "the whole demo: make verify PARTS=docs"
ELSEWHERE: dict[str, dict[str, str]] = {
    "README": {"Without and with lqg3": DEMO},
    "first_hour": {"Peaks of the top floor": DEMO, "node ": "needs a rig that runs: test_first_hour"},
    "operator": {"viewer: ": "runs until it is stopped: test_first_hour"},
}
"""Of a page: patterns of ```text blocks that show what lines print that are not run here, and what compares them."""
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?\b")
VALUE = re.compile(rf"# ({NUMBER.pattern}|[\[(<{{'\"]|(?:True|False|None)\b)")
"""How a comment begins that states a value."""
PATIENCE = 600.0
"""Seconds after which a command that does not end is killed, and its page wrong."""
FORKS = multiprocessing.get_context("forkserver")
"""Processes that have imported what pages need: an import takes as long as most of what is run."""
OFFLINE = ("abrace_plant.nodes.record", "abrace_sysid.nodes.identify", "abrace_lqg.nodes.design")
FORKS.set_forkserver_preload(["page_runner", "matplotlib.pyplot", "pandas", "control", "abrace.cli", *OFFLINE])


@dataclass
class Followed:
    """What was run of a page, what was not and why; how much of its output was compared, and what is not printed."""

    executed: int = 0
    skipped: dict[str, str] = field(default_factory=dict)
    compared: int = 0
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
    if any(re.match(pattern, line) for pattern in FAILS):
        return ""
    found = (why for pattern, why in {**skip, **NOT_HERE}.items() if re.match(pattern, line))
    return next(found, "a word that the reader replaces" if PLACEHOLDER.search(line) else "")


def lines(block: Block) -> list[str]:
    """The lines of a block that are given to a shell, continued ones joined, without comments."""
    joined = re.sub(r"\\\n\s*", "", block.text)
    cut = (re.split(r"\s+#\s", line)[0].strip() for line in joined.splitlines())
    return [line for line in cut if line.startswith(RUN) and (line.split()[0] in HEADS or "=" in line.split()[0])]


def follow(
    page: Path, folder: Path, skip: dict[str, str] | None = None, printed: Mapping[str, str] | None = None
) -> Followed:
    """Run the blocks of a `page` in a `folder`.

    `skip`: patterns of further lines that are not run, and why. `printed`: what lines that begin so have printed, which
    were run before.
    """
    ours, theirs = FORKS.Pipe()
    interpreter = FORKS.Process(target=_interpret, args=(theirs, folder, dict(os.environ)))
    interpreter.start()
    theirs.close()
    with ours:
        followed = _follow(page, folder, skip or {}, printed or {}, ours)
    interpreter.join()
    return followed


def _follow(
    page: Path, folder: Path, skip: dict[str, str], known: Mapping[str, str], interpreter: Connection
) -> Followed:
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
            right, statements = interpreter.recv()
            assert right, "\n".join([block.text, *(shown for shown, _ in statements)])
            printed += "".join(shown for shown, _ in statements)
            stated = [(shown, comment) for shown, comment in statements if comment]
            followed.compared += len(stated)
            followed.wrong += [comment for shown, comment in stated if not is_value(comment, shown)]
            followed.executed += 1
        elif block.language in ("", "bash"):
            for line in lines(block):
                if before := [text for words, text in known.items() if line.startswith(words)]:
                    printed += before[0]
                elif why := reason(line, skip):
                    followed.skipped[line] = why
                elif line.startswith(("bag=", "day=")):
                    variables.append(line)
                else:
                    code = next((code for pattern, code in FAILS.items() if re.match(pattern, line)), 0)
                    printed += run_line(line, folder, variables, code)
                    followed.executed += 1
        elif block.language == "text":
            if printed or not any(re.match(pattern, block.text) for pattern in ELSEWHERE.get(page.stem, {})):
                followed.compared += 1
                followed.wrong += not_printed(block.text, printed)
            printed = ""
    return followed


def not_printed(shown: str, printed: str) -> list[str]:
    """The `shown` lines that are not `printed`, in their order, up to spaces; `...` is anything within a line."""
    begin, wrong = 0, []
    for line in shown.splitlines():
        pattern = r"\s*.*?\s*".join(map(_whole, f" {line} ".split("...")))
        if found := re.compile(pattern).search(printed, begin):
            begin = found.end()
        else:
            wrong.append(line)
    return wrong


def _whole(part: str) -> str:
    """A pattern for a part of a line: its first and last word or number are the whole of one that is printed."""
    words = r"\s+".join(map(re.escape, part.split()))
    return (
        (r"(?<![\w.-])" if re.match(r"\s+\w", part) else "")
        + words
        + (r"(?!\.?\w)" if re.search(r"\w\s+$", part) else "")
    )


def is_value(comment: str, printed: str) -> bool:
    """Whether a `comment` states what is `printed`; of a number the digits that it has, and a unit may follow."""
    number = NUMBER.match(comment)
    if number and NUMBER.fullmatch(printed.strip()):
        shown = Decimal(number[0])
        return Decimal(printed.strip()).quantize(shown) == shown
    return bool(printed) and not not_printed(comment, printed)


def _enter(folder: Path, variables: dict[str, str]) -> None:
    """Make a process that was forked one that was started in a `folder` with these environment variables."""
    os.environ.clear()
    os.environ.update(variables)
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    warnings.simplefilter("ignore")


def _interpret(pipe: Connection, folder: Path, variables: dict[str, str]) -> None:
    """Run each text that comes, with the names that those before it left.

    The answer is whether it ended, and what each statement prints, with the value that a comment behind it states.
    """
    _enter(folder, variables)
    names: dict[str, object] = {"__name__": "page"}
    with contextlib.suppress(EOFError):
        while True:
            text = pipe.recv()
            statements: list[tuple[str, str]] = []
            try:
                statements += _statements(text, names)
                pipe.send((True, statements))
            except BaseException:  # the page's, shown by the test
                pipe.send((False, [*statements, (traceback.format_exc(), "")]))


def _statements(text: str, names: dict[str, object]) -> Iterator[tuple[str, str]]:
    """Run the statements of a text; what each prints, or is where its value is stated, and the stated value."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    stated = {each.start[0]: each.string[2:] for each in tokens if VALUE.match(each.string)}
    for statement in ast.parse(text).body:
        comment = stated.get(statement.end_lineno or 0, "") if isinstance(statement, ast.Expr) else ""
        with contextlib.redirect_stdout(io.StringIO()) as output:
            if comment and isinstance(statement, ast.Expr):
                value = eval(compile(ast.Expression(statement.value), "page", "eval"), names)
                if value is not None:
                    print(value)
            else:
                exec(compile(ast.Module([statement], []), "page", "exec"), names)
        yield output.getvalue(), comment


def run_line(line: str, folder: Path, variables: Sequence[str] = (), code: int = 0) -> str:
    """What a line prints, after these lines that set variables; it has to end with this `code`."""
    script = "\n".join([*variables, line if not line.startswith("abrace ") else f"printf '%s\\0' {line}"])
    ended = subprocess.run(["bash", "-ec", script], cwd=folder, capture_output=True, text=True, check=False)
    if ended.returncode == 0 and line.startswith("abrace "):
        ended = _fork(ended.stdout.split("\0")[:-1], folder)
    assert ended.returncode == code, f"{line}\n{ended.stdout}{ended.stderr}"
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
