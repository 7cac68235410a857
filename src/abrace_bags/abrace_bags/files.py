"""The files of a bag: which there are, which can be read, and which are missing."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import yaml

from abrace_bags.mcap.file_reader import McapFile
from abrace_bags.mcap.selection import Wanted
from abrace_core.errors import AbraceError


@dataclass(frozen=True)
class OpenedBag:
    """What is whole in the files of a bag.

    Parameters
    ----------
    files
        Those that can be read, in their order.
    warnings
        What is missing or can't be trusted, one sentence each.
    uncounted
        Whether messages are missing, nobody knows how many.
    """

    files: list[McapFile]
    warnings: list[str]
    uncounted: bool


def open_bag(bag: Path | str, wanted: Wanted) -> OpenedBag:
    """Read the files of a bag; one that can't be read does not keep the others from being read.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file.
    wanted
        Which messages to keep.

    Raises
    ------
    AbraceError
        If there is no such bag, or none of its files can be read.
    """
    files, refused = [], []
    for path in bag_files(bag):
        try:
            files.append(McapFile(path, wanted))
        except AbraceError as error:
            refused.append(str(error))
    if not files:
        raise AbraceError("; ".join(refused))
    warnings = missing_files(bag) + [f"{reason}; nothing is read of it" for reason in refused]
    warnings += [warning for file in files for warning in file.warnings]
    return OpenedBag(files, warnings, bool(refused) or any(file.uncounted for file in files))


def topic_names(bag: Path | str) -> set[str]:
    """Names of the topics of a `bag`.

    Raises
    ------
    AbraceError
        As `open_bag`.
    """
    files = open_bag(bag, Wanted(lambda _: False)).files
    return {channel.topic for file in files for channel in file.channels.values()}


def bag_files(bag: Path | str) -> list[Path]:
    """The MCAP files of a `bag`, in their order.

    Raises
    ------
    AbraceError
        If there is none.
    """
    bag = Path(bag)
    try:
        there = bag.exists()
    except OSError as error:
        raise AbraceError(f"{bag}: {error.strerror}") from error
    if not there:
        raise AbraceError(f"{bag}: no such bag, expected a bag directory or an MCAP file")
    if not bag.is_dir():
        return [bag]

    def place(path: Path) -> list[int | str]:
        return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)]

    files = sorted(bag.glob("*.mcap"), key=place)
    if not files:
        raise AbraceError(f"{bag}: no MCAP file in it, expected a bag directory")
    return files


def missing_files(bag: Path | str) -> list[str]:
    """Files that the metadata.yaml of a `bag` names and that are not there, one sentence each."""
    bag = Path(bag)
    path = bag / "metadata.yaml"
    if not path.is_file():
        return []
    try:
        named = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]["relative_file_paths"]
        return [f"{bag}: {name} is missing" for name in named if not (bag / Path(name).name).is_file()]
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError) as error:
        return [f"{path}: can't be read ({' '.join(str(error).split())})"]
