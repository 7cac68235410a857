# SPDX-License-Identifier: Apache-2.0
"""A topic of a bag of any length as arrays, some messages at a time."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from abrace_bags.reader import TopicArrays, common_type, decode_fitting
from abrace_bags.survey import survey
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.survey import RawMessage

PART = 10_000
"""Messages in a part."""
PART_SIZE = 1 << 22
"""Bytes of messages in a part, about."""


class TopicParts:
    """The messages of a topic, part by part in the order in which `replay` has them; at least one part.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    topic
        Its name.
    begin, end
        Log times of the messages [ns], `begin` included, `end` not; None: from the first, to the last.

    Attributes
    ----------
    warnings
        What is missing or can't be trusted, one sentence each; complete after the last part.

    Raises
    ------
    AbraceError
        If there is no such bag or topic, or its messages can't be decoded.
    """

    def __init__(self, bag: Path | str, topic: str, begin: int | None = None, end: int | None = None) -> None:
        self._name = f"{bag}: topic {topic}"
        self._found = survey(bag, lambda channel: channel.topic == topic, begin, end)
        channels = [
            channel for file in self._found.opened.files for channel in file.channels.values() if channel.topic == topic
        ]
        if not channels:
            raise AbraceError(f"{bag}: no topic {topic} in it")
        try:
            self._type = common_type(channels)
        except AbraceError as error:
            raise AbraceError(f"{self._name} {error}") from error
        self._type_name = channels[0].type_name
        self.warnings = self._found.opened.warnings
        if self._found.set_back:
            self.warnings.append(f"{self._name}: the clock was set back during the recording")

    def __iter__(self) -> Iterator[TopicArrays]:
        messages = self._found.messages()
        part = self._next(messages)
        while True:
            yield self._arrays(part)
            part = self._next(messages)
            if not part:
                return

    def _next(self, messages: Iterator[RawMessage]) -> list[RawMessage]:
        part: list[RawMessage] = []
        size = 0
        for message in itertools.islice(messages, PART):
            part.append(message)
            size += len(message.payload)
            if size > PART_SIZE:
                break
        return part

    def _arrays(self, part: list[RawMessage]) -> TopicArrays:
        try:
            fields, fits, notes = decode_fitting(self._type, blocks([message.payload for message in part]), len(part))
        except AbraceError as error:
            raise AbraceError(f"{self._name}: {error}") from error
        self.warnings += [f"{self._name}: {note}" for note in notes]
        times = np.array([message[2:] for message in part], np.int64).reshape(-1, 2)[fits]
        return TopicArrays(self._type_name, fields, times[:, 0], times[:, 1])


def blocks(payloads: Sequence[bytes]) -> list[tuple[NDArray[np.int64], NDArray[np.void]]]:
    """Messages by their lengths, as `decode` takes them: numbers, and bytes."""
    sizes = np.array([len(payload) for payload in payloads], np.int64)
    found = []
    for size in np.unique(sizes).tolist():
        numbers = np.flatnonzero(sizes == size)
        joined = b"".join(payloads[k] for k in numbers.tolist())
        found.append((numbers, np.frombuffer(joined, f"V{size}") if size else np.empty(numbers.size, "V0")))
    return found
