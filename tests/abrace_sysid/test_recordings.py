# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.noise import banded_noise
from abrace_sysid.recordings import longest_piece, prepare, require_at_rest, require_excited
from abrace_sysid.spectra.estimation import frequency_responses

BAND = (0.3, 10.0)


@pytest.fixture(scope="module")
def short_test(laboratory_of, rig):
    return laboratory_of(rig, 3).table_test(70)


def without(run, missing):
    """The run with these samples (a slice) lost."""
    kept = np.delete(np.arange(len(run.sequence)), missing)
    fields = ("sequence", "outputs", "ground_acceleration", "command")
    return replace(run, **{name: getattr(run, name)[kept] for name in fields})


def with_channel(run, name, values):
    outputs = run.outputs.copy()
    outputs[:, run.names.index(name)] = values
    return replace(run, outputs=outputs)


def test_a_good_test_passes_whole_and_without_a_word(short_test, command_test):
    for run, name, band in ((short_test, "w", BAND), (command_test, "U", (0.3, 30.0))):
        prepared = prepare(run, [name], band)
        assert (prepared.left_out, prepared.warnings) == ({}, ())
        assert prepared.outputs == run.names
        assert len(prepared.run.outputs) == len(run.outputs)
        assert np.array_equal(prepared.run.command, run.command)


def test_a_line_is_taken_from_a_response_to_noise_and_the_mean_from_a_periodic_one(short_test):
    time = short_test.time[:, None]
    drifting = replace(short_test, outputs=short_test.outputs + np.ptp(short_test.outputs, axis=0) * (2 + time / 20))
    scale = np.std(short_test.outputs, axis=0)
    straight, level = (prepare(drifting, ["w"], BAND, period).run.outputs for period in (None, 5000))
    assert np.allclose(level.mean(axis=0) / scale, 0, atol=1e-9)
    assert np.abs((level - drifting.outputs + drifting.outputs.mean(axis=0)) / scale).max() < 1e-9
    slope = (straight * (time - time.mean())).mean(axis=0) / scale
    assert np.allclose(slope, 0, atol=1e-9)
    expected = prepare(short_test, ["w"], BAND).run.outputs
    assert np.abs((straight - expected) / scale).max() < 1e-9


def test_peaks_that_a_periodic_input_repeats_are_not_clipped(rig, laboratory_of):
    run = laboratory_of(rig).multisine_test(False, True, periods=12, period=16.384)
    warned, quiet = (prepare(run, ["U"], (0.3, 30.0), period).warnings for period in (None, 8192))
    assert len(warned) == 1
    assert "U is clipped" in warned[0]
    assert quiet == ()


def test_the_longest_whole_piece_of_a_broken_record_is_used_and_said(short_test):
    broken = without(short_test, slice(1000, 1020))
    prepared = prepare(broken, ["w"], BAND)
    assert prepared.run.sequence[0] == 1020
    assert np.array_equal(np.diff(prepared.run.sequence), np.ones(len(prepared.run.sequence) - 1))
    (said,) = prepared.warnings
    assert "a gap after sample 999 (20 samples, 0.04 s); samples 1020 to 36999 are used, 71.96 s of 73.96" in said


def test_a_record_without_a_piece_that_is_long_enough_is_refused(short_test):
    twice = without(without(short_test, slice(20_000, 20_010)), slice(10_000, 10_500))
    expected = (
        r"bags/table: a gap after sample 9999 \(500 samples, 1 s\) and 1 more; "
        r"the longest whole piece has 33.98 s, expected at least 60 s"
    )
    with pytest.raises(AbraceError, match=expected):
        longest_piece(twice)
    with pytest.raises(AbraceError, match="bags/table: 40 s, expected at least 60 s"):
        longest_piece(without(short_test, slice(20_000, None)))
    repeated = replace(short_test, sequence=short_test.sequence - (short_test.sequence > 500).astype(np.uint64))
    assert "sample numbers that do not rise after 500" in longest_piece(repeated)[1][0]


def test_dead_channels_are_named_and_the_others_still_come_out(short_test):
    random = np.random.default_rng(1)
    samples = len(short_test.outputs)
    frozen = short_test.channels(["a1"])[:, 0].copy()
    frozen[20_000:] = frozen[20_000]
    run = with_channel(short_test, "x2", 1e-6 * random.standard_normal(samples))
    run = with_channel(with_channel(run, "f", 0.0), "a1", frozen)
    prepared = prepare(run, ["w"], BAND)
    assert prepared.outputs == ("x1", "x3", "xf", "a2", "a3")
    assert prepared.left_out["f"] == "never changes from 0"
    assert prepared.left_out["a1"] == "stuck for 34 s from sample 20000"
    assert "noise, its coherence with w is nowhere above 0." in prepared.left_out["x2"]
    assert len(prepared.warnings) == 3
    (whole,), (damaged,) = (frequency_responses(each, ["w"], BAND) for each in (short_test, prepared.run))
    whole, damaged = whole.select(prepared.outputs), damaged.select(prepared.outputs)
    difference = np.abs(damaged.response - whole.response)
    assert (difference < 5 * whole.sigma).mean() > 0.99, "the good channels as without the dead ones"

    dead = replace(run, outputs=np.zeros_like(run.outputs))
    with pytest.raises(AbraceError, match="no channel is a response to w: x1 never changes from 0, x2"):
        prepare(dead, ["w"], BAND)


def test_pure_noise_rarely_passes_as_a_response(short_test):
    random = np.random.default_rng(2)
    noise = replace(short_test, outputs=random.standard_normal(short_test.outputs.shape))
    noise = with_channel(noise, "x1", short_test.channels(["x1"])[:, 0])
    assert prepare(noise, ["w"], BAND).outputs == ("x1",)


def test_a_clipped_input_is_refused_and_a_clipped_channel_named(short_test):
    w = short_test.ground_acceleration
    run = replace(short_test, ground_acceleration=np.clip(w, -2 * w.std(), 2 * w.std()))
    with pytest.raises(AbraceError, match=r"input w is clipped, \d+ of 37000 samples .* expected at most 0.1%"):
        prepare(run, ["w"], BAND)
    a1 = short_test.channels(["a1"])[:, 0]
    clipped = np.clip(a1, -np.inf, 2 * a1.std())
    (said,) = prepare(with_channel(short_test, "a1", clipped), ["w"], BAND).warnings
    assert said == f"bags/table: channel a1 is clipped in {np.count_nonzero(clipped == clipped.max())} samples"


def test_a_value_that_is_not_finite_is_refused_with_its_place(short_test):
    values = short_test.channels(["x3"])[:, 0].copy()
    values[[700, 900]] = np.nan
    with pytest.raises(AbraceError, match="channel x3 has 2 values that are not finite, first at sample 700"):
        prepare(with_channel(short_test, "x3", values), ["w"], BAND)


def test_a_weak_slow_test_of_the_table_is_no_rest_and_the_noise_of_its_sensor_is_no_motion(short_test, command_test):
    """A tall building: 0.02 m/s^2 to 5 Hz, and an accelerometer with noise of a tenth of that."""
    random = np.random.default_rng(1)
    slow = banded_noise(len(short_test.outputs), 500.0, (0.1, 5.0), 0.02, 1)
    moved, still = (0.002 * random.standard_normal(len(run.outputs)) for run in (short_test, command_test))
    table = replace(short_test, ground_acceleration=slow + moved)
    require_at_rest(replace(command_test, ground_acceleration=still), "w", table)
    creeping = still + 0.1 * np.resize(slow, len(still))
    with pytest.raises(AbraceError, match=r"rms of w 0\.002 m/s\^2, and 0\.02 in"):
        require_at_rest(replace(command_test, ground_acceleration=creeping), "w", table)


def test_an_input_must_be_excited_throughout_and_another_at_rest(short_test, command_test):
    with pytest.raises(AbraceError, match=r"w is not excited from 12.2 to 15.1 Hz, expected noise from 0.3 to 30 Hz"):
        prepare(short_test, ["w"], (0.3, 30.0))
    with pytest.raises(AbraceError, match=r"U is not excited from 0.3 to 1.27 Hz"):
        require_excited(short_test, "U", BAND)
    with pytest.raises(AbraceError, match="band 5 to 5 Hz for w, expected within 0 to 250 Hz"):
        require_excited(short_test, "w", (5.0, 5.0))
    require_at_rest(short_test, "U", command_test)
    require_at_rest(command_test, "w", short_test)
    with pytest.raises(AbraceError, match=r"bags/command: U up to \d+.* N, expected 0"):
        require_at_rest(command_test, "U", short_test)
    with pytest.raises(AbraceError, match=r"bags/table: rms of w 0\.\d+ m/s\^2.*expected the first at rest"):
        require_at_rest(short_test, "w", command_test)
