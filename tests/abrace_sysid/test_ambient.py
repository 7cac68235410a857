# SPDX-License-Identifier: Apache-2.0
"""Modes from responses alone, and a change told from chance; how often intervals hold: `make verify`."""

from dataclasses import replace

import numpy as np
import pytest
from ambient_structure import BAND, RATE, AmbientStructure, weakened

from abrace_core import AbraceError
from abrace_sysid.ambient.change import compare_tests
from abrace_sysid.ambient.modes import AmbientOptions, ambient_modes, ambient_test
from abrace_sysid.ambient.subspace import OutputCovariances
from abrace_sysid.figures.ambient import ambient_stabilization
from abrace_sysid.recorded.test import Test


@pytest.fixture(scope="module")
def structure(rig) -> AmbientStructure:
    return AmbientStructure(rig)


IN_BAND = AmbientOptions(band=BAND)


def modes_of(structure: AmbientStructure, seconds: float, seed: int):
    return ambient_modes(
        f"seed {seed}", [structure.record(seconds, seed)], structure.channels, RATE, AmbientOptions(band=BAND)
    )


@pytest.fixture(scope="module")
def tests(structure):
    return [modes_of(structure, 600.0, seed) for seed in range(24)]


def test_every_mode_is_found_and_hardly_anything_else(structure, tests):
    found = [[mode.frequency for mode in test.modes] for test in tests]
    for frequency, _ in structure.poles:
        assert all(any(abs(one / frequency - 1) < 0.01 for one in each) for each in found)
    assert sum(len(each) for each in found) <= 3 * len(tests) + 4


def test_deviations_are_the_derivatives_of_the_poles(structure):
    """Poles of a Hankel matrix that is moved a little by each piece's deviation, against the first-order sum."""
    record = structure.record(600.0, 1)[::3]
    covariances = OutputCovariances([record], 20, 8)
    (found,) = covariances.modes([6], 3 / RATE)
    step, moved = 1e-4, []
    whole = covariances.hankel
    for deviation in covariances._deviations:
        ends = []
        for sign in (1, -1):
            other = OutputCovariances([record], 20, 8)
            other._left, other._singular, other._right = np.linalg.svd(whole + sign * step * deviation, False)
            (one,) = other.modes([6], 3 / RATE)
            ends.append(np.column_stack([one.frequency, one.damping]))
        moved.append((ends[0] - ends[1]) / (2 * step))
    covariance = np.einsum("jma,jmb->mab", moved, moved)
    sizes = [np.sqrt(np.diagonal(each, axis1=1, axis2=2)) for each in (found.covariance, covariance)]
    # singular values beyond the order, which first-order sums leave out, are small
    np.testing.assert_allclose(*sizes, rtol=2e-3)
    correlations = [
        each[:, 0, 1] / size.prod(axis=1) for each, size in zip((found.covariance, covariance), sizes, strict=True)
    ]
    np.testing.assert_allclose(*correlations, atol=5e-3)


def test_four_times_the_record_halves_the_deviations(structure):
    short, long = (
        [mode.interval for seed in range(4) for mode in modes_of(structure, seconds, seed).modes]
        for seconds in (400.0, 1600.0)
    )
    for name in ("frequency_deviation", "damping_deviation"):
        ratio = np.median([getattr(one, name) / one.frequency for one in long])
        ratio /= np.median([getattr(one, name) / one.frequency for one in short])
        assert 0.35 < ratio < 0.7, name


def test_several_records_are_one_test_and_units_do_not_matter(structure):
    records = [structure.record(300.0, seed) for seed in (1, 2)]
    found = ambient_modes("two", records, structure.channels, RATE, IN_BAND)
    scaled = ambient_modes(
        "scaled", [[1e3, 1.0, 1.0] * one for one in records], structure.channels, RATE, AmbientOptions(band=BAND)
    )
    assert found.seconds == 600.0
    assert [one.frequency for one in scaled.modes] == pytest.approx([one.frequency for one in found.modes], rel=1e-6)
    assert abs(scaled.modes[0].shape[0] / scaled.modes[0].shape[2]) == pytest.approx(
        1e3 * abs(found.modes[0].shape[0] / found.modes[0].shape[2]), rel=1e-6
    )


def test_shapes_are_those_of_the_frame(rig, tests):
    _, shapes = rig.building.modes()
    for mode, shape in zip(tests[0].modes, shapes.T, strict=True):
        product = abs(mode.shape.conj() @ shape) ** 2
        assert product / (np.linalg.norm(mode.shape) * np.linalg.norm(shape)) ** 2 > 0.999


def test_a_building_that_has_not_changed_is_hardly_ever_said_to_have(tests):
    said = [bool(compare_tests(one, other).changed) for one, other in zip(tests[::2], tests[1::2], strict=True)]
    assert sum(said) <= 1


def test_what_cannot_be_compared_is_not_said_to_be_unchanged(tests):
    same = compare_tests(tests[0], tests[0])
    assert same.words == "no change beyond chance"
    unknown = replace(same, modes=(replace(same.modes[0], probability=np.nan), *same.modes[1:]))
    assert unknown.words == "the building has changed"
    nothing = compare_tests(tests[0], replace(tests[0], modes=()))
    assert nothing.words == "no mode is in both tests: nothing can be said of the building"


def test_five_per_cent_less_of_a_storey_is_a_change_and_the_modes_say_so(rig, structure, tests):
    weaker = AmbientStructure(weakened(rig, 1, 0.05))
    for before, seed in zip(tests[:2], range(100, 102), strict=True):
        change = compare_tests(before, modes_of(weaker, 600.0, seed))
        assert change.changed
        for mode, (frequency, _), (old, _) in zip(change.modes, weaker.poles, structure.poles, strict=True):
            assert mode.frequency_change == pytest.approx(frequency / old - 1, abs=0.006)
        assert change.words == "the building has changed"


def test_the_diagram_has_every_order_and_every_mode(tests):
    axis = ambient_stabilization(tests[0]).axes[0]
    shown = [line.get_xdata()[0] for line in axis.lines if line.get_linestyle() == "--"]
    assert shown == pytest.approx([mode.frequency / (2 * np.pi) for mode in tests[0].modes])
    assert axis.get_xlim()[1] < 12.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"band": (0.0, 12.0)}, "band 0 to 12 Hz, expected within 0 to 50 Hz, the lower above 0"),
        ({"band": (0.5, 60.0)}, "band 0.5 to 60 Hz, expected within 0 to 50 Hz"),
        (
            {"seconds": 20.0},
            r"wind: 667 samples in 8 pieces .* use a longer record, or raise the lower end of the band",
        ),
        (
            {"band": (5.0, 1.0)},
            r"ambient test: band: \(5\.0, 1\.0\), expected two frequencies in Hz, the lower one first",
        ),
        ({"highest_order": 0}, "ambient test: highest_order: 0, expected greater than or equal to 4"),
        ({"value": np.nan}, "wind: channel a2 has values that are not finite"),
        ({"value": 0.0}, "wind: channel a2 never changes from 0"),
    ],
)
def test_what_cannot_be_used_is_refused(structure, change, message):
    record = structure.record(change.get("seconds", 100.0), 1)
    if "value" in change:
        record[:, 1] = change["value"]
    options = {name: change[name] for name in ("band", "highest_order") if name in change}
    with pytest.raises(AbraceError, match=message):
        ambient_modes("wind", [record], structure.channels, RATE, AmbientOptions.of({"band": BAND, **options}))


@pytest.mark.parametrize("times", [0.2, 10.0])
def test_without_a_band_a_tall_building_and_a_stiff_one_have_all_their_modes(structure, times):
    """The frame with its first mode at 0.21 and at 10.6 Hz."""
    record = structure.record(400.0, 1)
    record += 1e-4 * np.cumsum(np.random.default_rng(2).standard_normal(record.shape), axis=0)  # drift
    found = ambient_modes("wind", [record], structure.channels, times * RATE)
    assert found.band == pytest.approx((times * 0.32, times * 21.2), rel=0.05)
    frequencies = [times * frequency for frequency, _ in structure.poles]
    assert [mode.frequency for mode in found.modes] == pytest.approx(frequencies, rel=0.01)


def test_without_a_band_and_without_a_resonance_a_band_is_asked_for():
    record = np.random.default_rng(1).standard_normal((20_000, 3))
    with pytest.raises(AbraceError, match="wind: no resonance stands out of the spectrum by 10 dB: give the band"):
        ambient_modes("wind", [record], ("a1", "a2", "a3"), RATE)


def test_a_test_of_a_rig_is_used_by_its_accelerations_and_refused_with_a_command(rig, table_test, command_test):
    table_test, command_test = Test.of(table_test), Test.of(command_test)
    found = ambient_test([table_test], AmbientOptions())
    assert found.channels == ("a1", "a2", "a3")
    for frequency, _ in [pair for pair in map(tuple, _pairs(rig)) if pair[0] < 60][:3]:
        assert any(abs(mode.frequency / frequency - 1) < 0.01 for mode in found.modes)
    with pytest.raises(AbraceError, match=r"U up to \d+\.?\d* N, expected 0: an ambient test is without commands"):
        ambient_test([command_test], AmbientOptions(band=(0.5, 12.0)))
    with pytest.raises(AbraceError, match=r"channels a1, a2, acceleration\[0\], expected each channel once"):
        ambient_test([table_test], AmbientOptions(channels=("a1", "a2", "acceleration[0]")))
    other = replace(table_test, source="other", sample_period=0.004)
    with pytest.raises(AbraceError, match=r"other: sample period 0\.004, expected 0\.002, as in "):
        ambient_test([table_test, other], AmbientOptions(band=(0.5, 12.0)))


def _pairs(rig):
    poles = rig.model.poles
    poles = poles[poles.imag > 0]
    return sorted((abs(pole), -pole.real / abs(pole)) for pole in poles)
