# SPDX-License-Identifier: Apache-2.0
"""Runs tutorials: writes a page's files into a folder and runs its commands there, with no other preparation."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING

from documents import ROOT, blocks

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

LINE = re.compile(r"(?:abrace|python|cp) |\w+=\$\(")
"""Lines of a block that are given to the shell."""
SET_UP = ("make setup", "source ros2_ws/setup.bash")
"""Lines that prepare a terminal: whoever follows a tutorial in a test has done that before."""
NEEDS_A_TERMINAL = ("abrace status", "abrace stop", "abrace clear")
"""Commands for a second terminal while a test runs."""


def page(name: str) -> Path:
    """The page of a tutorial."""
    return ROOT / f"docs/{name}.md"


def write_files(name: str, folder: Path) -> list[str]:
    """Write the files of a tutorial into a `folder`; returns their names."""
    named = [block for block in blocks(page(name)) if block.name]
    for block in named:
        (folder / block.name).write_text(block.text, encoding="utf-8")
    return [block.name for block in named]


def shown_lines(name: str) -> list[str]:
    """Every line of a tutorial's blocks that have no language and are no file, in their order."""
    shown = [block for block in blocks(page(name)) if not block.language and not block.name]
    return [line.strip() for block in shown for line in block.text.splitlines() if line.strip()]


def lines(name: str) -> list[str]:
    """The shell commands of a tutorial, in their order."""
    return [line for line in shown_lines(name) if LINE.match(line) and not line.startswith(NEEDS_A_TERMINAL)]


def second_terminal(name: str) -> list[str]:
    """The commands that a tutorial gives in a second terminal, in their order."""
    return [line for line in shown_lines(name) if line.startswith(NEEDS_A_TERMINAL)]


def python(name: str) -> str:
    """The Python of a page that belongs to no file, as one program."""
    return "\n".join(block.text for block in blocks(page(name)) if block.language == "python" and not block.name)


def follow(name: str, folder: Path, without: Collection[str] = ()) -> dict[str, str]:
    """Run each line of a tutorial in a `folder`, except those `without`, then its Python; returns their output.

    Raises
    ------
    RuntimeError
        If a line, or the Python, does not end with 0.
    """
    write_files(name, folder)
    printed, set_before = {}, []
    for line in lines(name):
        if re.match(r"\w+=", line):
            set_before.append(line)
        elif line not in without:
            printed[line] = _ended(["bash", "-ec", "\n".join([*set_before, line])], folder)
    if program := python(name):
        printed["python"] = _ended([sys.executable, "-c", program], folder)
    return printed


def _ended(command: list[str], folder: Path) -> str:
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise RuntimeError(f"{command[-1]}\n{ended.stdout}{ended.stderr}")
    return ended.stdout
