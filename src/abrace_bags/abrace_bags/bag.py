# SPDX-License-Identifier: Apache-2.0
"""The files of a bag, and their content other than messages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from abrace_bags.mcap.file_reader import McapFile, read_facts_record
from abrace_bags.mcap.index import MessageFilter
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mcap.records import Attachment

    from abrace_bags.other_storage import OtherStorage
    from abrace_core.sequence import NumberRanges

METADATA_FILE = "metadata.yaml"


@dataclass(frozen=True)
class OpenedBag:
    """The files of a bag that can be read.

    Parameters
    ----------
    files
        In their order.
    problems
        What is wrong with the bag and its other files, one sentence each.
    unreadable
        Whether files can't be read.
    """

    files: list[McapFile | OtherStorage]
    problems: list[str]
    unreadable: bool

    @property
    def paths(self) -> list[Path]:
        """Of the files."""
        return [path for file in self.files for path in file.paths]

    @property
    def facts(self) -> dict[str, str]:
        """The run's facts, of the first file that has them."""
        return next((file.facts for file in self.files if file.facts is not None), {})

    @property
    def records(self) -> dict[str, dict[str, str]]:
        """Metadata records: texts by key, by the record's name."""
        return {name: texts for file in self.files for name, texts in file.metadata.items()}

    @property
    def attachments(self) -> list[Attachment]:
        """Files of the run."""
        return [attachment for file in self.files for attachment in file.attachments]

    @property
    def warnings(self) -> list[str]:
        """What is missing or can't be trusted, one sentence each."""
        return self.problems + [warning for file in self.files for warning in file.warnings]

    @property
    def uncounted(self) -> bool:
        """Whether messages may be missing and the files do not say how many."""
        return self.unreadable or any(file.uncounted for file in self.files)

    def read_besides_messages(self) -> None:
        """Read the topics, facts, records and attachments of files whose index does not name them all."""
        for file in self.files:
            if not file.indexed:
                for _ in file.chunks(MessageFilter(lambda _: True)):
                    pass


def open_bag(bag: Path | str) -> OpenedBag:
    """Open the files of a bag; one that can't be read does not keep the others from being read.

    Parameters
    ----------
    bag
        A bag directory or a single file: MCAP, or what else rosbag2 writes (sqlite3, compressed).

    Raises
    ------
    AbraceError
        If there is no such bag, or none of its files can be read.
    """
    path = existing(bag)
    if needs_rosbags(path):
        from abrace_bags.other_storage import OtherStorage

        return OpenedBag([OtherStorage(path)], [], unreadable=False)
    names, problems = _named_files(path)
    files: list[McapFile | OtherStorage] = []
    unreadable = []
    for one in names:
        try:
            files.append(McapFile(one))
        except AbraceError as error:
            unreadable.append(str(error))
    if not files:
        raise AbraceError("; ".join(unreadable))
    problems += [f"{reason}; nothing is read of it" for reason in unreadable]
    return OpenedBag(files, problems, bool(unreadable))


def read_facts(bag: Path | str) -> dict[str, str]:
    """The facts of the run in a `bag`: rig, controller, record, versions. Empty where it has none.

    Raises
    ------
    AbraceError
        If there is no such bag, it isn't one, or its facts are damaged.
    """
    path = existing(bag)
    if needs_rosbags(path):
        return open_bag(path).facts
    damaged = []
    for file in bag_files(path):
        try:
            facts = read_facts_record(file)
        except AbraceError as error:
            damaged.append(error)
            continue
        if facts is not None:
            return facts
    if damaged:
        raise damaged[0]
    return {}


def topic_names(bag: Path | str) -> set[str]:
    """Names of the topics of a `bag`.

    Raises
    ------
    AbraceError
        As `open_bag`.
    """
    opened = open_bag(bag)
    opened.read_besides_messages()
    return {channel.topic for file in opened.files for channel in file.channels.values()}


def existing(bag: Path | str) -> Path:
    """The path of a `bag`.

    Raises
    ------
    AbraceError
        If there is nothing.
    """
    bag = Path(bag)
    try:
        exists = bag.exists()
    except OSError as error:
        raise AbraceError(f"{bag}: {error.strerror}") from error
    if not exists:
        raise AbraceError(f"{bag}: no such bag, expected a bag directory or an MCAP file")
    return bag


def bag_files(bag: Path | str) -> list[Path]:
    """The MCAP files of a `bag`, in their order.

    Raises
    ------
    AbraceError
        If there is none.
    """
    return _named_files(existing(bag))[0]


def in_brackets(warnings: Sequence[str]) -> str:
    """The `warnings` of a bag for the error that they may explain; empty without any."""
    return f" ({'; '.join(warnings)})" if warnings else ""


def missing_messages(topic: str, numbers: NumberRanges | None) -> str:
    """How many messages of a `topic` are missing by their `numbers`, for a warning where the bag's count is lost."""
    if numbers is None or not numbers.ranges:
        return f"topic {topic}: the number of missing messages is unknown"
    span = f"{numbers.ranges[0][0]} to {numbers.ranges[-1][1]}"
    return f"topic {topic}: {numbers.missing} of the samples {span} are missing, later ones are not known"


def needs_rosbags(path: Path) -> bool:
    """Whether a bag is not plain MCAP, by its name or by what its metadata.yaml says."""
    if path.is_file():
        return path.suffix != ".mcap" and (path.suffix == ".db3" or path.name.endswith((".db3.zstd", ".mcap.zstd")))
    if not (path / METADATA_FILE).is_file():
        return any(path.glob("*.db3*")) and not any(path.glob("*.mcap"))
    try:
        information = _information(path)
        return information["storage_identifier"] != "mcap" or bool(information.get("compression_format"))
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        # reading its MCAP files reports what is wrong
        return False


def _information(bag: Path) -> dict[str, Any]:
    """The content of a bag's metadata.yaml."""
    text = (bag / METADATA_FILE).read_text(encoding="utf-8")
    loaded: dict[str, Any] = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))[
        "rosbag2_bagfile_information"
    ]
    return loaded


def _named_files(bag: Path) -> tuple[list[Path], list[str]]:
    """The MCAP files of a bag, and what is wrong with it.

    These are the files that metadata.yaml names. Without it, as when the logger was killed, they are those with the
    bag's name and a number, or if there are none, all files: the copy of a file would double its messages.
    """
    if not bag.is_dir():
        return [bag], []
    found = sorted(bag.glob("*.mcap"), key=_by_numbers)
    if not found:
        raise AbraceError(f"{bag}: no MCAP file in it, expected a bag directory")
    problems = []
    chosen: list[Path] = []
    why = ""
    if (bag / METADATA_FILE).is_file():
        try:
            named = [bag / Path(name).name for name in _information(bag)["relative_file_paths"]]
            chosen = [path for path in named if path.is_file()]
            problems = [f"{bag}: {path.name} is missing" for path in named if path not in chosen]
            why = f"{METADATA_FILE} does not name it"
        except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError) as error:
            problems = [f"{bag / METADATA_FILE}: can't be read ({' '.join(str(error).split())})"]
    if not chosen:
        pattern = re.compile(rf"{re.escape(bag.resolve().name)}_\d+\.mcap")
        chosen = [path for path in found if pattern.fullmatch(path.name)]
        why = f"the bag's own are {bag.resolve().name}_0.mcap and so on"
    if not chosen:
        return found, problems
    others = [path for path in found if path not in chosen]
    return chosen, problems + [f"{path}: is not read, {why}" for path in others]


def _by_numbers(path: Path) -> list[int | str]:
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)]
