# SPDX-License-Identifier: Apache-2.0
"""The node `plant`: a simulated rig with exactly the topics of the real one.

abrace run abrace_plant plant --ros-args -p rig:=five_storey -p seed:=3
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from abrace_core.node import Parameter, RCLError, run
from abrace_core.node.conventions import DISPLAY_PERIOD
from abrace_plant.devices.simulated import SimulatedRig, sensor_faults
from abrace_plant.live.loop import COMMAND, GROUND
from abrace_plant.nodes.rig_node import RigNode, time_limits
from abrace_plant.rig.model import Rig
from abrace_plant.rig.sensors import SensorFault

PARAMETERS = [
    *time_limits(10.0, 1000),
    Parameter("disconnected_braces", [], "disconnected brace groups (1 the first); all: bare frame", element=int),
    Parameter("seed", 0, "seed of the sensor noise", minimum=0),
    Parameter(
        "sensor_faults",
        [],
        "failed channels, such as a2=stuck, x3=zero, fa=noise@20.0 (from second 20 on)",
        element=str,
        live=True,
    ),
    Parameter("lockstep", False, "take the next sample when every input of wait_for has answered, not by the clock"),
    Parameter(
        "wait_for",
        [COMMAND],
        "inputs whose answers lockstep waits for",
        choices=(COMMAND, GROUND),
        required=True,
    ),
    Parameter("lockstep_timeout", 10.0, "seconds without an answer that end a lockstep run", minimum=0.1),
]


SUBSCRIBER_PATIENCE = 30.0
"""Seconds within which a slow subscriber has to accept messages; DDS removes a killed one after 20 s."""


class Plant(RigNode):
    """Samples the simulated rig, by the clock or in lockstep with its inputs."""

    def __init__(self) -> None:
        super().__init__("plant", PARAMETERS)
        self.lockstep = self.parameters.lockstep

    def load(self) -> Rig:
        """The rig, with the braces of the parameter `disconnected_braces` disconnected."""
        rig = super().load().disconnect(self.parameters.disconnected_braces)
        sensor_faults(self.parameters.sensor_faults, rig)
        return rig

    def configure(self) -> None:
        """Load the rig and create the topics; also compile, or load, the step of the simulation."""
        super().configure()
        self.make_device()

    def make_device(self) -> SimulatedRig:
        """The rig at rest, with its sensor faults."""
        self.simulated = SimulatedRig(self.rig, self.parameters.seed, not self.lockstep)
        self.simulated.set_sensor_faults(sensor_faults(self.parameters.sensor_faults, self.rig))
        return self.simulated

    def activate(self) -> None:
        """Begin a run."""
        super().activate()
        if self.lockstep:
            self.due = time.monotonic()

    def tick(self) -> None:
        """In lockstep take the first sample once all nodes have been found, or end because an answer is missing."""
        assert self.loop is not None
        if self.loop.sequence < 0:
            matched = all(self.inputs[name].get_publisher_count() for name in self.parameters.wait_for)
            if matched and self.response.get_subscription_count() >= len(self.parameters.wait_for):
                self.began = time.monotonic()
                self.step()
            else:
                self.due = time.monotonic() + DISPLAY_PERIOD
        else:
            missing = [name for name in self.parameters.wait_for if not self.loop.answered(name)]
            self.due = None
            self.finish(
                1,
                f"no answer to sample {self.loop.sequence} on {', '.join(missing)} within "
                f"{self.parameters.lockstep_timeout:g} s (lockstep_timeout)",
            )

    def step(self) -> None:
        """Take the next sample of a run in lockstep."""
        assert self.loop is not None
        self.publish_sample(self.loop.step())
        self.due = time.monotonic() + self.parameters.lockstep_timeout

    def send(self, payload: bytes) -> None:
        """Publish a response; in lockstep wait for a subscriber that is behind."""
        given_up = time.monotonic() + SUBSCRIBER_PATIENCE
        while True:
            try:
                super().send(payload)
                return
            except RCLError:
                if not self.lockstep:
                    raise
                if time.monotonic() > given_up:
                    self.finish(1, f"a subscriber of response accepted no message for {SUBSCRIBER_PATIENCE:g} s")
                    return

    def answered(self) -> None:
        """In lockstep, take the next sample once every input of `wait_for` has answered."""
        super().answered()
        # before the first sample, which `tick` takes, there are only answers to an earlier run
        if not self.lockstep or self.loop is None or self.loop.ended or self.loop.sequence < 0:
            return
        if self.due is not None and self.exit_code is None:
            for name in self.parameters.wait_for:
                if not self.loop.answered(name):
                    return
            if self.loop.sequence == self.last:
                self.due = None
                elapsed = time.monotonic() - self.began
                self.finish_run(f"{self.loop.sequence + 1} samples in {elapsed:.2f} s")
            else:
                self.step()

    def prepare_change(self, name: str, value: list[str]) -> Callable[[], None]:
        """New sensor faults act from the next sample on; before the rig is activated they are kept for it."""
        if not self.configured:
            return super().prepare_change(name, value)
        return partial(self.change_sensor_faults, sensor_faults(value, self.rig))

    def change_sensor_faults(self, faults: tuple[SensorFault, ...]) -> None:
        """Replace the sensor faults of the run."""
        if self.active:
            self.simulated.set_sensor_faults(faults)


def main() -> int:
    """Entry point."""
    return run(Plant)
