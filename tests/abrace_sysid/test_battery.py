# SPDX-License-Identifier: Apache-2.0
"""A tenth of `make verify PARTS=battery`: random structures, identified by the names alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from battery import measure_case
from battery_bounds import bounds
from battery_cases import EASY, HARD, OVER, case
from battery_structure import Structure
from scipy import signal

CASES = [(kind, number) for kind in EASY for number in range(3)] + [(kind, 0) for kind in HARD]


@cache
def outcome(kind, number):
    return measure_case(kind, number, with_peer=False)


@pytest.mark.parametrize(("kind", "number"), CASES)
def test_names_alone_give_every_identifiable_mode_and_no_false_one(kind, number):
    found = outcome(kind, number)
    assert found.refused == ""
    assert found.missed == []
    assert found.false == ()


def test_all_but_one_predict_within_a_point_of_what_the_noise_allows():
    found = [outcome(kind, number) for kind, number in CASES]
    beyond = [(one.kind, one.number, one.failures()) for one in found if not one.within]
    assert len(beyond) <= 1, beyond


def test_intervals_hold_as_often_as_they_say():
    covered = [holds for kind, number in CASES for holds in outcome(kind, number).covered]
    # 95 % of some 200, three standard errors of a share
    assert len(covered) > 150
    assert abs(np.mean(covered) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / len(covered))


@pytest.mark.parametrize(("kind", "number"), [("quake", 1), ("hit", 2), ("two_inputs", 0)])
def test_the_truth_moves_as_lsim_says(kind, number):
    one = case(kind, number)
    time = np.arange(len(one.driving)) / (OVER * one.sample_rate)
    expected = signal.lsim(one.structure.state_space(), one.driving, time)[1].reshape(len(time), -1)[::OVER]
    assert np.abs(one.foreseen - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize(("kind", "number"), [("noise", 1), ("closed_loop", 0), ("many_outputs", 0)])
def test_what_the_truth_does_not_foresee_is_white_and_as_large_as_stated(kind, number):
    one = case(kind, number)
    left = one.outputs - one.foreseen
    assert left.var(axis=0) == pytest.approx(one.white, rel=0.1)
    for column in left.T:
        assert abs(np.corrcoef(column[1:], column[:-1])[0, 1]) < 4 / np.sqrt(len(column))


def test_the_bound_of_a_hit_is_that_of_a_decaying_sine_of_known_phase():
    """A exp(-a t) cos(w t) in noise: var(a) = 16 a^3 s^2 / (A^2 rate), var(w) half of it."""
    truth = Structure(np.array([2 * np.pi]), np.array([0.02]), np.ones((1, 1, 1)), "displacement")
    rate, decay = 10.0, 0.02 * 2 * np.pi
    force = np.zeros((int(600 * rate) * OVER, 1))
    force[:OVER] = 1.0
    moved = truth.modal_responses(force, 1 / (rate * OVER))[::OVER, 0]
    spread = 0.01 * np.abs(moved).max()
    one = replace(
        case("hit", 0), structure=truth, sample_rate=rate, driving=force, inputs=force[::OVER], outputs=moved,
        foreseen=moved, white=np.array([spread**2]), walk=np.zeros(1), other_force=np.zeros((1, 1)), late=np.array([0]),
    )  # fmt: skip
    of_decay = np.sqrt(16 * decay**3 / rate) * 0.01
    found = bounds(one)
    assert found.damping[0] == pytest.approx(of_decay / decay, rel=0.1)
    assert found.frequency[0] == pytest.approx(of_decay / np.sqrt(2) / (2 * np.pi), rel=0.1)
