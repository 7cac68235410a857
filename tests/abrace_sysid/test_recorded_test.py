# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pandas
import pytest
from bag_of_run import write_bag
from scipy import io

from abrace_core import AbraceError
from abrace_core.model.noise import banded_noise
from abrace_sysid.examination import at_extremes, examined, prepared, require_at_rest, require_excited
from abrace_sysid.recorded.test import Test, given_tests
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


def test_a_good_test_has_no_fault_and_no_warning(short_test, command_test):
    for run, name, band in ((short_test, "w", BAND), (command_test, "U", (0.3, 30.0))):
        test = prepared(Test.of(run), {name: band})
        assert (test.faults, test.clipped, test.warnings) == ({}, {}, ())
        assert test.names == run.names
        assert np.array_equal(test.outputs, run.outputs)
        assert np.array_equal(test.channel("U"), run.command_from_here[:, 0])
        assert test.moving == (("U",) if name == "U" else ())
        assert test.period is None


def test_a_line_is_taken_from_a_response_to_noise_and_the_mean_from_a_periodic_one(short_test, laboratory_of, rig):
    time = short_test.time[:, None]
    drifting = replace(short_test, outputs=short_test.outputs + np.ptp(short_test.outputs, axis=0) * (2 + time / 20))
    scale = np.std(short_test.outputs, axis=0)
    straight = Test.of(drifting).still.outputs
    slope = (straight * (time - time.mean())).mean(axis=0) / scale
    assert np.allclose(slope, 0, atol=1e-9)
    expected = Test.of(short_test).still.outputs
    assert np.abs((straight - expected) / scale).max() < 1e-9
    repeated = Test.of(laboratory_of(rig).multisine_test(False, True, periods=4, period=16.384))
    assert repeated.period == 8192
    level = repeated.still
    assert np.allclose(level.outputs, repeated.outputs - repeated.outputs.mean(axis=0), rtol=0, atol=1e-12)
    assert np.array_equal(level.channel("U"), repeated.channel("U")), "commands are known exactly"


def test_peaks_that_a_periodic_input_repeats_are_not_clipped(rig, laboratory_of):
    run = laboratory_of(rig).multisine_test(False, True, periods=12, period=16.384)
    test = Test.of(run)
    assert test.period == 8192
    assert not examined(test, ["U"], (0.3, 30.0)).clipped
    ends = {name: at_extremes(test.channel(name)) for name in test.inputs}
    assert ends["U"] >= 12, "over all periods its peak is repeated"


def test_a_record_with_a_gap_is_refused(short_test):
    with pytest.raises(AbraceError, match="bags/table: sample 1020 after 999, expected consecutive samples"):
        Test.of(without(short_test, slice(1000, 1020)))
    repeated = replace(short_test, sequence=short_test.sequence - (short_test.sequence > 500).astype(np.uint64))
    with pytest.raises(AbraceError, match="sample 500 after 500"):
        Test.of(repeated)


def test_dead_channels_are_named_and_the_others_still_come_out(short_test):
    random = np.random.default_rng(1)
    samples = len(short_test.outputs)
    frozen = short_test.channels(["a1"])[:, 0].copy()
    frozen[20_000:] = frozen[20_000]
    run = with_channel(short_test, "x2", 1e-6 * random.standard_normal(samples))
    run = with_channel(with_channel(run, "f", 0.0), "a1", frozen)
    test = prepared(Test.of(run), {"w": BAND})
    good = [name for name in test.names if name not in test.faults]
    assert good == ["x1", "x3", "xf", "a2", "a3"]
    assert test.faults["f"] == "never changes from 0"
    assert test.faults["a1"] == "stuck for 34 s from sample 20000"
    assert "noise, its coherence with w is nowhere above 0." in test.faults["x2"]
    assert len(test.warnings) == 3
    assert "a1, f not used" in repr(test)
    (whole,), (damaged,) = (frequency_responses(each, ["w"], BAND) for each in (short_test, test))
    whole, damaged = whole.select(good), damaged.select(good)
    difference = np.abs(damaged.response - whole.response)
    assert (difference < 5 * whole.sigma).mean() > 0.99, "the good channels as without the dead ones"

    dead = replace(run, outputs=np.zeros_like(run.outputs))
    with pytest.raises(AbraceError, match="no channel is a response to w: x1 never changes from 0, x2"):
        prepared(Test.of(dead), {"w": BAND})


def test_pure_noise_rarely_passes_as_a_response(short_test):
    random = np.random.default_rng(2)
    noise = replace(short_test, outputs=random.standard_normal(short_test.outputs.shape))
    noise = with_channel(noise, "x1", short_test.channels(["x1"])[:, 0])
    assert set(noise.names) - set(prepared(Test.of(noise), {"w": BAND}).faults) == {"x1"}


def test_a_clipped_input_is_refused_and_a_clipped_channel_named(short_test):
    w = short_test.ground_acceleration
    run = replace(short_test, ground_acceleration=np.clip(w, -2 * w.std(), 2 * w.std()))
    with pytest.raises(AbraceError, match=r"input w is clipped, \d+ of 37000 samples .* expected at most 0.1%"):
        prepared(Test.of(run), {"w": BAND})
    a1 = short_test.channels(["a1"])[:, 0]
    clipped = np.clip(a1, -np.inf, 2 * a1.std())
    (said,) = prepared(Test.of(with_channel(short_test, "a1", clipped)), {"w": BAND}).warnings
    assert said == f"bags/table: channel a1 is clipped in {np.count_nonzero(clipped == clipped.max())} samples"


def test_a_value_that_is_not_finite_is_refused_with_its_place(short_test):
    values = short_test.channels(["x3"])[:, 0].copy()
    values[[700, 900]] = np.nan
    with pytest.raises(AbraceError, match="channel x3 has 2 values that are not finite, first at sample 700"):
        prepared(Test.of(with_channel(short_test, "x3", values)), {"w": BAND})


def test_a_weak_slow_test_of_the_table_is_no_rest_and_the_noise_of_its_sensor_is_no_motion(short_test, command_test):
    """A tall building: 0.02 m/s^2 to 5 Hz, and an accelerometer with noise of a tenth of that."""
    random = np.random.default_rng(1)
    slow = banded_noise(len(short_test.outputs), 500.0, (0.1, 5.0), 0.02, 1)
    moved, still = (0.002 * random.standard_normal(len(run.outputs)) for run in (short_test, command_test))
    table = Test.of(replace(short_test, ground_acceleration=slow + moved))
    require_at_rest(Test.of(replace(command_test, ground_acceleration=still)), "w", table)
    creeping = still + 0.1 * np.resize(slow, len(still))
    with pytest.raises(AbraceError, match=r"rms of w 0\.002 m/s\^2, and 0\.02 in"):
        require_at_rest(Test.of(replace(command_test, ground_acceleration=creeping)), "w", table)


def test_an_input_must_be_excited_throughout_and_another_at_rest(short_test, command_test):
    short_test, command_test = Test.of(short_test), Test.of(command_test)
    with pytest.raises(AbraceError, match=r"w is not excited from 12.2 to 15.1 Hz, expected noise from 0.3 to 30 Hz"):
        prepared(short_test, {"w": (0.3, 30.0)})
    with pytest.raises(AbraceError, match=r"U is not excited from 0.3 to 1.27 Hz"):
        require_excited(short_test, "U", BAND)
    with pytest.raises(AbraceError, match="band 5 to 5 Hz for w in 74 s, expected the lower frequency first"):
        require_excited(short_test, "w", (5.0, 5.0))
    require_at_rest(short_test, "U", command_test)
    require_at_rest(command_test, "w", short_test)
    with pytest.raises(AbraceError, match=r"bags/command: U up to \d+.* N, expected 0"):
        require_at_rest(command_test, "U", short_test)
    with pytest.raises(AbraceError, match=r"bags/table: rms of w 0\.\d+ m/s\^2.*expected the first at rest"):
        require_at_rest(short_test, "w", command_test)


def test_a_rigs_tests_from_a_file_or_from_arrays_are_those_of_its_bag(short_test, tmp_path):
    names = ("w", "U", *short_test.names)
    columns = np.column_stack([short_test.ground_acceleration, short_test.command_from_here, short_test.outputs])
    io.savemat(tmp_path / "test.mat", dict(zip(names, columns.T, strict=True)))
    path, recorded = tmp_path / "bag", Test.of(short_test)
    write_bag(short_test, path)
    frame = pandas.DataFrame(columns, columns=names)
    for test in (
        Test.read(tmp_path / "test.mat", ["w", "U"], short_test.names, sample_rate=500.0, hold="rig"),
        Test.from_arrays(frame, ["w", "U"], sample_rate=500.0, hold="rig"),
        Test.read(path),
        *given_tests(path),
    ):
        assert test.is_same(recorded)
        assert (test.inputs, test.names, test.floors, test.groups) == (("w", "U"), short_test.names, 3, 1)
        assert [test.hold_of(name) for name in test.inputs] == ["first", "zero"]
    with pytest.raises(AbraceError, match="no test given"):
        given_tests([])
    with pytest.raises(AbraceError, match="test 5: expected a Test, a Run, or the folder of a bag"):
        given_tests([5])


ROWS = np.arange(600)
FORCE, MOTION = np.sin(0.07 * ROWS), np.cos(0.03 * ROWS)
CLOCK = 0.02 * ROWS


def structure(values):
    """Simulink's structure with time."""
    return {"time": CLOCK[:, None], "signals": {"values": values, "dimensions": 1.0, "label": ""}, "blockName": "m/log"}


@pytest.mark.parametrize(
    ("variables", "asked"),
    [
        ({"t": CLOCK, "F": FORCE[None, :], "resp": np.vstack([MOTION, 2 * MOTION])}, {"time": "t"}),
        (
            {"F": structure(FORCE[:, None]), "resp": structure(np.column_stack([MOTION, 2 * MOTION]))},
            {"time": "F.time"},
        ),
        ({"F": structure(FORCE[:, None]), "resp": structure(np.column_stack([MOTION, 2 * MOTION]))}, {"time": "time"}),
        (
            {"F": structure(FORCE[:, None]), "resp": structure(np.column_stack([MOTION, 2 * MOTION]))},
            {"sample_rate": 50.0},
        ),
    ],
)
def test_rows_and_simulinks_structures_are_columns_by_their_names(tmp_path, variables, asked):
    io.savemat(tmp_path / "test.mat", variables)
    for outputs in (["resp_1", "resp_2"], []):
        test = Test.read(tmp_path / "test.mat", ["F"], outputs, **asked)
        assert (test.inputs, test.names) == (("F",), ("resp_1", "resp_2")), "times are no outputs"
        assert test.sample_period == pytest.approx(0.02)
        np.testing.assert_array_equal(test.channels(["F", "resp_1", "resp_2"]).T, [FORCE, MOTION, 2 * MOTION])


def test_a_recording_of_dspace_has_its_series_by_the_last_part_of_their_names(tmp_path):
    series = np.zeros((1, 2), dtype=[("Name", object), ("Data", object)])
    series[0, 0], series[0, 1] = ("model/table/w", FORCE[None, :]), ("model/roof/a1", MOTION[None, :])
    axis = np.zeros((1, 1), dtype=[("Name", object), ("Data", object)])
    axis[0, 0] = ("HostService", CLOCK[None, :])
    io.savemat(tmp_path / "test.mat", {"run_7": {"X": axis, "Y": series}})
    test = Test.read(tmp_path / "test.mat", ["w"], ["a1"], time="run_7.time")
    assert test.sample_period == pytest.approx(0.02)
    np.testing.assert_array_equal(test.channels(["w", "a1"]).T, [FORCE, MOTION])


def test_records_in_the_third_dimension_are_named(tmp_path):
    io.savemat(tmp_path / "test.mat", {"records": np.ones((150, 3, 4)), "u": FORCE})
    with pytest.raises(
        AbraceError, match="records is 150 x 3 x 4, expected each record of it as a matrix of its own; no"
    ):
        Test.read(tmp_path / "test.mat", ["records_1"], ["records_2"], 50.0)


@pytest.mark.parametrize(
    ("clock", "rate", "known"),
    [
        ({"t": CLOCK}, 50.0, True),
        ({"t": CLOCK}, 100.0, False),
        ({"time [ms]": 1e3 * CLOCK}, 100.0, False),
        ({"t": pandas.Timestamp("2026-03-01") + pandas.to_timedelta(CLOCK, unit="s")}, 100.0, False),
        ({"dt": np.array(0.02)}, 100.0, False),
        ({"time": ROWS.astype(float)}, 100.0, True),  # numbers of samples
    ],
)
def test_a_sample_rate_that_contradicts_the_files_own_times_is_refused(clock, rate, known):
    def read():
        return Test.from_arrays(clock | {"F": FORCE, "x": MOTION}, ["F"], ["x"], rate)

    if known:
        assert read().sample_period == 1 / rate
        return
    with pytest.raises(AbraceError, match=r"sample_rate 100 Hz, but the (times .* are of|file states) 50 Hz"):
        read()
