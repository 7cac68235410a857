# SPDX-License-Identifier: Apache-2.0
"""`abrace bag`: what is in a bag, its topics in other forms; parts of bags, several in one."""

from __future__ import annotations

import contextlib
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.report.table import Table
from abrace_bags.topics import printable
from abrace_core import AbraceError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from abrace_bags import CopiedBag
    from abrace_core.files.command_line import OneLineParser

LONGEST_FACT = 100
"""Characters of a fact that are shown: rig files are facts too."""


def add_bag_parser(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    """Add `bag` and what it can do to the command's `commands`."""
    bag = commands.add_parser(
        "bag",
        help="what is in a bag; its topics as CSV, MATLAB file or figure; parts, unions",
        example="abrace bag info bags/first",
    )
    bag.set_defaults(act=bag_command)
    actions = bag.add_subparsers(dest="action", required=True, metavar="ACTION")
    helps = {
        "info": ("topics, types, counts, rates, gaps, facts", ""),
        "csv": ("one topic as comma-separated values", " response --output response.csv"),
        "mat": ("topics as structs of a MATLAB file", " --output first.mat"),
        "plot": (
            "physical quantities of topics over time, as a PNG or SVG file",
            " response --start-offset 5 --duration 10 --output first.png",
        ),
    }
    for name, (text, further) in helps.items():
        action = actions.add_parser(name, help=text, example=f"abrace bag {name} bags/first{further}")
        action.add_argument("bag", type=Path, help="bag directory or MCAP file")
        if name == "csv":
            action.add_argument("topics", metavar="topic", nargs=1, help="name, or the end of one: response")
        elif name != "info":
            several = "+" if name == "plot" else "*"
            action.add_argument(
                "topics", metavar="topic", nargs=several, help="such as response: a name, or the end of one"
            )
        if name == "info":
            action.add_argument("--check", action="store_true", help="read everything, to find damage in any chunk")
        else:
            _add_range(action)
            action.add_argument("--output", type=Path, required=True, metavar="FILE", help="file to write")
    trim = actions.add_parser(
        "trim",
        help="a part of a bag as a new bag",
        example="abrace bag trim bags/first bags/shaking --start-offset 5 --duration 10",
    )
    trim.add_argument("bag", type=Path, help="bag directory or MCAP file")
    trim.add_argument("output", type=Path, metavar="out", help="bag to write, a new directory")
    trim.add_argument("topics", metavar="topic", nargs="*", help="such as response: a name, or the end of one")
    _add_range(trim)
    merge = actions.add_parser(
        "merge",
        help="several bags as one new bag, in the order of their times",
        example="abrace bag merge bags/both bags/rig bags/cameras",
    )
    merge.add_argument("output", type=Path, metavar="out", help="bag to write, a new directory")
    merge.add_argument("bags", type=Path, metavar="bag", nargs="+", help="bag directory or MCAP file")


def _add_range(action: argparse.ArgumentParser) -> None:
    """Add the options for a part of a bag."""
    action.add_argument(
        "--start-offset",
        type=float,
        default=0.0,
        metavar="S",
        help="seconds after the first message at which to begin",
    )
    action.add_argument("--duration", type=float, default=0.0, metavar="S", help="seconds from there; 0: to the end")


def bag_command(given: argparse.Namespace) -> None:
    """Carry out `abrace bag` with the arguments `given`."""
    if given.action == "info":
        print(printable(bag_information(given.bag, given.check)))
        return
    from abrace_bags import Bag, TopicParts, merge, trim, write_csv, write_mat

    if given.action == "merge":
        _report(given.output, merge(given.output, given.bags))
        return
    for name in ("start_offset", "duration"):
        if not 0.0 <= getattr(given, name) < 1e9:
            raise AbraceError(f"--{name.replace('_', '-')}: {getattr(given, name)}, expected seconds from 0 on")
    if given.action == "trim":
        _report(given.output, trim(given.bag, given.output, given.topics, given.start_offset, given.duration))
        return
    bag = Bag(given.bag)
    begin, end = bag.time_range(given.start_offset, given.duration, given.topics)
    warnings: Iterable[str]
    if given.action == "csv":
        messages = bag.raw(given.topics, begin, end)
        with _naming(given.bag):
            parts = TopicParts(messages)
            write_csv(given.output, parts)
        warnings = parts.warnings
    else:
        contents = bag.arrays(given.topics, begin, end)
        warnings = bag.warnings
        with _naming(given.bag):
            if given.action == "mat":
                write_mat(given.output, contents, bag.facts)
            else:
                from abrace_bags.figure import bag_figure
                from abrace_core.figures.saving import save_figure

                save_figure(bag_figure(contents), given.output)
    for warning in warnings:
        print(f"abrace: {printable(warning)}", file=sys.stderr)
    print(f"wrote {given.output}")


def _report(output: Path, copied: CopiedBag) -> None:
    for warning in copied.warnings:
        print(f"abrace: {printable(warning)}", file=sys.stderr)
    counts = ", ".join(f"{count} of {topic}" for topic, count in copied.counts.items())
    print(printable(f"wrote {output}: {counts}"))


@contextlib.contextmanager
def _naming(bag: Path) -> Iterator[None]:
    """Name the `bag` in errors."""
    try:
        yield
    except AbraceError as error:
        raise AbraceError(f"{bag}: {error}") from error


def bag_information(bag: Path, check: bool) -> str:
    """What is in a `bag`, for a person; with `check` it is read as a whole."""
    from abrace_bags import describe

    found = describe(bag, check)
    lines = [f"{bag}: {found.files} file{'s'[: found.files != 1]}, {found.size / 1e6:.2f} MB"]
    if found.end:
        begin = datetime.fromtimestamp(1e-9 * found.begin, UTC).isoformat(sep=" ", timespec="milliseconds")
        lines.append(f"{found.duration:.3f} s from {begin}")
    rows = tuple(
        (
            name,
            found.types[name],
            str(topic.messages),
            f"{topic.rate:.2f}",
            *(["-"] * 3 if topic.first_number is None else map(str, (topic.first_number, topic.gaps, topic.missing))),
            "-" if topic.lost is None else str(topic.lost),
        )
        for name, topic in found.contents.items()
    )
    header = ("topic", "type", "messages", "rate [1/s]", "first", "gaps", "missing", "lost")
    lines.append(Table("Topics", header, rows).text())
    lines += [
        f"{name} begins at sample {topic.first_number}: earlier samples are not in the bag"
        for name, topic in found.contents.items()
        if topic.first_number
    ]
    lines += [f"{name}: {_shortened(text)}" for name, text in found.facts.items()]
    lines += [f"attachment {name}: {size} bytes" for name, size in found.attachments.items()]
    lines += [f"WARNING: {warning}" for warning in found.warnings]
    return "\n".join(lines)


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_FACT else f"{line[:LONGEST_FACT]}..."
