# SPDX-License-Identifier: Apache-2.0
"""Live runs behind the C target: it stops by itself, the cable is cut, a valve sticks; `make verify` tries many."""

import random

import pytest
from live_rig import LiveRig
from target_stops import Stops, sine, strong, stuck_valve


@pytest.fixture
def live(tmp_path):
    opened: list[LiveRig] = []

    def start(law) -> LiveRig:
        opened.append(LiveRig(tmp_path, law))
        return opened[-1]

    yield start
    for rig in opened:
        rig.close()


def test_a_target_that_stops_or_is_cut_off_is_latched_and_followed_no_more(live):
    stops, chance = Stops(), random.Random(2)
    rig = live(sine(stops.shake))
    stops.trip(rig, chance)
    assert (stops.latched, stops.followed_again) == (1, 0), rig.safety.cause
    stops.cut(rig, chance)
    assert (stops.cable_passed, stops.followed_again) == (1, 0), rig.safety.cause
    assert stops.worst_step <= 1.0


def test_load_cells_that_stay_at_a_force_after_a_stop_are_a_state_of_their_own_that_cannot_be_cleared(live):
    assert stuck_valve(live(strong))
