# SPDX-License-Identifier: Apache-2.0
"""Modes of a known structure from records of every kind, names alone given."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from abrace_core import AbraceError
from abrace_core.model.verdict import Verdict
from abrace_sysid.data_identification import DataOptions, identify_data, observed, predicted, variance_accounted_for
from abrace_sysid.fitting.line_fit import LineFit, Lines, parameters_of, poles_of, refined
from abrace_sysid.fitting.line_noise import noise_of
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.mode_search import _candidates, find_modes
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.estimation import frequency_responses
from abrace_sysid.validity.judgement import identify_and_judge

FREQUENCY, DAMPING = np.array([2.1, 5.3, 8.2]), np.array([0.012, 0.006, 0.01])
SHAPES, DRIVE = np.array([[1.0, 0.8, -0.5], [0.6, -0.9, 0.9]]), np.array([1.0, 0.7, -0.9])
RATE, OVER, SAMPLES = 50.0, 8, 3000
HELD_OUT = 1000
NONE = np.zeros(0, dtype=np.complex128)
TRUE = 2 * np.pi * FREQUENCY * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))


def excitation(kind, random):
    """(OVER SAMPLES,) of the force, before the anti-aliasing filter."""
    count = OVER * SAMPLES
    time = np.arange(count) / (OVER * RATE)
    if kind == "noise":
        return random.normal(size=count)
    if kind == "sweep":
        return signal.chirp(time, 0.3, time[-1], 14.0)
    if kind == "earthquake":
        shaken = signal.sosfilt(
            signal.butter(2, [0.5, 12.0], "band", fs=OVER * RATE, output="sos"), random.normal(size=count)
        )
        return shaken * (time / 6 * np.exp(1 - time / 6) + 0.02)
    hits = (1.0,) if kind == "hit" else (1.0, 13.0, 21.0, 33.0, 47.0)
    return sum(np.where(abs(time - hit) < 0.03, np.cos((time - hit) * np.pi / 0.06), 0.0) for hit in hits)


def motion(force):
    """(samples, 2) displacements under a force that is linear between samples."""
    found, rate = 0.0, OVER * RATE
    for frequency, damping, shape, drive in zip(2 * np.pi * FREQUENCY, DAMPING, SHAPES.T, DRIVE, strict=True):
        system = signal.tf2ss([frequency**2], [1, 2 * damping * frequency, frequency**2])
        a, b, c, d, _ = signal.cont2discrete(system, 1 / rate, "foh")
        found = found + np.outer(signal.dlsim((a, b, c, d, 1 / rate), force)[1][:, 0], drive * shape)
    return found


def record(kind, noise=0.01, of_input=0.0, seed=1, more=()):
    """Columns by name; the noises are shares of the channels' rms, `more` is added to the first output."""
    random = np.random.default_rng(seed)
    force = signal.sosfilt(signal.butter(8, 18.0, fs=OVER * RATE, output="sos"), excitation(kind, random))
    outputs = motion(force)[::OVER]
    outputs = outputs + noise * outputs.std(axis=0) * random.normal(size=outputs.shape)
    for amplitude, frequency in more:
        turn = 2 * np.pi * frequency * np.arange(SAMPLES) / RATE
        outputs[:, 0] += amplitude * outputs[:, 0].std() * np.sin(turn)
    force = force[::OVER] + of_input * force.std() * random.normal(size=SAMPLES)
    return {"force": force, "y1": outputs[:, 0], "y2": outputs[:, 1]}


def read(columns):
    return DataOptions(inputs=("force",), sample_rate=RATE).read(columns)[0]


def right(found):
    """Whether the modes are the true ones, no more, each within four standard deviations or nearly."""
    pairs = found.pairs
    return len(pairs) == len(FREQUENCY) and all(
        abs(pair.frequency - abs(pole)) < 4 * pair.frequency_deviation
        and abs(pair.damping - damping) < 4 * pair.damping_deviation
        and pair.damping_deviation < 0.3 * damping
        for pair, pole, damping in zip(pairs, TRUE, DAMPING, strict=True)
    )


@pytest.mark.parametrize("kind", ["noise", "sweep", "earthquake", "hit", "hits"])
def test_names_alone_give_all_modes_and_no_other_and_predict_down_to_the_noise(kind):
    whole = read(record(kind))
    found = identify_data(whole.part(0, SAMPLES - HELD_OUT))
    assert right(found), found.pairs
    if kind not in ("hit", "sweep"):  # of a hit nothing is left at the end, a sweep ends above all modes
        rest = whole.part(SAMPLES - HELD_OUT, SAMPLES)
        noise = (0.01 * whole.outputs.std(axis=0) / rest.outputs.std(axis=0)) ** 2
        assert (variance_accounted_for(found.model, rest) > 1 - 1.3 * noise).all()


def test_a_record_without_noise_is_fitted():
    found = identify_data(read(record("noise", noise=0.0)))
    # the filter lets 1e-4 of what is above half the sample rate through
    assert [pair.frequency for pair in found.pairs] == pytest.approx(list(abs(TRUE)), rel=1e-5)
    assert [pair.damping for pair in found.pairs] == pytest.approx(list(DAMPING), rel=1e-4)


def test_noise_of_the_measured_input_gives_no_modes_beside_the_true_ones():
    assert right(identify_data(read(record("noise", noise=0.001, of_input=0.05))))


def test_a_hum_is_no_mode_and_is_said_to_be_left_out():
    found = identify_data(read(record("noise", more=[(0.05, 12.34)])))
    assert right(found), found.pairs
    (text,) = [text for text in found.warnings if "do not cause" in text]
    assert "motion at 12.34 Hz" in text
    assert np.abs(np.abs(found.estimate.poles) / (2 * np.pi) - 12.34).min() > 0.5


def test_an_impulse_is_an_excitation_and_not_a_clipped_one():
    force, time = np.zeros(2000), np.arange(2000) / RATE
    force[0] = 3.0
    decay = [np.exp(pole * time).imag for pole in TRUE]
    columns = {"force": force, "y1": 0.2 * SHAPES[0] @ decay, "y2": 0.2 * SHAPES[1] @ decay}
    found = identify_data(DataOptions(inputs=("force",), sample_rate=RATE, hold="zero").read(columns)[0])
    assert [pair.frequency for pair in found.pairs] == pytest.approx(list(abs(TRUE)), rel=1e-6)
    assert [pair.damping for pair in found.pairs] == pytest.approx(list(DAMPING), rel=1e-4)


def test_outputs_that_the_input_does_not_move_are_refused():
    columns = record("noise", noise=0.0)
    random = np.random.default_rng(7)
    columns |= {name: random.normal(size=SAMPLES) for name in ("y1", "y2")}
    with pytest.raises(AbraceError, match=r"no channel is a response|nothing that the inputs cause"):
        identify_data(read(columns))


@pytest.mark.parametrize(("hold", "error"), [("zero", 1e-12), ("band", 0.01)])
def test_the_state_from_rest_is_the_one_that_the_input_makes(hold, error):
    pole, steps = TRUE[0], 1 if hold == "zero" else 64
    fine, step = np.random.default_rng(1).normal(size=500 * steps) + 0.3, 1 / (RATE * steps)
    if hold == "band":
        fine = signal.sosfilt(signal.butter(8, 12.0, fs=1 / step, output="sos"), fine)
    force = fine[::steps]
    whole = np.expm1(pole * step)
    held, ramp = whole / pole, (whole - pole * step) / (pole**2 * step)
    taps = [0, held] if hold == "zero" else [ramp, held - ramp]
    state = signal.lfilter(taps, [1, -1 - whole], fine.astype(np.complex128))[::steps]
    test = DataOptions(inputs=("force",), sample_rate=RATE, hold=hold).read({"force": force, "y": state.real})[0]
    (lines,) = observed([test], (0.0, 25.0))
    expected = np.fft.fft(state)[1 : 1 + len(lines.omega)] / np.sqrt(500)
    found, slope = replace(lines, from_rest=True).state(pole, 0)
    assert np.abs(found - expected).max() < error * np.abs(expected).max()
    near = [replace(lines, from_rest=True).state(pole + by, 0)[0] for by in (1e-5, -1e-5)]
    assert slope == pytest.approx((near[0] - near[1]) / 2e-5, rel=1e-6, abs=1e-6 * np.abs(slope).max())
    with_history = lines.state(pole, 0)[0]
    assert np.abs(with_history - expected).max() > 0.1 * np.abs(expected).max()


def test_a_sweep_from_rest_shows_a_mode_that_it_does_not_reach():
    columns = record("sweep", noise=0.003)
    # the sweep is at 7.8 Hz here, and the highest mode at 8.2 Hz
    found = identify_data(read({name: column[: int(0.55 * SAMPLES)] for name, column in columns.items()}))
    assert right(found), found.pairs
    rest = read({name: column[int(0.55 * SAMPLES) :] for name, column in columns.items()})
    assert (variance_accounted_for(found.model, rest) > 0.99).all()


def test_an_input_that_acts_late_has_a_delay_of_its_own():
    random = np.random.default_rng(3)
    low = signal.butter(8, 15.0, fs=OVER * RATE, output="sos")
    forces = [signal.sosfilt(low, random.normal(size=OVER * SAMPLES)) for _ in range(2)]
    late = 3  # samples
    second = motion(np.roll(forces[1], late * OVER))[:, ::-1] * [1.0, -0.7]
    outputs = (motion(forces[0]) + second)[::OVER]
    outputs += 0.002 * outputs.std(axis=0) * random.normal(size=outputs.shape)
    columns = {"f1": forces[0][::OVER], "f2": forces[1][::OVER], "y1": outputs[:, 0], "y2": outputs[:, 1]}
    found = identify_data(DataOptions(inputs=("f1", "f2"), sample_rate=RATE).read(columns)[0])
    assert right(found), found.pairs
    assert list(found.delays) == ["f2"]
    first, own = np.array(found.model.input_delay) * RATE
    assert first == 0
    assert own == pytest.approx(late, abs=0.5)
    assert any("f2" in text and "late in its action against f1" in text for text in found.warnings)


@pytest.mark.parametrize("fast", [1e-4, -1e-4, 0.0])
def test_a_clock_that_differs_from_that_of_the_inputs_is_named(fast):
    columns, time = record("noise"), np.arange(SAMPLES) / RATE
    for name in ("y1", "y2"):
        columns[name] = CubicSpline(time, columns[name])(time / (1 + fast))
    texts = [text for text in identify_data(read(columns)).warnings if "clock" in text]
    assert len(texts) == (2 if fast else 0), texts
    for name, text in zip(("y1", "y2"), texts, strict=False):
        assert f"the clock of {name} is" in text
        size, *_, side = text.split(" is ")[1].split(" against ")[0].split()
        assert float(size) == pytest.approx(100, rel=0.1)
        assert side == ("fast" if fast > 0 else "slow")


@pytest.fixture(scope="module")
def lines():
    return Lines(observed([read(record("noise"))], (0.0, 20.0)), NONE)


def test_the_gradient_is_that_of_the_cost(lines):
    start = parameters_of(TRUE * 1.003)
    fit = LineFit.at(lines, poles_of(start))
    gradient = -2 * fit.curvature()[1]
    for number in range(start.size):
        step = np.zeros(start.size)
        step[number] = 1e-5
        costs = [LineFit.at(lines, poles_of(start + sign * step.reshape(start.shape))).cost for sign in (1, -1)]
        assert gradient[number] == pytest.approx((costs[0] - costs[1]) / 2e-5, rel=1e-3)


def test_the_curvature_is_that_of_the_residuals(lines):
    start = parameters_of(TRUE)
    slopes = []
    for number in range(start.size):
        step = np.zeros(start.size)
        step[number] = 1e-5
        ends = [LineFit.at(lines, poles_of(start + sign * step.reshape(start.shape))).residual for sign in (1, -1)]
        slopes.append((ends[0] - ends[1]).ravel() / 2e-5)
    expected = np.array(slopes) @ np.array(slopes).T
    scale = np.sqrt(np.diag(expected))
    difference = (LineFit.at(lines, TRUE).curvature()[0] - expected) / np.outer(scale, scale)
    assert np.abs(difference).max() < 0.02


def test_what_a_pole_explains_is_what_the_fit_without_it_leaves_more(lines):
    three = LineFit.at(lines, TRUE)
    without = [LineFit.at(lines, np.delete(TRUE, i)).misfit - three.misfit for i in range(3)]
    assert three.explained() == pytest.approx(without, rel=1e-3)
    columns = lines.columns(TRUE).beside(lines.fixed)
    columns = columns.times(np.eye(columns.count))
    weight = np.sqrt(2) / np.tile(lines.deviation, (2, 1))
    measured = np.vstack([lines.measured.real, lines.measured.imag]) * weight
    for i, explained in enumerate(three.explained(forced=True)):
        first, left = lines.per_pole * i, 0.0
        unforced = np.delete(columns, range(first, first + 2 * lines.inputs), axis=1)
        for own, each in zip(weight.T, measured.T, strict=True):
            left += np.linalg.lstsq(unforced * own[:, None], each, rcond=None)[1][0]
        assert left - three.misfit == pytest.approx(explained, rel=1e-3)


def test_modes_above_the_band_have_a_pair_only_if_there_are_any():
    def order(band):
        options = DataOptions(inputs=("force",), sample_rate=RATE, band=band)
        return identify_data(options.read(record("noise"))[0], options).model.order

    assert order((0.0, 0.0)) == 2 * len(TRUE)
    assert order((0.5, 7.0)) > 2 * np.count_nonzero(FREQUENCY < 7)


def test_the_gain_of_a_candidate_is_what_the_fit_with_it_explains_more(lines):
    two = LineFit.at(lines, TRUE[:2])
    three = LineFit.at(lines, np.append(two.poles, TRUE[2]))
    assert two.gains(TRUE[2:])[0] == pytest.approx(two.misfit - three.misfit, rel=1e-3)


@pytest.mark.parametrize("of_input", [0.0, 0.05])
def test_the_noise_is_told_from_noise_of_the_input(of_input):
    columns = record("noise", noise=0.01, of_input=of_input)
    of_record = Lines(observed([read(columns)], (0.0, 20.0)), NONE)
    noise = noise_of(refined(of_record, TRUE))
    assert noise.passes_through == bool(of_input)
    power = np.mean(np.abs(of_record.measured) ** 2, axis=0) * len(of_record.omega) / (SAMPLES / 2)
    quiet = of_record.omega > 2 * np.pi * 14
    assert np.median(noise.variance[quiet] / power, axis=0) == pytest.approx(1e-4, rel=0.3)
    resonant = np.argmin(abs(of_record.omega - abs(TRUE[0])))
    risen = noise.variance[resonant] / np.median(noise.variance[quiet], axis=0)
    assert (risen > 30).all() if of_input else (risen < 2).all()


def response():
    """Frequencies of the lines of a whole record [Hz] and the response (lines, 2) there."""
    frequency = np.fft.rfftfreq(SAMPLES, 1 / RATE)
    s, size = 2j * np.pi * frequency[:, None], np.abs(TRUE)
    return frequency, (DRIVE * size**2 / (s**2 + 2 * DAMPING * size * s + size**2)) @ SHAPES.T


def through_the_structure(part, random):
    """Columns whose error is that of a noise of the input, or in proportion to the response; and its (lines,) variance.

    In every second quarter of a hertz the input has a thirtieth of the power.
    """
    frequency, g = response()
    power = np.where(4 * frequency % 2 < 1, 1.0, 1 / 30)
    u, error = random.normal(size=(2, len(frequency), 2)) @ [1, 1j]
    u *= np.sqrt(power)
    share = 0.05 * (np.ones_like(power) if part == "noise of the input" else abs(u))[:, None]
    y = g * u[:, None] + g * share * error[:, None]
    y += 1e-7 * np.abs(y).max() * random.normal(size=(*y.shape, 2)) @ [1, 1j]
    force, y1, y2 = (np.fft.irfft(column, SAMPLES) for column in (u, *y.T))
    expected = np.abs(g[:, 0]) ** 2 * (1.0 if part == "noise of the input" else power)
    return {"force": force, "y1": y1, "y2": y2}, expected, power


@pytest.mark.parametrize("part", ["noise of the input", "in proportion"])
def test_the_noise_that_passes_through_has_the_shape_of_what_it_passes_through(part):
    columns, expected, power = through_the_structure(part, np.random.default_rng(5))
    of_record = Lines(observed([read(columns)], (0.0, 20.0)), NONE)
    ratio = noise_of(LineFit.at(of_record, TRUE)).variance[:, 0]
    omega = of_record.omega / (2 * np.pi)
    lines = np.searchsorted(response()[0], omega - 1e-9)
    ratio, weak = ratio / expected[lines], power[lines] < 1
    whole = np.median(ratio[omega < 12])
    for low, high in ((1.9, 2.3), (3.6, 3.8), (5.1, 5.5), (8.0, 8.4), (0.5, 12)):
        for kind in (weak, ~weak):
            near = np.median(ratio[kind & (omega > low) & (omega < high)]) / whole
            assert 0.4 < near < 2.5, (low, high, near)


def test_the_modes_of_two_records_are_as_certain_as_of_one_twice_as_long():
    records = [read(record(kind, seed=seed)) for seed, kind in ((3, "noise"), (4, "hits"))]
    both = find_modes(observed(records, (0.0, 20.0)), NONE, 20)
    assert both.is_mode.all()
    assert np.abs(both.poles) == pytest.approx(np.abs(TRUE), rel=1e-3)


def setup(names, seed, kind="noise"):
    """A record of the force and of these outputs alone."""
    columns = record(kind, seed=seed)
    return replace(read({name: columns[name] for name in ("force", *names)}), source=f"setup {seed}")


def test_records_with_other_outputs_make_one_model():
    setups = [setup(["y1"], 3), setup(["y2"], 4, "hits"), setup(["y1"], 5)]
    found = identify_data(setups)
    assert found.model.outputs == ("y1", "y2")
    assert [one.frequency for one in found.pairs] == pytest.approx(2 * np.pi * FREQUENCY, rel=1e-3)
    assert [one.damping for one in found.pairs] == pytest.approx(DAMPING, rel=0.05)
    for one, truth in zip(found.pairs, 2 * np.pi * FREQUENCY, strict=True):
        assert abs(one.frequency - truth) < 4 * one.frequency_deviation
    both = zip(found.pairs, identify_data(setups[0]).pairs, strict=True)
    assert all(one.damping_deviation < 0.8 * alone.damping_deviation for one, alone in both)
    whole = read(record("noise", noise=0.0, seed=9))
    assert variance_accounted_for(found.model, whole).min() > 0.999
    y1 = found.model.select(["y1"])
    # each output from the records that have it, long ones count more
    first, other = setups[0], setups[2].part(0, 1300)
    missed = sum(len(one.outputs) * np.var(one.outputs - predicted(y1, one)) for one in (first, other))
    moved = sum(len(one.outputs) * np.var(one.outputs) for one in (first, other))
    shares = variance_accounted_for(found.model, [first, setups[1], other])
    assert shares[0] == pytest.approx(1 - missed / moved, abs=1e-12)
    with pytest.raises(AbraceError, match="setup 4: no channel 'y1', it has y2"):
        variance_accounted_for(found.model, setups[1])
    (response,) = found.responses
    (of_first,) = frequency_responses([setups[0], setups[2]], ["force"], found.band)
    assert response.outputs == ("y1", "y2")
    assert response.select(["y1"]).response == pytest.approx(of_first.response, rel=1e-9)


def test_a_sensor_that_is_dead_in_one_record_is_used_in_the_other():
    whole, broken = read(record("noise", seed=3)), read(record("noise", seed=4))
    broken.outputs[:, 1] = 0.7
    found = identify_data([whole, replace(broken, source="second day")])
    assert found.model.outputs == ("y1", "y2")
    assert "second day: channel y2 is left out: never changes from 0.7" in found.warnings
    assert [one.names for one in found.records] == [("y1", "y2"), ("y1",)]


def test_noise_of_outputs_that_other_records_have_is_each_record_s_own():
    loud = read(record("noise", noise=0.3, seed=4))
    both = Lines(observed([setup(["y1"], 3), loud.select(["y2", "y1"])], (0.0, 20.0)), NONE)
    fit = LineFit.at(both, TRUE)
    noise = np.sqrt(noise_of(fit).variance)
    first = np.r_[both.rows[0], len(both.omega) + np.r_[both.rows[0]]]
    assert not fit.residual[first, 1].any(), "an output that is not measured is not fitted"
    quiet, second = (np.median(noise[rows], axis=0) for rows in both.rows)
    assert second[0] / quiet[0] == pytest.approx(30, rel=0.3)
    assert both.present.tolist() == [[True, False], [True, True]]
    assert both.values == len(both.omega) + len(both.observations[1].omega)


def test_a_delay_that_shapes_explain_as_well_has_a_wide_interval():
    random = np.random.default_rng(3)
    stiffness = 4000 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    stiffness[3, 3] = 4000
    size, shapes = np.linalg.eigh(stiffness)
    damping = shapes @ np.diag(0.02 * np.sqrt(size)) @ shapes.T
    a = np.block([[np.zeros((4, 4)), np.eye(4)], [-stiffness, -damping]])
    held = signal.cont2discrete((a, np.eye(8)[:, 7:], a[4:], np.eye(4)[:, 3:]), 0.01)
    force = random.standard_normal(8000)
    moved = signal.dlsim((*held[:4], 0.01), force)[1]
    moved = moved + 0.05 * moved.std(axis=0) * random.standard_normal(moved.shape)
    columns = {"force": force, "a2": np.roll(moved[:, 1], 2), "a4": moved[:, 3]}
    found = identify_data(Test.from_arrays(columns, ["force"], sample_rate=100.0, hold="zero"))
    delay = found.delays["a2"]
    assert abs(delay.seconds - 0.02) < delay.apart
    assert f"± {delay.apart / 0.01:.2f} samples" in found.warnings[0]


def test_columns_of_records_multiply_as_the_whole_matrix_does():
    random = np.random.default_rng(2)
    records = [setup(["y1"], 3), setup(["y2"], 4)]
    lines = Lines(observed(records, (0.0, 6.0)), NONE)
    some, others = lines.columns(TRUE).beside(lines.fixed), lines.columns(TRUE, slopes=True)
    dense, beside = (each.times(np.eye(each.count)) for each in (some, others))
    half, rows = len(lines.omega), lines.rows[0]
    assert np.count_nonzero(dense.any(axis=0)) == dense.shape[1]
    decay = 2 * lines.inputs + np.arange(2)
    assert dense[rows][:, decay].all()
    assert not dense[lines.rows[1]][:, decay].any()
    weight = random.uniform(1, 2, 2 * half)
    weight[rows], weight[half:][rows] = 0.0, 0.0
    heavy, right = weight[:, None] * dense, random.normal(size=(2 * half, 2))
    assert some.weighted(weight).onto(right) == pytest.approx(heavy.T @ right, rel=1e-9, abs=1e-9)
    assert np.tril(some.weighted(weight).squares()) == pytest.approx(np.tril(heavy.T @ heavy), rel=1e-9, abs=1e-9)
    assert some.products(others) == pytest.approx(dense.T @ beside, rel=1e-9, abs=1e-9)
    assert some.times(np.ones((some.count, 1)))[:, 0] == pytest.approx(dense.sum(axis=1), rel=1e-9, abs=1e-9)


def test_the_candidates_of_many_records_are_those_of_one():
    hits = [read(record("hit", seed=seed)) for seed in range(6)]
    counts = [len(candidates(Lines(observed(each, (0.0, 20.0)), NONE))) for each in (hits[:1], hits)]
    assert counts[1] < 1.5 * counts[0]


def candidates(lines):
    return _candidates(lines, lines.measured)[0]


def test_a_pair_above_the_lines_is_said_to_be_no_mode():
    options = DataOptions(inputs=("force",), sample_rate=RATE, band=(0.5, 6.0))
    found = identify_data(options.read(record("noise", noise=0.001))[0], options)
    assert found.fitted == (0.5, 6.0)
    assert np.abs(found.estimate.poles[~found.is_mode]) == pytest.approx([2 * np.pi * 8.2], rel=0.01)
    (said,) = found.warnings
    assert said == "data: a pair stands for what lies above the lines that were fitted, not for a mode"


def test_an_output_by_itself_is_as_certain_as_beside_another():
    columns = record("noise", seed=3)
    (whole,) = observed([read(columns | {"y1": 1e4 * columns["y1"], "y2": 1e3 * columns["y2"]})], (0.0, 12.0))
    apart = [replace(whole, outputs=(name,), measured=whole.measured[:, [i]]) for i, name in enumerate(whole.outputs)]
    together, split = (fit_poles(each, TRUE) for each in ([whole], apart))
    assert split.outputs == together.outputs
    assert split.poles == pytest.approx(together.poles, rel=1e-6)
    assert split.shapes * split.drive.T == pytest.approx(together.shapes * together.drive.T, rel=1e-4)
    for one, other in zip(split.pairs(), together.pairs(), strict=True):
        assert one.frequency_deviation == pytest.approx(other.frequency_deviation, rel=0.3)
        assert one.damping_deviation == pytest.approx(other.damping_deviation, rel=0.3)


def test_setups_are_judged_each_by_its_own_outputs():
    options = DataOptions(inputs=("force",), sample_rate=RATE, held_out=0.3)
    found, held_out, judged = identify_and_judge([setup(["y1"], 3), setup(["y2"], 5)], options)
    assert [one.names for one in held_out] == [("y1",), ("y2",)]
    assert [one.test.outputs for one in judged.residuals] == [("y1",), ("y2",)]
    assert judged.validity.verdict is Verdict.TRUST
    assert variance_accounted_for(found.model, held_out).min() > 0.99


def test_an_input_that_is_called_w_is_held_where_it_is_said_to_be():
    a, b, c, d, period = signal.cont2discrete(signal.tf2ss([1600.0], [1, 0.8, 1600.0]), 0.05, "zoh")
    held = np.random.default_rng(4).normal(size=3000)
    moved = signal.dlsim((a, b, c, d, period), held)[1]
    test = Test.from_arrays({"w": held, "y": moved[:, 0]}, ["w"], sample_rate=20.0, hold="zero")
    found = identify_data(test)
    assert variance_accounted_for(found.model, test)[0] > 1 - 1e-9
