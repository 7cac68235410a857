# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: those that its metadata.yaml names, or what is found without it, each read by its content."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from abrace_bags.mcap.file_reader import McapFile
from abrace_bags.mcap.records import open_file
from abrace_bags.metadata import METADATA_FILE
from abrace_bags.sqlite_file import SQLITE_MAGIC, SqliteFile
from abrace_core import AbraceError
from abrace_core.files.reading import load_yaml

if TYPE_CHECKING:
    from abrace_bags.mcap.bag_file import BagFile

_ENDINGS = (".mcap", ".db3")
_PACKED = tuple(f"{ending}.zstd" for ending in _ENDINGS)
_NUMBERED = re.compile(r"(.*_)?(\d{1,5})")
_OTHERS = {
    b"#ROSBAG V2.0": "is a bag of ROS 1, expected MCAP: rosbags-convert --src {path} --dst {stem} --dst-storage mcap",
    b"\x28\xb5\x2f\xfd": "is packed with zstd, expected MCAP: zstd -d {path}",
    b"\x1f\x8b": "is packed with gzip, expected MCAP: gunzip {path}",
    b"PK\3\4": "is packed, expected MCAP: unzip {path}",
    b"version https://git-lfs": "is only git-lfs's pointer to the file: git lfs pull",
}
"""What other files begin with, what they are, and what to do."""


def open_bag_file(path: Path) -> BagFile:
    """The file at a `path`, read by what it begins with.

    Raises
    ------
    AbraceError
        If it can't be read, or is neither MCAP nor sqlite3.
    """
    with open_file(path) as (file, _):
        head = file.read(32)
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise AbraceError(f"{path}: {what.format(path=path, stem=path.with_suffix(''))}")
    return SqliteFile(path) if head.startswith(SQLITE_MAGIC) else McapFile(path)


def find_files(bag: Path) -> tuple[list[Path], list[str], dict[str, int]]:
    """The files of a `bag`, a directory or a single file, what is wrong with it, and messages by topic as it says.

    These are the files that metadata.yaml names. Without it, as when the logger was killed, they are the numbered ones
    of one name: `first_0.mcap`, `first_1.mcap`. The copy of a file would double its messages.

    Raises
    ------
    AbraceError
        If there is none, they are of several recordings, or rosbag2 has compressed them.
    """
    if not bag.is_dir():
        return [bag], [], {}
    names: list[str] = []
    problems: list[str] = []
    counts: dict[str, int] = {}
    if (bag / METADATA_FILE).is_file():
        try:
            information = _information(bag / METADATA_FILE)
            names = [Path(name).name for name in information["relative_file_paths"]]
            if information.get("compression_format"):
                convert = f"rosbags-convert --src {bag} --dst {bag}_mcap --dst-storage mcap"
                raise AbraceError(f"{bag}: was compressed by rosbag2, expected MCAP without that: {convert}")
            for one in information.get("topics_with_message_count") or []:
                counts[one["topic_metadata"]["name"]] = int(one["message_count"])
        except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            problems = [f"{bag / METADATA_FILE}: can't be read ({' '.join(str(error).split())})"]
    files = sorted(path for path in bag.iterdir() if path.is_file())
    found = [path for path in files if path.suffix in _ENDINGS]
    if not found:
        packed = [str(path) for path in files if path.name.endswith(_PACKED)]
        if packed:
            raise AbraceError(f"{bag}: its files are packed with zstd, expected MCAP: zstd -d {' '.join(packed)}")
        raise AbraceError(f"{bag}: no MCAP or sqlite3 file in it, expected a bag directory")
    named = [bag / name for name in dict.fromkeys(names)]
    problems += [f"{bag}: {METADATA_FILE} names {path.name} twice" for path in named if names.count(path.name) > 1]
    problems += [f"{bag}: {path.name} is missing" for path in named if not path.is_file()]
    chosen, why = [path for path in named if path.is_file()], f"{METADATA_FILE} does not name it"
    if not chosen:
        chosen, missing = _numbered(bag, found)
        problems += missing
        why = f"the bag's own are {chosen[0].name} and so on"
    return chosen, problems + [f"{path}: is not read, {why}" for path in found if path not in chosen], counts


def _numbered(bag: Path, found: list[Path]) -> tuple[list[Path], list[str]]:
    """Those of the files `found` in a bag without metadata.yaml that belong together, and which are missing."""
    groups: dict[tuple[str, str], dict[int, Path]] = {}
    for path in found:
        if match := _NUMBERED.fullmatch(path.stem):
            groups.setdefault((match[1] or "", path.suffix), {})[int(match[2])] = path
    own = [group for group in groups if group[0] == f"{bag.resolve().name}_"] or list(groups)
    if len(own) == 1:
        files = groups[own[0]]
        name, ending = own[0]
        lacking = sorted(set(range(min(files), max(files))) - files.keys())[:3]
        return [files[k] for k in sorted(files)], [f"{bag}: {name}{k}{ending} is missing" for k in lacking]
    if len(found) > 1:
        names = ", ".join(str(path) for path in found)
        raise AbraceError(f"{bag}: several recordings and no {METADATA_FILE} in it, expected the name of one: {names}")
    return found, []


def _information(path: Path) -> dict[str, Any]:
    """The content of a bag's metadata.yaml."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loaded: dict[str, Any] = load_yaml(path.read_text(encoding="utf-8"), loader)["rosbag2_bagfile_information"]
    return loaded
