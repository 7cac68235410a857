# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
from computed_once import computed_once
from laboratory import Laboratory

from abrace_core.model.linear_model import LinearModel
from abrace_core.model.run import Run
from abrace_plant.rig.file import load_rig
from abrace_sysid.identification import identify

RIG_FILE = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"


@pytest.fixture(scope="session")
def rig():
    return load_rig(RIG_FILE)


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
def identified_with_steps(table_test, command_test, tmp_path_factory):
    """What is identified from both tests, and the steps that were reported meanwhile."""

    def compute():
        steps = []
        found = identify(table_test, command_test, progress=lambda step, fraction: steps.append((fraction, step)))
        return found, steps

    return computed_once(tmp_path_factory, "identified", compute)


@pytest.fixture(scope="session")
def identified(identified_with_steps):
    return identified_with_steps[0]


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
