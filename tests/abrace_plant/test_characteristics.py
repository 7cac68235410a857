# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from abrace_plant.rig import published
from abrace_plant.rig.characteristics import as_json, characterize, force_response
from abrace_plant.rig.characteristics_figure import characteristics_figure
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.motion import RigMotion

CONFIGURATION = Path(__file__).parents[2] / "src/abrace_plant/config"
RIG = load_rig(CONFIGURATION / "ncree_three_storey.yaml")


@pytest.fixture(scope="module")
def found():
    return characterize(RIG)


def test_the_papers_rig_is_the_papers(found):
    for ours, paper, damping_tolerance in (
        (found.bare, published.BARE, 0.10),
        (found.zero_command, published.ZERO_COMMAND, 0.05),
        (found.extra, published.EXTRA, 0.001),
    ):
        np.testing.assert_allclose(np.array(ours)[:, 0], np.array(paper)[:, 0], rtol=0.001)
        np.testing.assert_allclose(np.array(ours)[:, 1], np.array(paper)[:, 1], rtol=damping_tolerance)
    (brace,) = found.braces
    assert brace.bench_gain_error < 0.01
    assert brace.bench_lag == pytest.approx(0.0008, rel=0.01)
    assert max(found.antiresonance_error()) < 0.01
    assert found.shape == pytest.approx(published.SHAPE, abs=0.05)
    assert brace.stroke_ratio == pytest.approx(published.STROKE_RATIO, rel=0.01)


def test_the_rig_that_runs_rings_down_with_the_poles_that_are_reported(found):
    """Free vibration: after a push the top floor's motion, filtered to its first mode, decays as reported."""
    motion = RigMotion(RIG)
    frequency, ratio = found.zero_command[0]
    period = round(2 * np.pi / frequency * RIG.sample_rate)
    push = 3000.0 * np.sin(2 * np.pi * np.arange(5 * period) / period)
    for force in push:
        motion.outputs(0.0, np.array([force]))
    x3 = np.array([motion.outputs(0.0, np.zeros(1))[2] for _ in range(20_000)])[2500:]
    up = np.flatnonzero((x3[:-1] < 0) & (x3[1:] >= 0))
    crossings = up + x3[up] / (x3[up] - x3[up + 1])
    damped = 2 * np.pi * RIG.sample_rate * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    assert damped / np.sqrt(1 - ratio**2) == pytest.approx(frequency, rel=1e-4)
    peaks = np.array([x3[a:b].max() for a, b in pairwise(up)])
    decrement = -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0]
    assert decrement / np.sqrt(4 * np.pi**2 + decrement**2) == pytest.approx(ratio, rel=0.01)


def test_antiresonances_are_minima_of_the_force(found):
    for frequency in found.braces[0].antiresonances:
        around = frequency * np.array([0.999, 1.0, 1.001])
        beside, lowest, above = np.abs(force_response(RIG, 0, around))
        assert lowest < min(beside, above)
        assert lowest < 0.5


def test_a_command_delay_is_part_of_the_bench_lag():
    group = RIG.braces[0]
    late = replace(RIG, braces=(replace(group, actuator=replace(group.actuator, command_delay=0.0015)),))
    assert characterize(late).braces[0].bench_lag == pytest.approx(0.0023, rel=0.01)


@pytest.mark.parametrize("name", ["five_storey", "ten_storey", "single_storey"])
def test_any_rig_is_characterized(name):
    rig = load_rig(CONFIGURATION / f"{name}.yaml")
    found = characterize(rig)
    assert len(found.bare) == len(found.zero_command) == len(found.shape) == rig.floors
    assert len(found.braces) == rig.groups
    frequencies = [frequency for frequency, _ in found.zero_command]
    assert (np.diff(frequencies) > 0).all()
    assert all(zero >= bare for (zero, _), (bare, _) in zip(found.zero_command, found.bare, strict=True))
    assert found.shape[-1] == pytest.approx(1.0)
    assert json.loads(json.dumps(as_json(found, rig), allow_nan=False))["rig"] == rig.name
    assert len(characteristics_figure(rig, found).axes) == 6


def test_an_antiresonance_that_is_not_there_is_null_in_the_file():
    group = RIG.braces[0]
    ideal = replace(group, actuator=replace(group.actuator, velocity_feedback=0.0))
    rig = replace(RIG, name="ideal", braces=(ideal,))
    found = characterize(rig)
    assert np.isnan(found.braces[0].antiresonances).all(), "without velocity feedback the building cannot be felt in f"
    assert as_json(found, rig)["braces"][0]["antiresonances"] == [None] * 3
    assert "comparison" not in as_json(found, rig)
