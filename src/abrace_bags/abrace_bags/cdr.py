# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays: many serialised messages are decoded together, field by field.

A message is serialised as little-endian CDR (XCDR1): the encapsulation header of four bytes, then the fields in order,
each number aligned to its own size counted from the end of that header. The walk keeps a position in every message, so
that a field is one operation on all of them, whatever the lengths of the strings and sequences before it are.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype

from abrace_bags.definitions import NUMBERS
from abrace_bags.mcap.chunk import gather
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_bags.definitions import MessageType

_HEADER_SIZE = 4
_UNENDED = "has a string that does not end with a zero"
_Each: TypeAlias = "int | NDArray[np.int64]"
_TEXT_OVERHEAD = 60
"""Bytes that a text takes as an object in addition to its characters."""
_REMEMBERED = 100
"""Bytes of a text up to which equal texts become one object."""


class Decoded(NamedTuple):
    """What `decode` found.

    Parameters
    ----------
    fields
        By field, nested names joined by dots: (messages that fit, ...) arrays of numbers or texts; an array of objects,
        one a message, where their shapes differ, and of str where that takes less memory.
    fits
        (messages that fit,) their numbers.
    misfit
        The first message that does not fit, and why; empty where all do.
    """

    fields: dict[str, NDArray[Any]]
    fits: NDArray[np.intp]
    misfit: str


class _MisfitError(Exception):
    """Messages, given by their `numbers`, that do not fit their definition; the text is a predicate."""

    def __init__(self, numbers: NDArray[np.intp], why: str) -> None:
        super().__init__(why)
        self.numbers = numbers


def decode(message_type: MessageType, content: bytes, begins: NDArray[np.int64], ends: NDArray[np.int64]) -> Decoded:
    """Decode messages to one array a field; those that do not fit the type are left out.

    Parameters
    ----------
    message_type
        What they are.
    content
        Bytes that hold all messages.
    begins, ends
        (messages,) where each one begins in it, and where it ends.

    Raises
    ------
    AbraceError
        If half of the messages or more do not fit: the definition is another type's then.
    """
    fits, misfit = np.arange(len(begins)), ""
    size = int(ends[0] - begins[0]) if len(begins) else 0
    if size and (ends - begins == size).all():  # side by side, their fields are at equal distances
        content = gather(content, f"V{size}", begins).tobytes()
        begins = np.arange(len(begins), dtype=np.int64) * size
        ends = begins + size
    while True:
        try:
            return Decoded(_Walk(message_type, content, begins[fits], ends[fits], fits).fields(), fits, misfit)
        except _MisfitError as error:
            misfit = misfit or f"message {error.numbers[0]}: {error}"
            fits = np.setdiff1d(fits, error.numbers)
            if 2 * len(fits) <= len(begins):
                raise AbraceError(misfit) from error


def decode_each(message_type: MessageType, messages: Sequence[bytes]) -> Decoded:
    """Decode `messages` as `decode` does, given each by itself."""
    ends = np.array(list(accumulate(map(len, messages), initial=0)), np.int64)
    return decode(message_type, b"".join(messages), ends[:-1], ends[1:])


class _Walk:
    """A position in each of several messages, which goes through their fields.

    Positions, lengths and counts that all messages have in common are a number, others are arrays (messages,).
    """

    def __init__(
        self,
        message_type: MessageType,
        content: bytes,
        begins: NDArray[np.int64],
        ends: NDArray[np.int64],
        numbers: NDArray[np.intp],
    ) -> None:
        self._type, self._content = message_type, content
        self._begins, self._ends, self._numbers = begins, ends, numbers
        self._sizes = _in_common(ends - begins)
        steps = _in_common(np.diff(begins))
        self._step = steps if isinstance(steps, int) else 0
        self._at: _Each = _HEADER_SIZE
        # Fast DDS reserves up to 8 bytes for an empty sequence that it doesn't write, and pads the end to 4 bytes
        self._spare: _Each = 3

    def fields(self) -> dict[str, NDArray[Any]]:
        """All values of the messages, by field."""
        self._refuse(self._at > self._sizes, "has less than 4 bytes")
        form = self._gather(">u2", 0)
        wrong = form != 1
        if wrong.any():
            begin = form[wrong][0].tobytes()[::-1].hex(" ")
            self._refuse(wrong, f"begins with {begin}, expected 00 01 (little-endian CDR)")
        columns = self._message(self._type.name)
        wrong = np.broadcast_to(self._sizes - self._at > self._spare, len(self._begins))
        if wrong.any():
            size, expected = (np.broadcast_to(one, len(wrong))[wrong][0] for one in (self._sizes, self._at))
            self._refuse(wrong, f"has {size} bytes, expected {expected} by the definition of {self._type.name}")
        return columns

    def _refuse(self, wrong: bool | NDArray[np.bool_], why: str) -> None:
        if np.any(wrong) and len(self._numbers):
            raise _MisfitError(self._numbers if isinstance(wrong, bool) else self._numbers[wrong], why)

    def _message(self, type_name: str) -> dict[str, NDArray[Any]]:
        fields = self._type.fields[type_name]
        if not fields:  # ROS gives an empty message one unused byte
            self._take(1, 1)
        columns: dict[str, NDArray[Any]] = {}
        for name, (kind, detail) in fields:
            if kind in (Nodetype.BASE, Nodetype.NAME):
                columns.update(_prefixed(name, self._one(kind, detail)))
                continue
            (kind_of_one, detail_of_one), count = detail
            counts = self._length() if kind is Nodetype.SEQUENCE else count
            if kind_of_one is Nodetype.BASE and detail_of_one[0] in NUMBERS:
                columns[name] = self._arrays(detail_of_one[0], counts)
            else:
                columns.update(_prefixed(name, self._several(kind_of_one, detail_of_one, counts)))
        return columns

    def _one(self, kind: Nodetype, detail: Any) -> dict[str, NDArray[Any]]:
        """A value: its columns by their names within it, empty for that of a number or text."""
        if kind is Nodetype.NAME:
            return self._message(detail)
        if detail[0] in NUMBERS:
            form = np.dtype(NUMBERS[detail[0]])
            values = self._gather(form, self._take(form.itemsize, form.itemsize))
            return {"": values != 0 if detail[0] == "bool" else values}
        return {"": self._texts()}

    def _arrays(self, type_name: str, counts: _Each) -> NDArray[Any]:
        """Arrays of `counts` numbers."""
        form = np.dtype(NUMBERS[type_name])
        begins = self._take(counts * form.itemsize, form.itemsize)
        if isinstance(counts, int):
            values = self._gather(form, begins, counts)
            return values != 0 if type_name == "bool" else values
        distinct = np.unique(counts).tolist()
        rows = []
        for count in distinct:
            which = counts == count
            values = self._of(which, 0, 0)._gather(form, _some(begins, which), count)
            rows.append(values != 0 if type_name == "bool" else values)
        return _scattered(counts, distinct, rows)

    def _several(self, kind: Nodetype, detail: Any, counts: _Each) -> dict[str, NDArray[Any]]:
        """Arrays of `counts` texts or messages: columns by their names within an element."""
        self._refuse(counts > self._sizes - self._at, "has too few bytes for its arrays")
        names = self._type.names(detail) if kind is Nodetype.NAME else [""]
        if isinstance(counts, int):
            elements = [self._one(kind, detail) for _ in range(counts)]
            return {name: _stacked([one[name] for one in elements], len(self._begins)) for name in names}
        parts: list[tuple[NDArray[np.intp], dict[str, NDArray[Any]]]] = []
        at, spare = (np.broadcast_to(one, len(counts)).copy() for one in (self._at, self._spare))
        for number in range(int(counts.max())):
            which = np.flatnonzero(counts > number)
            walk = self._of(which, at, spare)
            parts.append((which, walk._one(kind, detail)))
            at[which], spare[which] = walk._at, walk._spare
        self._at, self._spare = at, spare
        distinct = np.unique(counts).tolist()
        columns = {}
        for name in names:
            rows = []
            for count in distinct:
                of_count = np.flatnonzero(counts == count)
                elements_of = [part[name][np.searchsorted(which, of_count)] for which, part in parts[:count]]
                rows.append(_stacked(elements_of, len(of_count)))
            columns[name] = _scattered(counts, distinct, rows)
        return columns

    def _of(self, which: NDArray[Any], at: _Each, spare: _Each) -> _Walk:
        """The walk through some of the messages, from where all are `at`."""
        walk = _Walk(self._type, self._content, self._begins[which], self._ends[which], self._numbers[which])
        walk._at, walk._spare = _some(at, which), _some(spare, which)
        return walk

    def _length(self) -> _Each:
        """The length of a text or sequence."""
        lengths = _in_common(self._gather("<u4", self._take(4, 4)).astype(np.int64))
        self._spare = self._spare + 8 * (lengths == 0)
        return lengths

    def _texts(self) -> NDArray[Any]:
        lengths = self._length()
        begins = self._take(lengths, 1)
        last = begins + lengths - 1
        if isinstance(lengths, int):
            if not lengths:
                return np.full(len(self._begins), "")
            self._refuse(self._gather("u1", last) != 0, _UNENDED)
            rows = self._gather("u1", begins, lengths - 1)
            if len(rows) and (rows == rows[0]).all():
                return _text_array([self._text(0, rows[0].tobytes())], len(rows))
        else:
            some = lengths > 0
            wrong = np.zeros(len(lengths), bool)
            wrong[some] = self._of(some, 0, 0)._gather("u1", _some(last, some)) != 0
            self._refuse(wrong, _UNENDED)
        texts = []
        known: dict[bytes, str] = {}
        firsts = self._begins + begins
        ends = firsts + np.maximum(lengths - 1, 0)
        for number, (begin, end) in enumerate(zip(firsts.tolist(), ends.tolist(), strict=True)):
            text = self._content[begin:end]
            if end - begin > _REMEMBERED:
                texts.append(self._text(number, text))
            elif text in known:
                texts.append(known[text])
            else:
                texts.append(known.setdefault(text, self._text(number, text)))
        return _text_array(texts, len(texts))

    def _text(self, number: int, text: bytes) -> str:
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            why = f"has a string that is not UTF-8 ({error.reason})"
            raise _MisfitError(self._numbers[number : number + 1], why) from error

    def _take(self, size: _Each, alignment: int) -> _Each:
        """Where the next `size` bytes of each message begin; the position goes behind them."""
        begins = self._at + (_HEADER_SIZE - self._at) % alignment
        if not isinstance(size, int):  # an empty sequence is not aligned
            begins = np.where(size > 0, begins, self._at)
        elif not size:
            begins = self._at
        self._at = begins + size
        self._refuse(self._at > self._sizes, f"has too few bytes for the definition of {self._type.name}")
        return begins

    def _gather(self, form: Any, at: _Each, count: int | None = None) -> NDArray[Any]:
        """(messages,) numbers at these positions of the messages, or (messages, count) for a `count`."""
        form = np.dtype(form)
        messages = len(self._begins)
        shape, strides = ((), ()) if count is None else ((count,), (form.itemsize,))
        if messages > 1 and self._step > 0 and isinstance(at, int) and count != 0:
            first = int(self._begins[0]) + at
            return np.ndarray((messages, *shape), form, self._content, first, (self._step, *strides)).copy()
        return gather(self._content, form, self._begins + at, count)


def _in_common(values: NDArray[np.int64]) -> _Each:
    """What all `values` are, if they are the same, or 0 if there is none; else the values."""
    if not len(values):
        return 0
    return int(values[0]) if (values == values[0]).all() else values


def _some(values: _Each, which: NDArray[Any]) -> _Each:
    return values if isinstance(values, int) else values[which]


def _prefixed(name: str, columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {f"{name}.{path}" if path else name: column for path, column in columns.items()}


def _stacked(elements: list[NDArray[Any]], messages: int) -> NDArray[Any]:
    """(messages, elements, ...) from the values (messages, ...) of each element; objects where their shapes differ."""
    if not elements:
        return np.empty((messages, 0))
    if len({element.shape for element in elements}) == 1:
        return np.stack(elements, axis=1)
    ragged = np.empty((messages, len(elements)), dtype=object)
    for j, element in enumerate(elements):
        for i in range(messages):
            ragged[i, j] = element[i]
    return ragged


def _scattered(counts: NDArray[np.int64], distinct: list[int], values: list[NDArray[Any]]) -> NDArray[Any]:
    """(messages,) objects: the rows of `values` of each of the `distinct` counts, in the order of the messages."""
    scattered = np.empty(len(counts), dtype=object)
    for count, rows in zip(distinct, values, strict=True):
        for number, row in zip(np.flatnonzero(counts == count).tolist(), rows, strict=True):
            scattered[number] = row
    return scattered


def _text_array(texts: list[str], messages: int) -> NDArray[Any]:
    """(messages,) of the `texts`, of which one is that of all messages; str, or objects where these are smaller."""
    longest, total = max(map(len, texts), default=0), sum(map(len, texts))
    small = 4 * longest * len(texts) <= _TEXT_OVERHEAD * len(texts) + total
    if small and not any(text.endswith("\0") for text in texts):  # NumPy's texts would lose it
        return np.array(texts) if len(texts) == messages else np.full(messages, texts[0])
    array = np.empty(messages, dtype=object)
    array[:] = texts if len(texts) == messages else texts[0]
    return array
