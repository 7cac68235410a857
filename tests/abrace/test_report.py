# SPDX-License-Identifier: Apache-2.0
"""The report: what summary.json and the tables say of a campaign's results, and what is refused."""

import json
import re

import pydantic
import pytest

from abrace.report.result import verdicts
from abrace.report.results import read_results
from abrace.report.table import Table
from abrace.report.tables import PAPER_POLES, interval_tables, margin_table
from abrace.report.writer import make_report
from abrace_core import AbraceError
from abrace_core.files.writing import write_json
from abrace_core.model.response import PAPER_RIG, TABLE_1_EXPERIMENT, TABLE_1_SIMULATION
from abrace_lqg.analysis.disk_margin import DiskMargin
from abrace_lqg.analysis.margins import Margins
from abrace_lqg.analysis.prediction import Excitation
from abrace_lqg.proof.checks import ModelProof, Proof
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.results import write_poles


@pytest.fixture(autouse=True)
def _wide(monkeypatch):
    """Rows of one line."""
    monkeypatch.setattr("abrace.report.table.WIDTH", 1000)


def as_rows(table, factor=1.0):
    return {name: {"peak": factor * row.peak, "rms": factor * row.rms} for name, row in table.items()}


def as_poles(poles, frequency=1.0, damping=1.0):
    unknown = {"frequency_deviation": None, "damping_ratio_deviation": None}
    return [{"frequency": frequency * abs(p), "damping_ratio": damping * -p.real / abs(p)} | unknown for p in poles]


def agreement(correlation, error, noise_free):
    row = {"correlation": correlation, "normalised_rms_error": error, "noise_free_error": noise_free}
    return {name: dict(row) for name in TABLE_1_EXPERIMENT}


def example():
    """Results whose measured run is 10 % above the paper's experiment, and whose simulated run is the paper's."""
    uncontrolled = as_rows(TABLE_1_EXPERIMENT, 4.4)
    uncontrolled["U"] = {"peak": 0.0, "rms": 0.0}
    return {
        "poles.json": {
            "rig": PAPER_RIG,
        }
        | {
            test: {"identified": as_poles(poles, 1.001, 0.95), "true": as_poles(poles)}
            for test, poles in PAPER_POLES.items()
        },
        "check/comparison.json": {
            "test": {"record": "el_centro", "peak_acceleration": 0.980665, "controller": "lqg3", "rig": PAPER_RIG},
            "measured": as_rows(TABLE_1_EXPERIMENT, 1.1),
            "simulated": as_rows(TABLE_1_SIMULATION),
            "uncontrolled": uncontrolled,
            "simulated_vs_measured": agreement(0.9921, 0.0345, 0.0301),
            "peak_rms_error": 0.012,
            "other_models": {"reduced": {"simulated_vs_measured": agreement(0.95, 0.2, 0.19), "peak_rms_error": 0.034}},
        },
        "timing.json": {
            "lockstep": True,
            "sample_rate": 500.0,
            "steps": [
                {"name": "table_noise", "wall_seconds": 42.0, "samples": 120000, "run_seconds": 40.0},
                {"name": "model", "wall_seconds": 7.5},
                {"name": "check", "wall_seconds": 0.0},
                {"name": "controlled", "wall_seconds": 12.0, "samples": 50000, "run_seconds": 10.0},
            ],
        },
    }


def write(directory, results):
    for name, content in results.items():
        (directory / name).parent.mkdir(exist_ok=True)
        (directory / name).write_text(content if isinstance(content, str) else json.dumps(content))


def reported(directory, results):
    write(directory, results)
    return make_report(directory), json.loads((directory / "summary.json").read_text())


def row(text, title, name):
    """Cells of a row of the printed table of this title."""
    section = next(section for section in text.split("\n\n") if section.startswith(title))
    return next(re.split(r"  +", line) for line in section.splitlines() if line.startswith(name + " "))


FINDING = {
    "check": "friction",
    "where": "storey 1",
    "value": 0.004,
    "limit": 0.0002,
    "unit": "of critical damping",
    "verdict": "trust with care",
    "cause": "friction",
    "meaning": "friction in storey 1: 51 +- 1 N in table_noise",
    "advice": "Free the bearings",
}


def test_the_report_says_whether_the_model_can_be_trusted_and_what_to_do(tmp_path):
    fine = FINDING | {"value": 0.0, "verdict": "trust", "cause": None, "meaning": "no friction", "advice": ""}
    found = [FINDING, fine, FINDING | {"check": "backlash", "verdict": "trust", "cause": None, "advice": ""}]
    validity = {"verdict": "trust with care", "causes": ["friction"], "findings": found, "not_checked": {}}
    results = example() | {"model/validity.json": validity}
    results["check/comparison.json"]["validity"] = FINDING | {"meaning": "a1 is 9 % off"}
    text, summary = reported(tmp_path, results)
    title = "Validity of model: trust with care: friction"
    assert row(text, title, "friction")[1:] == ["0.004", "0.0002", "trust with care", "storey 1"]
    section = next(section for section in text.split("\n\n") if section.startswith(title))
    assert section.endswith("friction in storey 1: 51 +- 1 N in table_noise\nFree the bearings")
    assert "Validity: trust with care: a1 is 9 % off" in text
    assert summary["validity"] == {"model": {"verdict": "trust with care", "causes": ["friction"]}}
    results["model/validity.json"] = validity | {"findings": [FINDING | {"verdict": "fine"}]}
    with pytest.raises(AbraceError, match=r"validity.json: findings.0.verdict: 'fine', expected 'trust'"):
        reported(tmp_path, results)


def test_poles_and_margins_are_shown_as_the_library_wrote_them_and_unknown_ones_as_a_dash(tmp_path):
    write(tmp_path, example())
    known, unknown = PoleInterval(7.2758, 0.0151, 0.0012, 0.0002), PoleInterval(38.0, 0.02)
    write_poles({"table": [known], "common": [known, unknown]}, tmp_path / "model/poles.json")
    margins = Margins(9.2, 52.5, float("inf"), 1.74)
    model = ModelProof("reduced", 8, True, [], {"U": margins}, DiskMargin(0.5, 7.0), {}, [])
    found = pydantic.TypeAdapter(Proof).dump_python(Proof((model,), ("U",), Excitation()), by_alias=True)
    (tmp_path / "check").mkdir(exist_ok=True)
    write_json(tmp_path / "check/check_proof.json", found)
    results = read_results(tmp_path)
    (intervals,) = interval_tables(results)
    assert intervals.rows == (
        ("table test 1", "7.2758 ± 0.0024", "1.510 ± 0.039"),
        ("both tests 1", "7.2758 ± 0.0024", "1.510 ± 0.039"),
        ("both tests 2", "38", "2"),
    )
    assert results.proofs["check"].models == (model,)
    assert margin_table(results.proofs).rows == (("check", "9.2", "52.5", "-", "1.74", "-", "yes", "-"),)


def test_modes_of_an_ambient_test_are_shown_with_their_intervals_and_changes(tmp_path):
    modes = [
        {"frequency": w, "damping_ratio": 0.01, "frequency_deviation": 0.01, "damping_ratio_deviation": 0.001}
        for w in (7.0, 22.0)
    ]
    change = {"before": 7.7, "after": 7.0, "frequency_change": -0.09, "damping_change": 0.2, "probability": 1e-9}
    content = {"seconds": 600.0, "channels": ["a1"], "modes": [mode | {"shape": [[1.0, 0.0]]} for mode in modes]}
    ambient = {"model/ambient.json": content | {"change": {"changed": True, "modes": [change]}}}
    text, _ = reported(tmp_path, example() | ambient)
    section = next(
        one for one in text.split("\n\n") if one.startswith("Modes from ambient vibration: model, 600 s of a1")
    )
    rows = [" ".join(line.split()) for line in section.splitlines()]
    assert "7.0000 +- 0.0196 1.000 +- 0.196 -9.000 +20.0 1e-09" in rows
    assert "22.0000 +- 0.0196 1.000 +- 0.196 not found before" in rows
    assert section.endswith("The building has changed.")


def test_summary_holds_poles_identified_and_true_with_their_largest_errors(tmp_path):
    results = example()
    _, summary = reported(tmp_path, results)
    for test in ("table", "command"):
        poles = summary["poles"][test]
        assert {key: poles[key] for key in ("identified", "true")} == results["poles.json"][test]
        assert poles["largest_relative_error"]["frequency"] == pytest.approx(0.001)
        assert poles["largest_relative_error"]["damping_ratio"] == pytest.approx(0.05)


def test_summary_holds_table_1_and_its_error_against_the_papers_experiment(tmp_path):
    results = example()
    _, summary = reported(tmp_path, results)
    comparison = results["check/comparison.json"]
    assert list(summary["table1"]["measured"]) == ["x1", "x2", "x3", "xf", "a1", "a2", "a3", "f", "U"]
    assert summary["table1"]["measured"] == comparison["measured"]
    assert summary["table1"]["simulated"] == comparison["simulated"]
    assert summary["table1"]["error_vs_paper_experiment"] == pytest.approx(0.1)
    assert summary["table1"]["simulated_error_vs_paper_experiment"] == pytest.approx(0.136, abs=5e-4)
    assert summary["uncontrolled"] == comparison["uncontrolled"]
    for key in ("simulated_vs_measured", "peak_rms_error", "other_models"):
        assert summary[key] == comparison[key]
    assert summary["units"] == {**dict.fromkeys(("x1", "x2", "x3", "xf"), "cm")} | {
        **dict.fromkeys(("a1", "a2", "a3"), "g"),
        **dict.fromkeys(("f", "U"), "kgf"),
    }


def test_summary_holds_wall_seconds_and_samples_per_second(tmp_path):
    _, summary = reported(tmp_path, example())
    timing = summary["timing"]
    assert timing["wall_seconds"] == {"table_noise": 42.0, "model": 7.5, "check": 0.0, "controlled": 12.0}
    assert timing["total_wall_seconds"] == 61.5
    assert timing["samples_per_second_of_test"] == {"table_noise": 3000.0, "controlled": 5000.0}
    assert timing["samples_per_second"] == 3400.0, "170000 samples in 50 s"
    assert timing["real_time_factor"] == pytest.approx(6.8)
    assert "lost_samples" not in timing, "in lockstep none can be"


def test_of_tests_in_real_time_lost_samples_and_missed_deadlines_are_reported(tmp_path):
    results = example()
    results["timing.json"]["lockstep"] = False
    for index, lost, missed in ((0, 0, 3), (3, 2, 40)):
        results["timing.json"]["steps"][index] |= {"lost_samples": lost, "missed_deadlines": missed}
    text, summary = reported(tmp_path, results)
    assert summary["timing"]["lost_samples"] == {"table_noise": 0, "controlled": 2}
    assert summary["timing"]["missed_deadlines"] == {"table_noise": 3, "controlled": 40}
    title = "Timing, in real time"
    assert row(text, title, "controlled")[-2:] == ["2", "40"]
    assert row(text, title, "model")[-2:] == ["-", "-"]
    assert row(text, title, "all")[-2:] == ["2", "43"]


def test_tables_set_the_results_beside_the_papers(tmp_path):
    text, _ = reported(tmp_path, example())
    assert row(text, "Poles from the table test", "1") == (
        ["1", "7.283", "7.276", "7.276", "+0.100", "1.436", "1.512", "1.512", "-5.0"]
    )
    assert row(text, "Poles from the command test", "6")[:4] == ["6", "135.203", "135.068", "135.068"]
    title = "Table 1: lqg3, el_centro at 0.1 g"
    assert row(text, title, "x1 [cm]") == (
        ["x1 [cm]", "1.104", "1.339", "1.214", "1.339", "0.159", "0.166", "0.175", "0.166"]
    )
    assert row(text, title, "U [kgf]")[1:5] == ["1457.0", "1657.0", "1602.7", "1657.0"]
    assert "18 cells: measured 0.100, simulated 0.136, the paper's simulation 0.136" in text
    assert row(text, "Without and with lqg3", "a3 [g]") == [
        "a3 [g]",
        "0.8624",
        "0.2156",
        "75.0",
        "0.0836",
        "0.0209",
        "75.0",
    ]
    assert row(text, "Without and with lqg3", "U [kgf]")[1:4] == ["0.0", "1602.7", "-"]
    assert row(text, "Simulated by the identified models", "x3") == (["x3", "0.9921", "0.0345", "0.0301", "0.1900"])
    assert "Mean error of peaks and rms: model 1.2 %, reduced 3.4 %" in text
    assert row(text, "Timing, in lockstep", "model") == ["model", "7.5", "-", "-"]
    assert row(text, "Timing, in lockstep", "all") == ["all", "61.5", "3400", "6.80"]


@pytest.mark.parametrize(("key", "value"), [("record", "kobe"), ("peak_acceleration", 1.96), ("controller", "lqg1")])
def test_another_test_is_not_set_beside_table_1(tmp_path, key, value):
    results = example()
    results["check/comparison.json"]["test"][key] = value
    text, summary = reported(tmp_path, results)
    assert "paper exp." not in text
    assert summary["table1"]["error_vs_paper_experiment"] is None
    assert row(text, "Peak and rms", "x1 [cm]") == ["x1 [cm]", "1.214", "1.339", "0.175", "0.166"]


def test_numbers_of_another_rig_are_in_si_units_without_the_papers(tmp_path):
    results = example()
    results["poles.json"]["rig"] = results["check/comparison.json"]["test"]["rig"] = "five_storey"
    text, summary = reported(tmp_path, results)
    assert "paper" not in text
    assert row(text, "Peak and rms: lqg3, el_centro at 0.981 m/s²", "x1 [mm]") == [
        "x1 [mm]",
        "12.14",
        "13.39",
        "1.75",
        "1.66",
    ]
    assert row(text, "Poles from the table test", "1")[:4] == ["1", "7.283", "7.276", "+0.100"]
    assert summary["units"] == {name: unit for name, unit in summary["units"].items() if unit in ("mm", "m/s²", "kN")}
    assert summary["table1"]["measured"]["f"]["peak"] == pytest.approx(1.1 * 1556.0 * 9.80665e-3)
    assert "x1 [cm]" in make_report(tmp_path, "paper"), "as asked for"


def test_numbers_that_are_not_known_are_dashes(tmp_path):
    results = example()
    comparison = results["check/comparison.json"]
    for cells in (comparison["measured"]["x1"], comparison["uncontrolled"]["xf"]):
        cells["peak"] = cells["rms"] = None
    for name in ("x1", "a1"):
        del comparison["simulated_vs_measured"][name]
    del comparison["simulated"]["a1"]
    comparison["peak_rms_error"] = comparison["other_models"]["reduced"]["peak_rms_error"] = None
    comparison["validity"] = FINDING | {"value": None, "meaning": "not judged: a1"}
    text, summary = reported(tmp_path, results)
    assert "not judged: a1" in text
    assert "Mean error of peaks and rms: model - %, reduced - %" in text
    assert summary["table1"]["measured"]["x1"] == {"peak": None, "rms": None}
    assert summary["table1"]["error_vs_paper_experiment"] is None
    assert row(text, "Without and with lqg3", "xf [cm]")[1:4] == ["-", "0.974", "-"]


def test_a_comparison_without_a_model_has_its_reductions(tmp_path):
    results = example()
    comparison = results["check/comparison.json"]
    comparison["simulated"] = None
    for key in ("simulated_vs_measured", "peak_rms_error", "other_models"):
        del comparison[key]
    comparison["test"]["controller"] = "skyhook"
    text, summary = reported(tmp_path, results)
    assert row(text, "Peak and rms: skyhook", "x1 [cm]") == ["x1 [cm]", "1.214", "0.175"]
    assert row(text, "Without and with skyhook", "a3 [g]")[3] == "75.0"
    assert "Simulated" not in text
    assert summary["table1"]["simulated"] is None


def test_the_result_comes_first_and_is_printed_last(tmp_path):
    validity = {"verdict": "trust with care", "causes": ["friction"], "findings": [FINDING], "not_checked": {}}
    results = with_two_controllers() | {"model/validity.json": validity}
    results["timing.json"]["steps"][1]["lost_samples"] = 3
    text, _ = reported(tmp_path, results)
    told = [
        "Models of step model: trust with care (friction)",
        "check: 10.0 % mean error to Table 1's experiment (paper's own: 13.6 %)",
        "Not to be trusted: table_noise: 3 samples not in the bag",
    ]
    assert text.splitlines()[-3:] == told
    title = "Peaks of the top floor without and with control"
    cells = ["lqg3", "el_centro at 0.1 g", "10.947", "2.737", "75.0", "0.8624", "0.2156", "75.0", "1602.7"]
    assert row(text, title, "check")[1:] == cells
    assert row(text, title, "first")[5] == "50.0", "the weaker controller"
    first, second, *_ = re.findall(r"<h2>(.*?)</h2>", (tmp_path / "report.html").read_text())
    assert (first, second) == ("Result", "Comparisons")


def test_a_controller_that_made_the_motion_worse_than_none_is_named(tmp_path):
    results = example()
    comparison = results["check/comparison.json"]
    comparison["measured"], comparison["uncontrolled"] = comparison["uncontrolled"], comparison["measured"]
    write(tmp_path, results)
    (care,) = [line for line in verdicts(read_results(tmp_path)) if line.startswith("Care: ")]
    assert care.startswith(
        "Care: check: lqg3 makes the motion worse than no control: peak of the greatest displacement "
    )


def test_a_pole_that_was_missed_or_made_up_shows(tmp_path):
    results = example()
    table = results["poles.json"]["table"]
    table["identified"][1]["frequency"] = 30.0
    text, summary = reported(tmp_path, results)
    assert row(text, "Poles from the table test", "2")[1:5] == ["-", "22.852", "22.852", "-"]
    assert row(text, "Poles from the table test", "3")[1:5] == ["30.000", "-", "-", "-"]
    assert summary["poles"]["table"]["largest_relative_error"] == {"frequency": None, "damping_ratio": None}


def test_a_rig_whose_own_poles_nobody_knows_and_of_another_size_is_reported(tmp_path):
    results = example()
    for test in ("table", "command"):
        results["poles.json"][test]["true"] = []
    for table in ("measured", "simulated", "uncontrolled"):
        rows = results["check/comparison.json"][table]
        results["check/comparison.json"][table] = {"x1": rows["x1"], "x5": rows["x3"], "U": rows["U"]}
    results["check/comparison.json"] |= {"simulated_vs_measured": {}, "other_models": {}}
    text, summary = reported(tmp_path, results)
    assert row(text, "Poles from the table test", "1")[1:5] == ["7.283", "-", "7.276", "-"]
    assert list(summary["table1"]["measured"]) == ["x1", "x5", "U"]
    assert summary["table1"]["error_vs_paper_experiment"] is None


def test_a_test_without_one_to_set_beside_has_no_reductions(tmp_path):
    results = example()
    results["check/comparison.json"]["uncontrolled"] = None
    text, summary = reported(tmp_path, results)
    assert summary["uncontrolled"] is None
    assert "Without and with" not in text
    assert "Table 1" in text


def with_two_controllers():
    """LQG3 and a weaker controller under the same motion."""
    results = example()
    weaker = json.loads(json.dumps(results["check/comparison.json"]))
    weaker["test"]["controller"] = "lqg1"
    weaker["measured"] = as_rows(TABLE_1_EXPERIMENT, 2.2)
    weaker["simulated"] = as_rows(TABLE_1_EXPERIMENT, 2.31)
    weaker["simulated_vs_measured"]["a1"]["correlation"] = 0.98
    first = {"name": "first", "wall_seconds": 1.0}
    results["timing.json"]["steps"] = [first, *results["timing.json"]["steps"]]
    return {**results, "first/comparison.json": weaker}


def test_tests_with_readings_at_the_end_of_their_range_are_named(tmp_path):
    results = example()
    results["check/comparison.json"]["clipped"] = {"measured": {"a2": 14}, "uncontrolled": None}
    text, summary = reported(tmp_path, results)
    assert re.search(r"check, measured +a2: 14 samples at the end of its range\n", text)
    assert re.search(r"check, uncontrolled +samples at the end of a sensor's range: unknown", text)
    assert summary["clipped"]["measured"] == {"a2": 14}
    results["check/comparison.json"]["clipped"] = {"measured": {}, "uncontrolled": {}}
    assert "end of" not in reported(tmp_path, results)[0]


def test_several_controllers_are_set_beside_each_other(tmp_path):
    text, summary = reported(tmp_path, with_two_controllers())
    assert list(summary["comparisons"]) == ["first", "check"]
    assert summary["test"]["controller"] == "lqg3", "the paper's test is the main one"
    title = "All controllers, el_centro at 0.1 g: "
    assert row(text, title + "peak", "x1 [cm]") == ["x1 [cm]", "4.858", "2.429", "1.214"]
    assert row(text, title + "reduction of peak", "a3") == ["a3", "50.0", "75.0"]


def test_controllers_stand_beside_their_own_test_without_control(tmp_path):
    results = with_two_controllers()
    results["first/comparison.json"]["uncontrolled"] = as_rows(TABLE_1_EXPERIMENT, 8.8)
    third = json.loads(json.dumps(results["check/comparison.json"]))
    third["test"]["controller"], third["measured"] = "skyhook", as_rows(TABLE_1_EXPERIMENT, 3.3)
    results["timing.json"]["steps"].append({"name": "third", "wall_seconds": 1.0})
    text, _ = reported(tmp_path, {**results, "third/comparison.json": third})
    title = "All controllers, el_centro at 0.1 g, {}: {}"
    assert row(text, title.format("first", "peak"), "x1 [cm]") == ["x1 [cm]", "9.715", "2.429"]
    assert row(text, title.format("first", "reduction of rms"), "a3") == ["a3", "75.0"], "2.2 of 8.8"
    assert row(text, title.format("check, third", "peak"), "x1 [cm]") == ["x1 [cm]", "4.858", "1.214", "3.643"]
    assert row(text, title.format("check, third", "reduction of peak"), "a3") == ["a3", "75.0", "25.0"]
    assert text.count("All controllers") == 8, "peak, rms and their reductions, twice"


@pytest.mark.parametrize("controllers", [1, 2])
def test_controllers_on_different_rigs_are_in_different_tables(tmp_path, controllers):
    results = with_two_controllers()
    other = json.loads(json.dumps(results["first/comparison.json"]))
    other["test"]["rig"] = "five_storey"
    for key in ("measured", "simulated", "uncontrolled"):
        rows = other[key]
        other[key] = {"x1": rows["x1"], "x4": {"peak": 2.0, "rms": 1.0}, "U": rows["U"]}
    other |= {"simulated_vs_measured": {}, "other_models": {}}
    for number in range(controllers):
        results["timing.json"]["steps"].append({"name": f"other_{number}", "wall_seconds": 1.0})
        results[f"other_{number}/comparison.json"] = other
    text, _ = reported(tmp_path, results)
    rig = f", rig {PAPER_RIG}" if controllers > 1 else ""
    title = "All controllers, el_centro at 0.981 m/s²"
    assert row(text, f"{title}{rig}: reduction of peak", "x1") == ["x1", "50.0", "75.0"]
    if controllers > 1:
        assert row(text, f"{title}, rig five_storey: reduction of peak", "x4") == ["x4", "0.0", "0.0"]
    assert text.count("All controllers") == 4 * controllers, "one controller on a rig has no table"


@pytest.mark.parametrize("name", ["poles.json", "check/comparison.json", "timing.json"])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not JSON"),
        ("{}", r"(table|test|lockstep): key is missing"),
    ],
)
def test_a_malformed_file_is_named_and_nothing_is_written(tmp_path, name, content, message):
    write(tmp_path, example())
    (tmp_path / name).write_text(content)
    with pytest.raises(AbraceError, match=f"results file {re.escape(str(tmp_path / name))}: .*{message}"):
        make_report(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["check", "poles.json", "timing.json"]


def test_a_folder_without_timing_is_no_campaigns(tmp_path):
    write(tmp_path, example())
    (tmp_path / "timing.json").unlink()
    with pytest.raises(AbraceError, match=r"timing\.json: No such file"):
        make_report(tmp_path)


@pytest.mark.parametrize(("name", "key"), [("poles.json", "poles"), ("check/comparison.json", "table1")])
def test_what_no_step_was_about_is_left_out(tmp_path, name, key):
    write(tmp_path, example())
    (tmp_path / name).unlink()
    make_report(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert key not in summary
    assert "timing" in summary


def test_wrong_values_are_named_with_their_key(tmp_path):
    def refused(results, message):
        write(tmp_path, results)
        with pytest.raises(AbraceError, match=message):
            make_report(tmp_path)

    results = example()
    results["check/comparison.json"]["measured"]["x1"]["rms"] = float("nan")
    refused(results, r"comparison\.json: measured\.x1\.rms: nan, expected a finite number")
    results = example()
    del results["check/comparison.json"]["simulated"]["xf"]
    results["check/comparison.json"]["simulated"]["x9"] = {"peak": 1.0, "rms": 1.0}
    refused(results, r"comparison\.json: as a whole: expected .*simulated with rows of measured, .*, x1 x2 x3 xf")
    results = example()
    results["poles.json"]["command"]["identified"] = []
    refused(results, r"poles\.json: command\.identified: .*expected")
    results = example()
    results["timing.json"]["steps"][0]["speed"] = 3
    refused(results, r"timing\.json: steps\.0\.speed: unknown key")


def test_columns_of_a_table_are_aligned_whatever_their_width():
    table = Table("T", ("", "long header", "n"), (("a", "1.5", "1000"), ("name", "-10.25", "2")), ("note",))
    assert table.text().splitlines() == [
        "T",
        "      long header     n",
        "----  -----------  ----",
        "a             1.5  1000",
        "name       -10.25     2",
        "note",
    ]


def test_a_table_is_within_80_columns_where_words_can_be_parted(monkeypatch):
    monkeypatch.setattr("abrace.report.table.WIDTH", 30)
    table = Table("T", ("step", "what it would be called", "n"), (("a", "a text of words", "1.5"),), ("note " * 9,))
    assert table.text().splitlines() == [
        "T",
        "step     what it would be    n",
        "                   called",
        "----  -------------------  ---",
        "a         a text of words  1.5",
        "note note note note note note",
        "note note note",
    ]


def test_no_test_is_said_to_be_trusted_where_there_was_none(tmp_path):
    results = example()
    results["timing.json"]["steps"] = [step for step in results["timing.json"]["steps"] if "samples" not in step]
    results["timing.json"]["failed"] = {"step": "table_noise", "cause": "no rig"}
    write(tmp_path, results)
    told = verdicts(read_results(tmp_path))
    assert told[0] == "Step table_noise failed: no rig"
    assert "Every test can be trusted" not in told
    write(tmp_path, example())
    assert verdicts(read_results(tmp_path))[-1] == "Every test can be trusted"
