# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: shipped values, the sample controller, any rig and controller, bags, and what is refused."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_of_run import write_bag

import abrace
from abrace.benchmark import trade_off as trade_off_module
from abrace.benchmark.comparison import Evaluation, uncontrolled_table, worst_table
from abrace.benchmark.criteria import Layout, Responses, peaks
from abrace.benchmark.definition import DATA, benchmark_names, load_definition
from abrace.benchmark.frame_benchmark import FrameBenchmark
from abrace.benchmark.laws import designed, margins_of, references
from abrace.benchmark.recorded import of_tests, recorded, recorded_case
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
def test_uncontrolled_values_of_the_3_storey_building_are_those_of_an_independent_rebuild():
    three = FrameBenchmark(load_definition("sac_la_3"))
    found = peaks(three.without_control(three.definition.cases[3], three.newmark), three.layout)
    rebuilt = {"d_max": 1.74573e-2, "xdd_max": 7.93566, "F_max": 1.36650e7, "d_max_norm": 3.53923e-3}
    rebuilt |= {"xdd_max_norm": 1.50139, "F_max_norm": 2.79448e6, "x_max": 0.180445, "xd_max": 1.07596}
    assert {name: found[name] for name in rebuilt} == pytest.approx(rebuilt, rel=1e-5)


@needs_records
def test_no_member_of_the_9_storey_building_yields_in_its_cases_and_both_controllers_reduce_all():
    nine = FrameBenchmark(load_definition("sac_la_9"))
    assert all(0.7 < nine.uncontrolled(case)["phi_max"] < 1 for case in nine.definition.cases)
    for name, law in references(nine).items():
        worst = Evaluation.of(name, nine.evaluate(law), nine.layout).worst()
        assert all(worst[f"J{i}"] < 0.9 for i in (1, 2, 3, 4, 5, 6, 7, 10)), (name, worst)
        assert margins_of(nine, law)["gain_margin_db"] > 6, name


@needs_records
def test_the_sample_controller_reaches_what_an_independent_rebuild_found(twenty):
    found = twenty.evaluate(references(twenty)["sample"], twenty.definition.cases[:1])
    ((values, _),) = found.values()
    row_g = {"J1": 0.7298, "J2": 0.5313, "J3": 0.7332, "J4": 0.6489, "J5": 0.5001, "J6": 0.7066, "J7": 0.7370}
    row_g |= {"J10": 0.7293, "J11": 0.001848, "J12": 0.06858, "J13": 0.001133, "J14": 5.427e-5}
    row_g |= {"J15": 25, "J16": 5, "J17": 20}
    assert values == pytest.approx(row_g, rel=0.01)


@needs_records
def test_our_controller_is_no_worse_than_the_sample_at_no_more_force_and_has_margins(twenty):
    laws = references(twenty)
    sample, own = (Evaluation.of(name, twenty.evaluate(law), twenty.layout).worst() for name, law in laws.items())
    for name in ("J1", "J2", "J3", "J4", "J5", "J6", "J11"):
        assert own[name] <= sample[name], name
    margins = margins_of(twenty, laws["abrace"])
    assert margins["gain_margin_db"] >= 6.0
    assert margins["disk_margin"] >= 0.3


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
    measured, _ = of_tests(benchmark, controlled, free, law.law)
    assert list(measured) == list(predicted)
    for name, value in measured.items():
        assert value == pytest.approx(predicted[name], rel=0.05), name
    assert not {"J16", "J17"} & set(of_tests(benchmark, controlled, free)[0]), "the law is not known"
    shifted = replace(controlled, braces=(2,), forces=controlled.outputs[:, -1:] + [[2000.0, -2000.0]])
    assert of_tests(benchmark, shifted, free)[0]["J11"] > measured["J11"] + 1000 / benchmark.layout.weight
    with pytest.raises(AbraceError, match="braces in its groups 1, expected those of small: 2"):
        recorded(benchmark, replace(controlled, braces=(1,), forces=controlled.outputs[:, -1:]))
    with pytest.raises(AbraceError, match="5 floors and 2 brace groups, expected those of small: 3 and 1"):
        recorded(benchmark, abrace.simulate("five_storey", "el_centro", duration=1.0))


def test_curvatures_of_a_frame_come_from_the_displacements_of_a_recorded_test():
    benchmark = open_benchmark("sac_la_20", ["el_centro"])
    law = references(benchmark)["abrace"]
    how = {"peak_acceleration": 1.5, "duration": 20.0}
    free, controlled = (abrace.simulate("sac_la_20", "el_centro", controller=one, **how) for one in (None, law))
    measured, _ = of_tests(benchmark, controlled, free)
    ((exact, _),) = benchmark.evaluate(law, [recorded_case(benchmark, controlled, "shaken")]).values()
    for name in ("J7", "J10"):
        assert measured[name] == pytest.approx(exact[name], rel=0.02), name
    with pytest.raises(AbraceError, match=r"sampled every 0\.002 s, expected the 0\.01 s of sac_la_20"):
        recorded_case(benchmark, replace(controlled, sample_period=0.002), "shaken")


def test_a_bag_stands_beside_the_controllers_under_the_motion_of_its_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = small(tmp_path)
    law = references(open_benchmark(str(path)))["lqg3"]
    save_controller(law, Path("mine.yaml"))
    how = {"peak_acceleration": 1.2, "duration": 4.0}
    for name, one in (("free", None), ("controlled", law)):
        run = abrace.simulate("ncree_three_storey", "el_centro", controller=one, **how)
        write_bag(replace(run, facts={"controller": "mine" if one else ""}), name)
    bags = ["--bag", "controlled", "--uncontrolled", "free"]
    assert main(["benchmark", str(path), *bags, "--controller", "mine.yaml"]) == 0
    assert "wrote results/benchmark/small/report.html" in capsys.readouterr().out
    content = json.loads(Path("results/benchmark/small/criteria.json").read_text())
    assert list(content) == ["recorded", "mine", "lqg1", "lqg3"]
    assert {tuple(one["cases"]) for one in content.values()} == {("controlled",)}
    reached, predicted = (content[name]["cases"]["controlled"] for name in ("recorded", "mine"))
    assert list(reached) == list(predicted)
    for name, value in reached.items():
        assert value == pytest.approx(predicted[name], rel=0.05), name
    assert Path("results/benchmark/small/profile_1.png").is_file()
    assert main(["benchmark", str(path), *bags]) == 0
    content = json.loads(Path("results/benchmark/small/criteria.json").read_text())
    assert "J17" not in content["recorded"]["cases"]["controlled"], "the controller's file was not given"
    assert main(["benchmark", str(path), *bags, "--controller", "a/b"]) == 2
    assert "--controller a/b: a node, given with --bag, expected controller files" in capsys.readouterr().err


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


def test_the_table_of_lqg1_to_lqg5_in_the_documentation_is_what_the_benchmark_gives():
    benchmark = open_benchmark("ncree_three_storey")
    found = [
        Evaluation.of(name, benchmark.evaluate(law), benchmark.layout, margins_of(benchmark, law))
        for name, law in references(benchmark).items()
    ]
    table = worst_table("", found)
    page = (Path(__file__).parents[2] / "docs/benchmarks.md").read_text(encoding="utf-8")
    written = page.partition("| " + " | ".join(table.header) + " |\n")[2].splitlines()[1:]
    assert len(table.rows) == 16
    for line, (label, *values) in zip(written, table.rows, strict=False):
        shown, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        assert shown == label
        assert [float(cell) for cell in cells] == pytest.approx([float(value) for value in values], rel=0.005), label


def test_the_page_says_what_criteria_are_divided_by_and_where_members_would_yield():
    values = dict.fromkeys(("d_max", "xd_max", "phi_max"), 1.5)
    table = uncontrolled_table({"one": values | {"phi_max": 0.9}, "two": values})
    assert table.header == ("criteria are divided by", "one", "two")
    assert ("greatest curvature over yield", "0.9", "1.5") in table.rows
    assert "would yield" in table.notes[0]
    assert not uncontrolled_table({"one": values | {"phi_max": 0.9}}).notes


def test_a_loop_that_is_not_stable_differs_from_one_whose_margins_are_not_known():
    case = {"one": ({"J1": 0.5}, Responses(1.0, *[np.zeros((2, 1))] * 4))}
    layout = Layout(np.ones(1), np.ones(1), (1,), (1,), (1.0,))
    margins = {"gain_margin_db": 9.0, "phase_margin_deg": 60.0, "disk_margin": 0.4}
    given = {"known": margins, "unstable": {}, "node": None}
    table = worst_table("", [Evaluation.of(name, case, layout, each) for name, each in given.items()])
    assert table.rows[-1] == ("disk margin", "0.4", "not stable", "-")
    assert len(worst_table("", [Evaluation.of("node", case, layout)]).rows) == 1


def record(path: Path, peak: float) -> Path:
    """A record of four seconds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    time = np.arange(0, 4.0, 0.02)
    np.savetxt(path, np.column_stack([time, peak * np.sin(9 * time)]), "%.6g", ",", header="t,a [m/s^2]", comments="")
    return path


@pytest.mark.parametrize("name", ["ncree_three_storey", "sac_la_3"])
def test_records_of_one_name_are_refused_as_their_results_would_be_mixed(name, tmp_path):
    one, other = (str(record(tmp_path / folder / "ns.csv", 1.0)) for folder in ("kobe", "chichi"))
    with pytest.raises(AbraceError, match=f"records {one} and {other}: both cases are named ns "):
        open_benchmark(name, [one, other])
    assert len(open_benchmark(name, [one, "el_centro"]).definition.cases) == 2


def test_controllers_named_like_others_are_told_apart(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = small(tmp_path)
    laws = references(open_benchmark(str(path)))
    files = ["lqg3.yaml", "a/mine.yaml", "b/mine.yaml"]
    for file, law in zip(files, ("lqg1", "lqg1", "lqg3"), strict=True):
        Path(file).parent.mkdir(exist_ok=True)
        save_controller(laws[law], Path(file))
    given = [argument for file in files for argument in ("--controller", file)]
    assert main(["benchmark", str(path), *given]) == 0
    content = json.loads((tmp_path / "results/benchmark/small/criteria.json").read_text())
    assert list(content) == ["lqg3 (lqg3.yaml)", "mine (a/mine.yaml)", "mine (b/mine.yaml)", "lqg1", "lqg3"]
    assert content["lqg3 (lqg3.yaml)"]["cases"] == content["lqg1"]["cases"]
    assert content["mine (b/mine.yaml)"]["cases"] == content["lqg3"]["cases"]
    capsys.readouterr()
    assert main(["benchmark", str(path), "--controller", "lqg3.yaml", "--controller", "lqg3.yaml"]) == 2
    assert "--controller: lqg3 (lqg3.yaml) twice, expected each controller once" in capsys.readouterr().err


def test_the_trade_off_takes_the_reference_and_not_a_file_named_like_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trade_off_module, "FACTORS", np.array([1.0]))
    drawn = []
    draw = trade_off_module.trade_off_figure
    monkeypatch.setattr(
        trade_off_module, "trade_off_figure", lambda *given: drawn.append((given[2], draw(*given))) or drawn[-1][1]
    )
    path = str(record(tmp_path / "short.csv", 1.0))
    benchmark = open_benchmark("sac_la_3", [path])
    save_controller(designed(benchmark, "sac_la_3"), tmp_path / "sample.yaml")
    assert main(["benchmark", "sac_la_3", "--record", path, "--controller", "sample.yaml", "--trade-off"]) == 0
    ((sample, _),) = drawn
    content = json.loads((tmp_path / "results/benchmark/sac_la_3/criteria.json").read_text())
    assert list(content) == ["sample (sample.yaml)", "sample", "abrace"]
    assert sample.cases == content["sample"]["cases"] != content["sample (sample.yaml)"]["cases"]


def test_the_trade_off_leaves_out_loops_without_margins_as_they_are_not_stable(tmp_path, monkeypatch):
    monkeypatch.setattr(trade_off_module, "FACTORS", np.array([4.0, 1.0]))
    benchmark = open_benchmark("sac_la_3", [str(record(tmp_path / "short.csv", 1.0))])
    tried = trade_off_module.trade_off(benchmark)
    assert [one.name for one in tried] == ["commands x 4", "commands x 1"]
    margins = tried[0].margins
    unstable = replace(tried[1], margins={})
    figure = trade_off_module.trade_off_figure(benchmark, tried, unstable)
    crosses = [[line for line in axis.lines if line.get_marker() == "x"] for axis in figure.axes]
    assert [len(each) for each in crosses] == [6, 0, 0], "expected crosses of J1 to J6 alone"
    monkeypatch.setattr(trade_off_module, "margins_of", lambda _, law: {} if law is laws[0] else margins)
    laws = []
    monkeypatch.setattr(trade_off_module, "designed", lambda *given: laws.append(designed(*given)) or laws[-1])
    assert [one.name for one in trade_off_module.trade_off(benchmark)] == ["commands x 1"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 4.5}, "number of samples 2000 and 2250"),
        ({"peak_acceleration": 0.7}, r"peak table acceleration \[m/s\^2\] 0.98\d* and 0.70"),
        ({"record": "noise"}, r"rms table acceleration \[m/s\^2\]"),
        ({"sample_period": 0.00201}, r"sample period \[s\] 0.002 and 0.00201"),
    ],
)
def test_recorded_tests_of_different_motions_are_refused(change, message, tmp_path):
    benchmark = open_benchmark(str(small(tmp_path)))
    how = {"peak_acceleration": 0.980665, "duration": 4.0}
    one = replace(abrace.simulate("ncree_three_storey", "el_centro", **how), source="one")
    if "sample_period" in change or "record" in change:
        ground = 0.98 * np.sign(one.ground_acceleration) if "record" in change else one.ground_acceleration
        other = replace(one, sample_period=change.get("sample_period", 0.002), ground_acceleration=ground)
    else:
        other = abrace.simulate("ncree_three_storey", "el_centro", **how | change)
    other = replace(other, source="other")
    with pytest.raises(
        AbraceError, match=f"one and other: {message}.*expected tests with the same motion of the table"
    ):
        of_tests(benchmark, one, other)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sac_la_21"], "sac_la_9) or a rig (five_storey"),
        (["sac_la_3", "--record", "still.csv"], "without control is 0, expected a ground that moves"),
        (["ncree_three_storey", "--controller", "none/here"], "--controller none/here: no package 'none'"),
        (["ncree_three_storey", "--controller", "none.py"], "--controller none.py: no such file"),
        (["outside.yaml"], "outside.yaml: name: '../small', expected up to 64 letters"),
        (["without_cases.yaml"], "benchmark file without_cases.yaml: duration: key is missing; cases: key is missing"),
        (["sac_la_3", "--record", "none.csv"], f"none.csv: not shipped, expected {DATA}"),
        (["ncree_three_storey", "--bag", "b"], "--bag and --uncontrolled, expected both or neither"),
        (["ncree_three_storey", "--noise", "1"], "--noise: given with a rig"),
        (["sac_la_20", "--bag", "b", "--uncontrolled", "c", "--trade-off"], "--trade-off: given with --bag, expected"),
        (["ncree_three_storey", "--trade-off"], "--trade-off: given with a rig, expected a benchmark of a frame"),
        (["sac_la_3", "--noise", "-1"], "--noise: -1, expected a seed from 0 on"),
        (
            ["sac_la_3", "--record", "el_centro", "--controller", "a/b"],
            "expected a benchmark of a rig, or of a frame with",
        ),
        (["sac_la_20", "--bag", "b", "--uncontrolled", "c", "--record", "el_centro"], "--record: given with --bag"),
        (["ncree_three_storey", "--controller", "none.yaml"], "none.yaml"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(DATA, raising=False)
    Path("outside.yaml").write_text(small(tmp_path).read_text().replace("name: small", "name: ../small"))
    Path("without_cases.yaml").write_text("name: x\nrig: ncree_three_storey\n")
    record(Path("still.csv"), 0.0)
    assert main(["benchmark", *arguments]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_every_benchmark_can_be_opened():
    assert {"sac_la_3", "sac_la_9", "sac_la_20", "ncree_three_storey"} <= set(benchmark_names())
    for name in benchmark_names():
        assert open_benchmark(name).definition.name == name
