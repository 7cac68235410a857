# SPDX-License-Identifier: Apache-2.0
"""Writes a bag message by message: MCAP files and their metadata.yaml, in rosbag2's layout."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.records import Channel, Schema

from abrace_bags.losses import COUNTS_RECORD, TopicCounts, counts_record, is_numbered, sequence_number
from abrace_bags.mcap.chunk_writer import compressor
from abrace_bags.mcap.file_writer import McapWriter
from abrace_bags.mcap.records import CHECKSUM_KEY, FACTS_RECORD, facts_checksum
from abrace_bags.metadata import METADATA_FILE, FileSpan, bag_information, yaml_text
from abrace_bags.qos import DEFAULT_QOS, in_words
from abrace_core.errors import AbraceError
from abrace_core.files import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import TracebackType
    from typing import Self

    from mcap.records import Attachment
    from rosbags.interfaces import Qos

ROSBAG2_RECORD = "rosbag2"
"""Name of the metadata record with the content of metadata.yaml, for rosbag2."""
WRITTEN_RECORDS = (FACTS_RECORD, ROSBAG2_RECORD, COUNTS_RECORD)
"""Names of the metadata records that every bag has."""


class BagWriter:
    """A bag that is being written.

    Everything up to the last `flush` is readable after the process was killed, everything up to the last `sync` after a
    power loss, without `metadata.yaml`: that is written by `close`, and when a file can't be written. Leaving a `with`
    block closes the bag. MCAP's sequence number of a message counts those of its topic from 1, over all files.

    Parameters
    ----------
    directory
        The bag: a directory that does not exist yet.
    facts
        Of the run, by name: rig, controller, record. Written first in each file.
    records
        Further metadata records by name, texts by key: versions, parameters.
    attachments
        Files of the run (`file_attachments`), for the first file.
    compression
        Of the chunks: `zstd`, `lz4` or `none`.
    split_size
        Bytes of messages, as compressed, after which the next file begins; 0: never.
    split_duration
        Seconds after which the next file begins; 0: never.

    Raises
    ------
    AbraceError
        If the compression is unknown, or the directory exists already or can't be made.
    """

    def __init__(
        self,
        directory: Path | str,
        facts: Mapping[str, str],
        *,
        records: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Sequence[Attachment] = (),
        compression: str = "zstd",
        split_size: int = 0,
        split_duration: float = 0.0,
    ) -> None:
        if CHECKSUM_KEY in facts:
            raise AbraceError(f"a run's facts can't have the name {CHECKSUM_KEY!r}")
        self.directory = Path(directory)
        self._facts = dict(facts)
        self._records = dict(records or {})
        self._compressor = compressor(compression)
        self._split_size = split_size
        self._split_duration = round(split_duration * 1e9)
        self._schemas: dict[tuple[str, str], Schema] = {}
        self._channels: list[Channel] = []
        self._topics: dict[int, dict[str, Any]] = {}
        self._counts: dict[int, TopicCounts] = {}
        self._files: list[FileSpan] = []
        self._closed = False
        try:
            make_folder(self.directory, new=True)
        except FileExistsError as error:
            raise AbraceError(f"bag {self.directory} exists already, expected a new directory") from error
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._open_file(attachments)
        except BaseException:
            shutil.rmtree(self.directory, ignore_errors=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add_topic(self, name: str, type_name: str, definition_text: str, type_hash: str, *qos: Qos) -> int:
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
            Of each of its publishers; `DEFAULT_QOS` if none is given.

        Returns
        -------
        int
            The topic's number, for `write`.

        Raises
        ------
        AbraceError
            If the topic is in the bag already, or the bag is closed.
        """
        self._check_open()
        if any(topic["name"] == name for topic in self._topics.values()):
            raise AbraceError(f"bag {self.directory}: topic {name} is in it already")
        profiles = [in_words(profile) for profile in qos or (DEFAULT_QOS,)]
        described = type_name, definition_text
        if described not in self._schemas:
            schema = Schema(
                id=len(self._schemas) + 1, name=type_name, encoding="ros2msg", data=definition_text.encode()
            )
            self._schemas[described] = schema
            self._file.add_schema(schema)
        topic_id = len(self._channels) + 1
        channel = Channel(
            id=topic_id,
            topic=name,
            message_encoding="cdr",
            schema_id=self._schemas[described].id,
            metadata={"offered_qos_profiles": yaml_text(profiles).rstrip(), "topic_type_hash": type_hash},
        )
        self._channels.append(channel)
        self._file.add_channel(channel)
        self._counts[topic_id] = TopicCounts(is_numbered(definition_text))
        self._topics[topic_id] = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": profiles,
            "type_description_hash": type_hash,
        }
        return topic_id

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write a message.

        Parameters
        ----------
        topic_id
            From `add_topic`.
        payload
            The serialised message.
        log_time_ns, publish_time_ns
            When it was received and when it was published [ns].

        Raises
        ------
        AbraceError
            If a time is negative, the bag is closed, or the file can't be written: the bag is then closed as it is.
        """
        if self._closed:
            self._check_open()
        if log_time_ns < 0 or publish_time_ns < 0:
            times = f"message at {log_time_ns} ns, published at {publish_time_ns} ns"
            raise AbraceError(f"bag {self.directory}: {times}, expected 0 or more")
        if self._full(log_time_ns):
            self.split()
        counts, span = self._counts[topic_id], self._span
        full = self._file.add_message(topic_id, counts.messages + 1, payload, log_time_ns, publish_time_ns)
        counts.messages += 1
        if counts.numbered:
            counts.add(sequence_number(payload))
        span.counts[topic_id] = span.counts.get(topic_id, 0) + 1
        if log_time_ns > span.last_time:
            span.last_time = log_time_ns
        if log_time_ns < span.first_time:
            span.first_time = log_time_ns
        if full:
            self.flush()

    def interrupt(self) -> None:
        """Count no gap of `sequence` before the next message of each topic: those before it are not to be recorded."""
        for counts in self._counts.values():
            counts.restart()

    def add_lost(self, topic_id: int, lost: int) -> None:
        """Count messages as lost.

        Parameters
        ----------
        topic_id
            From `add_topic`.
        lost
            How many more of its messages were published and did not come to `write`.
        """
        self._counts[topic_id].lost += lost

    def counts(self) -> dict[str, TopicCounts]:
        """Messages, gaps and losses until now, by topic."""
        return {topic["name"]: self._counts[number] for number, topic in self._topics.items()}

    def flush(self) -> None:
        """Hand everything written so far to the operating system: it is readable even if this process is killed.

        Ends the chunk; ten times a second is no load.

        Raises
        ------
        AbraceError
            If the bag is closed, or the file can't be written: the bag is then closed as it is.
        """
        self._check_open()
        with self._closed_on_failure():
            self._file.flush()

    def sync(self) -> None:
        """As `flush`, and wait until it is on the disk: it is readable even after a power loss.

        Raises
        ------
        AbraceError
            As `flush`.
        """
        self._check_open()
        with self._closed_on_failure():
            self._file.sync()

    def split(self) -> None:
        """Finish the file and go on in the next one.

        Raises
        ------
        AbraceError
            If the bag is closed, or a file can't be written: the bag is then closed as it is.
        """
        self._check_open()
        self._finish_file()
        self._open_file()

    def close(self) -> None:
        """Finish the file and write metadata.yaml. Closing again does nothing.

        Raises
        ------
        AbraceError
            If a file can't be written.
        """
        if self._closed:
            return
        with self._closed_on_failure():
            self._file.flush()
            self._file.add_metadata(COUNTS_RECORD, counts_record(self.counts()))
        self._finish_file()
        self._closed = True
        self._write_metadata()

    @property
    def file(self) -> Path:
        """The file that is being written."""
        return self._file.path

    @property
    def closed(self) -> bool:
        """Whether nothing more can be written, after `close` or a failure."""
        return self._closed

    def _check_open(self) -> None:
        if self._closed:
            raise AbraceError(f"bag {self.directory} is closed")

    def _full(self, time: int) -> bool:
        """Whether a message received at this time [ns] belongs in the next file."""
        if self._split_size and self._file.size - self._head_size >= self._split_size:
            return True
        return self._split_duration > 0 and time - self._span.first_time >= self._split_duration

    def _open_file(self, attachments: Sequence[Attachment] = ()) -> None:
        """Begin the next file: facts, records, types and topics, in the first one the attachments."""
        span = FileSpan(f"{self.directory.name}_{len(self._files)}.mcap", counts=dict.fromkeys(self._topics, 0))
        with self._closed_on_failure():
            self._file = McapWriter(self.directory / span.name, *self._compressor)
            self._file.add_metadata(FACTS_RECORD, {**self._facts, CHECKSUM_KEY: facts_checksum(self._facts)})
            for name, texts in self._records.items():
                self._file.add_metadata(name, texts)
            self._write_information(span)
            for schema in self._schemas.values():
                self._file.add_schema(schema)
            for channel in self._channels:
                self._file.add_channel(channel)
            for attachment in attachments:
                self._file.add_attachment(attachment)
            self._file.publish()
        self._span = span
        self._files.append(span)
        self._head_size = self._file.size

    def _finish_file(self) -> None:
        with self._closed_on_failure():
            self._file.flush()
            self._write_information(self._span)
            self._file.finish(self._span)

    def _write_information(self, span: FileSpan) -> None:
        """Write into the file a metadata.yaml for this file only, with which rosbag2 reads a single file."""
        information = bag_information(self._topics, [span], self._facts)
        self._file.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": yaml_text(information).rstrip()})

    def _write_metadata(self) -> None:
        information = bag_information(self._topics, self._files, self._facts)
        write_text(self.directory / METADATA_FILE, yaml_text({"rosbag2_bagfile_information": information}))

    @contextlib.contextmanager
    def _closed_on_failure(self) -> Iterator[None]:
        """When a file can't be written, close the bag as it is, with metadata.yaml if that can be written."""
        try:
            yield
        except OSError as error:
            self._closed = True
            if self._files:
                for topic_id, count in self._file.abandon().items():
                    self._span.counts[topic_id] -= count
                with contextlib.suppress(AbraceError):
                    self._write_metadata()
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> AbraceError:
        return AbraceError(f"cannot write bag {self.directory}: {error.strerror}")
