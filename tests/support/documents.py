# SPDX-License-Identifier: Apache-2.0
"""The documentation's pages, code blocks, commands and headings, for tests that check and run them."""

from __future__ import annotations

import ast
import re
import textwrap
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
"""Every page of the documentation."""
EXAMPLES = sorted((ROOT / "examples").glob("*/README.md"))
"""The page of each example."""
GENERATED = [path.stem.removeprefix("write_") for path in sorted((ROOT / "docs").glob("write_*.py"))]
"""Pages made from the code, by docs/write_NAME.py."""
HEADS = ("abrace", "ros2", "make", "python", "source")
"""First words of commands that are checked."""


@cache
def sources() -> dict[Path, ast.Module]:
    """The modules of all packages, parsed."""
    paths = sorted((ROOT / "src").glob("abrace*/abrace*/**/*.py"))
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


class Block(NamedTuple):
    """A code block: the language of its fence (empty: none, or an indented block), and its lines."""

    language: str
    text: str

    @property
    def name(self) -> str:
        """Name of the file that it shows, from its first line (`# my_rig.yaml`); empty: none."""
        found = re.match(r"# (\S+\.(?:yaml|py))\n", self.text)
        return found[1] if found else ""


@cache
def blocks(page: Path) -> list[Block]:
    """The code blocks of a page, fenced and indented, in their order."""
    lines = iter(page.read_text(encoding="utf-8").splitlines())
    found: list[Block] = []
    indented: list[str] = []
    after_empty = True
    for line in lines:
        fence = re.match(r" *```(\S*)", line)
        if fence:
            _end(indented, found)
            inside = []
            for each in lines:
                if each.strip() == "```":
                    break
                inside.append(each)
            found.append(Block(fence[1], textwrap.dedent("\n".join([*inside, ""]))))
        elif line.startswith("    ") and (after_empty or indented):
            indented.append(line)
        elif line.strip() or not indented:
            _end(indented, found)
        else:
            indented.append("")
        after_empty = not line.strip()
    _end(indented, found)
    return found


def _end(indented: list[str], found: list[Block]) -> None:
    """End the indented block, if there is one."""
    if indented:
        found.append(Block("", textwrap.dedent("\n".join([*indented, ""]))))
        indented.clear()


def commands(page: Path) -> list[str]:
    """The commands in the blocks of a page, without comments; continued lines are joined."""
    found = []
    for block in blocks(page):
        if block.language in ("", "bash"):
            joined = re.sub(r"\\\n\s*", "", block.text)
            lines = (re.split(r"\s+#\s", line)[0].strip() for line in joined.splitlines())
            found += [line for line in lines if line.split(" ")[0] in HEADS]
    return found


def inline_commands(page: Path) -> list[str]:
    """The commands in the sentences of a page."""
    sentences = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [
        " ".join(text.split())
        for text in re.findall(r"`([^`]+)`", sentences)
        if re.match(rf"({'|'.join(HEADS[:4])}) \S", " ".join(text.split()))
    ]


@cache
def anchors(page: Path) -> set[str]:
    """The anchors of the page's headings, as in links after the #."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#{1,4} (.+)$", text, re.MULTILINE)
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}
