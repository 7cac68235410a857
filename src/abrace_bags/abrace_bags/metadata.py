# SPDX-License-Identifier: Apache-2.0
"""The metadata.yaml of a bag as rosbag2 0.26 writes it, and the versions of the recording software."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import yaml

from abrace_bags.mcap.records import LATEST_TIME
from abrace_core import __version__

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from abrace_bags.mcap.file_writer import WrittenTopic

METADATA_FILE = "metadata.yaml"

_METADATA_VERSION = 9
_ROS_DISTRO = "jazzy"
"""That of the wheels, with which no ROS_DISTRO is set."""
_VERSIONS_OF = ("abrace_interfaces", "mcap", "numpy", "rclpy")


def time_span(first: int, last: int) -> dict[str, dict[str, int]]:
    """Beginning and duration of what has these `first` and `last` log times [ns], as rosbag2 writes them."""
    return {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": max(last - first, 0)},
    }


def bag_information(
    topics: Collection[WrittenTopic], files: Sequence[Mapping[str, Any]], facts: Mapping[str, str]
) -> dict[str, Any]:
    """The content of metadata.yaml: of a bag with these `topics`, these entries of its `files`, the run's `facts`."""
    spans = [one.content for one in topics if one.content.messages]
    return {
        "rosbag2_bagfile_information": {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            **time_span(
                min((one.first_time or 0 for one in spans), default=LATEST_TIME),
                max((one.last_time or 0 for one in spans), default=0),
            ),
            "message_count": sum(one.messages for one in spans),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": one.channel.topic,
                        "type": one.schema.name,
                        "serialization_format": one.channel.message_encoding,
                        "offered_qos_profiles": one.profiles,
                        "type_description_hash": one.channel.metadata["topic_type_hash"],
                    },
                    "message_count": one.content.messages,
                }
                for one in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file["path"] for file in files],
            "files": list(files),
            "custom_data": dict(facts) or None,
            "ros_distro": os.environ.get("ROS_DISTRO", _ROS_DISTRO),
        }
    }


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
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
    found = {"python": platform.python_version(), "abrace_core": __version__}
    for package in _VERSIONS_OF:
        for name in (package, f"ros-jazzy-{package}"):
            try:
                found[package] = version(name)
                break
            except PackageNotFoundError:
                continue
    return found
