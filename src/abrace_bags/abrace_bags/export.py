# SPDX-License-Identifier: Apache-2.0
"""A bag's topics for other programs: comma-separated values, MATLAB files."""

from __future__ import annotations

import csv
import itertools
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.writing import write_atomically

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.reader import TopicArrays

_LARGEST_VARIABLE = 2**31
"""Bytes of a variable in a MATLAB file of version 5, which is written as a whole."""
_CHARACTER, _CELL = 4, 56
"""Bytes of a character and of an array's head in it."""
_LONGEST_NAME = 63
"""Characters of a MATLAB name."""


def columns(messages: TopicArrays) -> dict[str, NDArray[Any]]:
    """All values of a topic's `messages` as columns.

    Returns
    -------
    dict
        By name, the bag's `log_time` and `publish_time` [ns] first (a field of that name is `message.log_time`), the
        elements of an array as `force[0]`: (messages,) each.

    Raises
    ------
    AbraceError
        If an array does not have the same length in all messages.
    """
    table: dict[str, NDArray[Any]] = {}
    for name, values in _with_times(messages).items():
        if values.dtype == object and not (values.size and isinstance(values.flat[0], str)):
            raise AbraceError(f"{name} does not have the same length in all messages, expected a table's columns")
        indices = itertools.product(*map(range, values.shape[1:]))
        for index, column in zip(indices, values.reshape(len(values), math.prod(values.shape[1:])).T, strict=True):
            table[name + "".join(f"[{number}]" for number in index)] = column
    return table


def write_csv(path: Path | str, parts: Iterable[TopicArrays]) -> None:
    """Write a topic's messages as comma-separated values, a header line and a line each; no digit is lost.

    Parameters
    ----------
    path
        The file.
    parts
        The messages, some at a time: only one part is in memory.

    Raises
    ------
    AbraceError
        If an array does not have the same length in all messages, or the file can't be written.
    """
    header: list[str] | None = None
    with write_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for part in parts:
            table = columns(part)
            if header is None:
                header = list(table)
                writer.writerow(header)
            if list(table) != header and part.log_time.size:
                name = next(iter(set(header) ^ set(table)))
                raise AbraceError(f"{name} is not in all messages, expected arrays of the same length")
            writer.writerows(zip(*(column.tolist() for column in table.values()), strict=True))


def write_mat(path: Path | str, topics: Mapping[str, TopicArrays], facts: Mapping[str, str]) -> None:
    """Write topics as a MATLAB file.

    Parameters
    ----------
    path
        The file.
    topics
        By name. Each becomes a struct of that name, its fields (messages, ...) arrays and `log_time`, `publish_time`;
        characters that a MATLAB name cannot have become underscores.
    facts
        Become the struct `facts`.

    Raises
    ------
    AbraceError
        If two names become one, the messages do not fit the format, or the file can't be written.
    """
    from scipy.io import savemat

    structs: dict[str, Any] = {}
    for topic, messages in topics.items():
        values = _struct(_with_times(messages))
        size = sum(map(_size, values.values()))
        if size >= _LARGEST_VARIABLE:
            gigabytes = f"{size / 1e9:.1f} GB, expected less than 2 GB in a MATLAB file"
            raise AbraceError(f"topic {topic}: has {gigabytes}: export a part of the time")
        _add(structs, topic, values)
    _add(structs, "facts", _struct(facts))
    with write_atomically(path) as temporary:
        savemat(str(temporary), structs, appendmat=False, long_field_names=True, do_compression=True, oned_as="column")


def _size(values: Any) -> int:
    """Bytes of a field as MATLAB has it: of a cell array those of its cells, with what is around each."""
    if values.dtype != object:
        return int(values.nbytes)
    cells = (len(one) * _CHARACTER if isinstance(one, str) else _size(np.asarray(one)) for one in values.flat)
    return sum(cells) + values.size * _CELL


def _with_times(messages: TopicArrays) -> dict[str, NDArray[Any]]:
    """The bag's times and the fields; a field of such a name becomes `message.log_time`."""
    times = {"log_time": messages.log_time, "publish_time": messages.publish_time}
    return times | {f"message.{name}" if name in times else name: values for name, values in messages.fields.items()}


def _struct(values: Mapping[str, Any]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for name, value in values.items():
        _add(named, name, value.astype(object) if isinstance(value, np.ndarray) and value.dtype.kind == "U" else value)
    return named


def _add(named: dict[str, Any], name: str, value: Any) -> None:
    plain = re.sub(r"\W", "_", name.strip("/"), flags=re.ASCII)
    plain = (plain if plain[:1].isalpha() else f"x_{plain}")[:_LONGEST_NAME]
    if plain in named:
        raise AbraceError(f"{name} and another name are both {plain} in MATLAB, expected different names")
    named[plain] = value
