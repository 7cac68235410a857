# SPDX-License-Identifier: Apache-2.0
"""The simulated rig in lockstep, without ROS: a loop in which commands act, at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core.safety.rig_safety import RigSafety
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import RigLoop, rig_outputs

if TYPE_CHECKING:
    from abrace_plant.devices.device import Device
    from abrace_plant.rig.model import Rig

RUN = 1
"""Number of the loop's run."""


def active_safety(rig: Rig) -> RigSafety:
    """The state machine of a rig that is active."""
    safety = RigSafety()
    safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
    safety.activate()
    return safety


def loop_of(rig: Rig, device: Device, safety: RigSafety) -> RigLoop:
    """The loop of a rig and its device."""
    return RigLoop(rig, device, safety, 0.02, 10, RUN, lockstep=True)


def simulated_loop(rig: Rig, seed: int) -> RigLoop:
    """The loop of a simulated rig, with the seed of its sensors' noise."""
    return loop_of(rig, SimulatedRig(rig, seed, by_the_clock=False), active_safety(rig))
