# SPDX-License-Identifier: Apache-2.0
"""What a bag has of each topic: messages, times, numbers; as counted at writing or reading, or as the bag says."""

from __future__ import annotations

import contextlib
import json
import re
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.mcap.chunk import MESSAGE_HEAD_SIZE
from abrace_bags.sequence import NumberRanges, SequenceCounter, clock_was_set_back
from abrace_bags.stamps import StampStream

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_bags.mcap.chunk import Messages

COUNTS_RECORD = "abrace_topics"
"""Name of the metadata record: by topic, JSON with what `_RECORDED` names."""
_RECORDED = ("messages", "gaps", "missing", "lost", "first_time", "last_time", "first_number", "rate")

_NUMBERED = re.compile(r"\s*std_msgs/(msg/)?Header\s+\w+\s+uint64\s+sequence(\s|$)")
"""What a definition without comments and constants begins with, whose messages are numbered."""
_NO_FIELD = re.compile(r"#.*|^[ \t]*[\w/]+[ \t]+\w+[ \t]*=.*", re.MULTILINE)
_OUT_OF_TURN = 100_000_000
"""How far the times of several publishers' messages may step back [ns]; a larger step means a clock that was set
back."""
_STAMP_OFFSET, _LENGTH_OFFSET, _FRAME_OFFSET = (MESSAGE_HEAD_SIZE + after for after in (4, 12, 16))
"""Offsets in a message record of the header's stamp, of the length of its frame_id, and of its text."""
_STAMP_AND_LENGTH, _SEQUENCE = struct.Struct("<iII"), struct.Struct("<Q")


@dataclass
class TopicContent:
    """What a bag has of one topic.

    Parameters
    ----------
    messages
        How many.
    gaps, missing
        Where their numbers rise by more than 1, in the order of recording, and numbers that are missing there.
    lost
        Messages published and not recorded, as far as is known; None where they were not counted.
    first_time, last_time
        Least and greatest log time [ns]; None without a message, and where the bag does not say.
    first_number
        `sequence` of the first message; None for topics without such numbers, and where the bag does not say.
    numbers
        All that were read; None for topics that have none.
    steps_back
        Whether log times step back.
    stated_rate
        The `rate` as the bag says; None: it is found by the messages.
    every
        Of so many messages one was to be recorded, those whose numbers it divides.
    """

    messages: int = 0
    gaps: int = 0
    missing: int = 0
    lost: int | None = 0
    first_time: int | None = None
    last_time: int | None = None
    first_number: int | None = None
    numbers: NumberRanges | None = field(default=None, compare=False)
    steps_back: bool = False
    stated_rate: float | None = field(default=None, compare=False)
    every: int = field(default=1, compare=False)
    _last: tuple[int, int] = field(default=(-1, -1), compare=False)
    _counter: SequenceCounter = field(default_factory=SequenceCounter, compare=False)
    _stamps: StampStream = field(default_factory=StampStream, compare=False)

    @classmethod
    def of(cls, definition: str, every: int = 1) -> TopicContent:
        """Nothing yet, of a topic with this `definition` (.msg) of its messages' type, of which one of `every` is kept.

        Messages are numbered that begin with a header and a `sequence`, as the rig's do.
        """
        numbers = NumberRanges(every) if is_numbered(definition) else None
        return cls(numbers=numbers, every=every, _counter=SequenceCounter(every))

    @property
    def rate(self) -> float:
        """Recorded samples a second by their stamps, without numbers by their log times; 0: fewer than two."""
        if self.stated_rate is not None:
            return self.stated_rate
        period = self._stamps.times().period
        if period > 0:
            return 1 / period
        span = 1e-9 * ((self.last_time or 0) - (self.first_time or 0))
        return (self.messages - 1) / span if span else 0.0

    def write(self, times: Sequence[int], records: bytes, begins: Sequence[int]) -> None:
        """Count messages with these log `times` [ns] that were written at `begins` in a chunk of `records`."""
        self._add_times(len(times), min(times), max(times))
        if self.numbers is None:
            self._stamps.add(np.array(times, np.int64))
            return
        stamps, numbers = [], []
        for begin in begins:
            try:
                seconds, nanoseconds, size = _STAMP_AND_LENGTH.unpack_from(records, begin + _STAMP_OFFSET)
                end = _FRAME_OFFSET - MESSAGE_HEAD_SIZE + size
                (number,) = _SEQUENCE.unpack_from(records, begin + MESSAGE_HEAD_SIZE + end + (4 - end) % 8)
            except struct.error:
                continue
            self.first_number = number if self.first_number is None else self.first_number
            self._counter.add(number)
            stamps.append(seconds * 1_000_000_000 + nanoseconds)
            numbers.append(number)
        self._stamps.add(np.array(stamps, np.int64), np.array(numbers, np.uint64) // self.every)
        self.gaps, self.missing = self._counter.gaps, self._counter.missing

    def read(self, messages: Messages) -> bool:
        """Count messages that were read, in the order of the file; returns whether the clock was set back before them.

        How many are missing is then known of all `numbers`.
        """
        log_time = messages.log_time
        self._add_times(log_time.size, int(log_time.min()), int(log_time.max()))
        before, number_before = self._last
        if self.numbers is None:
            self._stamps.add(log_time)
        self.steps_back |= bool((np.diff(log_time, prepend=max(before, 0)) < -_OUT_OF_TURN).any())
        number, set_back = -1, False
        if self.numbers is not None:
            numbers = sequence_numbers(messages)
            if numbers.size:
                self.numbers.add(numbers)
                self.first_number = int(numbers[0]) if self.first_number is None else self.first_number
                number = int(numbers[-1])
            if numbers.size == log_time.size:
                times = log_time
                seconds, nanoseconds = (
                    messages.numbers(form, at) for form, at in (("<i4", _STAMP_OFFSET), ("<u4", _STAMP_OFFSET + 4))
                )
                self._stamps.add(seconds * np.int64(1_000_000_000) + nanoseconds, numbers // self.every)
                if number_before >= 0:
                    times, numbers = np.append(before, times), np.append(np.uint64(number_before), numbers)
                set_back = clock_was_set_back(times, numbers)
        self._last = int(log_time[-1]), number
        return set_back

    def _add_times(self, count: int, first: int, last: int) -> None:
        self.messages += count
        self.first_time = first if self.first_time is None else min(self.first_time, first)
        self.last_time = last if self.last_time is None else max(self.last_time, last)


def is_numbered(definition: str) -> bool:
    """Whether messages with this `definition` (.msg) of their type begin with a header and a `sequence`."""
    return _NUMBERED.match(_NO_FIELD.sub("", definition)) is not None


def sequence_numbers(messages: Messages) -> NDArray[np.uint64]:
    """The `sequence` of numbered messages, without those that are too short to have one."""
    if messages.sizes.size and messages.sizes.min() < _FRAME_OFFSET:
        messages = messages.chosen(messages.sizes >= _FRAME_OFFSET)
    # the number follows the frame_id, aligned to 8 bytes from the end of the encapsulation's 4 bytes
    text_end = messages.numbers("<u4", _LENGTH_OFFSET).astype(np.int64) + _FRAME_OFFSET - MESSAGE_HEAD_SIZE
    offset = MESSAGE_HEAD_SIZE + text_end + (4 - text_end) % 8
    fits = offset + 8 <= messages.sizes
    if not fits.all():
        messages, offset = messages.chosen(fits), offset[fits]
    numbers: NDArray[np.uint64] = messages.numbers("<u8", offset)
    return numbers


def counts_record(contents: Mapping[str, TopicContent]) -> dict[str, str]:
    """The texts of the metadata record from `contents` by topic."""
    return {topic: json.dumps({name: getattr(one, name) for name in _RECORDED}) for topic, one in contents.items()}


def recorded_contents(records: Mapping[str, Mapping[str, str]]) -> dict[str, TopicContent]:
    """What was counted at writing by topic, of those topics that a bag's metadata `records` have."""
    found = {}
    for topic, text in records.get(COUNTS_RECORD, {}).items():
        with contextlib.suppress(ValueError, TypeError, AttributeError):
            counts: dict[str, Any] = {name: json.loads(text).get(name) for name in _RECORDED}
            if all(isinstance(counts[name], int) for name in _RECORDED[:3]):
                found[topic] = TopicContent(
                    **{name: counts[name] for name in _RECORDED[:-1]}, stated_rate=counts["rate"]
                )
    return found
