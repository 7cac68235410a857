# SPDX-License-Identifier: Apache-2.0
"""The events of a test, from its bag: faults, lost samples, clipped readings, limited commands and motions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags import Bag
from abrace_bags.sequence import NumberRanges
from abrace_core import AbraceError, RunFailed
from abrace_core.model.run import clipped_counts
from abrace_core.model.signals import channel_names
from abrace_core.safety.wire import LATE, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED

if TYPE_CHECKING:
    from pathlib import Path

FLAGS = {
    "saturated": SATURATED,
    "rate_limited": RATE_LIMITED,
    "table_limited": TABLE_LIMITED,
    "stop_pressed": STOP_PRESSED,
    "late": LATE,
}
"""Entries of a test in timing.json, and the flag of the samples that each of them counts."""


def examine(bag: Path, topic: str, samples: int | None) -> dict[str, Any]:
    """Entries of a test for timing.json, from the responses on a `topic` of its `bag`; counts of zero are left out.

    `samples`: how many the rig published; None: not known, and the gaps within the bag are counted as lost.

    Raises
    ------
    RunFailed
        If the rig had a fault.
    """
    response = Bag(bag).arrays([topic]).get(topic)
    if response is None or not response.log_time.size:
        raise RunFailed(f"{bag}: has no sample of {topic}, expected those of a test")
    fields = response.fields
    causes = [cause for cause in dict.fromkeys(fields["cause"].tolist()) if cause]
    if causes:
        raise RunFailed(f"the rig had a fault: {'; '.join(causes)}")
    found: dict[str, Any] = {name: int(np.sum(fields["flags"] & flag != 0)) for name, flag in FLAGS.items()}
    sizes = [fields[name].shape[1] for name in ("displacement", "stroke")]
    braces = tuple(fields["braces"][0].tolist())
    if len(braces) != sizes[1]:
        raise AbraceError(f"{bag}: {len(braces)} numbers of braces, expected {sizes[1]}, one for each group")
    counts = clipped_counts(fields["clipped"], channel_names(sizes[0], braces))
    found["clipped"] = {name: count for name, count in counts.items() if count}
    numbers = NumberRanges()
    numbers.add(fields["sequence"])
    missing = numbers.missing
    lost = missing if samples is None else max(samples - response.log_time.size, missing)
    return {"lost_samples": lost} | {name: value for name, value in found.items() if value}
