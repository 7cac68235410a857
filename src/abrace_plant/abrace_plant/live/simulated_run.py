# SPDX-License-Identifier: Apache-2.0
"""A whole test of the simulated rig, in lockstep and without ROS: what the node `plant` would publish, as a Run.

It uses the node's own parts: limits of braces and table, sensors, interlocks. So a test gives the same numbers here as
in the graph.
"""

from __future__ import annotations

import itertools
import json
import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.model import signals
from abrace_core.model.run import Run
from abrace_core.safety.rig_safety import RigSafety
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import RigLoop, rig_outputs

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

TIMEOUT, LATE, NUMBER = 0.02, 10, 1
"""As the node's defaults: seconds without an answer, samples late in a row; and the number of the run."""


def simulated_run(
    rig: Rig,
    ground: NDArray[np.float64],
    force: Callable[[int, list[float], list[float]], list[float]],
    seed: int = 0,
    source: str = "simulated",
) -> Run:
    """A test of a rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    ground
        (samples,) acceleration of the table [m/s^2], commanded in answer to each sample.
    force
        Gives the force of one brace of each group (groups,) [N] in answer to a sample: its number,
        [displacements, strokes, accelerations, forces] as measured, a force being the mean of its group's, NaN what is
        not measured; and the command (groups,) [N] that acted until then. Samples count from the end of the fade.
    seed
        Of the sensors' noise.
    source
        What the Run is called.

    Returns
    -------
    Run
        Its facts have the rig's name and, where the rig was stopped by a fault, the cause as `stopped`.
    """
    safety = RigSafety()
    safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
    safety.activate()
    loop = RigLoop(rig, SimulatedRig(rig, seed, by_the_clock=False), safety, TIMEOUT, LATE, NUMBER, lockstep=True)
    first = loop.until_it_acts()
    braces, others = rig.braces_in_group, 2 * rig.floors + rig.groups
    ends = np.cumsum([others, *braces]).tolist()
    groups = [[i for i in range(*edges) if i in rig.channel_places] for edges in itertools.pairwise(ends)]
    names, without = signals.response_names(rig.floors, rig.groups), rig.not_measured
    recorded = [i for i, name in enumerate(names) if name in rig.recorded_names]
    outputs, table = np.zeros((len(ground), len(recorded))), np.zeros(len(ground))
    command, clipped = np.zeros((len(ground), rig.groups)), np.zeros(len(ground), dtype=np.uint64)
    cause = ""
    for k, acceleration in enumerate(ground.tolist()):
        sample = loop.step() if k else first
        reading = rig.as_in_message(sample.reading)
        z = reading[:others] + [
            sum([reading[i] for i in cells]) / len(cells) if cells else math.nan for cells in groups
        ]
        outputs[k], table[k] = [z[i] for i in recorded], reading[-1]
        command[k], clipped[k] = sample.command, sample.head.clipped
        cause = cause or sample.cause
        loop.receive_ground_acceleration(sample.stamp, acceleration)
        loop.receive_command(NUMBER, loop.sequence, force(k, z, sample.command), "")
    facts = {
        "rig": rig.name,
        "sample_period": repr(1 / rig.sample_rate),
        "capacity": json.dumps(rig.capacity.tolist()),
        "sensor_seed": str(seed),
    }
    stopped = {"stopped": cause} if cause else {}
    sequence = np.arange(len(ground), dtype=np.uint64)
    return Run(
        source,
        1 / rig.sample_rate,
        sequence,
        rig.floors,
        rig.groups,
        outputs,
        table,
        command,
        facts | stopped,
        clipped,
        braces,
        without=without,
    )
