# SPDX-License-Identifier: Apache-2.0
"""MCAP files in every form that its specification leaves open: chunks, indexes, repeated records, padding, checksums.

The variety is that of the conformance files of foxglove/mcap (`ch` chunks, `mx` message indexes, `chx` chunk index,
`rch` and `rsh` repeated channels and schemas, `ax` and `mdx` indexes of attachments and metadata, `st` statistics,
`sum` summary offsets, `pad` further fields at a record's end); `nocrc` leaves out all checksums.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import Counter
from typing import TYPE_CHECKING

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from abrace_bags import Bag, describe, recover

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"
FEATURES = ("ch", "mx", "chx", "rch", "rsh", "ax", "mdx", "st", "sum", "pad")
_NEEDED = {"ch": (Schema, Channel), "rch": (Channel,), "rsh": (Schema,), "ax": (Attachment,), "mdx": (Metadata,)}
_REQUIRES = {"mx": ("ch",), "chx": ("ch",), "sum": ("chx", "rch", "rsh", "ax", "mdx", "st")}
_PADDING = b"\x01\xff\xff"


def string_type(records: str = "std_msgs/msg/String") -> Schema:
    """The schema of a text."""
    return Schema(id=1, name=records, encoding="ros2msg", data=b"string data\n")


def text_message(text: str, time: int, sequence: int = 1, channel: int = 1) -> Message:
    """A message of a std_msgs/String."""
    content = text.encode() + b"\0"
    data = b"\0\1\0\0" + struct.pack("<I", len(content)) + content
    return Message(channel_id=channel, log_time=time, publish_time=time + 1, sequence=sequence, data=data)


def inputs() -> dict[str, list[McapRecord]]:
    """What files hold, by a name: nothing, one record of each kind, messages out of the order of their times."""
    channel = Channel(id=1, topic="/text", message_encoding="cdr", schema_id=1, metadata={"origin": "test"})
    plain = Channel(id=2, topic="/plain", message_encoding="text", schema_id=0, metadata={})
    several = [text_message(f"number {number}", time, number) for number, time in enumerate((0, 2, 1, 3, 3, 5, 4, 9))]
    return {
        "NoData": [],
        "OneMessage": [string_type(), channel, text_message("one", 1000)],
        "OneSchemalessMessage": [
            plain,
            Message(channel_id=2, log_time=7, data=b"no schema", publish_time=8, sequence=3),
        ],
        "OneAttachment": [
            Attachment(create_time=1, log_time=2, name="rig.yaml", media_type="text/yaml", data=b"floors: 3\n")
        ],
        "OneMetadata": [Metadata("notes", {"who": "nobody", "what": "test"})],
        "SeveralMessages": [string_type(), channel, *several],
    }


def variants(records: Sequence[McapRecord]) -> Iterator[tuple[str, ...]]:
    """The features that a file of these `records` can have."""
    for chosen in itertools.product((False, True), repeat=len(FEATURES)):
        features = tuple(itertools.compress(FEATURES, chosen))
        lacking = [one for one in features if one in _NEEDED and not any(isinstance(r, _NEEDED[one]) for r in records)]
        alone = [one for one in features if one in _REQUIRES and not set(_REQUIRES[one]) & set(features)]
        if not lacking and not alone:
            yield features


def variant(records: Sequence[McapRecord], features: Collection[str]) -> bytes:
    """A file of these `records` with these `features`."""
    return _File(records, features).content


class _File:
    def __init__(self, records: Sequence[McapRecord], features: Collection[str]) -> None:
        self._features = features
        self.content = MAGIC
        self._add(Header("", ""))
        indexes: list[McapRecord] = []
        in_chunk: list[McapRecord] = []
        for record in records:
            if "ch" in features and isinstance(record, Schema | Channel | Message):
                in_chunk.append(record)
                continue
            offset = len(self.content)
            self._add(record)
            length = len(self.content) - offset
            if isinstance(record, Attachment) and "ax" in features:
                indexes.append(
                    AttachmentIndex(
                        offset=offset,
                        length=length,
                        log_time=record.log_time,
                        create_time=record.create_time,
                        data_size=len(record.data),
                        name=record.name,
                        media_type=record.media_type,
                    )
                )
            if isinstance(record, Metadata) and "mdx" in features:
                indexes.append(MetadataIndex(offset, length, record.name))
        messages = [record for record in records if isinstance(record, Message)]
        if "ch" in features and in_chunk:
            indexes += self._add_chunk(in_chunk, messages)
        self._add(DataEnd(self._checksum(self.content)))
        self._add_summary(records, messages, indexes)

    def _checksum(self, content: bytes) -> int:
        return 0 if "nocrc" in self._features else zlib.crc32(content)

    def _add(self, record: McapRecord) -> None:
        content = _record_bytes(record)
        if "pad" in self._features and not isinstance(record, Footer | DataEnd | Message | Chunk):
            size = len(content) - 9 + len(_PADDING)
            content = content[:1] + struct.pack("<Q", size) + content[9:] + _PADDING
        if isinstance(record, Attachment) and "nocrc" in self._features:
            end = len(content) - len(_PADDING) * ("pad" in self._features)
            content = content[: end - 4] + bytes(4) + content[end:]
        self.content += content

    def _add_chunk(self, records: list[McapRecord], messages: list[Message]) -> list[McapRecord]:
        data = b""
        places: dict[int, list[tuple[int, int]]] = {}
        for record in records:
            if isinstance(record, Channel):
                places[record.id] = []
            if isinstance(record, Message):
                places[record.channel_id].append((record.log_time, len(data)))
            data += _record_bytes(record)
        first, last = (chosen([message.log_time for message in messages], default=0) for chosen in (min, max))
        offset = len(self.content)
        chunk = Chunk(
            compression="",
            data=data,
            message_end_time=last,
            message_start_time=first,
            uncompressed_crc=self._checksum(data),
            uncompressed_size=len(data),
        )
        self._add(chunk)
        length = len(self.content) - offset
        found = {}
        if "mx" in self._features:
            for channel, timed in places.items():
                if timed:
                    found[channel] = len(self.content)
                    self._add(MessageIndex(channel, timed))
        if "chx" not in self._features:
            return []
        of_indexes = len(self.content) - offset - length
        return [
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression="",
                compressed_size=len(data),
                message_end_time=last,
                message_index_length=of_indexes,
                message_index_offsets=found,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        ]

    def _add_summary(self, records: Sequence[McapRecord], messages: list[Message], indexes: list[McapRecord]) -> None:
        kinds = Counter(map(type, records))
        times = [message.log_time for message in messages]
        statistics = Statistics(
            attachment_count=kinds[Attachment],
            channel_count=kinds[Channel],
            channel_message_counts=dict(Counter(message.channel_id for message in messages)),
            chunk_count=int("ch" in self._features and bool(kinds[Channel])),
            message_count=len(messages),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=kinds[Metadata],
            schema_count=kinds[Schema],
        )
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [one for one in records if isinstance(one, Schema) and "rsh" in self._features]),
            (Opcode.CHANNEL, [one for one in records if isinstance(one, Channel) and "rch" in self._features]),
            (Opcode.STATISTICS, [statistics] if "st" in self._features else []),
            (Opcode.METADATA_INDEX, [one for one in indexes if isinstance(one, MetadataIndex)]),
            (Opcode.ATTACHMENT_INDEX, [one for one in indexes if isinstance(one, AttachmentIndex)]),
            (Opcode.CHUNK_INDEX, [one for one in indexes if isinstance(one, ChunkIndex)]),
        ]
        start = len(self.content)
        offsets = []
        for opcode, group in groups:
            begin = len(self.content)
            for record in group:
                self._add(record)
            if group:
                offsets.append(SummaryOffset(opcode, begin, len(self.content) - begin))
        of_summary = start if offsets else 0
        of_offsets = len(self.content) if "sum" in self._features else 0
        for one in offsets if "sum" in self._features else []:
            self._add(one)
        footer = _record_bytes(Footer(summary_start=of_summary, summary_offset_start=of_offsets, summary_crc=0))
        checksum = self._checksum(self.content[start:] + footer[:-4])
        self.content += footer[:-4] + struct.pack("<I", checksum) + MAGIC


def _record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def misread(path: Path, records: Sequence[McapRecord], folder: Path) -> str:
    """What is wrong with what abrace reads of a file of these `records`; empty if nothing is.

    Each door is tried: `Bag`, `describe` by the index and with `check`, and `recover`, which writes into a `folder`.
    """
    topics = {one.id: one.topic for one in records if isinstance(one, Channel)}
    metadata = {one.name: one.metadata for one in records if isinstance(one, Metadata)}
    attachments = [one for one in records if isinstance(one, Attachment)]
    messages = [
        (topics[one.channel_id], one.data, one.log_time, one.publish_time)
        for one in records
        if isinstance(one, Message)
    ]
    in_time = sorted(messages, key=lambda message: message[2])
    counts = dict.fromkeys(topics.values(), 0) | Counter(topic for topic, *_ in messages)
    bag = Bag(path)
    found: list[tuple[str, object, object]] = [
        ("topics", sorted(bag.topics), sorted(topics.values())),
        ("metadata", bag.metadata, metadata),
        ("attachments", [one.record() for one in bag.attachments], attachments),
        ("messages", [tuple(one) for one in bag.raw()], in_time),
        ("a message's time", [one.log_time for one in bag.raw((), 2, 3)], [2 for one in messages if one[2] == 2]),
        ("warnings", bag.warnings, ()),
    ]
    for check in (False, True):
        described = describe(path, check)
        found.append(("counts", {name: one.messages for name, one in described.contents.items()}, counts))
        found.append(("warnings of info", described.warnings, ()))
    if messages:
        output = folder / f"recovered {path.stem}"
        copied = recover(path, output)
        found.append(("warnings of recover", copied.warnings, ()))
        found.append(("recovered messages", [tuple(one) for one in Bag(output).raw()], in_time))
        found.append(("recovered metadata", metadata.items() <= Bag(output).metadata.items(), True))
    return "; ".join(f"{what}: {got}, expected {expected}" for what, got, expected in found if got != expected)
