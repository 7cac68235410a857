# SPDX-License-Identifier: Apache-2.0
"""`abrace fragility` and `abrace.fragility`: from a rig's name to curves, and what is wrong in one line."""

from __future__ import annotations

import subprocess
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rehearsal import Cause, controller, rehearse

import abrace
from abrace.cli import main
from abrace.interactive.exploration import Explored
from abrace.interactive.fragility import ground_motions, interlocks_of
from abrace_core.controller_file import Controller, save_controller
from abrace_core.installed import find_file
from abrace_core.linear_model import LinearModel, save_model
from abrace_lqg.exploration.ensemble import noise_motion
from abrace_lqg.exploration.study import Outcome, Study, evaluate
from abrace_lqg.weights import load_weights

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


def test_from_a_rig_to_curves_and_again_without_computing(damper, tmp_path):
    folder = tmp_path / "found"
    given = ["fragility", RIG, "--controller", str(damper), "--record", "el_centro", "--noise", "1"]
    given += ["--noise-duration", "4", "--intensity", "0.25", "1", "4", "--limit", "d1=0.01", "--fault", "a1=0"]
    given += ["--rig", RIG, "--workers", "1", "--output", str(folder)]
    ran = subprocess.run(["abrace", *given], capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stderr
    assert not ran.stderr
    assert "fragility: done in" in ran.stdout
    assert "damper, a1=0: d1 above 0.01 m: median" in ran.stdout
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
        rig=RIG,
        folder=folder,
        scheduler="nobody",
    )
    assert part.stat().st_mtime_ns == written, "what is done should not have been computed again"
    assert repr(again) == f"<Fragility: 18 loops, d1, in {folder}>"
    loops = again.loops()
    mine = loops[(loops.controller == "damper") & (loops.motion == "el_centro") & (loops.fault == "none")]
    for _, row in mine[mine.interlock == "none"].iterrows():
        model = abrace.load_rig(RIG).model
        run = abrace.simulate(model, "el_centro", controller=damper, peak_acceleration=row.intensity)
        assert row.peak_x3 == pytest.approx(np.abs(run.channels(["x3"])).max(), rel=1e-9)
        assert row.peak_U == pytest.approx(np.abs(run.command).max(), rel=1e-9)
    assert len(mine[mine.interlock == "none"]) > 1


def test_sets_of_weights_are_explored_on_a_rig(tmp_path):
    given = {"sets": 3, "noise": [1], "noise_duration": 4.0, "rig": RIG, "folder": tmp_path / "found"}
    with pytest.raises(abrace.AbraceError, match="does not answer"):
        abrace.explore(RIG, "lqg3", scheduler="tcp://127.0.0.1:1", **given)
    with pytest.raises(abrace.AbraceError, match="no records"):
        abrace.explore(RIG, "lqg3", **given | {"noise": []})
    with pytest.raises(abrace.AbraceError, match="models 5: ncree_three_storey has no covariance"):
        abrace.explore(RIG, "lqg3", models=5, **given)
    outcome = evaluated(RIG)
    found = Explored((outcome,), 0.9)
    assert repr(found) == "<Explored: 1 sets of weights, 0 without a controller>"
    assert found.to_pandas().loc[0, "command [N]"] == outcome.command.rms
    assert found.to_pandas().loc[0, "rank"] == 1
    assert found.plot().axes
    assert found.plot("robust").axes
    with pytest.raises(abrace.AbraceError, match="figure 'x' of an exploration: expected trade_off or robust"):
        found.plot("x")


def test_interlocks_of_the_rig_act_in_an_exploration(monkeypatch):
    from abrace.interactive import exploration as interactive

    seen = []
    monkeypatch.setattr(interactive, "run_exploration", lambda study, *_, **__: seen.append(study) or [])
    abrace.explore(RIG, noise=[1], noise_duration=4.0, peak_acceleration=[1.0, 3.0], faults={"a1": -1.0}, rig=RIG)
    (study,) = seen
    assert study.count == 2 * 2
    outcome = evaluate(study, 0, load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights")))
    assert 0 < outcome.interlocked < 4, "a reversed accelerometer should have been found implausible"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (["--limit", "d1"], "--limit d1: expected NAME=NUMBER, such as a1=0"),
        (["--limit", "q1=3"], "limits q1=3: expected a value above 0 for some of x1"),
        (["--limit", "d1=inf"], "--limit d1=inf: expected NAME=NUMBER"),
        (["--limit", "d1=0.01", "d1=0.02"], "--limit: 2 of d1, expected one of each quantity"),
        (["--fault", "a1=nan"], "--fault a1=nan: expected NAME=NUMBER"),
        (["--fault", "a1=0", "a1=0"], "fault a1=0: given twice, expected each once"),
        (["--noise-duration", "nan"], "noise_duration nan: expected seconds above 0"),
        (["--workers", "0"], "--workers: 0, expected 1 or more"),
        (["--intensity", "2", "1"], "intensities [2.0, 1.0], expected numbers above 0 that rise"),
        (["--models", "5"], "models 5: ncree_three_storey has no covariance to draw models from"),
        (["--fault", "a1=0"], "fault a1=0: no controller measures a1"),
        (["--controller", "none.yaml"], "none.yaml"),
        (["--record", "nowhere"], "nowhere"),
        (["--scheduler", "tcp://127.0.0.1:1"], "Dask scheduler tcp://127.0.0.1:1: does not answer"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(change, expected, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = ["fragility", RIG, "--noise", "1", "--noise-duration", "2", "--intensity", "1", "--limit", "d1=0.01"]
    assert main([*given, *change]) == 2
    errors = capsys.readouterr().err
    assert expected in errors
    assert len(errors.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_interlocks_of_quantities_that_the_model_lacks_are_left_out_with_a_warning(damper, tmp_path):
    given = {
        "limits": {"x1": 0.01},
        "intensities": [1.0],
        "noise": [1],
        "noise_duration": 2.0,
        "rig": RIG,
        "workers": 1,
    }
    whole = abrace.load_rig(RIG).model
    second_left_out = whole.select([name for name in whole.outputs if name != "x2"])
    with pytest.warns(UserWarning, match="no interlocks of d2, d3, x2, which the model does not have") as seen:
        found = abrace.fragility(second_left_out, [damper], folder=tmp_path / "left_out", **given)
    assert [warning.filename for warning in seen] == [__file__]
    assert len(found.loops()) == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        abrace.fragility(whole, [damper], folder=tmp_path / "whole", **given)


def test_the_interlock_of_a_weaker_actuator_s_force_is_smaller_by_its_capacity():
    """50 and 100 kN; the rig file's 108 kN are those of the stronger one."""
    rig = abrace.load_rig("five_storey")
    acting = interlocks_of(rig.model, rig, PERIOD).interlocks
    assert {each.quantity: each.value for each in acting if each.quantity[0] == "f"} == {"f1": 54e3, "f2": 108e3}


@pytest.mark.parametrize(("factor", "fault"), [(-1.0, None), (0.0, "a1=zero")])
def test_the_interlock_that_finds_a_failing_sensor_is_that_of_the_rig_itself(factor, fault, tmp_path):
    rig = abrace.load_rig(RIG)
    law = controller(rig, load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights")))
    ((_, ground),) = ground_motions([], [1], 8.0, PERIOD)
    ground *= 1.0 / np.abs(ground).max()
    tamper = None if fault else lambda reading: reading.__setitem__(4, factor * reading[4])
    lived = rehearse(rig, ground, law=law, cause=Cause(fault=fault or "", tamper=tamper))
    given = {"noise": [1], "noise_duration": 8.0, "intensities": [1.0], "limits": {"d1": 0.01}}
    found = abrace.fragility(RIG, [law], faults={"a1": factor}, rig=rig, folder=tmp_path, workers=1, **given)
    loops = found.loops().set_index("fault")
    assert loops.loc["none", "interlock"].tolist() == ["none", "none"]
    row = loops.loc[f"a1={factor:g}"]
    assert row.interlock == (lived.trip.name if lived.trip.interlock != "stuck" else "stuck")
    assert row.trip_time == pytest.approx(lived.time, abs=0.02)


def test_models_are_drawn_from_the_covariance_in_the_model_file(tmp_path, monkeypatch):
    from abrace.interactive import fragility as interactive

    a = np.array([[-0.2, 10.0], [-10.0, -0.2]])
    model = LinearModel(a, [[1.0, 0.0], [0.0, 1.0]], np.eye(2), np.zeros((2, 2)), ("w", "U"), ("x1", "a1"))
    covariance = np.diag([1e-4] * 2 + [0.0] * 14)
    path = tmp_path / "model.json"
    save_model(model, path, covariance)
    seen = []
    monkeypatch.setattr(interactive, "run_study", lambda study, *_, **__: seen.append(study))
    for _ in range(2):
        abrace.fragility(path, limits={"x1": 1.0}, intensities=[1.0], noise=[1], models=4, folder=tmp_path / "f")
    first, second = seen
    assert len(first.models) == 4
    assert np.array_equal(first.models[0].a, a)
    assert len({float(each.a[0, 1]) for each in first.models}) == 4
    assert all(np.array_equal(one.a, other.a) for one, other in zip(first.models, second.models, strict=True))
