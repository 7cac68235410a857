# SPDX-License-Identifier: Apache-2.0
"""New bags with the messages of others: what can be read of a damaged bag, a part of a bag, several bags in one.

Messages, their types and QoS, the run's facts, the other metadata and the attachments are kept as they are. No more
than some chunks are in memory.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import operator
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from abrace_bags.bag import COPY_RECORD, Bag, in_brackets, missing_messages
from abrace_bags.mcap.contents import recorded_contents
from abrace_bags.topics import EVERY, every_of
from abrace_bags.writer import WRITTEN_RECORDS, BagWriter
from abrace_core import AbraceError
from abrace_core.files.writing import make_folder, move

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from abrace_bags.mcap.attachments import StoredAttachment
    from abrace_bags.raw import RawMessage, RawMessages
    from abrace_bags.topics import RecordedTopic

Content = TypeVar("Content")
_NOT_COPIED = (*WRITTEN_RECORDS, "rosbag2")
"""Names of the metadata records that describe one bag: those of each new bag, and that of rosbag2."""


@dataclass(frozen=True)
class CopiedBag:
    """What was written.

    Parameters
    ----------
    counts
        Messages by topic.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    counts: dict[str, int]
    warnings: tuple[str, ...]


def recover(bag: Path | str, output: Path | str) -> CopiedBag:
    """Write everything that can be read of a bag to a new one, in the order in which it was recorded.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file, cut off or damaged or not.
    output
        The bag to write: a directory that must not exist.

    Raises
    ------
    AbraceError
        If there is no such bag, it has no message that can be read, or the new one can't be written.
    """
    opened = Bag(bag)
    found = opened.raw()
    if not found.count:
        raise AbraceError(f"{bag}: no message in it that can be read{in_brackets(found.warnings)}")
    contents = found.contents.items() if opened.uncounted else ()
    missing = [f"{bag}: {missing_messages(name, one.numbers)}" for name, one in contents]
    return _write(Path(output), {opened: found}, found.as_written(), missing)


def trim(
    bag: Path | str, output: Path | str, topics: Collection[str] = (), start_offset: float = 0.0, duration: float = 0.0
) -> CopiedBag:
    """Write a part of a bag to a new one, in the order of the log times.

    Messages lost at recording are counted as in the whole bag.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    output
        The bag to write: a directory that must not exist.
    topics
        Whole names, or unique ends of names; all when empty.
    start_offset
        Where the part begins [s], counted from the first message of these topics.
    duration
        Its length [s]; 0: to the end.

    Raises
    ------
    AbraceError
        If there is no such bag, one of the topics is not in it, it has no message in that part, or the new bag can't be
        written.
    """
    opened = Bag(bag)
    found = opened.raw(topics, *opened.time_range(start_offset, duration, topics))
    if not found.count:
        part = f" from {start_offset:g} s to {start_offset + duration:g} s" if duration else ""
        raise AbraceError(f"{bag}: there is no message{part}{in_brackets(found.warnings)}")
    return _write(Path(output), {opened: found}, found, part=True)


def merge(output: Path | str, bags: Sequence[Path | str]) -> CopiedBag:
    """Write all messages of several bags to a new one, in the order of the log times.

    Facts, other metadata and attachments that are the same in the bags are written once. Where bags differ in one, each
    bag's is kept, with the name of its bag: `controlled/record`.

    Parameters
    ----------
    output
        The bag to write: a directory that must not exist.
    bags
        Bag directories or single files, each once.

    Raises
    ------
    AbraceError
        If there is no such bag, one is named twice, a topic has several types or was recorded with another `every`,
        there is no message, or the new bag can't be written.
    """
    paths = [Path(bag).resolve() for bag in bags]
    for bag, path in zip(bags, paths, strict=True):
        if paths.count(path) > 1:
            raise AbraceError(f"bag {bag} is named twice: its messages would come twice")
    found = {opened: opened.raw() for opened in map(Bag, bags)}
    if not any(one.count for one in found.values()):
        raise AbraceError(f"{', '.join(map(str, bags))}: there is no message that can be read")
    copied = _write(Path(output), found, heapq.merge(*found.values(), key=operator.attrgetter("log_time")))
    return replace(copied, warnings=(*copied.warnings, *_overlaps(found)))


def _write(
    output: Path,
    found: Mapping[Bag, RawMessages],
    messages: Iterable[RawMessage],
    missing: Sequence[str] = (),
    part: bool = False,
) -> CopiedBag:
    """Write the `messages` that were `found` in bags, what else these hold, and the warnings of what is `missing`.

    What a bag counted and does not have any more is lost, unless only a `part` of it is copied.
    """
    bags = dict(zip(_labels([opened.path for opened in found]), found, strict=True))
    warnings = [*(warning for one in found.values() for warning in one.warnings), *missing]
    facts = _joined({label: _facts(opened, found[opened]) for label, opened in bags.items()})
    records = _joined(
        {
            label: {name: texts for name, texts in opened.metadata.items() if name not in _NOT_COPIED}
            for label, opened in bags.items()
        }
    )
    attachments = _joined({label: _attachments(opened, warnings) for label, opened in bags.items()}, _is_same_file)
    if warnings:
        records[COPY_RECORD] = {"warnings": "\n".join(warnings)}
    topics = _topics(found)
    with (
        _new_bag(output) as temporary,
        BagWriter(
            temporary,
            facts,
            records=records,
            attachments=(replace(one.record(), name=name) for name, one in attachments.items()),
        ) as writer,
    ):
        numbers = {name: _add_topic(writer, topic) for name, topic in topics.items()}
        for topic, payload, log_time, publish_time in messages:
            writer.write(numbers[topic], payload, log_time, publish_time)
        for opened in found:
            known = recorded_contents(opened.metadata)
            for topic, content in found[opened].contents.items():
                recorded = known.get(topic)
                lost = None if recorded is None else recorded.lost
                if lost is not None and recorded is not None and not part:
                    lost += recorded.messages - content.messages
                writer.add_lost(numbers[topic], lost)
    return CopiedBag({name: one.messages for name, one in writer.contents().items()}, tuple(warnings))


def _labels(paths: Sequence[Path]) -> list[str]:
    """Names of bags: those of their folders or files, where all are different."""
    names = [path.resolve().name.removesuffix(".mcap") for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _joined(
    parts: Mapping[str, Mapping[str, Content]], is_same: Callable[[Content, Content], bool] = operator.eq
) -> dict[str, Content]:
    """What is in several bags, by its name; of what is not the same in all that have it, each with its bag's name."""
    joined: dict[str, Content] = {}
    for name in dict.fromkeys(name for part in parts.values() for name in part):
        found = {label: part[name] for label, part in parts.items() if name in part}
        first = next(iter(found.values()))
        same = all(one is first or is_same(one, first) for one in found.values())
        joined |= {name: first} if same else {f"{label}/{name}": one for label, one in found.items()}
    return joined


def _facts(opened: Bag, messages: RawMessages) -> dict[str, str]:
    """The facts of a bag, but of topics of which it has no `messages`."""
    others = {name for name in opened.facts if name.startswith(EVERY)} - {EVERY + name for name in messages.topics}
    return {name: text for name, text in opened.facts.items() if name not in others}


def _attachments(opened: Bag, warnings: list[str]) -> dict[str, StoredAttachment]:
    """The attachments of a bag that can be read, by their names; of others there are `warnings`."""
    readable: dict[str, StoredAttachment] = {}
    for one in opened.attachments:
        try:
            one.record()
        except AbraceError as error:
            warnings.append(f"{error}, it is left out")
        else:
            same = sum(one.name == other.name for other in readable.values())
            readable[f"{one.name} ({same + 1})" if same else one.name] = one
    return readable


def _is_same_file(one: StoredAttachment, other: StoredAttachment) -> bool:
    return one.size == other.size and one.data == other.data


def _topics(found: Mapping[Bag, RawMessages]) -> dict[str, RecordedTopic]:
    """The topics of all bags, with the QoS of all their publishers."""
    topics: dict[str, RecordedTopic] = {}
    kept: dict[str, int] = {}
    for opened, one in found.items():
        for name, topic in one.topics.items():
            known, every = topics.get(name, topic), every_of(opened.facts, name)
            if kept.setdefault(name, every) != every:
                raise AbraceError(
                    f"{opened.path}: topic {name}: one of {every} messages, expected one of {kept[name]} as in the "
                    "bags before it"
                )
            joined = known.joined(topic)
            if joined is None:
                types = f"{topic.type_name} is not the {known.type_name} of the bags before it"
                raise AbraceError(f"{opened.path}: topic {name}: {types}, expected one type")
            topics[name] = joined
    return topics


def _overlaps(found: Mapping[Bag, RawMessages]) -> Iterator[str]:
    """Warnings of numbered topics that have messages in several bags at the same time: samples of different runs."""
    for (one, messages), (other, others) in itertools.combinations(found.items(), 2):
        for name, content in messages.contents.items():
            also = others.contents.get(name)
            if also is None or content.first_number is None or also.first_number is None:
                continue
            if max(content.first_time or 0, also.first_time or 0) <= min(content.last_time or 0, also.last_time or 0):
                yield f"topic {name}: {one.path} and {other.path} have messages of the same time, which are mixed"


@contextlib.contextmanager
def _new_bag(output: Path) -> Iterator[Path]:
    """A temporary path for a bag, which is renamed to `output` when it is whole, and removed after an error."""
    if output.exists():
        raise AbraceError(f"bag {output} exists already, expected a new directory")
    try:
        make_folder(output.parent)
        with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as folder:
            temporary = Path(folder) / output.name
            try:
                yield temporary
            except AbraceError as error:
                raise AbraceError(str(error).replace(str(temporary), str(output))) from error
            move(temporary, output)
    except OSError as error:
        raise AbraceError(f"cannot write bag {output}: {error.strerror}") from error


def _add_topic(writer: BagWriter, topic: RecordedTopic) -> int:
    """Add a topic to the new bag as it was in the old one."""
    try:
        offers = topic.offers
    except AbraceError:
        offers = []
    return writer.add_topic(
        topic.name,
        topic.type_name,
        topic.definition,
        topic.type_hash,
        *offers,
        encoding=topic.schema_encoding,
        message_encoding=topic.message_encoding,
    )
