# SPDX-License-Identifier: Apache-2.0
"""The offline nodes as processes: from bags to a model, a controller, a comparison; and what wrong input gives."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_of_run import write_bag
from forked import run_node
from scipy import signal

from abrace import simulate
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import load_controller
from abrace_core.model.linear_model import LinearModel, load_model, pole_table, save_model
from abrace_core.model.noise import banded_noise
from abrace_core.model.table_signals import table_noise
from abrace_plant.rig.file import load_rig

SECONDS = 80.0


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    """Tests of the paper's rig; one lacks 25 samples, of one a2 is at the end of its range in 14 samples."""
    folder, samples = tmp_path_factory.mktemp("bags"), round(SECONDS * 500)
    shaken = simulate("ncree_three_storey", table_noise(samples, 500.0, (0.1, 10.0), 0.25, 1), seed=3)
    pushed = banded_noise(samples, 500.0, (0.0, 30.0), 1800.0, 2)
    check = simulate("ncree_three_storey", table_noise(5000, 500.0, (0.1, 10.0), 0.2, 5), seed=3)
    left, clipped = np.delete(np.arange(samples), slice(6000, 6025)), np.zeros(5000, dtype=np.uint64)
    clipped[700:714] = 1 << 5
    names = ("sequence", "outputs", "ground_acceleration", "command", "clipped")
    runs = {
        "table": shaken,
        "command": simulate("ncree_three_storey", command=pushed[:, None], seed=3),
        "gap": replace(shaken, **{name: getattr(shaken, name)[left] for name in names}),
        "check": replace(check, clipped=clipped),
    }
    for name, run in runs.items():
        write_bag(run, folder / name)
    return {name: folder / name for name in runs}


def test_bags_become_a_model_the_model_a_controller_and_both_are_compared(bags, tmp_path):
    model, controller, comparison = tmp_path / "model", tmp_path / "lqg3.yaml", tmp_path / "comparison"

    ended = run_node("abrace_sysid", "identify", table=bags["table"], command=bags["command"], output=model)
    assert ended.returncode == 0, ended.stderr
    assert "100% identified" in ended.stdout
    assert load_model(model / "model.json").order == 14
    assert load_model(model / "superposed.json").order == 24
    assert load_model(model / "reduced.json").order == 8
    for name in ("figure_3_force.svg", "figure_4_table.svg", "figure_5_command.svg", "model.mat", "reduced.mat"):
        assert (model / name).stat().st_size > 1000
    judged = json.loads((model / "validity.json").read_text())
    assert judged["verdict"] == "trust", ended.stdout
    assert "validity: trust" in ended.stdout
    assert (model / "validity.svg").stat().st_size > 10_000
    found = json.loads((model / "poles.json").read_text())
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    own = pole_table(rig.model.poles)
    for test, count in (("table", 3), ("command", 6)):
        assert len(found[test]) == count
        for pole, (frequency, damping_ratio) in zip(found[test], own, strict=False):
            assert pole["frequency"] == pytest.approx(frequency, rel=2e-3)
            assert pole["damping_ratio"] == pytest.approx(damping_ratio, rel=0.10)

    ended = run_node(
        "abrace_lqg",
        "design",
        model=model / "reduced.json",
        check_models=f"[{model / 'model.json'}, {model / 'superposed.json'}]",
        output=controller,
    )
    assert ended.returncode == 0, ended.stderr
    assert "gain margin" in ended.stdout

    refused = tmp_path / "refused.yaml"
    ended = run_node("abrace_lqg", "design", model=model / "reduced.json", disk_margin=0.5, output=refused)
    assert ended.returncode == 2
    assert "design refused: disk margin 0.3" in ended.stderr
    assert "with reduced, expected at least 0.5 (accept: [small_disk_margin]" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert not list(tmp_path.glob("refused*"))

    written = load_controller(controller)
    assert written.force_limit.tolist() == rig.capacity.tolist(), "from the bags' facts"
    law = written.law
    assert law.inputs == ("a1", "a2", "a3")
    assert law.sample_period == 0.002

    ended = run_node(
        "abrace_sysid",
        "validate",
        test=bags["check"],
        model=model / "model.json",
        other_models=f"[{model / 'superposed.json'}, {model / 'reduced.json'}]",
        output=comparison,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads((comparison / "comparison.json").read_text())
    assert found["clipped"] == {"measured": {"a2": 14}}
    assert f"{bags['check']}: a2: 14 samples at the end of its range" in ended.stderr
    assert set(found["other_models"]) == {"superposed", "reduced"}
    for prediction, least in ((found, 0.998), *((other, 0.98) for other in found["other_models"].values())):
        channels = prediction["simulated_vs_measured"]
        assert set(channels) == {"x1", "x2", "x3", "xf", "a1", "a2", "a3", "f"}
        assert min(channel["correlation"] for channel in channels.values()) > least
    assert found["peak_rms_error"] < 0.01
    ended = run_node("abrace_sysid", "validate", test=bags["gap"], model=model / "model.json", output=tmp_path / "no")
    assert ended.returncode == 2, "there the test has to be whole"
    assert "sample 5999 is followed by sample 6025" in ended.stderr
    assert all(
        row["noise_free_error"] <= row["normalised_rms_error"] for row in found["simulated_vs_measured"].values()
    )


def test_a_model_of_data_is_validated_with_a_file_of_its_columns(tmp_path):
    facts = {"data": "first.csv", "hold": "zero", "options": {"time": "time"}}
    bench = LinearModel([[-3.0]], [[3.0]], [[2e3]], [[0.0]], ("shaker",), ("acc 1",), provenance=facts)
    save_model(replace(bench, units={"shaker": "N", "acc 1": "mg"}), tmp_path / "model.json")
    time, force = 0.01 * np.arange(2000), np.random.default_rng(1).standard_normal(2000)
    state = signal.lfilter([0.0, 1 - np.exp(-0.03)], [1.0, -np.exp(-0.03)], force)  # held for 10 ms
    table, names = np.column_stack([time, force, 2.0 * state]), "time [s],shaker [N],acc 1 [g]"
    np.savetxt(tmp_path / "second.csv", table, delimiter=",", header=names, comments="")
    given = {"test": tmp_path / "second.csv", "model": tmp_path / "model.json", "output": tmp_path / "check"}
    ended = run_node("abrace_sysid", "validate", **given)
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "check/comparison.json").read_text())
    assert found["simulated_vs_measured"]["acc 1"]["normalised_rms_error"] < 5e-3
    expected = 2.0 * 9.80665 * np.std(state)
    assert found["measured"]["acc 1"]["rms"] == pytest.approx(expected, rel=1e-3)
    assert found["units"] == {"shaker": "N", "acc 1": "m/s^2"}
    assert (tmp_path / "check/figure_6_time_histories.svg").is_file()
    ended = run_node("abrace_sysid", "validate", **given, outputs="[laser]")
    assert ended.returncode == 2
    assert "second.csv: no column 'laser', it has time [s], shaker [N], acc 1 [g]" in ended.stderr
    ended = run_node("abrace_sysid", "validate", **given, uncontrolled=tmp_path)
    assert ended.returncode == 2


def test_modes_are_found_without_a_drive_and_a_building_that_is_the_same_has_not_changed(bags, tmp_path):
    ended = run_node("abrace_sysid", "ambient", test=bags["table"], before=bags["table"], output=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-2] == "no change beyond chance"
    found = json.loads((tmp_path / "ambient.json").read_text())
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    for frequency, _ in pole_table(rig.model.poles)[:3]:
        assert any(mode["frequency"] == pytest.approx(frequency, rel=0.01) for mode in found["modes"])
    assert found["change"]["changed"] is False
    assert {mode["probability"] for mode in found["change"]["modes"]} == {1.0}
    assert (tmp_path / "ambient_stabilization.svg").stat().st_size > 1000


def test_a_bag_that_was_cut_off_or_has_a_gap_is_used_as_far_as_it_goes_and_says_so(bags, tmp_path):
    cut = tmp_path / "cut"
    shutil.copytree(bags["table"], cut)
    (cut / "metadata.yaml").unlink()
    (recorded,) = cut.glob("*.mcap")
    with recorded.open("r+b") as file:
        file.truncate(int(0.9 * recorded.stat().st_size))
    ended = run_node("abrace_sysid", "ambient", test=f"[{bags['gap']}, {cut}]", output=tmp_path / "found")
    assert ended.returncode == 0, ended.stderr
    assert "cut" in ended.stderr
    assert "a gap after sample 5999 (25 samples, 0.05 s); samples 6025 to 39999 are used" in ended.stderr


def test_a_rig_is_characterized_with_the_papers_numbers_beside(tmp_path):
    ended = run_node("abrace_plant", "characterize", output=tmp_path / "rig")
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "rig/characteristics.json").read_text())
    assert found["zero_command"][0] == pytest.approx([7.363, 0.0138], rel=0.05)
    assert {row["paper"] for row in found["comparison"]} >= {6.673, 22.933, 37.966}
    assert "antiresonance 1" in ended.stdout
    assert (tmp_path / "rig/characteristics.svg").stat().st_size > 10_000
