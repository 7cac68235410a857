"""`abrace bag`: what is in a bag, and its topics as CSV, as a MATLAB file, as a figure."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from abrace.report.table import Table
from abrace_bags import BagContents, read_topics
from abrace_bags.reader import topic_names
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    import argparse

LONGEST_FACT = 100
"""Characters of a fact that are shown: rig files are facts too."""


def add_bag_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `bag` and what it can do to the command's `commands`."""
    bag = commands.add_parser("bag", help="what is in a bag; its topics as CSV, MATLAB file or figure")
    actions = bag.add_subparsers(dest="action", required=True, metavar="ACTION")
    helps = {
        "info": "topics, types, counts, rates, gaps, facts",
        "csv": "one topic as comma-separated values",
        "mat": "topics as structs of a MATLAB file",
        "plot": "topics over time, as a PNG file",
    }
    for name, text in helps.items():
        action = actions.add_parser(name, help=text)
        action.add_argument("bag", type=Path, help="bag directory or MCAP file")
        if name == "csv":
            action.add_argument("topics", metavar="topic", nargs=1, help="such as /response")
        elif name != "info":
            several = "+" if name == "plot" else "*"
            action.add_argument("topics", metavar="topic", nargs=several, help="such as /response")
        if name != "info":
            action.add_argument("--output", type=Path, required=True, metavar="FILE", help="file to write")


def bag_command(given: argparse.Namespace) -> None:
    """Carry out `abrace bag` with the arguments `given`."""
    if given.action == "info":
        print(bag_information(given.bag))
        return
    contents = _read(given.bag, given.topics)
    for warning in contents.warnings:
        print(f"abrace: {warning}", file=sys.stderr)
    try:
        if given.action == "csv":
            from abrace_bags.export import write_csv

            write_csv(given.output, contents.popitem()[1])
        elif given.action == "mat":
            from abrace_bags.export import write_mat

            write_mat(given.output, contents, contents.facts)
        else:
            from abrace_bags.figure import bag_figure
            from abrace_core.drawing import save_figure

            save_figure(bag_figure(contents), given.output)
    except AbraceError as error:
        raise AbraceError(f"{given.bag}: {error}") from error
    print(f"wrote {given.output}")


def _read(bag: Path, topics: list[str]) -> BagContents:
    """The topics asked for, all if none; a leading slash may be left out."""
    if not topics:
        return read_topics(bag)
    available = topic_names(bag)
    return read_topics(bag, [topic if topic in available or topic.startswith("/") else f"/{topic}" for topic in topics])


def bag_information(bag: Path) -> str:
    """What is in a `bag`, for a person."""
    from abrace_bags.description import describe

    found = describe(bag)
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
            "-" if topic.gaps is None else str(topic.gaps),
            "-" if topic.missing is None else str(topic.missing),
            "-" if topic.lost is None else str(topic.lost),
        )
        for topic in found.topics
    )
    header = ("topic", "type", "messages", "rate [1/s]", "gaps", "missing", "lost")
    lines.append(Table("Topics", header, rows).text())
    lines += [f"{name}: {_shortened(text)}" for name, text in found.facts.items()]
    lines += [f"attachment {name}: {size} bytes" for name, size in found.attachments.items()]
    lines += [f"WARNING: {warning}" for warning in found.warnings]
    return "\n".join(lines)


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_FACT else f"{line[:LONGEST_FACT]}..."
