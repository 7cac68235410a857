# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: shipped values, the sample controller, any rig and controller, bags, and what is refused."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

import abrace
from abrace.benchmark.criteria import peaks
from abrace.benchmark.definition import DATA, benchmark_names, load_definition
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.laws import designed, references
from abrace.benchmark.recorded import of_tests, recorded
from abrace.benchmark.sampled_loop import Converter, run_loops
from abrace.benchmark_command import open_benchmark
from abrace.cli import main
from abrace_core.controller_file import save_controller
from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_model
from abrace_core.simulation import simulate_closed_loop

needs_records = pytest.mark.skipif(
    not os.environ.get(DATA), reason=f"the benchmark's records are not shipped: {DATA} names no folder"
)


@pytest.fixture(scope="module")
def twenty() -> FrameBenchmark:
    return FrameBenchmark(load_definition("sac_la_20"))


@needs_records
def test_uncontrolled_values_of_the_20_storey_building_are_the_shipped_ones(twenty):
    case = twenty.definition.cases[3]
    found = peaks(twenty.without_control(case, twenty.newmark), twenty.layout)
    assert found == pytest.approx(case.uncontrolled, rel=1e-4)


@needs_records
def test_the_sample_controller_reaches_what_an_independent_rebuild_found(twenty):
    found = twenty.evaluate(references(twenty)["sample"], twenty.definition.cases[:1])
    ((values, _),) = found.values()
    row_g = {"J1": 0.7298, "J2": 0.5313, "J3": 0.7332, "J4": 0.6489, "J5": 0.5001, "J6": 0.7066, "J7": 0.7370}
    row_g |= {"J10": 0.7293, "J11": 0.001848, "J12": 0.06858, "J13": 0.001133, "J14": 5.427e-5}
    row_g |= {"J15": 25, "J16": 5, "J17": 20}
    assert values == pytest.approx(row_g, rel=0.01)


def test_frames_take_any_record_with_uncontrolled_values_of_their_own():
    benchmark = open_benchmark("sac_la_3", ["el_centro"])
    (case,) = benchmark.definition.cases
    law = designed(benchmark, "sac_la_3")
    ((values, responses),) = benchmark.evaluate(law).values()
    assert all(0.2 < values[f"J{i}"] < 1 for i in range(1, 7)), values
    assert len(responses.displacement) == 10001
    quiet, noisy = values, open_benchmark("sac_la_3", ["el_centro"], noise_seed=1).evaluate(law)[case.name][0]
    assert 0 < abs(noisy["J5"] / quiet["J5"] - 1) < 0.2


def test_a_loop_without_converters_is_the_linear_one_and_converters_round_and_clip():
    benchmark = open_benchmark("sac_la_3", ["el_centro"])
    (case,) = benchmark.definition.cases
    law = designed(benchmark, "sac_la_3")
    ground = benchmark.ground(case)[:800] / 20  # no command is cut
    plant = benchmark.plant.select([f"a{i}" for i in (1, 2, 3)])
    exact = Converter(1.0, 0)
    states, inputs = run_loops(plant, law, np.column_stack([ground, 2 * ground]), exact, exact)
    outputs, _ = simulate_closed_loop(plant, law.law, ground, law.force_limit, law.correction)
    assert states[0] @ plant.c.T + inputs[0] @ plant.d.T == pytest.approx(outputs, abs=1e-9)
    assert states[1] == pytest.approx(2 * states[0], abs=1e-9)
    converter = Converter(10.0, 16)
    assert converter.convert(np.array([1.0, 3e-4, 11.0, -11.0])) == pytest.approx(
        [1.0, 20 / 2**16, 10, -10], abs=1.6e-4
    )


def small(tmp_path: Path) -> Path:
    """The paper's rig with two controllers, four seconds of one record."""
    content = {"name": "small", "rig": "ncree_three_storey", "duration": 4.0, "weights": ["lqg1", "lqg3"]}
    content["cases"] = [{"record": "el_centro", "peak_acceleration": 0.980665}]
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_a_recorded_test_gets_the_criteria_that_the_model_predicts(tmp_path):
    benchmark = open_benchmark(str(small(tmp_path)))
    law = references(benchmark)["lqg3"]
    ((predicted, _),) = benchmark.evaluate(law).values()
    how = {"peak_acceleration": 0.980665, "duration": 4.0}
    free, controlled = (
        abrace.simulate("ncree_three_storey", "el_centro", controller=one, **how) for one in (None, law)
    )
    measured, _ = of_tests(benchmark, controlled, free)
    for name in ("J1", "J2", "J3", "J4", "J5", "J6", "J11", "J12", "J13", "J14", "J15"):
        assert measured[name] == pytest.approx(predicted[name], rel=0.05), name
    with pytest.raises(AbraceError, match="5 floors and 2 brace groups, expected those of small: 3 and 1"):
        recorded(benchmark, abrace.simulate("five_storey", "el_centro", duration=1.0))


def test_the_command_writes_tables_figures_and_a_page_and_exports(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = small(tmp_path)
    benchmark = open_benchmark(str(path))
    mine = references(benchmark)["lqg1"]
    save_controller(mine, tmp_path / "mine.yaml")
    assert main(["benchmark", str(path), "--controller", "mine.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "lqg3" in printed
    assert "J14 mean power of all devices" in printed
    folder = tmp_path / "results/benchmark/small"
    written = {file.name for file in folder.iterdir()}
    assert {"criteria.json", "criteria.png", "profile_1.png", "report.html", "report.md"} <= written
    content = json.loads((folder / "criteria.json").read_text())
    assert content["mine"]["cases"] == content["lqg1"]["cases"]
    assert content["lqg3"]["margins"]["gain_margin_db"] > 6
    assert main(["benchmark", str(path), "--export", "shared"]) == 0
    model = load_model(tmp_path / "shared/model.json")
    assert model.outputs[-3:] == ("v1", "v2", "v3")
    told = json.loads((tmp_path / "shared/benchmark.json").read_text())
    assert set(told["cases"][0]["uncontrolled"]) >= {"d_max", "F_max_norm", "xd_max"}
    exported = {file.name for file in (tmp_path / "shared").iterdir()}
    assert {"lqg1.yaml", "lqg1.mat", "ground_1.csv", "model.mat", "discrete.mat"} <= exported


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sac_la_21"], "unknown, expected"),
        (["sac_la_3", "--record", "none.csv"], f"none.csv: not shipped, expected {DATA}"),
        (["ncree_three_storey", "--bag", "b"], "--bag and --uncontrolled, expected both or neither"),
        (["ncree_three_storey", "--noise", "1"], "--noise: given with a rig"),
        (["sac_la_3", "--noise", "-1"], "--noise: -1, expected a seed from 0 on"),
        (["sac_la_3", "--record", "el_centro", "--controller", "a/b"], "a node, expected a benchmark of a rig"),
        (["ncree_three_storey", "--controller", "none.yaml"], "none.yaml"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(DATA, raising=False)
    assert main(["benchmark", *arguments]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_every_benchmark_can_be_opened():
    assert {"sac_la_3", "sac_la_20", "ncree_three_storey"} <= set(benchmark_names())
    for name in benchmark_names():
        assert open_benchmark(name).definition.name == name
