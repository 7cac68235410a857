# SPDX-License-Identifier: Apache-2.0
"""The node `check_sensors`: checks a rig's sensors by their readings, from the hardware at rest or from a bag.

abrace run abrace_plant check_sensors --ros-args -p rig:=my_rig.yaml -p bag:=bags/at_rest -p output:=results/sensors
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from abrace_bags import read_run
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.files.writing import write_text
from abrace_core.model import signals
from abrace_core.model.run import Run
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_plant.devices.device import Device, Reading, Wanted, exchange, make_safe_and_close, open_device
from abrace_plant.devices.file import load_device
from abrace_plant.devices.sensor_check import check_sensors
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import Rig

PARAMETERS = [
    Parameter("rig", "ncree_three_storey", "rig: a name in the package's configuration or a file", required=True),
    Parameter(
        "device",
        "",
        "device: a name in the package's configuration or a file; read with zero force and the table at rest",
    ),
    Parameter("bag", "", "bag with the rig's response, instead of the hardware"),
    Parameter("duration", 10.0, "seconds of the hardware's readings", minimum=1.0),
    Parameter("output", "", "JSON file of what is printed; empty: none"),
]


class CheckSensors(AbraceNode):
    """Reads, judges and ends; with code 1 where a channel has a fault."""

    def __init__(self) -> None:
        super().__init__("check_sensors", PARAMETERS)

    def work(self) -> None:
        """Read, judge, print, write."""
        given = self.parameters
        rig = load_rig(find_file(given.rig, "abrace_plant", "config", ".yaml", "rig"))
        if bool(given.device) == bool(given.bag):
            raise AbraceError("parameters device, bag: expected one of them")
        clipped, ranges = None, None
        if given.bag:
            recorded = read_run(given.bag)
            readings = recorded_readings(recorded, rig)
            clipped = None if recorded.clipped is None else recorded.clipped.tolist()
        else:
            device = load_device(find_file(given.device, "abrace_plant", "config/devices", ".yaml", "device"), rig)
            ranges = getattr(getattr(device, "calibration", None), "range", None)
            read = read_at_rest(device, rig, round(given.duration * rig.sample_rate))
            readings, clipped = np.array([one.values for one in read]), [one.clipped for one in read]
        found = check_sensors(rig, readings, clipped, ranges)
        print(found.text())
        if given.output:
            write_text(Path(given.output), json.dumps(asdict(found), indent=1) + "\n")
        self.exit_code = 0 if found.well else 1


def recorded_readings(recorded: Run, rig: Rig) -> NDArray[np.float64]:
    """(samples, channels) of a recorded test, with the force of each brace, as a device of the rig gives them."""
    every = signals.channel_names(recorded.floors, recorded.braces)
    names = tuple(name for name in every if name not in recorded.without)
    if names != rig.channel_names or recorded.forces is None:
        raise AbraceError(
            f"{recorded.source}: has the channels {', '.join(names)}, expected those of the rig {rig.name}: "
            f"{', '.join(rig.channel_names)}"
        )
    others = [i for i, name in enumerate(recorded.names) if name[0] != "f"]
    readings = np.column_stack([recorded.outputs[:, others], recorded.forces, recorded.ground_acceleration])
    return readings[:, : len(names)]


def read_at_rest(device: Device, rig: Rig, samples: int) -> list[Reading]:
    """Readings of the device with zero force and the table at rest; the target is not armed."""
    open_device(device)
    try:
        names, zero = rig.channel_names, [0.0] * rig.groups
        readings = [exchange(device, names, zero, 0.0, Wanted.SAFE, 0) for _ in range(samples)]
    except BaseException as error:
        make_safe_and_close(device, error)
        raise
    try:
        device.make_safe()
    finally:
        device.close()
    return readings


def main() -> int:
    """Entry point."""
    return run(CheckSensors)
