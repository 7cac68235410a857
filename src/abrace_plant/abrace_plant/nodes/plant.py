# SPDX-License-Identifier: Apache-2.0
"""The node `plant`: a simulated rig with exactly the topics of the real one.

abrace run abrace_plant plant --ros-args -p rig:=five_storey -p seed:=3
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from rclpy.duration import Duration

from abrace_core import RunFailed
from abrace_core.files.installed import find_file
from abrace_core.safety.table_guard import TableGuard
from abrace_node.node import DISPLAY_PERIOD, RCLError
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_plant.devices.simulated import SimulatedRig, check_faults
from abrace_plant.live.loop import COMMAND, GROUND
from abrace_plant.nodes.rig_node import RIG, RigNode, time_limits
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.model import Rig

PARAMETERS = [
    *time_limits(10.0, 1000),
    Parameter("stop_heartbeat", 0.0, "seconds within which every stop button must repeat; 0: off", minimum=0.0),
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


REPEAT_PERIOD = 0.5
"""Seconds after which the first sample of a lockstep run is said again, while it is not answered: who gets it may not
have found yet who hears the answer. Later answers cannot be lost so."""
SUBSCRIBER_PATIENCE = 30.0
"""Seconds within which a slow subscriber has to accept messages; DDS removes a killed one after 20 s."""


class Plant(RigNode):
    """Samples the simulated rig, by the clock or in lockstep with its inputs."""

    simulated: SimulatedRig | None = None
    said = b""
    """The last response."""

    def __init__(self) -> None:
        super().__init__("plant", PARAMETERS)
        self.lockstep = self.parameters.lockstep

    def load(self) -> Rig:
        """The rig, with the braces of the parameter `disconnected_braces` disconnected."""
        rig = super().load().disconnect(self.parameters.disconnected_braces)
        check_faults(self.parameters.sensor_faults, rig)
        return rig

    def configure(self) -> None:
        """Load the rig and create the topics; also compile, or load, the step of the simulation."""
        super().configure()
        self.make_device()

    def make_device(self) -> SimulatedRig:
        """The rig at rest, its table where it was left; stamps go on: no answer to the former run fits this one."""
        begin, (_, table) = self.simulated.next_stamp if self.simulated else 0, self.safety.outputs
        assert isinstance(table, TableGuard)
        given, place = self.parameters, table.state.displacement
        self.simulated = simulated = SimulatedRig(self.rig, given.seed, not self.lockstep, begin, place)
        simulated.set_sensor_faults(self.parameters.sensor_faults)
        return simulated

    def activate(self) -> None:
        """Begin a run."""
        super().activate()
        if self.lockstep:
            self.due = time.monotonic()

    def tick(self) -> None:
        """In lockstep take the first sample once all nodes have been found and say it again until it is answered.

        Where an answer is missing for too long, end.
        """
        assert self.loop is not None
        now = time.monotonic()
        if self.loop.sequence < 0:
            if all(self.finds_commander(self.response, self.inputs[name]) for name in self.parameters.wait_for):
                self.began = now
                self.step()
            else:
                self.due = now + DISPLAY_PERIOD
        elif self.loop.sequence == 0 and now < self.given_up:
            self.loop.say_again()
            self.send(self.said)
            self.due = min(now + REPEAT_PERIOD, self.given_up)
        else:
            missing = [name for name in self.parameters.wait_for if not self.loop.has_answer(name)]
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
        now = time.monotonic()
        self.given_up = now + self.parameters.lockstep_timeout
        self.due = min(self.given_up, now + REPEAT_PERIOD) if self.loop.sequence == 0 else self.given_up

    def send(self, payload: bytes) -> None:
        """Publish a response; in lockstep wait for a subscriber that is behind."""
        self.said = payload
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

    def flush_publishers(self) -> None:
        """Wait until the last samples have arrived; in lockstep as long as for one that a subscriber does not accept.

        Raises
        ------
        RunFailed
            If a subscriber of a lockstep run has not got them.
        """
        patience = Duration(seconds=SUBSCRIBER_PATIENCE)
        if self.lockstep and self.configured and not self.response.wait_for_all_acked(patience):
            raise RunFailed(f"a subscriber of response has not got the last samples within {SUBSCRIBER_PATIENCE:g} s")
        super().flush_publishers()

    def on_input(self) -> None:
        """In lockstep, take the next sample once every input of `wait_for` has answered."""
        super().on_input()
        # before the first sample, which `tick` takes, there are only answers to an earlier run
        if not self.lockstep or self.loop is None or self.loop.ended or self.loop.sequence < 0:
            return
        if self.due is not None and self.exit_code is None:
            for name in self.parameters.wait_for:
                if not self.loop.has_answer(name):
                    return
            if self.loop.sequence == self.last_sequence:
                self.due = None
                elapsed = time.monotonic() - self.began
                self.finish_run(f"{self.loop.sequence + 1} samples in {elapsed:.2f} s")
            else:
                self.step()

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`; in lockstep also for whom the first sample waits."""
        fault, message, values = super().diagnose()
        if self.lockstep and self.active and self.loop is not None and self.loop.sequence < 0:
            message = f"waiting for a node that gets response and publishes {', '.join(self.parameters.wait_for)}"
        return fault, message, values

    def prepare_change(self, name: str, value: list[str]) -> Callable[[], None]:
        """New sensor faults act from the next sample on; before the rig is activated they are kept for it."""
        if not self.configured:
            return super().prepare_change(name, value)
        check_faults(value, self.rig)
        assert self.simulated is not None
        return partial(self.simulated.set_sensor_faults, value)


def prepare() -> None:
    """Compile, or load, simulation and interlocks, for a process of which each plant is a fork."""
    rig = load_rig(find_file(RIG, "abrace_plant", "config", ".yaml", "rig"))
    SimulatedRig(rig, 0, by_the_clock=False)
    Interlocks(rig)


def main() -> int:
    """Entry point."""
    return run(Plant)
