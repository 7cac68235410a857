# SPDX-License-Identifier: Apache-2.0
"""Writes a bag message by message: MCAP files and their metadata.yaml, in rosbag2's layout."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.records import Channel, Schema

from abrace_bags.mcap.contents import COUNTS_RECORD, TopicContent, counts_record
from abrace_bags.mcap.file_writer import McapWriter, WrittenTopic
from abrace_bags.mcap.records import (
    CHECKSUM_KEY,
    FACTS_RECORD,
    LARGEST_MESSAGE,
    LARGEST_TEXTS,
    LATEST_TIME,
    facts_checksum,
    record_bytes,
)
from abrace_bags.metadata import METADATA_FILE, bag_information, time_span, yaml_text
from abrace_bags.qos import DEFAULT_QOS, in_words
from abrace_bags.topics import every_of
from abrace_core import AbraceError
from abrace_core.files.writing import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from types import TracebackType
    from typing import Self

    from mcap.records import Attachment
    from rosbags.interfaces import Qos

WRITTEN_RECORDS = (FACTS_RECORD, COUNTS_RECORD)
"""Names of the metadata records that every bag has."""
INDEX_MEMORY = 64 * 1024 * 1024
"""Bytes of a file's index, which stay in memory until the file ends, after which the next file begins in any case: some
18 hours at ten flushes a second."""
_NEVER = 2**64


class BagWriter:
    """A bag that is being written.

    Everything up to the last `flush` is readable after the process was killed, everything up to the last `sync` after a
    power loss, without `metadata.yaml`: that is written by `close`, and when a file can't be written. Leaving a `with`
    block closes the bag. MCAP's sequence number of a message counts those of its topic from 1, over all files.

    What readers would take for damaged is refused with an AbraceError, and changes nothing.

    Parameters
    ----------
    directory
        The bag: a directory that does not exist yet.
    facts
        Of the run, by name: rig, controller, record; `every of TOPIC` (`topics.EVERY`) where of so many messages one
        is written. Written first in each file.
    records
        Further metadata records by name, texts by key: versions, parameters.
    attachments
        Files of the run (`file_attachments`), for the first file.
    split_size
        Bytes of messages, as compressed, after which the next file begins; 0: at `INDEX_MEMORY`.
    split_duration
        Seconds after which the next file begins; 0: never.

    Raises
    ------
    AbraceError
        If facts or records are no texts, a record or an attachment is too large, or the directory exists already or
        can't be made.
    """

    def __init__(
        self,
        directory: Path | str,
        facts: Mapping[str, str],
        *,
        records: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Iterable[Attachment] = (),
        split_size: int = 0,
        split_duration: float = 0.0,
    ) -> None:
        self.directory = Path(directory)
        self._facts = self._texts("fact", facts)
        self._records = {name: self._texts(f"record {name}:", texts) for name, texts in (records or {}).items()}
        if taken := self._records.keys() & set(WRITTEN_RECORDS):
            raise self._error(f"record {min(taken)}: every bag has one of this name, expected another name")
        if CHECKSUM_KEY in facts:
            raise self._error(f"fact {CHECKSUM_KEY}: it is written with the facts, expected another name")
        self._split_size = split_size or _NEVER
        self._split_duration = round(split_duration * 1e9) or _NEVER
        self._schemas: dict[tuple[str, str, str], Schema] = {}
        self._topics: dict[int, WrittenTopic] = {}
        self._room = LARGEST_TEXTS
        self._files: list[dict[str, Any]] = []
        self._closed = False
        try:
            make_folder(self.directory, new=True)
        except FileExistsError as error:
            raise AbraceError(f"bag {self.directory} exists already, expected a new directory") from error
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._open_file(map(self._checked, attachments))
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
        self,
        name: str,
        type_name: str,
        definition_text: str,
        type_hash: str,
        *qos: Qos,
        encoding: str = "ros2msg",
        message_encoding: str = "cdr",
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
            Of each of its publishers; `DEFAULT_QOS` if none is given.
        encoding
            How the definition is written: `ros2msg` or `ros2idl`. One that is no text has its bytes as Python's
            `surrogateescape` has them.
        message_encoding
            How the messages are serialised.

        Returns
        -------
        int
            The topic's number, for `write`.

        Raises
        ------
        AbraceError
            If the topic is in the bag already, something of it is no text, there are too many topics, or the bag is
            closed.
        """
        self._check_open()
        for text in (name, type_name, type_hash):
            self._check_text(f"topic {name!r}", text)
        definition = self._check_text(f"topic {name!r}", definition_text, "surrogateescape")
        if any(topic.channel.topic == name for topic in self._topics.values()):
            raise self._error(f"topic {name} is in it already")
        described = type_name, definition_text, encoding
        schema = self._schemas.get(described)
        new = schema is None
        schema = schema or Schema(id=len(self._schemas) + 1, name=type_name, encoding=encoding, data=definition)
        profiles = [in_words(profile) for profile in qos or (DEFAULT_QOS,)]
        topic_id = len(self._topics) + 1
        channel = Channel(
            id=topic_id,
            topic=name,
            message_encoding=message_encoding,
            schema_id=schema.id,
            metadata={"offered_qos_profiles": yaml_text(profiles).rstrip(), "topic_type_hash": type_hash},
        )
        taken = len(record_bytes(channel)) + (len(record_bytes(schema)) if new else 0)
        if taken > self._room:
            raise self._error(f"topic {name}: the descriptions of all topics are too large for a bag")
        self._room -= taken
        self._topics[topic_id] = WrittenTopic(
            schema=schema,
            channel=channel,
            profiles=profiles,
            content=TopicContent.of(definition_text, every_of(self._facts, name)),
        )
        if new:
            self._schemas[described] = schema
            self._file.describe(schema)
        self._file.describe(channel)
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
            When it was received and when it was published [ns], from 0 to 2^63 - 1.

        Raises
        ------
        AbraceError
            If the message can't be in a bag, or the bag is closed; or if the file can't be written: the bag is then
            closed as it is.
        """
        if self._closed:
            self._check_open()
        topic = self._topics.get(topic_id)
        if (
            topic is None
            or not isinstance(payload, bytes)
            or len(payload) > LARGEST_MESSAGE
            or not 0 <= log_time_ns <= LATEST_TIME
            or not 0 <= publish_time_ns <= LATEST_TIME
        ):
            raise self._refusal(topic, topic_id, payload, log_time_ns, publish_time_ns)
        if log_time_ns >= self._end_time or self._file.size >= self._end_size:
            self._next_file(log_time_ns)
        if self._file.add_message(topic, payload, log_time_ns, publish_time_ns):
            self.flush()

    def add_lost(self, topic_id: int, lost: int | None) -> None:
        """Count messages as lost.

        Parameters
        ----------
        topic_id
            From `add_topic`.
        lost
            How many more of its messages were published and did not come to `write`; None: nobody knows.

        Raises
        ------
        AbraceError
            If there is no such topic.
        """
        if topic_id not in self._topics:
            raise self._refusal(None, topic_id)
        content = self._topics[topic_id].content
        content.lost = None if lost is None or content.lost is None else content.lost + lost

    def contents(self) -> dict[str, TopicContent]:
        """Messages, gaps and losses until the last flush, by topic."""
        return {topic.channel.topic: topic.content for topic in self._topics.values()}

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
        if self._file.index_size > INDEX_MEMORY:
            self._end_size = 0

    def sync(self) -> None:
        """As `flush`, and wait until it is on the disk: it is readable even after a power loss.

        Raises
        ------
        AbraceError
            As `flush`.
        """
        self.flush()
        with self._closed_on_failure():
            self._file.sync()

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
            self._file.add_metadata(COUNTS_RECORD, counts_record(self.contents()))
        self._finish_file()
        self._closed = True
        self._write_metadata()

    @property
    def file(self) -> Path:
        """The file that is being written."""
        return self._file.path

    def _check_open(self) -> None:
        if self._closed:
            raise AbraceError(f"bag {self.directory} is closed")

    def _texts(self, what: str, texts: Mapping[str, str]) -> dict[str, str]:
        """A copy of `texts` by key, which can be written."""
        for key, text in texts.items():
            self._check_text(f"{what} {key!r}", key)
            self._check_text(f"{what} {key!r}", text)
        return dict(texts)

    def _check_text(self, what: str, text: str, errors: str = "strict") -> bytes:
        if not isinstance(text, str):
            raise self._error(f"{what}: {text!r}, expected a text")
        try:
            return text.encode(errors=errors)
        except UnicodeEncodeError as error:
            raise self._error(f"{what}: {text[error.start]!r} in it is no character") from error

    def _checked(self, attachment: Attachment) -> Attachment:
        self._check_text(f"attachment {attachment.name!r}", attachment.name)
        return attachment

    def _refusal(
        self, topic: WrittenTopic | None, topic_id: int, payload: object = b"", log_time: int = 0, publish_time: int = 0
    ) -> AbraceError:
        """Why a message can't be in a bag."""
        if topic is None:
            return self._error(f"no topic has the number {topic_id}, expected one from add_topic")
        what = f"message of {topic.channel.topic}"
        if not isinstance(payload, bytes):
            return self._error(f"{what}: is a {type(payload).__name__}, expected bytes")
        if len(payload) > LARGEST_MESSAGE:
            return self._error(f"{what}: has {len(payload)} bytes, expected at most {LARGEST_MESSAGE}")
        return self._error(f"{what}: at {log_time} ns, published at {publish_time} ns, expected 0 to 2^63 - 1")

    def _open_file(self, attachments: Iterable[Attachment] = ()) -> None:
        """Begin the next file: facts, records, types and topics, in the first one the attachments."""
        path = self.directory / f"{self.directory.name}_{len(self._files)}.mcap"
        records = {FACTS_RECORD: {**self._facts, CHECKSUM_KEY: facts_checksum(self._facts)}, **self._records}
        with self._closed_on_failure():
            self._file = McapWriter(path, self._topics.values(), records, attachments)
        self._files.append({})
        # the first message begins the time of the file
        self._end_time, self._end_size = 0, self._file.size + self._split_size

    def _next_file(self, time: int) -> None:
        """Begin the file for a message of this `time` [ns], unless it is the first one of a file."""
        if self._end_time:
            self._finish_file()
            self._open_file()
        self._end_time = time + self._split_duration

    def _finish_file(self) -> None:
        with self._closed_on_failure():
            self._file.finish()
        self._describe_file()

    def _describe_file(self) -> None:
        """Note what the file that is being written holds, for metadata.yaml."""
        span = time_span(self._file.first_time, self._file.last_time)
        self._files[-1] = {"path": self.file.name, **span, "message_count": self._file.count}

    def _write_metadata(self) -> None:
        information = bag_information(self._topics.values(), self._files, self._facts)
        write_text(self.directory / METADATA_FILE, yaml_text(information))

    @contextlib.contextmanager
    def _closed_on_failure(self) -> Iterator[None]:
        """When a file can't be written, close the bag as it is, with metadata.yaml if that can be written."""
        try:
            yield
        except OSError as error:
            self._closed = True
            if self._files:
                self._file.abandon()
                self._describe_file()
                with contextlib.suppress(AbraceError):
                    self._write_metadata()
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> AbraceError:
        return AbraceError(f"cannot write bag {self.directory}: {error.strerror}")

    def _error(self, what: str) -> AbraceError:
        return AbraceError(f"bag {self.directory}: {what}")
