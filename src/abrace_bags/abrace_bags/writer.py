"""Writes a bag: MCAP files and their metadata.yaml, in rosbag2's layout, message by message."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.records import Channel, Schema

from abrace_bags.losses import TALLY_RECORD, Tally, is_numbered, tally_texts
from abrace_bags.mcap.file_writer import McapWriter
from abrace_bags.mcap.open_chunk import compressor
from abrace_bags.mcap.records import CHECKSUM_KEY, FACTS_RECORD, facts_checksum
from abrace_bags.metadata import DEFAULT_QOS, METADATA_FILE, FileSpan, bag_information, offered_qos, yaml_text
from abrace_core.errors import AbraceError
from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import TracebackType
    from typing import Self

    from mcap.records import Attachment

__all__ = ["BagWriter", "offered_qos"]

ROSBAG2_RECORD = "rosbag2"
"""Name of the metadata record that tells rosbag2 what metadata.yaml says."""
WRITTEN_RECORDS = (FACTS_RECORD, ROSBAG2_RECORD, TALLY_RECORD)
"""Names of the metadata records that a writer makes itself."""


class BagWriter:
    """A bag that is being written.

    Everything up to the last `flush` is readable after the process was killed, without `metadata.yaml`, which `close`
    writes. Leaving a `with` block closes the bag. A message's number in the file counts those of its topic from 1, over
    all files.

    Parameters
    ----------
    directory
        The bag: a directory that is not there yet.
    facts
        What is to be known of the run: rig, controller, record. Written first in each file.
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
        If the compression is unknown, or the directory is there already or can't be made.
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
        self._channels: dict[int, Channel] = {}
        self._topics: dict[int, dict[str, Any]] = {}
        self._tallies: dict[int, Tally] = {}
        self._files: list[FileSpan] = []
        try:
            self.directory.mkdir(parents=True)
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

    def add_topic(
        self, name: str, type_name: str, definition_text: str, type_hash: str, *qos: Mapping[str, Any]
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
            What each of its publishers offers, in rosbag2's words (`offered_qos`); what is not named is as for a
            reliable topic of depth 10.

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
        profiles = [{**DEFAULT_QOS, **profile} for profile in qos or ({},)]
        unknown = sorted({word for profile in profiles for word in profile} - set(DEFAULT_QOS))
        if unknown:
            raise AbraceError(f"bag {self.directory}: topic {name}: unknown QoS {unknown[0]!r}")
        numbered = is_numbered(definition_text)
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
        self._channels[topic_id] = channel
        self._file.add_channel(channel)
        self._tallies[topic_id] = Tally(numbered)
        self._topics[topic_id] = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": profiles,
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
        if self._full(log_time_ns):
            self.split()
        tally, span = self._tallies[topic_id], self._span
        try:
            self._file.add_message(topic_id, tally.messages + 1, payload, log_time_ns, publish_time_ns)
        except OSError as error:
            self._file.abandon()
            raise self._failure(error) from error
        tally.count(payload)
        span.counts[topic_id] = span.counts.get(topic_id, 0) + 1
        if log_time_ns > span.last_time:
            span.last_time = log_time_ns
        if log_time_ns < span.first_time:
            span.first_time = log_time_ns

    def interrupt(self) -> None:
        """What is left out from here to the next message of each topic is left out on purpose: no gap of `sequence`."""
        for tally in self._tallies.values():
            tally.last = None

    def add_lost(self, topic_id: int, lost: int) -> None:
        """Say how many more messages of a topic were lost.

        Parameters
        ----------
        topic_id
            From `add_topic`.
        lost
            Messages that were published and did not come to `write`.
        """
        self._tallies[topic_id].lost += lost

    def tallies(self) -> dict[str, Tally]:
        """Messages, gaps and losses until now, by topic."""
        return {topic["name"]: self._tallies[number] for number, topic in self._topics.items()}

    def flush(self) -> None:
        """Hand everything written so far to the operating system: it is then readable, come what may to this process.

        Ends the chunk; ten times a second costs nothing that can be seen.

        Raises
        ------
        AbraceError
            If the file can't be written: the bag is then closed as it is.
        """
        with self._failing():
            self._file.flush()

    def split(self) -> None:
        """Finish the file and go on in the next one.

        Raises
        ------
        AbraceError
            If a file can't be written: the bag is then closed as it is.
        """
        self._finish_file()
        self._open_file()

    def close(self) -> None:
        """Finish the file and write metadata.yaml. Closing again does nothing.

        Raises
        ------
        AbraceError
            If a file can't be written.
        """
        if self._file.closed:
            return
        with self._failing():
            self._file.flush()
            self._file.add_metadata(TALLY_RECORD, tally_texts(self.tallies()))
        self._finish_file()
        information = bag_information(self._topics, self._files, self._facts)
        write_text(self.directory / METADATA_FILE, yaml_text({"rosbag2_bagfile_information": information}))

    @property
    def file(self) -> Path:
        """The file that is being written."""
        return self.directory / self._span.name

    @property
    def closed(self) -> bool:
        """Whether nothing more can be written, after `close` or a failure."""
        return self._file.closed

    @property
    def _span(self) -> FileSpan:
        return self._files[-1]

    def _full(self, time: int) -> bool:
        """Whether a message that arrived at this time [ns] belongs into the next file."""
        if self._split_size and self._file.size - self._head_size >= self._split_size:
            return True
        return self._split_duration > 0 and time - self._span.first_time >= self._split_duration

    def _open_file(self, attachments: Sequence[Attachment] = ()) -> None:
        """Begin the next file with what each file holds, the first one with what is attached."""
        span = FileSpan(f"{self.directory.name}_{len(self._files)}.mcap", counts=dict.fromkeys(self._topics, 0))
        # without its head a file is none that readers know: it gets its name when it has one
        temporary = self.directory / f"{span.name}.part"
        try:
            self._file = McapWriter(temporary, *self._compressor)
        except OSError as error:
            raise self._failure(error) from error
        self._files.append(span)
        try:
            with self._failing():
                self._file.add_metadata(FACTS_RECORD, {**self._facts, CHECKSUM_KEY: facts_checksum(self._facts)})
                for name, texts in self._records.items():
                    self._file.add_metadata(name, texts)
                self._write_information()
                for schema in self._schemas.values():
                    self._file.add_schema(schema)
                for channel in self._channels.values():
                    self._file.add_channel(channel)
                for attachment in attachments:
                    self._file.add_attachment(attachment)
                self._file.flush()
                temporary.rename(self.file)
        except AbraceError:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise
        self._head_size = self._file.size

    def _finish_file(self) -> None:
        with self._failing():
            self._file.flush()
            self._write_information()
            self._file.finish(self._span)

    def _write_information(self) -> None:
        """What metadata.yaml would say of this file alone, in the file itself: rosbag2 reads a single file by it."""
        information = bag_information(self._topics, [self._span], self._facts)
        self._file.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": yaml_text(information).rstrip()})

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """What goes wrong with the file closes it as it is."""
        try:
            yield
        except OSError as error:
            self._file.abandon()
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> AbraceError:
        return AbraceError(f"cannot write bag {self.directory}: {error.strerror}")
