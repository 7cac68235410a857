# SPDX-License-Identifier: Apache-2.0
"""Writes a simulated test of a rig to a bag, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_bags import BagWriter, message_definition
from abrace_core.wire import LOCKSTEP, Head, Responses

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_core.run import Run


def write_bag(run: Run, path: Path | str) -> None:
    """The bag of a run: every brace of a group has the group's mean force, unless the run has those of the braces."""
    definition = message_definition("abrace_interfaces/msg/Response")
    packed, step = Responses(), round(run.sample_period * 1e9)
    x, xf, a, f = np.split(run.outputs, np.cumsum([run.floors, run.groups, run.floors]), axis=1)
    f = np.repeat(f, run.braces, axis=1) if run.forces is None else run.forces
    with BagWriter(path, run.facts) as bag:
        topic = bag.add_topic("/response", definition.type_name, definition.text, definition.type_hash)
        rows = zip(x.tolist(), a.tolist(), xf.tolist(), f.tolist(), run.command.tolist(), strict=True)
        for k, arrays in enumerate(rows):
            head = Head(k, 1, 0 if run.clipped is None else int(run.clipped[k]), LOCKSTEP, 0)
            payload = packed.pack(step * k, head, "", run.braces, *arrays, float(run.ground_acceleration[k]))
            bag.write(topic, payload, step * k, step * k)
