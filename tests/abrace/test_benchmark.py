# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: shipped values, the sample controller, any rig and controller, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from abrace.benchmark_tables import uncontrolled_table, worst_table
from abrace.cli import main
from abrace_core import AbraceError
from abrace_core.model.controller_file import save_controller
from abrace_core.model.simulation import simulate_closed_loop
from abrace_studies.benchmark.comparison import Evaluation
from abrace_studies.benchmark.definition import DATA, benchmark_names
from abrace_studies.benchmark.laws import designed, margins_of, references
from abrace_studies.benchmark.opening import open_benchmark
from abrace_studies.benchmark.sampled_loop import Converter, run_loops


def test_frames_take_any_record_with_uncontrolled_values_of_their_own():
    benchmark = open_benchmark("sac_la_3", ["el_centro"])
    law = designed(benchmark, "sac_la_3")
    (values,) = benchmark.evaluate(law).values()
    assert all(0.2 < values[f"J{i}"] < 1 for i in range(1, 7)), values


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


def test_the_command_writes_tables_figures_and_a_page(tmp_path, monkeypatch, capsys):
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
    assert {"criteria.json", "report.html"} <= written
    content = json.loads((folder / "criteria.json").read_text())
    assert content["mine"]["cases"] == content["lqg1"]["cases"]
    assert content["lqg3"]["margins"]["gain_margin_db"] > 6


def test_the_table_of_lqg1_to_lqg5_in_the_documentation_is_what_the_benchmark_gives():
    benchmark = open_benchmark("ncree_three_storey")
    found = [
        Evaluation(name, benchmark.evaluate(law), margins_of(benchmark, law))
        for name, law in references(benchmark).items()
    ]
    table = worst_table("", found)
    page = (Path(__file__).parents[2] / "docs/compare.md").read_text(encoding="utf-8")
    written = page.partition("| " + " | ".join(table.header) + " |\n")[2].splitlines()[1:]
    found_in = {label: values for label, *values in table.rows}
    shown = written[: written.index("")]
    assert len(shown) > 5
    for line in shown:
        label, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        values = found_in[label]
        assert [float(cell) for cell in cells] == pytest.approx([float(value) for value in values], rel=0.005), label


def test_the_page_says_what_criteria_are_divided_by_and_where_members_would_yield():
    values = dict.fromkeys(("d_max", "xd_max", "phi_max"), 1.5)
    table = uncontrolled_table({"one": values | {"phi_max": 0.9}, "two": values})
    assert table.header == ("criteria are divided by", "one", "two")
    assert ("greatest curvature over yield", "0.9", "1.5") in table.rows
    assert "would yield" in table.notes[0]
    assert not uncontrolled_table({"one": values | {"phi_max": 0.9}}).notes


def test_a_loop_without_margins_is_not_stable():
    margins = {"gain_margin_db": 9.0, "phase_margin_deg": 60.0, "disk_margin": 0.4}
    found = [Evaluation(name, {"one": {"J1": 0.5}}, each) for name, each in (("known", margins), ("unstable", {}))]
    assert worst_table("", found).rows[-1] == ("disk margin", "0.4", "not stable")


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sac_la_21"], "sac_la_9) or a rig (five_storey"),
        (["sac_la_3", "--record", "still.csv"], "without control is 0, expected a ground that moves"),
        (["outside.yaml"], "outside.yaml: name: '../small', expected up to 64 letters"),
        (["without_cases.yaml"], "benchmark file without_cases.yaml: duration: key is missing; cases: key is missing"),
        (["sac_la_3", "--record", "none.csv"], f"none.csv: not shipped, expected {DATA}"),
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
