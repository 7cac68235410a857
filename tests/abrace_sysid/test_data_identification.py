# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import fft, io

from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_model
from abrace_sysid.data_identification import DataOptions, identify_data
from abrace_sysid.data_results import write_data_results
from abrace_sysid.figures.data import figures_of_data
from abrace_sysid.free_prediction import variance_accounted_for
from abrace_sysid.measured_data import MeasuredData, read_data, units_of
from abrace_sysid.models.modal import modal_model
from abrace_sysid.validity.data_judgement import judge_data
from abrace_sysid.validity.finding import Verdict
from abrace_sysid.validity.sensor_findings import spiked
from abrace_sysid.validity_results import write_validity

FREQUENCY = 2 * np.pi * np.array([6.0, 11.0, 17.0, 31.0, 44.0, 58.0])
DAMPING = np.array([0.006, 0.004, 0.008, 0.005, 0.006, 0.004])
ABOVE = 2 * np.pi * 130.0
"""A mode above half the sample rate: its tail is in the data."""

RATE, SECONDS = 200.0, 20.0
MEASURED = Path(__file__).parents[2].parent / "shared/flexible_structure/flexible_structure_dat.mat"
"""Beside the repository, where it is; the project ships no copy."""


def structure_data(outputs=8, noise=0.01, seed=0):
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
    return MeasuredData("structure", 1 / RATE, ("shaker_1", "shaker_2"), names, force[kept], acceleration[kept])


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
    swapped = MeasuredData(
        "swapped", rest.sample_period, rest.inputs, rest.names, rest.excitation[:, ::-1], rest.outputs
    )
    assert variance_accounted_for(found.model, swapped).mean() < 0.9


def test_results_are_files_a_person_and_a_programme_read(found, data, tmp_path):
    text = write_data_results(found, data.part(2800, 4000), tmp_path, mat=True)
    assert "variance accounted for, 6 s held out: mean 99.9" in text
    model = load_model(tmp_path / "model.json")
    assert model.provenance["data"] == "structure"
    poles = json.loads((tmp_path / "poles.json").read_text())["data"]
    assert len(poles) == 6
    assert poles[0]["damping_ratio_deviation"] > 0
    assert set(json.loads((tmp_path / "prediction.json").read_text())["variance_accounted_for"]) == set(data.names)
    assert (tmp_path / "model.mat").exists()
    drawn = figures_of_data(found)
    assert set(drawn) == {"transfer_functions_shaker_1", "transfer_functions_shaker_2", "residuals", "confidence"}


def test_measured_data_are_judged_by_what_is_left_over_and_by_what_was_held_out(found, data, tmp_path):
    used, rest = data.part(0, 2800), data.part(2800, 4000)
    judged = judge_data(used, found, rest)
    # the tail of the mode above half the sample rate is not quite that of the pairs that stand for it
    assert [(reason.check, reason.verdict) for reason in judged.validity.reasons] in ([], [("whiteness", Verdict.CARE)])
    checks = {finding.check for finding in judged.validity.findings}
    assert {"channels respond", "spikes", "residual", "whiteness", "independence", "prediction"} <= checks
    (residual,) = judged.residuals
    assert np.median(residual.ratio.mean(axis=0)) == pytest.approx(1.0, abs=0.2)
    assert "held_out is 0" in judge_data(used, found, data.part(0, 0)).validity.not_checked["prediction"]
    write_validity(judged, tmp_path)
    assert json.loads((tmp_path / "validity.json").read_text())["causes"] == []
    assert (tmp_path / "validity.png").stat().st_size > 10000

    fourth = np.argmin(np.abs(np.abs(found.estimate.poles) - FREQUENCY[3]))
    shapes = found.estimate.shapes * (np.arange(len(found.estimate.poles)) != fourth)
    poor = replace(found, model=modal_model(replace(found.estimate, shapes=shapes), {}))
    named = judge_data(used, poor, rest).validity
    assert named.causes in (("mode missed",), ("unmodelled dynamics",))
    assert {reason.check for reason in named.reasons} >= {"residual", "whiteness", "independence", "prediction"}


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
    spoilt = MeasuredData("structure", data.sample_period, data.inputs, data.names, data.excitation, dead)
    found = identify_data(spoilt.part(0, 2000), DataOptions(most_modes=2))
    assert found.warnings == ("structure: channel place_4 is left out: never changes from 0.5",)
    assert "place_4" not in found.model.outputs


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.part(0, 300), "structure: 300 samples, expected at least 400"),
        (
            lambda d: MeasuredData(d.source, d.sample_period, d.inputs, d.names, 0 * d.excitation, d.outputs),
            "structure: shaker_1 is not excited",
        ),
        (
            lambda d: MeasuredData(d.source, d.sample_period, d.inputs, d.names, d.excitation[:, [0, 0]], d.outputs),
            "zero, or repeats another",
        ),
        (
            lambda d: MeasuredData(d.source, d.sample_period, d.inputs, d.names, d.excitation, np.nan * d.outputs),
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
        read = read_data(tmp_path / name, ["u_1", "u_2"], time="t", units=units_of(["u_1=N"]))
        assert read.names == ("y_1", "y_2")
        assert read.sample_period == pytest.approx(1 / RATE)
        assert np.allclose(read.channels(["u_2", "y_1"]), both[:, 1:3])
    np.savez(tmp_path / "bag.npz", **{"ground_acceleration": both[:, 0], "displacement[0]": both[:, 1]})
    read = read_data(tmp_path / "bag.npz", ["w"], sample_rate=RATE)
    assert (read.inputs, read.names) == (("w",), ("displacement[0]",))
    assert np.allclose(read.channels(["x1", "w"]), both[:, [1, 0]])
    read = read_data(tmp_path / "data.npy", ["1", "2"], ["4"], sample_rate=RATE)
    assert np.allclose(read.outputs[:, 0], both[:, 3])


MISTAKES = {
    "no file": ({"path": "none.mat"}, "none.mat: No such file"),
    "another ending": ({"path": "data.xls"}, "expected a file with the ending .mat, .csv, .npz, .npy"),
    "a damaged file": ({"path": "bad.mat"}, "bad.mat: cannot be read as .mat"),
    "a damaged file that ends SciPy's process": ({"path": "crash.mat"}, "version 4 to 7.2 (damaged)"),
    "a file of MATLAB 7.3": ({"path": "new.mat"}, "version 7.3 (HDF5), expected one saved with save -v7"),
    "objects": ({"path": "objects.npz"}, "objects.npz: cannot be read as .npz (Object arrays cannot be loaded"),
    "an array without names": ({"path": np.zeros((50, 3))}, "data ndarray, expected a file, a DataFrame, or arrays"),
    "a rate that is a text": (
        {"time": "", "sample_rate": "100"},
        "data.npz: sample_rate '100', expected a number in Hz",
    ),
    "a hold of another name": ({"hold": "zoh"}, "data.npz: hold 'zoh', expected band or zero"),
    "no data": ({"path": None}, "data NoneType, expected a file"),
    "words for numbers": ({"path": {"t": [0.0, 0.1], "u": ["a", "b"], "y": [1.0, 2.0]}}, "no column 'u', it has t, y"),
    "a text for a number": ({"path": "bad.csv"}, "expected a line of names, then numbers"),
    "no such column": ({"inputs": ["force"], "time": "seconds"}, "no column 'force', 'seconds', it has t, u, y, short"),
    "columns that differ in length": ({"outputs": ["short"]}, "short has 9 samples and u 50, expected the same"),
    "no rate": ({"time": ""}, "sample_rate 0 Hz and time '', expected just one of the two"),
    "uneven times": ({"time": "y"}, "time column y does not rise in even steps"),
    "one column twice": ({"outputs": ["u"]}, "named twice: u"),
    "a unit of nothing": ({"units": {"z": "N", "q": "m"}}, "units of z, q, expected of some of u, y"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_files_that_cannot_be_used_are_refused_with_one_line(mistake, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(1)
    content = {"t": np.arange(50) / RATE, "u": random.standard_normal(50), "y": random.standard_normal(50)}
    np.savez("data.npz", **content, short=np.zeros(9))
    Path("bad.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    Path("bad.csv").write_text("t,u,y\n1,2,three\n")
    io.savemat("crash.mat", {"t": np.arange(4.0), "q": {"a": np.arange(3.0)}})
    crash = bytearray(Path("crash.mat").read_bytes())
    crash[144] = 5  # the class of the array
    Path("crash.mat").write_bytes(crash)
    Path("new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n")
    np.savez("objects.npz", **content, facts=np.array({"by": "me"}, dtype=object))
    changed, message = MISTAKES[mistake]
    arguments = {"path": "data.npz", "inputs": ["u"], "outputs": ["y"], "time": "t"} | changed
    with pytest.raises(AbraceError) as error:
        read_data(**arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.skipif(not MEASURED.exists(), reason=f"there is no {MEASURED}")
def test_the_strongest_modes_of_a_measured_structure_are_found():
    inputs = ["flexible_structure_dat_1", "flexible_structure_dat_2"]
    data = read_data(MEASURED, inputs, sample_rate=1024.0)
    assert len(data.names) == 28
    found = identify_data(data.part(0, 5682), DataOptions(most_modes=3))
    assert [round(pair.frequency / (2 * np.pi)) for pair in found.pairs] == [229, 334, 417]
