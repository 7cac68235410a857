# SPDX-License-Identifier: Apache-2.0
"""What the bag of a test says of its run: faults, losses, readings and motions that were cut, commands that were."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags import read_topics
from abrace_core.errors import AbraceError, RunFailed
from abrace_core.sequence import missing_numbers
from abrace_core.signals import channel_names
from abrace_core.wire import LATE, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED

if TYPE_CHECKING:
    from pathlib import Path

FLAGS = {
    "saturated": SATURATED,
    "rate_limited": RATE_LIMITED,
    "table_limited": TABLE_LIMITED,
    "stop_pressed": STOP_PRESSED,
    "late": LATE,
}
"""Entries of a test in timing.json that count samples, and the flag that each of those has."""


def examine(bag: Path, topic: str, samples: int | None) -> dict[str, Any]:
    """Entries of a test for timing.json, from the responses in its bag; only what happened is in them.

    Parameters
    ----------
    bag
        Of the test.
    topic
        Of its responses.
    samples
        How many the rig has published; None: it does not say, and what is missing between those in the bag is lost.

    Raises
    ------
    RunFailed
        If the rig had a fault.
    """
    response = read_topics(bag, [topic]).get(topic)
    if response is None or not response.log_time.size:
        raise RunFailed(f"{bag}: no sample of {topic} is in it, expected those of a test")
    fields = response.fields
    causes = [cause for cause in dict.fromkeys(fields["cause"].tolist()) if cause]
    if causes:
        raise RunFailed(f"the rig had a fault: {'; '.join(causes)}")
    found: dict[str, Any] = {name: int(np.sum(fields["flags"] & flag != 0)) for name, flag in FLAGS.items()}
    sizes = [fields[name].shape[1] for name in ("displacement", "stroke")]
    braces = tuple(fields["braces"][0].tolist())
    if len(braces) != sizes[1]:
        raise AbraceError(f"{bag}: braces of {len(braces)} groups, expected {sizes[1]}")
    names = channel_names(sizes[0], braces)[:64]
    at_end = {name: int(np.sum(fields["clipped"] >> np.uint64(i) & np.uint64(1))) for i, name in enumerate(names)}
    found["clipped"] = {name: count for name, count in at_end.items() if count}
    missing = missing_numbers(fields["sequence"])[1]
    lost = missing if samples is None else max(samples - response.log_time.size, missing)
    return {"lost_samples": lost} | {name: value for name, value in found.items() if value}
