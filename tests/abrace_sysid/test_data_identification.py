# SPDX-License-Identifier: Apache-2.0
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from forked_matlab import matlab_files_by_forks  # noqa: F401
from laboratory import paper_tests
from scipy import fft, io

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import load_model
from abrace_core.model.simulation import simulate
from abrace_core.model.verdict import Verdict
from abrace_sysid.data_identification import DataOptions, identify_data, observed, variance_accounted_for
from abrace_sysid.figures.identification import figures_of_data
from abrace_sysid.fitting.output_delays import output_delays
from abrace_sysid.fitting.pole_estimate import PoleEstimate
from abrace_sysid.models.modal import modal_model
from abrace_sysid.recorded.test import Test
from abrace_sysid.results import write_data_results, write_validity
from abrace_sysid.spectra.bands import steady_band
from abrace_sysid.validity.judgement import identify_and_judge, judge_data
from abrace_sysid.validity.sensor_findings import other_units, spiked

FREQUENCY = 2 * np.pi * np.array([6.0, 11.0, 17.0, 31.0, 44.0, 58.0])
DAMPING = np.array([0.006, 0.004, 0.008, 0.005, 0.006, 0.004])
ABOVE = 2 * np.pi * 130.0
"""A mode above half the sample rate: its tail is in the data."""

RATE, SECONDS = 200.0, 20.0


def structure_data(outputs=4, noise=0.01, seed=0):
    """Two forces at once with noise, accelerations at many places; sampled as with ideal filters."""
    random = np.random.default_rng(seed)
    poles = np.append(FREQUENCY, ABOVE) * (-np.append(DAMPING, 0.01) + 1j)
    shapes = random.standard_normal((outputs, len(poles)))
    drive = random.standard_normal((len(poles), 2))
    samples = round(3 * SECONDS * RATE)
    force = random.standard_normal((samples, 2)) * [1.0, 4.0]
    s = 2j * np.pi * fft.rfftfreq(samples, 1 / RATE)[:, None]
    modal = s**2 / ((s - poles) * (s - poles.conj()))
    acceleration = fft.irfft((modal * (fft.rfft(force, axis=0) @ drive.T)) @ shapes.T, samples, axis=0)
    acceleration += noise * acceleration.std(axis=0) * random.standard_normal(acceleration.shape)
    kept = slice(samples // 3, samples // 3 + round(SECONDS * RATE))
    names = tuple(f"place_{i + 1}" for i in range(outputs))
    return Test("structure", 1 / RATE, ("shaker_1", "shaker_2"), names, force[kept], acceleration[kept])


@pytest.fixture(scope="module")
def data():
    return structure_data()


@pytest.fixture(scope="module")
def found(data):
    return identify_data(data.part(0, 2800))


def test_all_modes_are_found_without_being_told_how_many_and_lie_in_their_intervals(found):
    assert len(found.pairs) == len(FREQUENCY), [pair.frequency for pair in found.pairs]
    for pair, frequency, damping in zip(found.pairs, FREQUENCY, DAMPING, strict=True):
        own = frequency * np.hypot(1, damping)
        assert abs(pair.frequency / own - 1) < 2e-4
        assert abs(pair.damping / damping - 1) < 0.03
        assert abs(pair.frequency - own) < 4 * pair.frequency_deviation
        assert abs(pair.damping - damping) < 4 * pair.damping_deviation


@pytest.mark.parametrize(
    ("seed", "outputs", "band", "samples"),
    [
        *((seed, ("x1", "x2", "x3", "a1", "a2", "a3"), NOT_GIVEN, None) for seed in (0, 5)),
        *((seed, ("x1", "x3", "a1"), (0.5, 8.0), 20_001) for seed in (17, 68)),
    ],
)
def test_noise_is_not_taken_for_modes_by_chance(seed, outputs, band, samples):
    """Two had one and two modes more by what each half predicts of the other alone, two by intervals of 95 %."""
    run, _ = paper_tests(40.0, seed)
    test = Test.from_arrays({name: run[name][:samples] for name in ("w", *outputs)}, ("w",), (), 500.0)
    pairs = identify_data(test, DataOptions(inputs=("w",), band=band)).pairs
    expected = [1.172, 3.650, 6.042, 9.0][: 4 if band == NOT_GIVEN else 3]
    assert [pair.frequency / (2 * np.pi) for pair in pairs] == pytest.approx(expected, rel=2e-3)


def test_every_output_of_the_rest_of_the_record_is_predicted_down_to_its_noise(found, data):
    share = variance_accounted_for(found.model, data.part(2800, 4000))
    assert found.model.is_stable()
    assert found.model.inputs == data.inputs
    assert share.mean() > 1 - 3 * 0.01**2, share
    assert share.min() > 0.999, share


def test_a_prediction_that_misses_a_mode_or_takes_the_wrong_hold_is_worse(found, data):
    rest = data.part(2800, 4000)
    best = variance_accounted_for(found.model, rest).mean()
    held = found.model
    wrong = variance_accounted_for(held.select(outputs=held.outputs[::-1]), rest)
    assert wrong.mean() == pytest.approx(best), "names, not places, say which output is which"
    swapped = Test("swapped", rest.sample_period, rest.inputs, rest.names, rest.excitation[:, ::-1], rest.outputs)
    assert variance_accounted_for(found.model, swapped).mean() < 0.9


def test_a_burst_after_a_quiet_half_gives_the_modes_though_no_half_predicts_the_other(data):
    late = np.repeat([0.0, 1.0], 1400)[:, None]
    quiet = replace(data.part(0, 2800), excitation=data.excitation[:2800] * late, outputs=data.outputs[:2800] * 1e-3)
    s = 2j * np.pi * fft.rfftfreq(2800, 1 / RATE)[:, None]
    poles = FREQUENCY * (-DAMPING + 1j)
    modal = 1 / ((s - poles) * (s - poles.conj()))
    force = fft.rfft(quiet.excitation, axis=0)
    random = np.random.default_rng(5)
    outputs = fft.irfft(
        (modal * (force @ random.standard_normal((2, 6)))) @ random.standard_normal((6, len(quiet.names))), 2800, axis=0
    )
    outputs += 0.003 * outputs.std(axis=0) * random.standard_normal(outputs.shape)
    found = identify_data(replace(quiet, outputs=outputs))
    for frequency in FREQUENCY:
        assert min(abs(pair.frequency / frequency - 1) for pair in found.pairs) < 1e-3


def test_the_band_is_the_one_that_is_excited_and_a_refusal_says_which_it_is(data):
    lines = fft.rfft(data.excitation, axis=0)
    lines[fft.rfftfreq(len(data.excitation), 1 / RATE) > 40.0] *= 1e-4
    narrow = replace(data, excitation=fft.irfft(lines, len(data.excitation), axis=0))
    low, high = steady_band(narrow, narrow.inputs, 0.5)
    assert (low, high) == pytest.approx((0.5, 40.0), abs=2.0)
    with pytest.raises(AbraceError, match=r"is not excited from .*; it is excited from 0\.\d+ to (39|4\d)"):
        identify_data(narrow, DataOptions(inputs=data.inputs, band=(1.0, 90.0)))


def test_what_lies_outside_the_band_does_not_count_in_the_prediction_within_it(found, data):
    rest, time = data.part(2800, 4000), np.arange(1200)[:, None] / RATE
    drifting = replace(rest, outputs=rest.outputs + 20 * rest.outputs.std(axis=0) * np.sin(2 * np.pi * 0.5 * time))
    assert variance_accounted_for(found.model, drifting).max() < 0.5
    assert variance_accounted_for(found.model, drifting, (2.0, 90.0)).min() > 0.999


def small(late=(0.0, 0.0, 0.0), seed=0, samples=1600, noise=0.003, inputs=1):
    """Two modes, three accelerometers, each so many samples late, at 50 Hz."""
    random, size = np.random.default_rng([seed, 7]), samples + 400
    poles = 2 * np.pi * np.array([3.0, 8.0]) * (-0.01 + 1j)
    shapes, drive = np.array([[0.5, 1.0], [1.0, 0.3], [0.8, -0.9]]), np.array([[1.0, 0.4], [1.0, -0.7]])[:, :inputs]
    force = random.standard_normal((size, inputs))
    frequency = fft.rfftfreq(size, 0.02)[:, None]
    s = 2j * np.pi * frequency
    modal = s**2 / ((s - poles) * (s - poles.conj())) * (fft.rfft(force, axis=0) @ drive.T)
    turned = (modal @ shapes.T) * np.exp(-s * 0.02 * np.array(late))
    outputs = fft.irfft(turned, size, axis=0)
    outputs += noise * outputs.std(axis=0) * random.standard_normal(outputs.shape)
    names = ("u", "v")[:inputs]
    return Test("small", 0.02, names, ("a1", "a2", "a3"), force, outputs).part(200, size - 200)


@pytest.mark.parametrize(
    ("given", "pairs"), [({"modes": 1}, 1), ({"modes": 2}, 2), ({"order": 4}, 2), ({"modes": 4}, 4), ({"order": 8}, 4)]
)
def test_a_given_number_of_modes_or_states_is_met(given, pairs):
    found = identify_data(small((0.0, 0.0, 0.0)), DataOptions.of({"inputs": ["u"], **given}))
    assert len(found.is_mode) == pairs
    # one input: two states for the modes above it may be, unless the number of states is given
    assert found.model.order in ([given["order"]] if "order" in given else [2 * pairs, 2 * pairs + 2])
    assert found.model.provenance["sample_period"] == 0.02
    listed = [pair.frequency / (2 * np.pi) for pair in found.pairs]
    # white noise moves an accelerometer in a mode the more the faster the mode is: 8 Hz explains most
    for true in [8.0, 3.0][:pairs]:
        assert min(abs(np.array(listed) - true)) < 0.05, "more are added to those that pay"


def test_a_given_order_leaves_no_states_for_the_modes_above(data):
    part = data.part(0, 2000).select(["place_1", "place_2"])
    by_modes, by_order = (
        identify_data(part, DataOptions.of({"inputs": data.inputs, **given})).model
        for given in ({"modes": 6}, {"order": 12})
    )
    assert (by_modes.order, by_order.order) == (16, 12), "two inputs, and the tail of a mode at 130 Hz"


def test_a_hum_is_none_of_the_modes_whose_number_is_given():
    record = small()
    hum = record.outputs.std() * np.sin(2 * np.pi * 12.0 * np.arange(len(record.outputs)) * record.sample_period)
    found = identify_data(
        replace(record, outputs=record.outputs + hum[:, None]), DataOptions.of({"inputs": ["u"], "modes": 2})
    )
    np.testing.assert_allclose([pair.frequency / (2 * np.pi) for pair in found.pairs], [3.0, 8.0], rtol=0.01)
    assert len(found.not_driven)
    np.testing.assert_allclose(np.abs(found.not_driven) / (2 * np.pi), 12.0, rtol=0.01)


def test_more_modes_than_a_record_has_lines_for_are_refused():
    record = small((0.0, 0.0, 0.0), inputs=2).part(0, 400).select(["a1"])
    with pytest.raises(AbraceError, match=r"^identification: 60 modes, expected at most \d+"):
        identify_data(record, DataOptions.of({"inputs": ["u", "v"], "modes": 60}))


BELOW = DataOptions(inputs=("u",), band=(0.5, 20.0))
LATE = [(0.0, 0.0, 3.0), (0.0, 0.4, 0.0), (-2.0, 0.0, 0.0), (1.0, 0.0, 5.0)]
POLES = 2 * np.pi * np.array([3.0, 8.0, 1.4 * 24.0]) * (-0.01 + 1j)


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize("late", [(0.0, 0.0, 0.0), *LATE])
def test_an_output_that_is_late_or_early_is_measured_and_one_that_is_in_time_is_not_claimed(late, inputs):
    data = small(late, inputs=inputs)
    delays = output_delays(observed([data], (0.5, 24.0)), POLES)
    for delay, true in zip(delays, late, strict=True):
        assert abs(delay.seconds / 0.02 - true) < min(0.1, 4 * delay.deviation / 0.02)
        assert delay.is_certain == bool(true)


def test_a_late_output_gives_no_modes_and_is_said_with_its_uncertainty():
    data = small((0.0, 0.0, 3.0))
    found = identify_data(data.part(0, 1100), BELOW)
    assert [pair.frequency / (2 * np.pi) for pair in found.pairs] == pytest.approx([3.0, 8.0], rel=1e-3)
    assert list(found.delays) == ["a3"]
    assert found.delays["a3"].seconds == pytest.approx(0.06, abs=0.003)
    assert re.fullmatch(r"small: a3 [23]\.\d\d ± 0\.\d\d samples \(.* ms\) late against .*", found.warnings[-1])
    rest = data.part(1100, 1600)
    assert variance_accounted_for(found.model, found.in_time(rest), found.band).min() > 0.999
    assert variance_accounted_for(found.model, rest, found.band)[2] < 0.9, "the model is of outputs in time"
    (finding,) = (one for one in judge_data(found, []).validity.findings if one.check == "sensors synchronous")
    assert finding.value == pytest.approx(0.06, abs=0.003)
    assert "a3 is " in finding.meaning


def test_a_delay_of_all_outputs_is_one_of_the_model():
    found = identify_data(small((2.0, 2.0, 2.0)).part(0, 1100), BELOW)
    assert found.model.input_delay == pytest.approx((0.04,), abs=0.003)
    assert variance_accounted_for(found.model, small((2.0, 2.0, 2.0)).part(1100, 1600), found.band).min() > 0.995


def test_several_records_give_one_model_and_another_one_is_predicted():
    records = [small(seed=seed, samples=500, noise=0.01) for seed in (1, 2, 3)]
    loud = replace(records[1], excitation=9 * records[1].excitation, outputs=9 * records[1].outputs)
    found, held_out, judged = identify_and_judge([records[0], loud], BELOW, validation=[records[2]])
    one = identify_data(records[0], BELOW)
    assert [pair.frequency / (2 * np.pi) for pair in found.pairs] == pytest.approx([3.0, 8.0], rel=1e-3)
    assert all(
        pair.frequency_deviation < alone.frequency_deviation for pair, alone in zip(found.pairs, one.pairs, strict=True)
    )
    assert held_out == (records[2],)
    assert "prediction" in {finding.check for finding in judged.validity.findings}
    assert len(judged.residuals) == 2
    apart = replace(records[2], sample_period=0.01)
    with pytest.raises(AbraceError, match=r"sample period 0\.01, expected 0\.02"):
        identify_and_judge(records[0], BELOW, validation=[apart])


def test_a_model_keeps_the_units_that_were_given_or_stand_in_names_and_its_figures_show_them(tmp_path):
    record = small(seed=1, samples=500, noise=0.01)
    columns = dict(zip((*record.inputs, *record.names), np.hstack([record.excitation, record.outputs]).T, strict=True))
    first = record.names[0]
    columns[f"{first} [g]"] = columns.pop(first)
    options = DataOptions(
        inputs=record.inputs, outputs=record.names, sample_rate=1 / record.sample_period, band=BELOW.band,
        units={record.inputs[0]: "kN"},
    )  # fmt: skip
    found = identify_data(options.read(columns), options)
    assert found.model.units == {record.inputs[0]: "kN", first: "g"}
    (top, *_), *_ = figures_of_data(found)[f"transfer_functions_{record.inputs[0]}"].rows
    assert "[g / kN]" in top.y_label
    write_data_results(found, (), tmp_path)
    assert load_model(tmp_path / "model.json").units == found.model.units


def test_records_of_different_units_are_refused():
    one, other = small(seed=1, samples=500, noise=0.01), small(seed=2, samples=500, noise=0.01)
    name = one.names[0]
    with pytest.raises(AbraceError, match=f"{name} in m/s\\^2, expected g, as in"):
        identify_data([replace(one, units={name: "g"}), replace(other, units={name: "m/s^2"})], BELOW)


@pytest.mark.parametrize(
    ("of_a", "of_x", "stated", "said"),
    [
        (1.0, 1.0, {}, ""),
        (1 / 9.80665, 1.0, {}, "a1 reads as if in g: a1 is 0.102 times the second derivative of x1"),
        (1.0, 1000.0, {}, "x1 reads as if in mm: a1 is 0.001 times the second derivative of x1"),
        (1 / 9.80665, 1000.0, {}, "a1 reads as if in g and x1 reads as if in mm: a1 is 0.000102 times"),
        (1 / 9.80665, 1000.0, {"a1": "g", "x1": "mm"}, ""),
    ],
)
def test_units_of_two_sensors_of_a_floor_are_guessed_and_said(of_a, of_x, stated, said):
    poles = 2 * np.pi * np.array([3.0, 8.0]) * (-0.01 + 1j)
    shape = np.array([1.0, -0.5 + 0.1j])
    shapes = np.array([of_x * shape, of_a * poles**2 * shape])
    drive, nan = np.ones((2, 1), dtype=complex), np.full((4, 4), np.nan)
    fit = PoleEstimate(
        poles, nan, 0.0, 9, 4, ("w",), ("x1", "a1"), drive, shapes, np.zeros((2, 1)), np.array([nan[0, 0]])
    )
    found = other_units(fit, stated, "day")
    assert [one.verdict for one in found] == [Verdict.CARE] * bool(said)
    assert all(one.meaning.startswith(said) for one in found)


def test_held_inputs_are_predicted_as_held(found):
    held = discretize(found.model, 1 / RATE)
    inputs = np.random.default_rng(2).standard_normal((1200, 2))
    data = Test("held", 1 / RATE, held.inputs, held.outputs, inputs, simulate(held, inputs), hold="zero")
    assert variance_accounted_for(found.model, data).min() > 0.99999


def test_results_are_files_a_person_and_a_programme_read(found, data, tmp_path):
    text = write_data_results(found, [data.part(2800, 4000)], tmp_path)
    assert "variance accounted for, 6 s held out: mean 99.9" in text
    model = load_model(tmp_path / "model.json")
    assert model.provenance["data"] == "structure"
    poles = json.loads((tmp_path / "poles.json").read_text())["data"]
    assert len(poles) == 6
    assert poles[0]["damping_ratio_deviation"] > 0
    assert set(json.loads((tmp_path / "prediction.json").read_text())["variance_accounted_for"]) == set(data.names)
    assert (tmp_path / "model.mat").exists()
    drawn = figures_of_data(found)
    assert set(drawn) == {"transfer_functions_shaker_1", "transfer_functions_shaker_2", "confidence"}


def test_measured_data_are_judged_by_what_is_left_over_and_by_what_was_held_out(found, data, tmp_path):
    rest = data.part(2800, 4000)
    judged = judge_data(found, [rest])
    # the tail of the mode above half the sample rate is not quite that of the pairs that stand for it
    assert [(reason.check, reason.verdict) for reason in judged.validity.reasons] in ([], [("whiteness", Verdict.CARE)])
    checks = {finding.check for finding in judged.validity.findings}
    assert {"channels respond", "spikes", "residual", "whiteness", "independence", "prediction"} <= checks
    (residual,) = judged.residuals
    assert np.median(residual.ratio.mean(axis=0)) == pytest.approx(1.0, abs=0.2)
    assert "held_out is 0" in judge_data(found, []).validity.not_checked["prediction"]
    write_validity(judged, tmp_path)
    assert json.loads((tmp_path / "validity.json").read_text())["causes"] == []
    assert (tmp_path / "validity.svg").stat().st_size > 10000

    fourth = np.argmin(np.abs(np.abs(found.estimate.poles) - FREQUENCY[3]))
    shapes = found.estimate.shapes * (np.arange(len(found.estimate.poles)) != fourth)
    poor = replace(found, model=modal_model(replace(found.estimate, shapes=shapes), {}))
    named = judge_data(poor, [rest]).validity
    assert named.causes in (("mode missed",), ("unmodelled dynamics",))
    assert {reason.check for reason in named.reasons} >= {"residual", "whiteness", "independence", "prediction"}


def test_an_output_that_stands_still_while_it_is_predicted_is_not_judged(found, data, tmp_path):
    stuck = data.outputs.copy()
    stuck[2800:, 1] = 0.5
    rest = replace(data, outputs=stuck).part(2800, 4000)
    (finding,) = (one for one in judge_data(found, [rest]).validity.findings if one.check == "prediction")
    assert (finding.verdict, finding.where) == (Verdict.CARE, "place_2")
    text = write_data_results(found, [rest], tmp_path)
    assert text.endswith("not judged: place_2")
    shares = json.loads((tmp_path / "prediction.json").read_text())["variance_accounted_for"]
    assert shares.pop("place_2") is None
    assert min(shares.values()) > 0.999
    # with fewer numbers than states any initial state fits
    assert np.isnan(variance_accounted_for(found.model, data.part(2800, 2801))).all()
    spoilt = np.where(np.arange(4000)[:, None] == 3000, np.nan, data.excitation)
    assert np.isnan(variance_accounted_for(found.model, replace(data, excitation=spoilt).part(2800, 4000))).all()


def test_spikes_of_measured_data_are_named_where_they_stand_out_of_what_is_measured(data):
    spoilt = data.outputs.copy()
    spoilt[[500, 900, 1700], 2] += 60 * spoilt[:, 2].std()
    (found,) = spiked(replace(data, outputs=spoilt), (*data.inputs, *data.names))
    assert (found.cause, found.where) == ("spikes", "place_3, structure")
    assert "place_3 has 3 spikes" in found.meaning
    (clean,) = spiked(data, (*data.inputs, *data.names))
    assert clean.verdict == Verdict.TRUST


def test_an_output_that_does_not_answer_is_left_out_and_named(data):
    dead = data.outputs.copy()
    dead[:, 3] = 0.5
    spoilt = Test("structure", data.sample_period, data.inputs, data.names, data.excitation, dead)
    found = identify_data(spoilt.part(0, 2000), DataOptions(inputs=data.inputs, modes=2))
    assert found.warnings == ("structure: channel place_4 is left out: never changes from 0.5",)
    assert "place_4" not in found.model.outputs


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.part(0, 300), "structure: 300 samples, expected at least 400"),
        (
            lambda d: Test(d.source, d.sample_period, d.inputs, d.names, 0 * d.excitation, d.outputs),
            "structure: shaker_1 is not excited",
        ),
        (
            lambda d: Test(d.source, d.sample_period, d.inputs, d.names, d.excitation[:, [0, 0]], d.outputs),
            "zero, or repeats another",
        ),
        (
            lambda d: Test(d.source, d.sample_period, d.inputs, d.names, d.excitation, np.nan * d.outputs),
            "channel place_1 has 4000 values that are not finite",
        ),
    ],
)
def test_data_that_cannot_be_used_are_refused_with_the_reason(data, spoil, message):
    with pytest.raises(AbraceError, match=message):
        identify_data(spoil(data))


def test_the_same_columns_are_read_from_every_kind_of_file(data, tmp_path):
    both = np.hstack([data.excitation, data.outputs])[:500]
    time = np.arange(500) / RATE
    io.savemat(tmp_path / "data.mat", {"t": time, "u": both[:, :2], "y": both[:, 2:4], "about": "text"})
    np.savez(tmp_path / "data.npz", t=time, u=both[:, :2], y=both[:, 2:4])
    np.save(tmp_path / "data.npy", both[:, :4])
    header = "t,u_1,u_2,y_1,y_2"
    np.savetxt(tmp_path / "data.csv", np.column_stack([time, both[:, :4]]), delimiter=",", header=header, comments="")
    for name in ("data.mat", "data.npz", "data.csv"):
        read = Test.read(tmp_path / name, ["u_1", "u_2"], time="t", units={"u_1": "N"})
        assert read.names == ("y_1", "y_2")
        assert read.sample_period == pytest.approx(1 / RATE)
        assert np.allclose(read.channels(["u_2", "y_1"]), both[:, 1:3])
    np.savez(tmp_path / "bag.npz", **{"ground_acceleration": both[:, 0], "displacement[0]": both[:, 1]})
    read = Test.read(tmp_path / "bag.npz", ["w"], sample_rate=RATE)
    assert (read.inputs, read.names) == (("w",), ("displacement[0]",))
    assert np.allclose(read.channels(["x1", "w"]), both[:, [1, 0]])
    read = Test.read(tmp_path / "data.npy", ["1", "2"], ["4"], sample_rate=RATE)
    assert np.allclose(read.outputs[:, 0], both[:, 3])


MISTAKES = {
    "no file": ({"path": "none.mat"}, "none.mat: No such file"),
    "an empty file": ({"path": "data.xls"}, "data.xls: empty, expected numbers"),
    "a damaged file": ({"path": "bad.mat"}, "bad.mat: not read as a MATLAB file of version 4 to 7.2"),
    "a damaged file that ends SciPy's process": ({"path": "crash.mat"}, "version 4 to 7.2 (damaged)"),
    "a damaged file of MATLAB 7.3": ({"path": "new.mat"}, "version 7.3 (HDF5)"),
    "an array without names": ({"path": np.zeros((50, 3))}, "data ndarray, expected a file, a DataFrame, or arrays"),
    "a hold of another name": ({"hold": "zoh"}, "data.npz: hold 'zoh', expected rig or band or zero"),
    "no data": ({"path": None}, "data NoneType, expected a file"),
    "no inputs": ({"inputs": []}, "data.npz: no input, expected some of t, u, y, short"),
    "words for numbers": ({"path": {"t": [0.0, 0.1], "u": ["a", "b"], "y": [1.0, 2.0]}}, "no column 'u', it has t, y"),
    "a text for a number": ({"path": "bad.csv"}, "bad.csv, line 2: 'three' in y, expected a finite number"),
    "no such column": ({"inputs": ["force"], "time": "seconds"}, "no column 'force', 'seconds', it has t, u, y, short"),
    "columns that differ in length": ({"outputs": ["short"]}, "short has 9 samples and u 50, expected the same"),
    "no rate": ({"time": ""}, "sample_rate 0 Hz and time '', expected one of the two, such as time='t'"),
    "uneven times": ({"time": "y"}, "expected equal steps of"),
    "two columns of one name": ({"path": "twice.csv"}, "twice.csv: columns named twice: y; expected each name once"),
    "two columns of a table of one name": (
        {"path": pandas.DataFrame(np.zeros((50, 3)), columns=["t", "u", "u"])},
        "data: columns named twice: u; expected",
    ),
    "a column of a matrix that is named as another": (
        {"path": {"t": np.arange(50.0), "u_1": np.zeros(50), "u": np.zeros((50, 2)), "y": np.zeros(50)}},
        "data: no column 'u', it has t, u_1, u_1, u_2, y",
    ),
    "one column twice": ({"outputs": ["u"]}, "columns named twice: u"),
    "a unit of nothing": ({"units": {"z": "N", "q": "m"}}, "units of z, q, expected of some of u, y"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_files_that_cannot_be_used_are_refused_with_one_line(mistake, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(1)
    content = {"t": np.arange(50) / RATE, "u": random.standard_normal(50), "y": random.standard_normal(50)}
    np.savez("data.npz", **content, short=np.zeros(9))
    Path("bad.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    Path("bad.csv").write_text("t,u,y\n1,2,three\n2,3,4\n")
    Path("data.xls").touch()
    Path("twice.csv").write_text("t,u,y,y\n0,1,2,3\n1,2,3,4\n")
    io.savemat("crash.mat", {"t": np.arange(4.0), "q": {"a": np.arange(3.0)}})
    crash = bytearray(Path("crash.mat").read_bytes())
    crash[144] = 5  # the class of the array
    Path("crash.mat").write_bytes(crash)
    Path("new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n")
    changed, message = MISTAKES[mistake]
    arguments = {"path": "data.npz", "inputs": ["u"], "outputs": ["y"], "time": "t"} | changed
    path = arguments.pop("path")
    with pytest.raises(AbraceError) as error:
        Test.read(path, **arguments) if isinstance(path, str) else Test.from_arrays(path, **arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"modes": -1}, "identification: modes: -1, expected greater than or equal to 0"),
        ({"order": 7}, "order 7: an even number, two states for each pole pair"),
        ({"order": 6, "modes": 2}, "order 6 and modes 2: order 4, or one of the two"),
        ({"band": (1.0,)}, "identification: band: .*, expected two frequencies in Hz"),
        ({"sample_rate": "100"}, "identification: sample_rate: '100', expected a number"),
        ({"units": ["a1"]}, r"identification: units: \['a1'\], expected NAME=UNIT"),
        ({"inputs": True}, "identification: inputs.0: True, expected a valid string"),
    ],
)
def test_options_that_are_none_are_refused(options, message):
    with pytest.raises(AbraceError, match=message):
        DataOptions.of({"inputs": ["u"], **options})
