# SPDX-License-Identifier: Apache-2.0
"""Write docs/commands.md from the parsers, tables and Makefile that take commands: `python docs/write_commands.py`."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from abrace import cli
from abrace_bringup import graphs
from abrace_core.files import write_text
from abrace_plant.nodes import emulator

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace_bringup.arguments import Argument

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/commands.md"
LAUNCH_FILES = {"closed_loop": graphs.CLOSED_LOOP, "identification": graphs.IDENTIFICATION}

INTRODUCTION = f"""# Commands

Written by `python docs/write_commands.py` from the commands' parsers; `--help` after a command prints the same.
Nodes and their parameters: [nodes](nodes.md).

| exit code | of every command and node |
|---|---|
| 0 | done, or ended by Ctrl-C or SIGTERM (a node) |
| {cli.FAILED} | something failed while it ran, or its results cannot be trusted |
| {cli.WRONG_INPUT} | an input is wrong; one line states what, where, and what was expected |
| 130 | `abrace` was ended by Ctrl-C |
"""


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its subcommands, at any depth, that take arguments of their own."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not inner:
        yield parser
    for action in inner:
        for each in dict.fromkeys(action.choices.values()):
            yield from commands(each)


def helps(parser: argparse.ArgumentParser) -> dict[str, str]:
    """What each of the parser's subcommands does, at any depth."""
    found: dict[str, str] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {f"{parser.prog} {each.dest}": each.help or "" for each in action._choices_actions}
            for inner in action.choices.values():
                found |= helps(inner)
    return found


def arguments(parser: argparse.ArgumentParser) -> str:
    """The table of what a command takes; empty: nothing."""
    rows = [
        f"| `{_form(action)}` | {_text(action)} |"
        for action in parser._actions
        if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
    ]
    return "\n".join(["| argument | what it is |", "|---|---|", *rows, ""]) if rows else ""


def _form(action: argparse.Action) -> str:
    """An argument as it is given."""
    value = str(action.metavar or (action.dest.upper() if action.option_strings else action.dest))
    if action.choices is not None:
        value = ",".join(map(str, action.choices))
    if not action.option_strings:
        return value
    return action.option_strings[0] if action.nargs == 0 else f"{action.option_strings[0]} {value}"


def _text(action: argparse.Action) -> str:
    notes = ["required"] if action.option_strings and action.required else []
    notes += ["several"] if action.nargs in ("+", "*", "...") else []
    return "; ".join([action.help or "", *notes])


def section(parser: argparse.ArgumentParser, about: str) -> str:
    """A command: what it does, its form, what it takes."""
    usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
    example = (parser.epilog or "").removeprefix("example: ")
    shown = f"{usage}\n\n{example}".strip()
    return f"### {parser.prog}\n\n{about[:1].upper()}{about[1:]}.\n\n```text\n{shown}\n```\n\n{arguments(parser)}"


def launch_section(name: str, table: Sequence[Argument]) -> str:
    """A launch file and its arguments."""
    rows = [
        f"| `{each.name}` | {f'`{each.default}`' if each.default else 'empty'} | {each.description} |" for each in table
    ]
    head = f"### {name}\n\n`abrace run abrace_bringup {name} NAME:=VALUE ...`, or with ROS 2 installed\n"
    command = f"`ros2 launch abrace_bringup {name}.launch.py NAME:=VALUE ...`\n"
    return "\n".join([head + command, "| argument | default | what it is |", "|---|---|---|", *rows, ""])


def make_section() -> str:
    """What `make` does."""
    found = re.findall(r"^([a-z-]+):.*## (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    rows = [f"| `make {name}` | {text} |" for name, text in found]
    return "\n".join(["## make\n", "| command | what it does |", "|---|---|", *rows, ""])


def page() -> str:
    """The whole page."""
    main = cli.parser()
    about = helps(main)
    ours = [arguments(main), *(section(each, about[each.prog]) for each in commands(main))]
    target = section(
        emulator.arguments(),
        "A rig behind a device file: `abrace run abrace_plant emulator` ([emulator](bridge.md#the-emulator))",
    )
    launches = [launch_section(name, table) for name, table in LAUNCH_FILES.items()]
    of_launch = "## Launch files\n\nWhat ends a launch, a real rig, further parameters: [launch files](launch.md).\n"
    parts = [INTRODUCTION, "## abrace\n", *ours, "## Programs without ROS\n", target, of_launch, *launches]
    return "\n".join([*parts, make_section()])


if __name__ == "__main__":
    write_text(PAGE, page())
