# SPDX-License-Identifier: Apache-2.0
"""Margins of the interlocks in the paper's tests, and what trips them, in short: make verify has them all."""

from pathlib import Path

import numpy as np
import pytest
from rehearsal import Cause, controller, el_centro, rehearse

from abrace_core.model.signals import channel_names
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.limits import INTERLOCKS

SOURCE = Path(__file__).parents[2] / "src"
LQG3 = load_weights(SOURCE / "abrace_lqg/config/lqg3.yaml")
NAMES = channel_names(3, [2])


@pytest.fixture(scope="module")
def rig():
    return load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")


@pytest.fixture(scope="module")
def lqg3(rig):
    return controller(rig, LQG3)


def test_every_interlock_has_a_margin_in_el_centro_with_and_without_control(rig, lqg3):
    for law in (None, lqg3):
        found = rehearse(rig, el_centro(500.0, 12.0), law=law)
        assert found.trip is None, str(found.trip)
        assert max(found.utilisation.values()) < 0.85
        assert list(found.utilisation) == list(INTERLOCKS)


@pytest.mark.parametrize("channel", ["x2", "xf", "a1", "fb"])
@pytest.mark.parametrize("kind", ["stuck", "zero", "noise"])
def test_a_failing_sensor_trips_within_a_tenth_of_a_second(rig, lqg3, channel, kind):
    cause = Cause(3.0, f"{channel}={kind}")
    found = rehearse(rig, el_centro(500.0, 3.2), law=lqg3, cause=cause)
    assert found.trip is not None
    assert 3.0 < found.time < 3.1


def test_a_law_with_the_wrong_sign_trips_while_the_building_is_elastic(rig):
    found = rehearse(rig, el_centro(500.0, 6.0), law=controller(rig, LQG3, -1.0))
    assert found.trip is not None
    assert found.drift < 0.042
    assert found.greatest_drift < 0.045


def test_a_loop_that_is_unstable_with_a_local_mode_trips_though_the_building_hardly_moves(rig):
    found = rehearse(rig, np.zeros(3000), law=controller(rig, LQG3, 4.0))
    assert found.trip.interlock == "oscillation"
    assert found.drift < 0.01


def test_a_table_that_runs_away_trips(rig, lqg3):
    found = rehearse(rig, np.zeros(1500), law=lqg3, cause=Cause(1.0, table=1.0))
    assert found.trip.interlock == "table_displacement"
    assert 1.0 < found.time < 2.0


@pytest.mark.parametrize(
    ("channels", "factor", "interlock"),
    [
        (["a1"], -1.0, "implausible_acceleration"),
        (["a3"], 0.5, "implausible_acceleration"),
        (["xf"], 0.5, "implausible_stroke"),
        (["fa"], -1.0, "force_error"),
        (["fb"], 0.5, "force_error"),
    ],
)
def test_a_sensor_that_is_turned_around_or_wrongly_calibrated_trips(rig, lqg3, channels, factor, interlock):
    places = [NAMES.index(name) for name in channels]

    def tamper(reading: np.ndarray) -> None:
        reading[places] *= factor

    found = rehearse(rig, el_centro(500.0, 6.0), law=lqg3, cause=Cause(2.0, tamper=tamper))
    assert found.trip.interlock == interlock
