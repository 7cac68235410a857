# SPDX-License-Identifier: Apache-2.0
"""`abrace bag`: what is in a bag, its topics as CSV, as a MATLAB file, as a figure, and the building in motion."""

from __future__ import annotations

import contextlib
import math
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.report.table import Table
from abrace_core.errors import AbraceError
from abrace_core.suggestion import expected_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from abrace_core.command_line import OneLineParser

LONGEST_FACT = 100
"""Characters of a fact that are shown: rig files are facts too."""


def add_bag_parser(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    """Add `bag` and what it can do to the command's `commands`."""
    bag = commands.add_parser(
        "bag",
        help="what is in a bag; its topics as CSV, MATLAB file or figure; the building in motion",
        example="abrace bag info bags/first",
    )
    actions = bag.add_subparsers(dest="action", required=True, metavar="ACTION")
    helps = {
        "info": ("topics, types, counts, rates, gaps, facts", ""),
        "csv": ("one topic as comma-separated values", " response --output response.csv"),
        "mat": ("topics as structs of a MATLAB file", " --output first.mat"),
        "plot": (
            "physical quantities of topics over time, as a PNG or SVG file",
            " response --start-offset 5 --duration 10 --output first.png",
        ),
        "animate": ("the building in motion, alone or next to another test, as a GIF file", " --output first.gif"),
    }
    for name, (text, further) in helps.items():
        action = actions.add_parser(name, help=text, example=f"abrace bag {name} bags/first{further}")
        action.add_argument("bag", type=Path, help="bag directory or MCAP file")
        if name == "csv":
            action.add_argument("topics", metavar="topic", nargs=1, help="name, or the end of one: response")
        elif name == "animate":
            action.add_argument(
                "--against", type=Path, metavar="BAG", help="another test of the same building, drawn on the left"
            )
            action.add_argument(
                "--exaggeration", type=float, default=0.0, metavar="N", help="factor of displacements; 0: chosen to fit"
            )
        elif name != "info":
            several = "+" if name == "plot" else "*"
            action.add_argument(
                "topics", metavar="topic", nargs=several, help="such as response: a name, or the end of one"
            )
        if name == "info":
            action.add_argument("--check", action="store_true", help="read everything, to find damage in any chunk")
        else:
            action.add_argument(
                "--start-offset",
                type=float,
                default=0.0,
                metavar="S",
                help="seconds after the first message at which to begin",
            )
            action.add_argument(
                "--duration", type=float, default=0.0, metavar="S", help="seconds from there; 0: to the end"
            )
            action.add_argument("--output", type=Path, required=True, metavar="FILE", help="file to write")


def bag_command(given: argparse.Namespace) -> None:
    """Carry out `abrace bag` with the arguments `given`."""
    if given.action == "info":
        print(bag_information(given.bag, given.check))
        return
    from abrace_bags.survey import time_range

    for name in ("start_offset", "duration"):
        if not 0.0 <= getattr(given, name) < 1e9:
            raise AbraceError(f"--{name.replace('_', '-')}: {getattr(given, name)}, expected seconds from 0 on")
    if given.action == "animate":
        _animate(given)
        return
    topics = _topics(given.bag, given.topics)
    begin, end = time_range(
        given.bag, lambda channel: not topics or channel.topic in topics, given.start_offset, given.duration
    )
    if given.action == "csv":
        from abrace_bags.export import write_csv
        from abrace_bags.parts import TopicParts

        parts = TopicParts(given.bag, topics[0], begin, end)
        with _naming(given.bag):
            write_csv(given.output, parts)
        warnings: Iterable[str] = parts.warnings
    else:
        from abrace_bags.reader import read_topics

        contents = read_topics(given.bag, topics or None, begin, end)
        warnings = contents.warnings
        with _naming(given.bag):
            if given.action == "mat":
                from abrace_bags.export import write_mat

                write_mat(given.output, contents, contents.facts)
            else:
                from abrace_bags.figure import bag_figure
                from abrace_core.drawing import save_image

                save_image(bag_figure(contents), given.output)
    for warning in warnings:
        print(f"abrace: {warning}", file=sys.stderr)
    print(f"wrote {given.output}")


def _animate(given: argparse.Namespace) -> None:
    from abrace.report.animation import animate

    if not 0.0 <= given.exaggeration < math.inf:
        raise AbraceError(f"--exaggeration: {given.exaggeration}, expected a number above 0")
    bags = [bag for bag in (given.against, given.bag) if bag is not None]
    scale = animate(bags, given.output, given.start_offset, given.duration, given.exaggeration)
    print(f"wrote {given.output}, displacements {scale:g} times as large")


@contextlib.contextmanager
def _naming(bag: Path) -> Iterator[None]:
    """Name the `bag` in errors."""
    try:
        yield
    except AbraceError as error:
        raise AbraceError(f"{bag}: {error}") from error


def _topics(bag: Path, asked: list[str]) -> list[str]:
    """The topics asked for, all if none: by their names, or by ends of names that only one topic has."""
    from abrace_bags.bag import topic_names

    available = topic_names(bag)
    return [_topic(bag, topic, available) for topic in asked]


def _topic(bag: Path, asked: str, available: set[str]) -> str:
    slashed = asked if asked in available or asked.startswith("/") else f"/{asked}"
    found = [slashed] if slashed in available else sorted(name for name in available if name.endswith(slashed))
    if len(found) > 1:
        raise AbraceError(f"{bag}: {len(found)} topics end in {slashed}, expected one of {', '.join(found)}")
    if not found:
        raise AbraceError(f"{bag}: no topic {slashed} in it, {expected_of(slashed, available)}")
    return found[0]


def bag_information(bag: Path, check: bool) -> str:
    """What is in a `bag`, for a person; with `check` it is read as a whole."""
    from abrace_bags.description import describe

    found = describe(bag, check)
    lines = [f"{bag}: {found.files} file{'s'[: found.files != 1]}, {found.size / 1e6:.2f} MB"]
    if found.end:
        begin = datetime.fromtimestamp(1e-9 * found.begin, UTC).isoformat(sep=" ", timespec="milliseconds")
        lines.append(f"{found.duration:.3f} s from {begin}")
    rows = tuple(
        (
            topic.name,
            topic.type_name,
            str(topic.count),
            f"{topic.rate:.2f}",
            "-" if topic.first is None else str(topic.first),
            "-" if topic.gaps is None else str(topic.gaps),
            "-" if topic.missing is None else str(topic.missing),
            "-" if topic.lost is None else str(topic.lost),
        )
        for topic in found.topics
    )
    header = ("topic", "type", "messages", "rate [1/s]", "first", "gaps", "missing", "lost")
    lines.append(Table("Topics", header, rows).text())
    lines += [
        f"{topic.name} begins at sample {topic.first}: earlier samples are not in the bag"
        for topic in found.topics
        if topic.first
    ]
    lines += [f"{name}: {_shortened(text)}" for name, text in found.facts.items()]
    lines += [f"attachment {name}: {size} bytes" for name, size in found.attachments.items()]
    lines += [f"WARNING: {warning}" for warning in found.warnings]
    return "\n".join(lines)


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_FACT else f"{line[:LONGEST_FACT]}..."
