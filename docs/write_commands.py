# SPDX-License-Identifier: Apache-2.0
"""Write docs/commands.md from the parsers, tables and Makefile that take commands: `python docs/write_commands.py`."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from typing import TYPE_CHECKING

import pages

from abrace import cli
from abrace_bringup import graphs
from abrace_core.files.command_line import OneLineParser
from abrace_plant.nodes import emulator

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace_bringup.arguments import Argument

LAUNCH_FILES = {graph.name: graph.arguments for graph in graphs.GRAPHS.values()}

EXAMPLES = 4
"""Lines of a command's examples that are shown; `--help` has all."""
SEVERAL = 4
"""Options of a command that are listed in its form; more are in its table alone."""

INTRODUCTION = f"""# Commands

`--help` after a command prints the same, and more examples. Nodes and their parameters: [nodes](nodes.md). *Made from
the commands' parsers by `docs/write_commands.py`.*

| exit code | of every command and node |
|---|---|
| 0 | done, or ended by Ctrl-C or SIGTERM (a node) |
| {cli.FAILED} | something failed while it ran, or its results cannot be trusted |
| {cli.WRONG_INPUT} | an input is wrong; one line states what, where, and what was expected |
| 130 | `abrace` was ended by Ctrl-C |
"""


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its subcommands, at any depth, that take arguments of their own."""
    if isinstance(parser, OneLineParser):
        parser.add_late()
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


def taken(parser: argparse.ArgumentParser) -> list[tuple[str, str]]:
    """What a command takes: each argument, and what it is."""
    hidden = argparse._HelpAction | argparse._SubParsersAction
    return [(f"`{_form(action)}`", _text(action)) for action in parser._actions if not isinstance(action, hidden)]


def table(rows: Sequence[tuple[str, str]]) -> str:
    """The table of arguments; empty: nothing."""
    return pages.table(["argument", "what it is"], rows) if rows else ""


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


def section(parser: argparse.ArgumentParser, about: str, shared: Sequence[tuple[str, str]] = ()) -> str:
    """A command: what it does, its form, what it takes beyond what is `shared`."""
    options = [action for action in parser._actions if action.option_strings]
    if len(options) > SEVERAL:
        given = [_form(action) for action in parser._actions if not action.option_strings]
        usage = f"{parser.prog} [OPTION ...] {' '.join(given)}".strip()
    else:
        usage = " ".join(parser.format_usage().removeprefix("usage: ").split()).replace(" [-h]", "")
    example = "\n".join((parser.epilog or "").removeprefix("example: ").splitlines()[:EXAMPLES])
    shown = f"{usage}\n\n{example}".strip()
    own = table([row for row in taken(parser) if row not in shared])
    return f"### {parser.prog}\n\n{about[:1].upper()}{about[1:]}.\n\n```text\n{shown}\n```\n\n{own}"


def launch_section(name: str, table: Sequence[Argument], before: str = "") -> str:
    """A launch file and its arguments; those of the one `before` it are named alone."""
    described = [_argument_row(each) for each in LAUNCH_FILES[before]] if before else []
    rows = [_argument_row(each) for each in table]
    common = ", ".join(row[0] for row in rows if row in described)
    rest = pages.paragraph(f"As [{before}](#{before}) it has {common}.") if common else ""
    shown = pages.table(["argument", "default", "what it is"], [row for row in rows if row not in described])
    return f"### {name}\n\n    abrace run abrace_bringup {name} NAME:=VALUE ...\n\n{shown}\n{rest}"


def _argument_row(argument: Argument) -> tuple[str, str, str]:
    return f"`{argument.name}`", f"`{argument.default}`" if argument.default else "", argument.description


def make_section() -> str:
    """What `make` does."""
    found = re.findall(r"^([a-z-]+):.*## (.*)$", (pages.ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    rows = [(f"`make {name}`", text) for name, text in found]
    return "\n".join(["## make\n", pages.table(["command", "what it does"], rows)])


def page() -> str:
    """The whole page."""
    main = cli.parser()
    about = helps(main)
    counted = Counter(row for each in commands(main) for row in taken(each))
    shared = [row for row, times in counted.items() if times > 1]
    ours = [table(taken(main)), "Arguments of several commands:\n", table(shared)]
    ours += [section(each, about[each.prog], shared) for each in commands(main)]
    target = section(
        emulator.arguments(),
        "A rig behind a device file: `abrace run abrace_plant emulator` ([emulator](bridge.md#the-emulator))",
    )
    launches, before = [], ""
    for name, described in LAUNCH_FILES.items():
        launches.append(launch_section(name, described, before))
        before = name
    of_launch = "## Launch files\n\nWith ROS 2 installed also `ros2 launch abrace_bringup NAME.launch.py ...`.\n"
    parts = [INTRODUCTION, "## abrace\n", *ours, "## Programs without ROS\n", target, of_launch, *launches]
    return "\n".join([*parts, make_section()])


if __name__ == "__main__":
    pages.write(__file__, page)
