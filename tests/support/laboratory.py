# SPDX-License-Identifier: Apache-2.0
"""A laboratory without ROS: simulated tests of a rig with its sensors, as recorded Runs.

Used by the tests of identification and by `make verify`, which need many records.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from abrace_core.model.multisine import repeated_multisine
from abrace_core.model.noise import banded_noise
from abrace_core.model.run import Run
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_plant.rig.effects import effects
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_core.model.linear_model import LinearModel
    from abrace_plant.rig.model import Rig

Array = NDArray[np.float64]
PAPER_RIG = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"
SILENCE = 1000
"""Samples at rest before and after the noise of a test."""


def paper_tests(seconds: float, seed: int) -> tuple[Run, Run]:
    """A test of the table and one of the braces of the paper's rig, white noise of so many `seconds`."""
    rig = load_rig(PAPER_RIG)
    laboratory, facts = Laboratory(rig, seed), {"rig": rig.name, "capacity": json.dumps(rig.capacity.tolist())}
    return replace(laboratory.table_test(seconds), facts=facts), replace(laboratory.command_test(seconds), facts=facts)


class Laboratory:
    """Tests of a rig as Runs: white noise, and earthquakes with a controller or without.

    Parameters
    ----------
    rig
        The rig; records have its sensors' noise, range and resolution. A rig without nonlinear effects is simulated as
        linear and without limits, a rig with such effects with all of them.
    seed
        Seed of sensor noise and excitation.
    """

    def __init__(self, rig: Rig, seed: int = 0) -> None:
        self.rig, self.seed = rig, seed
        self.model = rig.discrete_model()
        self.as_it_is = bool(effects(rig))

    def _run(self, source: str, outputs: Array, ground: Array, command_until: Array) -> Run:
        channels = [one for one in self.rig.sensors.channels(self.rig.floors, self.rig.groups, self.rig.groups) if one]
        sensors = Measurement(channels, self.seed, self.model.sample_period)
        readings = sensors.record(np.column_stack([outputs, ground]))
        sequence = np.arange(len(ground), dtype=np.uint64)
        period = self.model.sample_period
        shape = (self.rig.floors, self.rig.groups)
        braces = self.rig.braces_in_group
        return Run(source, period, sequence, *shape, readings[:, :-1], readings[:, -1], command_until, braces=braces)

    def _stepped(self, source: str, ground: Array, command: Callable[[int, Array], Array]) -> Run:
        """A test of a rig with nonlinear effects; `command` gives the command at k from k and the outputs at k - 1."""
        motion, acting = RigMotion(self.rig), np.zeros(self.rig.groups)
        outputs, until = np.zeros((len(ground), len(self.model.outputs))), np.zeros((len(ground), len(acting)))
        table = np.zeros(len(ground))
        for k, acceleration in enumerate(ground):
            until[k] = acting
            acting = np.clip(command(k, outputs[k - 1]), -self.rig.capacity, self.rig.capacity)
            outputs[k] = motion.outputs(acceleration, acting)
            table[k] = motion.ground_acceleration
        return self._run(source, outputs, table, until)

    def open_loop(self, source: str, ground: Array, command: Array) -> Run:
        """A test with a `command` (samples,) or (samples, groups) from each sample on; its name is `source`."""
        command = command.reshape(len(ground), -1)
        if self.as_it_is:
            return self._stepped(source, ground, lambda k, _: command[k])
        outputs = simulate(self.model, np.column_stack([ground, command]))
        return self._run(source, outputs, ground, np.vstack([np.zeros((1, command.shape[1])), command[:-1]]))

    def closed_loop(self, source: str, ground: Array, controller: LinearModel, correction: Array | None = None) -> Run:
        """A test in which a discrete `controller` commands, within the rig's capacity; its name is `source`.

        `correction` is the controller's, as in `simulate_closed_loop`; not used for a rig with nonlinear effects.
        """
        if self.as_it_is:
            state, measured = np.zeros(controller.order), [self.model.outputs.index(n) for n in controller.inputs]

            def law(_: int, outputs: Array) -> Array:
                nonlocal state
                command = controller.c @ state + controller.d @ outputs[measured]
                state = controller.a @ state + controller.b @ outputs[measured]
                return np.asarray(command)

            return self._stepped(source, ground, law)
        outputs, command = simulate_closed_loop(self.model, controller, ground, self.rig.capacity, correction)
        return self._run(source, outputs, ground, command)

    def table_test(self, seconds: float, rms: float = 0.25) -> Run:
        """White noise on the table, zero command."""
        noise = self._noise(seconds, 10.0, rms, 1000 + self.seed)
        return self.open_loop("bags/table", noise, 0 * noise)

    def command_test(self, seconds: float, rms: float = 1800.0) -> Run:
        """White noise as command, the table at rest."""
        noise = self._noise(seconds, 30.0, rms, 2000 + self.seed)
        return self.open_loop("bags/command", 0 * noise, noise)

    def multisine_test(self, table: bool, command: bool, periods: int = 5, period: float = 32.768) -> Run:
        """Multisines on the table (odd lines), as command (even lines if also on the table, otherwise odd), or both."""
        duration, rate = periods * period, 500.0
        still = np.zeros(round(duration * rate))
        lines = "even" if table and command else "odd"
        ground = repeated_multisine(duration, period, rate, (0.3, 10.0), 0.25, 4000 + self.seed) if table else still
        force = (
            repeated_multisine(duration, period, rate, (0.3, 30.0), 1800.0, 5000 + self.seed, lines)
            if command
            else still
        )
        return self.open_loop("bags/" + ("both" if table and command else "multisine"), ground, force)

    def earthquake(
        self, controller: LinearModel | None = None, seconds: float = 40, correction: Array | None = None
    ) -> Run:
        """A noise with the envelope of an earthquake, at 0.1 g, with a controller or zero command."""
        samples = int(seconds * 500)
        time = np.arange(samples) / 500
        rise_and_decay = np.minimum(time / 2, 1) * np.exp(-np.maximum(time - 8, 0) / 8)
        ground = banded_noise(samples, 500, (0.3, 12.0), 1.0, 3000 + self.seed) * rise_and_decay
        ground *= 0.981 / np.abs(ground).max()
        if controller is None:
            return self.open_loop("bags/earthquake", ground, 0 * ground)
        return self.closed_loop("bags/controlled", ground, controller, correction)

    @staticmethod
    def _noise(seconds: float, highest: float, rms: float, seed: int) -> Array:
        noise = banded_noise(int(seconds * 500), 500, (0.0, highest), rms, seed)
        return np.concatenate([np.zeros(SILENCE), noise, np.zeros(SILENCE)])
