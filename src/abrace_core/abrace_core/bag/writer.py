"""Writes a bag: an MCAP file and its metadata.yaml, in rosbag2's layout, message by message."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from mcap.writer import CompressionType, Writer

from abrace_core.bag.mcap_records import CHECKSUM_KEY, FACTS_RECORD, facts_checksum
from abrace_core.errors import AbraceError
from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType
    from typing import Self

CHUNK_SIZE = 64 * 1024
"""Bytes of messages in a chunk [before compression]: what a process that is killed may lose."""

_METADATA_VERSION = 9
_ROS_DISTRO = "jazzy"
_LATEST = 2**63 - 1
_FOREVER = {"sec": _LATEST // 10**9, "nsec": _LATEST % 10**9}
_DEFAULT_QOS = {
    "history": "keep_last",
    "depth": 10,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}


def offered_qos(profile: Any) -> dict[str, Any]:
    """A QoS profile as bags tell it, for `BagWriter.add_topic`.

    Parameters
    ----------
    profile
        An `rclpy.qos.QoSProfile`.
    """
    return {
        "history": profile.history.short_key,
        "depth": profile.depth,
        "reliability": profile.reliability.short_key,
        "durability": profile.durability.short_key,
        "deadline": _duration(profile.deadline),
        "lifespan": _duration(profile.lifespan),
        "liveliness": profile.liveliness.short_key,
        "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _duration(duration: Any) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


class BagWriter:
    """A bag that is being written.

    Everything up to the last `flush` is readable after the process was killed, without `metadata.yaml`, which `close`
    writes. Leaving a `with` block closes the bag.

    Parameters
    ----------
    directory
        The bag: a directory that is not there yet.
    facts
        What is to be known of the run: rig, controller, record, versions. Written first of all.

    Raises
    ------
    AbraceError
        If the directory is there already or can't be made.
    """

    def __init__(self, directory: Path | str, facts: Mapping[str, str]) -> None:
        if CHECKSUM_KEY in facts:
            raise AbraceError(f"a run's facts can't have the name {CHECKSUM_KEY!r}")
        self.directory = Path(directory)
        self._facts = dict(facts)
        self._schemas: dict[str, int] = {}
        self._topics: dict[int, dict[str, Any]] = {}
        self._counts: dict[int, int] = {}
        self._first_time = _LATEST
        self._last_time = 0
        self._path = self.directory / f"{self.directory.name}_0.mcap"
        try:
            self.directory.mkdir(parents=True)
            self._file = self._path.open("xb")
        except FileExistsError as error:
            raise AbraceError(f"bag {self.directory} exists already, expected a new directory") from error
        except OSError as error:
            raise self._failure(error) from error
        self._writer = Writer(
            self._file,
            chunk_size=CHUNK_SIZE,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        try:
            self._writer.start("ros2", "abrace")
            self._writer.add_metadata(FACTS_RECORD, {**self._facts, CHECKSUM_KEY: facts_checksum(self._facts)})
            self._write_information()
            self._file.flush()
        except OSError as error:
            self._abandon()
            raise self._failure(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add_topic(
        self, name: str, type_name: str, definition_text: str, type_hash: str, qos: Mapping[str, Any] | None = None
    ) -> int:
        """Announce a topic.

        Parameters
        ----------
        name
            The topic, as `/response`.
        type_name
            Its type, as `abrace_interfaces/msg/Response`.
        definition_text, type_hash
            As `message_definition` finds them.
        qos
            Its QoS in rosbag2's words (`offered_qos`); what is not named is as for a reliable topic of depth 10.

        Returns
        -------
        int
            The topic's number, for `write`.

        Raises
        ------
        AbraceError
            If the topic is in the bag already, or a word of `qos` is unknown.
        """
        if any(topic["name"] == name for topic in self._topics.values()):
            raise AbraceError(f"bag {self.directory}: topic {name} is in it already")
        profile = {**_DEFAULT_QOS, **(qos or {})}
        unknown = sorted(set(profile) - set(_DEFAULT_QOS))
        if unknown:
            raise AbraceError(f"bag {self.directory}: topic {name}: unknown QoS {unknown[0]!r}")
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", definition_text.encode())
        details = {"offered_qos_profiles": _yaml([profile]).rstrip(), "topic_type_hash": type_hash}
        topic_id = self._writer.register_channel(name, "cdr", self._schemas[type_name], details)
        self._counts[topic_id] = 0
        self._topics[topic_id] = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [profile],
            "type_description_hash": type_hash,
        }
        return topic_id

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write a message as it came from the wire.

        Parameters
        ----------
        topic_id
            From `add_topic`.
        payload
            The serialised message.
        log_time_ns, publish_time_ns
            When it arrived and when it was published [ns].

        Raises
        ------
        AbraceError
            If a time is negative, or the file can't be written: the bag is then closed as it is.
        """
        if log_time_ns < 0 or publish_time_ns < 0:
            raise AbraceError(f"bag {self.directory}: message at {log_time_ns} ns, published at {publish_time_ns} ns")
        try:
            self._writer.add_message(topic_id, log_time_ns, payload, publish_time_ns)
        except OSError as error:
            self._abandon()
            raise self._failure(error) from error
        self._counts[topic_id] += 1
        if log_time_ns > self._last_time:
            self._last_time = log_time_ns
        if log_time_ns < self._first_time:
            self._first_time = log_time_ns

    def flush(self) -> None:
        """Hand everything written so far to the operating system: it is then readable, come what may to this process.

        Ends the chunk; ten times a second costs nothing that can be seen.

        Raises
        ------
        AbraceError
            If the file can't be written: the bag is then closed as it is.
        """
        try:
            self._writer.flush()
        except OSError as error:
            self._abandon()
            raise self._failure(error) from error

    def close(self) -> None:
        """Finish the file and write metadata.yaml. Closing again does nothing.

        Raises
        ------
        AbraceError
            If a file can't be written.
        """
        if self._file.closed:
            return
        try:
            self._writer.flush()
            self._write_information()
            self._writer.finish()
            self._file.close()
        except OSError as error:
            self._abandon()
            raise self._failure(error) from error
        write_text(self.directory / "metadata.yaml", _yaml({"rosbag2_bagfile_information": self._information()}))

    def _write_information(self) -> None:
        """What metadata.yaml says, in the file itself: rosbag2 reads a single file by it."""
        self._writer.add_metadata("rosbag2", {"serialized_metadata": _yaml(self._information()).rstrip()})

    def _information(self) -> dict[str, Any]:
        """The bag's description in the words of rosbag2's metadata.yaml."""
        count = sum(self._counts.values())
        duration = {"nanoseconds": max(self._last_time - self._first_time, 0)}
        start = {"nanoseconds_since_epoch": self._first_time}
        return {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                {"topic_metadata": topic, "message_count": self._counts[topic_id]}
                for topic_id, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._path.name],
            "files": [{"path": self._path.name, "starting_time": start, "duration": duration, "message_count": count}],
            "custom_data": self._facts or None,
            "ros_distro": _ROS_DISTRO,
        }

    def _abandon(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()

    def _failure(self, error: OSError) -> AbraceError:
        return AbraceError(f"cannot write bag {self.directory}: {error.strerror}")


class _Dumper(yaml.SafeDumper):
    """YAML without anchors, which rosbag2 doesn't write."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        return True


def _yaml(content: Any) -> str:
    return str(yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=2**16))
