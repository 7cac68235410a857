# SPDX-License-Identifier: Apache-2.0
"""Sample period and force limits of controllers, and the band of ground motions, from what a model says of its rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from abrace_core import AbraceError
from abrace_lqg.proof.limits import DesignOptions, excitation_of, force_limit_of, sample_period_of
from abrace_plant.rig.file import load_rig

SOURCE = Path(__file__).parents[2] / "src"


@pytest.fixture(scope="module")
def rig():
    return load_rig(SOURCE / "abrace_plant/config/five_storey.yaml")


def test_they_are_those_of_the_rig(rig):
    assert sample_period_of(rig.model) == 1 / rig.sample_rate
    assert force_limit_of(rig.model) == rig.capacity.tolist()


def test_given_ones_come_first(rig):
    assert sample_period_of(rig.model, 0.01) == 0.01
    assert force_limit_of(rig.model, [1.0, 2.0]) == [1.0, 2.0]
    assert force_limit_of(rig.model, [3.0]) == [3.0, 3.0], "one for every group"
    with pytest.raises(AbraceError, match=r"force_limit: \[1.0, 2.0, 3.0\] N, expected one for each .* \(U1, U2\)"):
        force_limit_of(rig.model, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("period", [-0.002, float("nan"), 0.31, 1e9])
def test_a_sample_period_in_which_the_slowest_mode_turns_around_is_refused(rig, period):
    """1.65 Hz: half a period is 0.3 s."""
    expected = r"sample_period: .* s, expected above 0 and below 0\.302 s, half the slowest mode's period"
    with pytest.raises(AbraceError, match=expected):
        sample_period_of(rig.model, period)
    assert sample_period_of(rig.model, 0.29) == 0.29


def test_without_either_nothing_is_assumed(rig):
    model = replace(rig.model, provenance={})
    with pytest.raises(
        AbraceError, match="sample_period: not given, and the model's file does not have it, expected s"
    ):
        sample_period_of(model)
    with pytest.raises(
        AbraceError, match=r"force_limit: not given, .* expected the greatest of U1 \[N\], U2 \[N\], or a rig"
    ):
        force_limit_of(model)


@pytest.mark.parametrize(("times", "band"), [(1.0, (0.3, 10.0)), (0.1, (0.0826, 10.0)), (10.0, (0.3, 66.1))])
def test_the_band_of_ground_motions_includes_the_slowest_mode(rig, times, band):
    # five_storey's slowest mode is at 1.65 Hz; all of the model is made slower or faster
    model = replace(rig.model, a=times * rig.model.a)
    found = excitation_of(model)
    assert (found.rms, found.band) == (0.25, pytest.approx(band, rel=0.01))
    assert excitation_of(model, 0.1, (1.0, 2.0)).band == (1.0, 2.0)


def test_the_band_of_ground_motions_ends_at_half_the_sample_rate_unless_it_is_given(rig):
    assert excitation_of(rig.model, sample_period=0.1).band == (0.3, 5.0)
    assert excitation_of(rig.model, sample_period=0.002).band == (0.3, 10.0)
    assert excitation_of(rig.model, 0.25, (0.5, 20.0), 0.1).band == (0.5, 20.0)
    assert DesignOptions(sample_period=0.1, force_limit=(1e3,)).of_model(rig.model).excitation_band == (0.3, 5.0)
