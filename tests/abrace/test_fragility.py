# SPDX-License-Identifier: Apache-2.0
"""`abrace fragility` and `abrace.fragility`: from a rig's name to curves, and what is wrong in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import abrace
from abrace.cli import main
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import Controller, load_controller, save_controller
from abrace_core.model.linear_model import LinearModel, save_model
from abrace_lqg.weights import load_weights
from abrace_studies.exploration.study import Outcome, Study, evaluate
from abrace_studies.ground_motions import noise_motion

if TYPE_CHECKING:
    from pathlib import Path

PERIOD = 0.002
RIG = "ncree_three_storey"


def evaluated(name: str) -> Outcome:
    """LQG3 tried on a rig."""
    rig = abrace.load_rig(name)
    motions = [noise_motion(1, 4.0, (0.1, 10.0), PERIOD)]
    study = Study.of(rig.model, [rig.model], motions, intensities=[1.0], capacity=rig.capacity, sample_period=PERIOD)
    return evaluate(study, 0, load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights")))


@pytest.fixture
def damper(tmp_path) -> Path:
    law = LinearModel([[0.998]], [[PERIOD]], [[-3.0e4]], [[0.0]], ("a1",), ("U",), PERIOD)
    path = tmp_path / "damper.yaml"
    save_controller(Controller("damper", law, [[0.0]], [[0.0, 0.0]], [2000.0], "m", "w", "g"), path)
    return path


def test_from_a_rig_to_curves_and_again_without_computing(damper, tmp_path, capsys):
    folder = tmp_path / "found"
    given = ["fragility", RIG, "--controllers", str(damper), "--records", "el_centro", "--noise", "1"]
    given += ["--noise-duration", "4", "--intensities", "0.25", "1", "4", "--limits", "d1=0.01", "--faults", "a1=0"]
    given += ["--workers", "1", "--output", str(folder)]
    assert main(given) == 0
    said = capsys.readouterr()
    assert not said.err
    assert "fragility: done in" in said.out
    assert "damper, a1=0: d1 above 0.01 m: median" in said.out
    (part,) = (folder / "loops").glob("part-*.parquet")
    written = part.stat().st_mtime_ns
    again = abrace.fragility(
        RIG,
        [damper],
        limits={"d1": 0.01},
        intensities=[0.25, 1.0, 4.0],
        records=["el_centro"],
        noise=[1],
        noise_duration=4.0,
        faults={"a1": 0.0},
        folder=folder,
        scheduler="nobody",
    )
    assert part.stat().st_mtime_ns == written, "what is done should not have been computed again"
    assert repr(again) == f"<Fragility: 18 loops, d1, in {folder}>"
    loops = again.loops()
    mine = loops[(loops.controller == "damper") & (loops.motion == "el_centro") & (loops.fault == "none")]
    for _, row in mine.iterrows():
        model = abrace.load_rig(RIG).model
        run = abrace.simulate(model, "el_centro", controller=damper, peak_acceleration=row.intensity)
        assert row.peak_x3 == pytest.approx(np.abs(run.channels(["x3"])).max(), rel=1e-9)
        assert row.peak_U == pytest.approx(np.abs(run.command).max(), rel=1e-9)
    assert len(mine) == 3


def test_sets_of_weights_are_explored_on_a_rig(tmp_path, capsys):
    given = {"sets": 3, "noise": [1], "noise_duration": 4.0, "rig": RIG, "folder": tmp_path / "found"}
    with pytest.raises(abrace.AbraceError, match="does not answer"):
        abrace.explore(RIG, "lqg3", scheduler="tcp://127.0.0.1:1", **given)
    with pytest.raises(abrace.AbraceError, match="no records"):
        abrace.explore(RIG, "lqg3", **given | {"noise": []})
    with pytest.raises(abrace.AbraceError, match="models 5: ncree_three_storey has no covariance"):
        abrace.explore(RIG, "lqg3", models=5, **given)
    found = abrace.explore(RIG, "lqg3", workers=1, peak_acceleration=1.0, **given)
    assert repr(found) == "<Explored: 4 sets of weights, 0 without a controller>"
    table = found.to_pandas()
    assert list(table.index) == [0, 1, 2, 3]
    assert table.loc[0, "command_rms"] == pytest.approx(evaluated(RIG).command.rms, rel=1e-9), (
        "LQG3 itself is the first"
    )
    assert table.loc[0, "rank"] >= 1
    assert main(["explore", RIG, "--pick", "0", "--output", str(tmp_path / "found")]) == 0
    assert "set_0.yaml" in capsys.readouterr().out
    assert load_controller(tmp_path / "found/set_0.yaml").law.inputs == ("a1", "a2", "a3")
    assert main(["explore", RIG, "--pick", "9", "--output", str(tmp_path / "found")]) == 2
    assert "exploration.json: no set 9, expected 0 to 3" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (["--limits", "d1"], "fragility: limits: ['d1'], expected NAME=NUMBER, such as a1=0"),
        (["--limits", "q1=3"], "limits q1=3: expected a value above 0 for some of x1"),
        (["--limits", "d1=inf"], "fragility: limits: ['d1=inf'], expected NAME=NUMBER"),
        (["--limits", "d1=0.01", "d1=0.02"], "limits: ['d1=0.01', 'd1=0.02'], expected one limit above 0 of d1"),
        (["--faults", "a1=nan"], "fragility: faults: ['a1=nan'], expected NAME=NUMBER"),
        (["--faults", "a1=0", "a1=0"], "fault a1=0: given twice, expected each once"),
        (["--noise-duration", "nan"], "fragility: noise_duration: nan, expected a finite number"),
        (["--workers", "-1"], "fragility: workers: -1, expected greater than or equal to 0"),
        (["--intensities", "2", "1"], "fragility: intensities: [2.0, 1.0], expected numbers that rise"),
        (["--models", "5"], "models 5: ncree_three_storey has no covariance to draw models from"),
        (["--faults", "a1=0"], "fault a1=0: no controller measures a1"),
        (["--controllers", "none.yaml"], "none.yaml"),
        (["--records", "nowhere"], "nowhere"),
        (["--scheduler", "tcp://127.0.0.1:1"], "Dask scheduler tcp://127.0.0.1:1: does not answer"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(change, expected, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = ["fragility", RIG, "--noise", "1", "--noise-duration", "2", "--intensities", "1", "--limits", "d1=0.01"]
    assert main([*given, *change]) == 2
    errors = capsys.readouterr().err
    assert expected in errors
    assert len(errors.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_models_are_drawn_from_the_covariance_in_the_model_file(tmp_path):
    a = np.array([[-0.2, 10.0], [-10.0, -0.2]])
    model = LinearModel(a, [[1.0, 0.0], [0.0, 1.0]], np.eye(2), np.zeros((2, 2)), ("w", "U"), ("x1", "a1"))
    path = tmp_path / "model.json"
    save_model(model, path, np.diag([1e-4] * 2 + [0.0] * 14))
    given = {"limits": {"x1": 1.0}, "intensities": [1.0], "noise": [1], "workers": 1}
    alone = abrace.fragility(path, folder=tmp_path / "alone", **given).loops()
    first, again = (abrace.fragility(path, models=4, folder=tmp_path / name, **given).loops() for name in "fg")
    peaks = first.sort_values("model").peak_x1.tolist()
    assert peaks[0] == alone.peak_x1.iloc[0], "the first is the model itself"
    assert len(set(peaks)) == 4
    assert again.sort_values("model").peak_x1.tolist() == peaks
