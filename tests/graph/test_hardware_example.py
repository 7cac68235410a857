# SPDX-License-Identifier: Apache-2.0
"""Example 8 as its page says: its campaign, on the emulator behind UDP packets, through the node sensor_bridge.

A busy machine is not to stop the rig: it has fewer samples a second than in the example, and device and target wait
longer for each other. The tests are shorter.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from documents import ROOT, blocks
from domain_coordinator import domain_id
from page_runner import lines
from running_graph import SLOW
from udp_target import CONFIG, free_ports

from abrace_bags import read_runs
from abrace_core.model.simulation import simulate
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.run import Run

EXAMPLE = ROOT / "examples/8_hardware"
NOISE = {"x": 5.6e-5, "xf": 2.2e-5, "a": 3.4e-3, "f": 16.0, "w": 8.4e-4}
"""Standard deviations of the sensors' noise, as the rig file has them: m, m, m/s^2, N of one load cell, m/s^2."""
PATIENCE = 500.0
"""Seconds for the campaign: a healthy machine never comes near."""


def replaced(file: Path, values: dict[str, str]) -> None:
    """Put other values behind keys of a YAML file, each as often as it is there."""
    text = file.read_text(encoding="utf-8")
    for key, value in values.items():
        text, count = re.subn(rf"(\b{key}): [^,}}\s]+", rf"\1: {value}", text)
        assert count, f"{file.name}: no {key}"
    file.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the example in which the commands of its page were given."""
    folder = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("hardware") / "example")
    port, local_port = map(str, free_ports(2))
    replaced(folder / "device.yaml", {"port": port, "local_port": local_port, "timeout": "0.9", "life_time": "1.0"})
    replaced(folder / "campaign.yaml", {"rig": "slow.yaml", "duration": "3.0"})
    shutil.copy(CONFIG / "ncree_three_storey.yaml", folder / "slow.yaml")
    replaced(folder / "slow.yaml", {"sample_rate": str(SLOW)})
    commands = [line for block in blocks(EXAMPLE / "README.md") for line in lines(block)]
    assert commands == ["abrace campaign campaign.yaml --check", "abrace campaign campaign.yaml"]
    with domain_id() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        for command in commands:
            ended = subprocess.run(
                shlex.split(command), cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE,
                check=False,
            )  # fmt: skip
            assert ended.returncode == 0, f"{command}\n{ended.stdout}{ended.stderr}"
    return folder


def recorded(folder: Path, test: str) -> list[Run]:
    """The bag of a test; in several pieces where the emulator was held up, and missed ticks."""
    (bag,) = folder.glob(f"bags/hardware/*/{test}")
    return read_runs(bag)


def noise_of(runs: list[Run]) -> NDArray[np.float64]:
    """Of each output; a group's force is the mean of two load cells."""
    noise = [NOISE.get(name, NOISE[name[0]]) for name in runs[0].names]
    return np.array(
        [one / np.sqrt(2.0) if name == "f" else one for one, name in zip(noise, runs[0].names, strict=True)]
    )


def measured_and_predicted(folder: Path, test: str) -> tuple[list[Run], NDArray[np.float64], NDArray[np.float64]]:
    """A test's bag, its outputs, and those of the rig file's linear model under the recorded inputs, from rest.

    While it misses ticks the target holds its outputs.
    """
    runs = recorded(folder, test)
    numbers = np.concatenate([run.sequence for run in runs]).astype(int)
    measured, ground, until = (
        np.concatenate([getattr(run, name) for run in runs]) for name in ("outputs", "ground_acceleration", "command")
    )
    every = np.arange(numbers[0], numbers[-1] + 1)
    following = np.searchsorted(numbers, np.minimum(every + 1, numbers[-1]))
    inputs = np.column_stack([np.interp(every, numbers, ground), until[following]])
    model = load_rig(folder / "slow.yaml").discrete_model()
    assert (model.inputs, model.outputs) == (("w", "U"), runs[0].names)
    return runs, measured, simulate(model, inputs)[numbers - numbers[0]]


TESTS = ("rest", "first_force", "first_motion")


@pytest.mark.parametrize("test", TESTS)
def test_the_device_file_is_the_rig_and_nothing_stops_it(folder: Path, test: str) -> None:
    given = yaml.safe_load((folder / f"results/hardware/nodes/{test}_plant.yaml").read_text())["/**"]["ros__parameters"]
    assert Path(given["device"]).name == "device.yaml", "the bridge, not the simulated rig"
    runs = recorded(folder, test)
    assert sum(len(run.sequence) for run in runs) > 2.0 * SLOW
    assert not [run.stopped for run in runs if run.stopped]
    report = json.loads((folder / f"results/hardware/nodes/{test}_emulator.json").read_text())
    assert report["last_arm"] > 0, "the target was armed by the bridge"


def test_at_rest_the_sensors_have_the_noise_of_the_rig_file_about_zero(folder: Path) -> None:
    runs = recorded(folder, "rest")
    outputs, ground = (
        np.concatenate([getattr(run, name) for run in runs]) for name in ("outputs", "ground_acceleration")
    )
    readings, noise = np.column_stack([outputs, ground]), np.append(noise_of(runs), NOISE["w"])
    assert np.abs(readings.mean(axis=0) / noise).max() < 0.4, "0 is measured: 20 standard deviations of a mean are 1"
    assert readings.std(axis=0) / noise == pytest.approx(1.0, abs=0.25)
    assert not any(run.command.any() for run in runs)


def test_the_force_that_is_commanded_comes_back_and_moves_the_building(folder: Path) -> None:
    runs, measured, predicted = measured_and_predicted(folder, "first_force")
    command = np.concatenate([run.command for run in runs])
    assert 100.0 < np.abs(command).max() <= 250.0, "noise of 80 N, no more than 1 % of the capacity"
    report = json.loads((folder / "results/hardware/nodes/first_force_emulator.json").read_text())
    assert report["worst_force"] == pytest.approx(np.abs(command).max(), rel=1e-6), (
        "what the target put out is in the bag"
    )
    assert (measured - predicted).std(axis=0) / noise_of(runs) == pytest.approx(1.0, abs=0.25), (
        "the sensors' noise is left"
    )
    force = runs[0].names.index("f")
    assert np.corrcoef(measured[:, force], predicted[:, force])[0, 1] > 0.9
    for one, other in (run.forces.T for run in runs):
        assert (one - other).std() < 1.6 * np.sqrt(2.0) * NOISE["f"], "both load cells read the force"


def test_the_table_plays_a_tenth_of_the_record_and_the_building_follows(folder: Path) -> None:
    runs, measured, predicted = measured_and_predicted(folder, "first_motion")
    ground = np.concatenate([run.ground_acceleration for run in runs])
    assert np.abs(ground).max() == pytest.approx(0.098, abs=6 * NOISE["w"])
    assert not any(run.command.any() for run in runs)
    size = measured.std(axis=0)
    assert size[runs[0].names.index("x3")] > 20 * NOISE["x"], "it moves"
    left = (measured - predicted).std(axis=0)
    assert (left < 1.3 * noise_of(runs) + 0.05 * size).all()
