# SPDX-License-Identifier: Apache-2.0
"""The figure of a bag: every quantity of the topics that are asked for over time."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.figures.chart import COLOURS, Chart, Curve, Panel
from abrace_core.model.signals import load_cell_names, numbered

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_bags.reader import TopicArrays

UNITS = {
    "displacement": "m",
    "acceleration": "m/s²",
    "stroke": "m",
    "force": "N",
    "command": "N",
    "ground_acceleration": "m/s²",
    "accel.linear.x": "m/s²",
    "accel.linear.y": "m/s²",
    "accel.linear.z": "m/s²",
}
"""Of the quantities that abrace's messages carry."""
_LARGEST = 1e300
"""Larger numbers, which overflow an axis, are not drawn."""
_NOT_DRAWN = ("header.stamp.sec", "header.stamp.nanosec")
_LETTERS = {"displacement": "x", "acceleration": "a", "stroke": "xf", "force": "f", "command": "U"}
"""Of the channels of abrace's messages, as the paper names them; one to each floor, group or load cell."""
_MOST_NAMED = 12
"""Channels up to which a legend names them."""


def bag_figure(topics: Mapping[str, TopicArrays]) -> Figure:
    """A panel for each quantity of each topic.

    Parameters
    ----------
    topics
        By name. Quantities are drawn over the stamps of their messages, where they have one, else over their log time.
        Texts and what never changes are left out, and counters and flags where there are quantities.

    Raises
    ------
    AbraceError
        If there is nothing to draw.
    """
    times = {topic: _time(messages) for topic, messages in topics.items()}
    begin = min((time[0] for time in times.values() if time.size), default=0)
    panels = [
        (topic, name, values.reshape(len(values), -1))
        for topic, messages in topics.items()
        for name, values in _quantities(messages).items()
    ]
    if not panels:
        raise AbraceError(f"topics {', '.join(topics)}: nothing to draw, expected numbers that change")
    seconds = {topic: 1e-9 * (time - begin) for topic, time in times.items()}
    ends = 0.0, max(time[-1] for time in seconds.values() if time.size)
    rows = []
    for topic, name, values in panels:
        drawn = np.where(np.abs(values.astype(float)) < _LARGEST, values, np.nan).T
        named = 1 < len(drawn) <= _MOST_NAMED or (len(drawn) == 1 and name in _LETTERS)
        labels = _labels(topics[topic], name, len(drawn)) if named else [""] * len(drawn)
        curves = tuple(
            Curve(seconds[topic], channel, label, colour)
            for channel, label, colour in zip(drawn, labels, itertools.cycle(COLOURS), strict=False)
        )
        words = name.replace("_", " ")
        title = f"{topic}: {words}" if len(topics) > 1 else words
        rows.append((Panel(curves, title, "", f"[{UNITS[name]}]" if name in UNITS else "", x_limits=ends),))
    rows[-1] = (replace(rows[-1][0], x_label="time [s]"),)
    return Chart(tuple(rows), (11.0, 1.0 + 1.7 * len(rows))).figure()


def _quantities(messages: TopicArrays) -> dict[str, NDArray[Any]]:
    """The numbers of a topic that change; of a topic with quantities no counters, flags and states."""
    numbers = {
        name: values
        for name, values in messages.fields.items()
        if name not in _NOT_DRAWN and values.dtype.kind in "iufb" and values.size and (values != values[0]).any()
    }
    quantities = {name: values for name, values in numbers.items() if values.dtype.kind == "f"}
    return quantities or numbers


def _labels(messages: TopicArrays, name: str, count: int) -> Sequence[str]:
    """Names of the `count` channels of a field: those of a rig, else numbers."""
    braces = messages.fields.get("braces")
    if name == "force" and braces is not None and braces.ndim == 2 and braces[0].sum() == count:
        return load_cell_names(braces[0].tolist())
    return numbered(_LETTERS[name], count) if name in _LETTERS else [str(number) for number in range(count)]


def _time(messages: TopicArrays) -> NDArray[np.int64]:
    """(messages,) [ns]."""
    seconds, nanoseconds = (messages.fields.get(f"header.stamp.{part}") for part in ("sec", "nanosec"))
    if seconds is None or nanoseconds is None or seconds.ndim > 1 or not seconds.any():
        return messages.log_time
    return seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
