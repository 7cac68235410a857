# SPDX-License-Identifier: Apache-2.0
"""Modes of a known structure from records of every kind, names alone given."""

import numpy as np
import pytest
from scipy import signal

from abrace_core import AbraceError
from abrace_sysid.data_identification import DataOptions, identify_data, observed, variance_accounted_for
from abrace_sysid.fitting.line_fit import LineFit, Lines, parameters_of, poles_of, refined
from abrace_sysid.fitting.line_noise import noise_of
from abrace_sysid.fitting.mode_search import find_modes

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


def test_the_modes_of_two_records_are_as_certain_as_of_one_twice_as_long():
    records = [read(record(kind, seed=seed)) for seed, kind in ((3, "noise"), (4, "hits"))]
    both = find_modes(observed(records, (0.0, 20.0)), NONE, 20)
    assert both.is_mode.all()
    assert np.abs(both.poles) == pytest.approx(np.abs(TRUE), rel=1e-3)
