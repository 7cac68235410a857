# SPDX-License-Identifier: Apache-2.0
"""Writes a simulated test of a rig to a bag, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_bags import BagWriter, message_definition
from abrace_core.model.signals import load_cell_names, response_names
from abrace_core.safety.wire import LOCKSTEP, Head, Responses

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_core.model.run import Run


def write_bag(run: Run, path: Path | str) -> None:
    """The bag of a run: every brace of a group has the group's mean force, unless the run has those of all braces."""
    definition = message_definition("abrace_interfaces/msg/Response")
    packed, step = Responses(), round(run.sample_period * 1e9)
    braces, names = run.braces or (1,) * run.groups, response_names(run.floors, run.groups)
    every = np.full((len(run.outputs), len(names)), np.nan)
    every[:, [names.index(name) for name in run.names]] = run.outputs
    x, xf, a, f = np.split(every, np.cumsum([run.floors, run.groups, run.floors]), axis=1)
    f = np.repeat(f, braces, axis=1) if run.forces is None else run.forces
    f = np.where([name in run.without for name in load_cell_names(braces)], np.nan, f)
    with BagWriter(path, {name: text for name, text in run.facts.items() if name != "stopped"}) as bag:
        topic = bag.add_topic("/response", definition.type_name, definition.text, definition.type_hash)
        rows = zip(x.tolist(), a.tolist(), xf.tolist(), f.tolist(), run.command.tolist(), strict=True)
        for k, (number, arrays) in enumerate(zip(run.sequence.tolist(), rows, strict=True)):
            head = Head(number, 1, 0 if run.clipped is None else int(run.clipped[k]), LOCKSTEP, 0)
            cause = run.stopped if k == len(run.sequence) - 1 else ""
            table = float(run.ground_acceleration[k]), 0.0
            payload = packed.pack(step * number, head, cause, braces, *arrays, *table)
            bag.write(topic, payload, step * number, step * number)
