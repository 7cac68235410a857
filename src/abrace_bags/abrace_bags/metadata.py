# SPDX-License-Identifier: Apache-2.0
"""The metadata.yaml of a bag as rosbag2 0.26 writes it, and the versions of the recording software."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

METADATA_FILE = "metadata.yaml"

_METADATA_VERSION = 9
_ROS_DISTRO = "jazzy"
_LATEST = 2**63 - 1
_VERSIONS_OF = ("abrace_core", "abrace_interfaces", "mcap", "numpy", "rclpy")


@dataclass
class FileSpan:
    """What one file of a bag holds.

    Parameters
    ----------
    name
        Of the file, without its folder.
    first_time, last_time
        Earliest and latest time of arrival [ns].
    counts
        Messages by topic number.
    """

    name: str
    first_time: int = _LATEST
    last_time: int = 0
    counts: dict[int, int] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Messages in the file."""
        return sum(self.counts.values())


def bag_information(
    topics: Mapping[int, Mapping[str, Any]], files: Sequence[FileSpan], facts: Mapping[str, str]
) -> dict[str, Any]:
    """A bag's description with the keys of rosbag2's metadata.yaml.

    Parameters
    ----------
    topics
        `topic_metadata` by topic number.
    files
        All files of the bag, or the one that is to be described by itself.
    facts
        Facts of the run.
    """
    start, duration = _span(files)
    return {
        "version": _METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": sum(file.count for file in files),
        "topics_with_message_count": [
            {"topic_metadata": dict(topic), "message_count": sum(file.counts.get(number, 0) for file in files)}
            for number, topic in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file(file) for file in files],
        "custom_data": dict(facts) or None,
        "ros_distro": _ROS_DISTRO,
    }


def _file(file: FileSpan) -> dict[str, Any]:
    start, duration = _span([file])
    return {"path": file.name, "starting_time": start, "duration": duration, "message_count": file.count}


def _span(files: Sequence[FileSpan]) -> tuple[dict[str, int], dict[str, int]]:
    first = min(file.first_time for file in files)
    last = max(file.last_time for file in files)
    return {"nanoseconds_since_epoch": first}, {"nanoseconds": max(last - first, 0)}


class _Dumper(yaml.SafeDumper):
    """YAML without anchors, which rosbag2 doesn't write."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        return True


def yaml_text(content: Any) -> str:
    """YAML as rosbag2 writes it.

    Parameters
    ----------
    content
        Plain dicts, lists, numbers and texts.
    """
    return str(yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**16))


def installed_versions() -> dict[str, str]:
    """Versions of Python and of the installed packages that a bag depends on."""
    found = {"python": platform.python_version()}
    for package in _VERSIONS_OF:
        for name in (package, f"ros-jazzy-{package}"):
            try:
                found[package] = version(name)
                break
            except PackageNotFoundError:
                continue
    return found
