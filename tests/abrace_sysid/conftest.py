from pathlib import Path

import numpy as np
import pytest

from abrace_core.linear_model import LinearModel
from abrace_core.noise import banded_noise
from abrace_core.run import Run
from abrace_core.simulation import simulate, simulate_closed_loop
from abrace_plant.rig_file import load_rig
from abrace_plant.sensors import Measurement
from abrace_sysid.identification import identify

RIG_FILE = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"
SILENCE = 1000


@pytest.fixture(scope="session")
def rig():
    return load_rig(RIG_FILE)


class Laboratory:
    """Tests of a rig as Runs, made without ROS: white noise, and earthquakes with a controller or without."""

    def __init__(self, rig, seed=0):
        self.rig, self.seed = rig, seed
        self.model = rig.discrete_model()

    def _run(self, source, outputs, ground, command_until):
        channels = self.rig.sensors.channels(self.rig.floors, self.rig.groups)
        sensors = Measurement(channels, self.seed, self.model.sample_period)
        readings = sensors.record(np.column_stack([outputs, ground]))
        sequence = np.arange(len(ground), dtype=np.uint64)
        period = self.model.sample_period
        shape = (self.rig.floors, self.rig.groups)
        return Run(source, period, sequence, *shape, readings[:, :-1], readings[:, -1], command_until)

    def open_loop(self, source, ground, command):
        """`command` (samples,) is in force from each sample on."""
        outputs = simulate(self.model, np.column_stack([ground, command]))
        return self._run(source, outputs, ground, np.concatenate([[0.0], command[:-1]])[:, None])

    def table_test(self, seconds, rms=0.25):
        noise = self._noise(seconds, 10.0, rms, 1000 + self.seed)
        return self.open_loop("bags/table", noise, 0 * noise)

    def command_test(self, seconds, rms=1800.0):
        noise = self._noise(seconds, 30.0, rms, 2000 + self.seed)
        return self.open_loop("bags/command", 0 * noise, noise)

    def earthquake(self, controller=None, seconds=40):
        samples = int(seconds * 500)
        time = np.arange(samples) / 500
        rise_and_decay = np.minimum(time / 2, 1) * np.exp(-np.maximum(time - 8, 0) / 8)
        ground = banded_noise(samples, 500, (0.3, 12.0), 1.0, 3000 + self.seed) * rise_and_decay
        ground *= 0.981 / np.abs(ground).max()
        if controller is None:
            return self.open_loop("bags/earthquake", ground, 0 * ground)
        outputs, command = simulate_closed_loop(self.model, controller, ground, self.rig.capacity)
        return self._run("bags/controlled", outputs, ground, command)

    @staticmethod
    def _noise(seconds, highest, rms, seed):
        noise = banded_noise(int(seconds * 500), 500, (0.0, highest), rms, seed)
        return np.concatenate([np.zeros(SILENCE), noise, np.zeros(SILENCE)])


@pytest.fixture(scope="session")
def laboratory(rig):
    return Laboratory(rig)


@pytest.fixture(scope="session")
def laboratory_of():
    return Laboratory


@pytest.fixture(scope="session")
def table_test(laboratory):
    return laboratory.table_test(240)


@pytest.fixture(scope="session")
def command_test(laboratory):
    return laboratory.command_test(240)


@pytest.fixture(scope="session")
def identified(table_test, command_test):
    return identify(table_test, command_test)


@pytest.fixture(scope="session")
def controller():
    """A damper: the command opposes leaky integrals of the three accelerations."""
    leak = np.exp(-2.0 * 0.002)
    gain = -4e4 * np.array([[0.6, 0.3, 0.3]])
    return LinearModel(
        leak * np.eye(3), 0.002 * np.eye(3), gain, np.zeros((1, 3)), ("a1", "a2", "a3"), ("U",), sample_period=0.002
    )


@pytest.fixture(scope="session")
def plain_run():
    """A run of a one-storey rig whose every output is one given series."""

    def make(outputs, ground=None, command=None):
        samples = len(outputs)
        ground = np.zeros(samples) if ground is None else ground
        command = np.zeros(samples) if command is None else command
        columns = np.column_stack([outputs] * 4)
        sequence = np.arange(samples, dtype=np.uint64)
        return Run("bags/plain", 0.002, sequence, 1, 1, columns, ground, command[:, None])

    return make
