# SPDX-License-Identifier: Apache-2.0
"""Readers of binary files: MATLAB's `.mat`, and any topic of a bag.

- `.mat` (versions 4 to 7.2): the channel is the name of a variable, a struct's field as `quake.acceleration`. A vector
  is an acceleration, two columns are time [s] and acceleration. Without a channel the only such series is read.
- a bag directory or a `.mcap` file: the channel is `topic:field`, the field as `abrace_bags.read_topics` names it,
  as `response:ground_acceleration`, `ground_motion:accel.linear.x` or `response:acceleration[2]`. Messages of ROS are
  in SI units. Their times are the stamps of their headers, and those of the log where they have no header; these may
  have jitter, as in a recording in real time. Where messages have a `sequence`, their numbers show whether one is
  missing.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags import TopicArrays, read_topics
from abrace_bags.reader import read_selected
from abrace_core.errors import AbraceError
from abrace_core.matlab_loader import load_matlab
from abrace_plant.records.reading import Reading, checked_reading, record_error

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

_FIELD = re.compile(r"(?P<field>[^\[\]]+)(?:\[(?P<index>\d{1,9})\])?")


def read_mat(name: str, path: Path, channel: str | None) -> Reading:
    """Read a MATLAB file.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    path
        The file.
    channel
        Name of the variable; the only series in the file when None.
    """
    variables = load_matlab(path)
    arrays = _arrays({key: value for key, value in variables.items() if not key.startswith("__")}, "")
    series = [key for key, values in arrays.items() if _is_series(values)]
    listed = ", ".join(f"{key} ({' x '.join(map(str, values.shape))})" for key, values in arrays.items()) or "none"
    if channel is None and len(series) != 1:
        raise record_error(name, f"{len(series)} series in it, expected channel as one of its arrays: {listed}")
    chosen = series[0] if channel is None else channel.strip()
    if chosen not in arrays:
        raise record_error(name, f"no array {chosen!r} of numbers in it, expected one of: {listed}")
    values = arrays[chosen]
    if not _is_series(values):
        shape = " x ".join(map(str, values.shape))
        message = f"{chosen} is {shape}, expected a vector (acceleration) or two columns (time, acceleration)"
        raise record_error(name, message)

    def error_at(message: str, sample: int | None) -> AbraceError:
        return record_error(name, message, chosen if sample is None else f"{chosen}, row {sample + 1}")

    if values.ndim == 1:
        return checked_reading(values, error_at, unit=None)
    return checked_reading(values[:, 1], error_at, unit=None, times=values[:, 0])


def _arrays(variables: Mapping[str, Any], prefix: str) -> dict[str, NDArray[Any]]:
    """Arrays of real numbers by name, those in structs as `struct.field`."""
    found: dict[str, NDArray[Any]] = {}
    for key, value in variables.items():
        if isinstance(value, dict):
            found |= _arrays(value, f"{prefix}{key}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.size > 1:
            found[prefix + key] = value
    return found


def _is_series(values: NDArray[Any]) -> bool:
    return values.ndim == 1 or (values.ndim == 2 and values.shape[1] == 2)


def read_bag(name: str, path: Path, channel: str | None) -> Reading:
    """Read one field of one topic of a bag.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    path
        A bag directory or an MCAP file.
    channel
        As `topic:field`.
    """
    try:
        topic, _, wanted = (channel or "").strip().partition(":")
        form = _FIELD.fullmatch(wanted)
        if not topic or form is None:
            given = f"channel {channel!r}" if channel else "a bag"
            raise record_error(name, f"{given}, expected channel as topic:field, one of {_listed(read_topics(path))}")
        named = {topic, f"/{topic}"}
        contents = read_selected(path, lambda described: described.topic in named)
        if len(contents) != 1:
            raise record_error(name, f"no topic {topic!r} in it, expected one of {_listed(read_topics(path))}")
        missing = [warning for warning in contents.warnings if "have no checksum" not in warning]
        if missing:
            raise record_error(name, f"not whole: {missing[0]}")
    except AbraceError as error:
        message = str(error)
        raise error if message.startswith("ground motion ") else AbraceError(f"ground motion {message}") from error
    return _field(name, topic, contents.popitem()[1], form["field"], form["index"])


def _field(name: str, topic: str, messages: TopicArrays, field: str, index: str | None) -> Reading:
    """A field of a topic, at the mean step of its stamps; none of its messages may be missing."""
    values = messages.fields.get(field)
    if values is None or not _is_number(values):
        listed = ", ".join(_numeric(messages)) or "none"
        raise record_error(name, f"no numbers {field!r} in {topic}, expected one of {listed}")
    if values.ndim == 2:
        if index is None or int(index) >= values.shape[1]:
            expected = f"{field}[0] to {field}[{values.shape[1] - 1}]" if values.shape[1] else "another field"
            raise record_error(name, f"{topic}:{field} has {values.shape[1]} numbers, expected one of {expected}")
        values = values[:, int(index)]
    elif index is not None:
        raise record_error(name, f"{topic}:{field} is one number, expected it without [{index}]")
    stamp = messages.fields.get("header.stamp.sec")
    if stamp is None:
        nanoseconds = messages.log_time
    else:
        nanoseconds = stamp.astype(np.int64) * 10**9 + messages.fields["header.stamp.nanosec"].astype(np.int64)

    def error_at(message: str, sample: int | None) -> AbraceError:
        return record_error(name, message, topic if sample is None else f"{topic}, message {sample + 1}")

    stamps = (nanoseconds - nanoseconds[:1]) * 1e-9
    numbers = messages.fields.get("sequence")
    if numbers is not None and not (numbers.dtype.kind in "iu" and numbers.ndim == 1):
        numbers = None
    return checked_reading(values, error_at, unit="m/s^2", stamps=stamps, numbers=numbers)


def _is_number(values: NDArray[Any]) -> bool:
    return values.dtype.kind in "fiu" and values.ndim in (1, 2)


def _numeric(messages: TopicArrays) -> list[str]:
    """The fields of a topic that are numbers, those with several as `field[count]`, without the header."""
    return [
        field + (f"[{values.shape[1]}]" if values.ndim == 2 else "")
        for field, values in messages.fields.items()
        if _is_number(values) and not field.startswith("header.")
    ]


def _listed(topics: Mapping[str, TopicArrays]) -> str:
    parts = (f"{topic.strip('/')}: {', '.join(_numeric(messages))}" for topic, messages in topics.items())
    return "; ".join(part for part in parts if not part.endswith(": ")) or "none"
