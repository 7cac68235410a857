# SPDX-License-Identifier: Apache-2.0
"""Generated rigs without a fault: shear buildings, close modes, isolators, stiff ones, two unequal brace groups."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from laboratory import Laboratory

from abrace_core.model import signals
from abrace_core.model.noise import banded_noise
from abrace_plant.rig.file import load_rig
from abrace_sysid.examination import examined
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.recorded.test import Test
from abrace_sysid.validity.judgement import findings_of_tests

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig
    from abrace_sysid.validity.finding import Finding

KINDS = ("shear", "close modes", "isolated", "stiff", "two groups")
REST = 2.0
"""At both ends of a test [s]."""


def faultless(seed: int) -> tuple[str, Rig]:
    """The kind of a rig without a fault, and the rig."""
    random = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    floors = int(random.integers(1, 13) if kind == "shear" else random.integers(3, 7))
    masses = 1e4 * random.uniform(0.7, 1.3, floors)
    storeys = random.uniform(0.7, 1.3, floors) * np.linspace(1.0, 0.6, floors)
    first = random.uniform(8.0, 14.0) / (1 + 0.15 * floors) if kind == "stiff" else random.uniform(0.8, 3.0)
    damping = random.uniform(0.005, 0.02, floors)
    building: dict[str, Any] = {"storey_height": 3.0}
    if kind == "close modes":
        masses[:] = 1e4
        others = random.uniform(1.5, 2.5) * np.arange(2, floors)
        hertz = first * np.concatenate([[1.0, 1.0 + random.uniform(0.005, 0.03)], others])
        shapes = np.linalg.qr(random.standard_normal((floors, floors)))[0].T
        building["modes"] = {"frequencies": (2 * np.pi * np.sort(hertz)).tolist(), "shapes": shapes.tolist()}
    else:
        storeys *= (2 * np.pi * first) ** 2 / _slowest(storeys, masses)
        if kind == "isolated":
            storeys *= random.uniform(4.0, 40.0)
            storeys[0] = masses.sum() * (2 * np.pi * random.uniform(0.2, 0.5)) ** 2
            damping[0] = 0.05
        building["stiffness"] = _stiffness(storeys).tolist()
    capacity = 0.05 * 9.81 * float(masses.sum())
    braces = [_brace(1, capacity, 0.8, 0.001)]
    if kind == "two groups":
        braces.append(_brace(int(random.integers(2, floors + 1)), 0.4 * capacity, 0.7, 0.002))
    sensor = {"bits": 24}
    content = {
        "name": f"faultless_{seed}",
        "sample_rate": {"two groups": 1000.0, "isolated": 200.0}.get(kind, 500.0),
        "table": {"peak_acceleration": 10.0, "peak_jerk": 2000.0, "peak_velocity": 1.0, "peak_displacement": 0.5},
        "building": building | {"masses": masses.tolist(), "damping_ratios": damping.tolist()},
        "braces": braces,
        "sensors": {
            "displacement": sensor | {"range": 0.4, "noise": 2e-5},
            "stroke": sensor | {"range": 0.3, "noise": 2e-5},
            "acceleration": sensor | {"range": 10.0, "noise": 2e-3},
            "force": sensor | {"range": 1.3 * capacity, "noise": 5e-4 * capacity},
            "ground_acceleration": sensor | {"range": 5.0, "noise": 1e-3},
        },
    }
    with TemporaryDirectory() as folder:
        path = Path(folder, "rig.yaml")
        path.write_text(yaml.safe_dump(content))
        return kind, load_rig(path)


def _stiffness(storeys: NDArray[np.float64]) -> NDArray[np.float64]:
    above = np.append(storeys[1:], 0.0)
    return np.asarray(np.diag(storeys + above) - np.diag(above[:-1], 1) - np.diag(above[:-1], -1))


def _slowest(storeys: NDArray[np.float64], masses: NDArray[np.float64]) -> float:
    root = 1 / np.sqrt(masses)
    return float(np.linalg.eigvalsh(_stiffness(storeys) * np.outer(root, root))[0])


def _brace(floor: int, capacity: float, cosine: float, lag: float) -> dict[str, Any]:
    actuator = {
        "capacity": capacity,
        "rate_limit": 100 * capacity,
        "lag": lag,
        "integral_rate": 2.0,
        "velocity_feedback": 0.1 * capacity,
        "flow_limit": 200 * capacity,
        "stroke_limit": 0.2,
        "stop_stiffness": 1e3 * capacity,
    }
    return {"floor": floor, "count": 1, "cosine": cosine, "stiffener_stiffness": 0.0, "actuator": actuator}


def noise_tests(rig: Rig, seed: int, seconds: float) -> list[Run]:
    """Noise on the table, then in each brace group, up to the modes that a laboratory would excite."""
    rate, laboratory = rig.sample_rate, Laboratory(rig, seed)
    fastest = float(rig.building.modes()[0][-1]) / (2 * np.pi)
    highest = min(max(10.0, 1.2 * fastest if rig.floors < 6 else 10.0), 0.3 * rate)
    rest, samples = np.zeros(round(REST * rate)), round(seconds * rate)

    def noise(band: tuple[float, float], rms: float, number: int) -> NDArray[np.float64]:
        return np.concatenate([rest, banded_noise(samples, rate, band, rms, 10 * seed + number), rest])

    ground = noise((0.1, highest), 0.25, 0)
    found = [laboratory.open_loop("table", ground, np.zeros((len(ground), rig.groups)))]
    for group in range(rig.groups):
        command = np.zeros((len(ground), rig.groups))
        command[:, group] = noise((0.0, min(2 * highest, 0.35 * rate)), 0.12 * rig.capacity[group], 1 + group)
        found.append(laboratory.open_loop(f"command_{group + 1}", 0 * ground, command))
    return found


def accusations(rig: Rig, seed: int, seconds: float) -> list[Finding]:
    """Findings that name a fault of a sensor or part of a rig without a fault; there should be none."""
    tests = [Test.of(run) for run in noise_tests(rig, seed, seconds)]
    options = IdentificationOptions().of_tests(tests[:1], tests[1:])
    driving = [test.moving or (signals.GROUND,) for test in tests]
    tests = [examined(test, names, options.band_of(test)) for test, names in zip(tests, driving, strict=True)]
    return [finding for finding in findings_of_tests(tests, options, {}) if finding.cause]
