# SPDX-License-Identifier: Apache-2.0
"""The node `record` as a process, and its figure."""

import json

import numpy as np
import pytest
from forked import run_node

from abrace_core.figures.saving import save_figure
from abrace_plant.records.figure import record_figure
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import intensity, response_spectrum
from abrace_plant.records.record import Record


def test_el_centro_is_measured_as_read_and_as_played_and_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = run_node("abrace_plant", "record", record="el_centro", peak_acceleration=0.980665, time_scale=0.5)
    assert ended.returncode == 0, ended.stderr
    folder = tmp_path / "results/records/el_centro"
    facts = json.loads((folder / "record.json").read_text())
    record = read_record("el_centro")
    measures = intensity(record)
    assert facts["recorded"]["peak_acceleration"] == measures.peak_acceleration
    assert facts["recorded"]["significant_duration"] == measures.significant_duration
    assert facts["recorded"]["sample_period"] == 0.01
    assert facts["played"]["peak_acceleration"] == 0.980665
    assert facts["played"]["sample_period"] == 0.002
    assert facts["played"]["significant_duration"] == pytest.approx(measures.significant_duration / 2, rel=0.02)
    assert facts["treatment"]["band_limit"] == 25.0
    spectra = facts["recorded"]["spectra"]
    assert np.shape(spectra["pseudo_acceleration"]) == (3, len(spectra["periods"]))
    assert "<svg" in (folder / "record.svg").read_text()
    rows = {line[:24].strip(): line[24:].split() for line in ended.stdout.splitlines()}
    assert rows["PGA [m/s^2]"] == [f"{measures.peak_acceleration:.4f}", "0.9807"]
    assert rows["Arias intensity [m/s]"][0] == f"{measures.arias_intensity:.4f}"
    assert rows["duration [s]"][0] == "53.7200"
    assert "the table can play it" in ended.stdout
    played = facts["table"]
    assert played["displacement"]["value"] == pytest.approx(facts["played"]["peak_displacement"], rel=1e-3)
    assert (played["displacement"]["limit"], played["velocity"]["limit"]) == (0.25, 1.0)
    assert not any(demand["exceeded"] for demand in played.values())


def test_what_the_table_has_not_is_told_with_what_to_do_and_the_rest_is_shown_all_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = run_node("abrace_plant", "record", record="el_centro", peak_acceleration=30.0)
    assert ended.returncode == 0, ended.stderr
    told = [line for line in ended.stdout.splitlines() if line.startswith("refused for its ")]
    assert [line.partition(":")[0].removeprefix("refused for its ") for line in told] == [
        "acceleration",
        "velocity",
        "displacement",
    ]
    facts = json.loads((tmp_path / "results/records/el_centro/record.json").read_text())
    beyond = facts["table"]["acceleration"]
    assert (beyond["value"], beyond["limit"], beyond["exceeded"]) == (30.0, 10.0, True)


def test_any_motion_is_drawn_even_one_of_zeros(tmp_path):
    motions = []
    for acceleration in (np.zeros(300), np.random.default_rng(0).standard_normal(400)):
        record = Record("any", 0.01, acceleration)
        motions.append((record, intensity(record), response_spectrum(record)))
    figure = record_figure(*motions)
    husid_plot = next(axis for axis in figure.axes if axis.get_ylabel() == "Arias intensity [%]")
    marked = [line.get_xdata()[0] for line in husid_plot.lines if len(line.get_xdata()) == 2]
    assert motions[1][1].significant_from in marked
    assert motions[1][1].significant_to in marked
    save_figure(figure, tmp_path / "any.svg")
    assert (tmp_path / "any.svg").stat().st_size > 10_000
