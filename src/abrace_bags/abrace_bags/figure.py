"""The figure of a bag: every quantity of the topics that are asked for over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping

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


def bag_figure(topics: Mapping[str, TopicArrays]) -> Figure:
    """A panel for each quantity of each topic.

    Parameters
    ----------
    topics
        By name. Numbers are drawn over the stamps of their messages, where they have one, else over their log time;
        quantities that never change and texts are left out.

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
        for name, values in messages.fields.items()
        if name not in _NOT_DRAWN and values.dtype.kind in "iufb" and values.size and (values != values[0]).any()
    ]
    if not panels:
        raise AbraceError(f"topics {', '.join(topics)}: nothing to draw, expected numbers that change")
    figure = Figure(figsize=(11.0, 1.0 + 1.7 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (topic, name, values) in zip(axes, panels, strict=True):
        seconds = 1e-9 * (times[topic] - begin)
        drawn = np.where(np.abs(values.astype(float)) < _LARGEST, values, np.nan)
        for number, channel in enumerate(drawn.T):
            shade: dict[str, Any] = {"alpha": 1.0 - 0.7 * number / values.shape[1], "color": MEASURED, "lw": 0.8}
            axis.plot(seconds, channel, label=f"{number}", **shade)
        if 1 < values.shape[1] <= 12:
            axis.legend(loc="upper right", ncols=values.shape[1], fontsize="small")
        axis.set_title(f"{topic} {name}", loc="left", fontsize="small")
        axis.set_ylabel(f"[{UNITS[name]}]" if name in UNITS else "")
        axis.margins(x=0)
    axes[-1].set_xlabel("time [s]")
    return figure


def _time(messages: TopicArrays) -> NDArray[np.int64]:
    """(messages,) [ns]."""
    seconds, nanoseconds = (messages.fields.get(f"header.stamp.{part}") for part in ("sec", "nanosec"))
    if seconds is None or nanoseconds is None or seconds.ndim > 1 or not seconds.any():
        return messages.log_time
    return seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
