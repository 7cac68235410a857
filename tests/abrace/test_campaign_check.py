# SPDX-License-Identifier: Apache-2.0
"""A campaign is checked whole before anything moves: what is wrong, what will go wrong, what it takes and writes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from campaign_file import TOP, day, mistakes_of

from abrace.campaign.forecast import Peak
from abrace.campaign.plan import Plan, check_campaign
from abrace.cli import main
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel, save_model
from abrace_plant.live.simulated_run import simulated_run
from abrace_plant.rig.file import load_rig

DEMO = Path(__file__).parents[2] / "src/abrace/campaigns/demo.yaml"
NOISE = "rms: RMS, band: [0.3, 20.0], seed: 1"
EL_CENTRO = "{record: el_centro, peak_acceleration: 0.980665}"


def checked(folder: Path, *steps: str, top: str = TOP) -> Plan:
    return check_campaign(day(folder, *steps, top=top))


def problems(folder: Path, *steps: str, top: str = TOP) -> list[str]:
    return mistakes_of(day(folder, *steps, top=top), check_campaign)


def test_everything_that_is_wrong_is_told_before_the_first_test(tmp_path: Path) -> None:
    (tmp_path / "lqg.yaml").write_text("nothing: here")
    (tmp_path / "no_bag").mkdir()
    found = problems(
        tmp_path,
        "{name: a, test: {duration: 9.0}}",
        f"{{name: b, test: {{duration: 9.0, ground_motion: {EL_CENTRO.replace('0.98', '30.')}}}}}",
        "{name: c, test: {duration: 9.0, ground_motion: {record: records/none.csv}, controller: lqg.yaml}}",
        "{name: d, test: {duration: 9.0, controller: {run: [abrace_lqg, skyhook]}, force_limit: [3e5]}}",
        "{name: e, test: {duration: 9.0, excitation: {rms: 9.0, band: [0.0, 400.0], seed: 1}, sensor_faults: [a9=no]}}",
        "{name: f, test: {duration: 1.0, controller: {run: laws/none.py}, force_limit: [1.0, 2.0]}}",
        "{name: g, compare: {test: a, uncontrolled: ./no_bag}}",
        "{name: h, design: {model: ./no_model, weights: lqg9}}",
        "{name: i, validate: {test: a, model: ./no_model.json}}",
    )
    expected = [
        "14 mistakes, nothing was started",
        "step a: a lockstep test without any input",
        "step b: test.ground_motion: ground motion el_centro exceeds the table's limits: acceleration 30",
        f"step c: test.ground_motion: ground motion {tmp_path}/records/none.csv: no such file, and no such name",
        f"step c: test.controller: controller file {tmp_path}/lqg.yaml: nothing: unknown key",
        "step d: test.controller: package abrace_lqg has no executable 'skyhook'",
        "step d: test.force_limit: [300000.0] N, expected at most the capacity, 24516.6 N",
        "step e: test.excitation: noise band 0.0 to 400.0 Hz: expected 0 <= lowest < highest < 250 Hz",
        "step e: test.sensor_faults: sensor fault 'a9=no': expected CHANNEL=KIND",
        f"step f: test.controller: {tmp_path}/laws/none.py: no such file, expected a Python program",
        "step f: test.force_limit: [1.0, 2.0], expected one force [N] for each of 1 brace groups",
        "step g: compare.uncontrolled: ",
        f"step h: design.model: model file {tmp_path}/no_model/reduced.json: No such file",
        "step h: design.weights: weights 'lqg9': unknown",
        f"step i: validate.model: model file {tmp_path}/no_model.json: No such file",
    ]
    assert len(found) == len(expected), found
    for line, start in zip(found, expected, strict=True):
        assert line.startswith(start), f"{line}, expected {start}"


def test_a_design_from_a_model_of_data_is_checked_by_the_names_of_that_model(tmp_path: Path) -> None:
    of_data = LinearModel([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]], ("shaker", "base"), ("roof",))
    save_model(of_data, tmp_path / "data.json")
    (tmp_path / "names.yaml").write_text("measured: [roof]\nsignals: {roof: 1.0}\nnoise_to_excitation: 0.1\n")
    step = "{name: NAME, design: {model: ./data.json, weights: ./names.yaml, commands: [shaker], disturbance: BASE}}"
    right, wrong = step.replace("NAME", "a").replace("BASE", "base"), step.replace("NAME", "b").replace("BASE", "road")
    assert checked(tmp_path, right)
    found = [line for line in problems(tmp_path, right, wrong) if line.startswith("step")]
    assert found == ["step b: design.model has no input road, it has shaker, base"]


def test_what_a_verb_would_refuse_is_told_by_its_own_check_in_one_round(tmp_path: Path) -> None:
    """Options of every offline step, and a weights file; what pydantic finds, and what needs rig and tests."""
    weights = (find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights")).read_text()
    (tmp_path / "own.yaml").write_text(weights.replace("a1", "a7"))
    (tmp_path / "other.yaml").write_text(weights.replace("noise_to_excitation", "noise_to_exitation"))
    noise, pushed = NOISE.replace("RMS", "0.1"), NOISE.replace("RMS", "900.0")

    def identify(name: str, options: str) -> str:
        return f"{{name: {name}, identify: {{table: w, command: u, {options}}}}}"

    found = problems(
        tmp_path,
        f"{{name: w, test: {{duration: 70.0, ground_motion: {{record: white_noise, {noise}}}}}}}",
        f"{{name: u, test: {{duration: 70.0, excitation: {{{pushed}}}}}}}",
        identify("a", "method: papr"),
        identify("b", "modes: 2"),
        identify("c", "table_band: [5.0, 1.0]"),
        identify("d", "command_band: [0.3, 30.0]"),
        identify("e", 'segment: "4096"'),
        identify("f", "transfer_function: welch, segment: 40000"),
        identify("g", "mthod: paper"),
        identify("g1", "half_width: 3"),
        identify("g2", "degree: 40"),
        identify("g3", "half_width: 700"),
        identify("g4", "transfer_function: local_polynomial, degree: 5"),
        identify("g5", "modes: 6, reduced_order: 16"),
        identify("g6", "method: paper, reduced_order: 25"),
        "{name: h, design: {model: b, weights: own.yaml}}",
        "{name: i, design: {model: b, weights: other.yaml, gain_margin: -1.0}}",
        "{name: j, design: {model: b, weights: other.yaml}}",
        "{name: k, design: {model: b, weights: lqg3, force_limit: [1.0, 2.0], excitation_band: [2.0, 1.0]}}",
        "{name: l, design: {model: b, weights: lqg3, force_limit: [1.0, 2.0]}}",
        "{name: m, design: {model: b, weights: lqg3, sample_period: 0.9}}",
        "{name: n, ambient: {test: w, band: [9.0, 1.0]}}",
        "{name: o, ambient: {test: w, band: [1.0, 900.0]}}",
        "{name: p, ambient: {test: w, channels: [a7], highest_order: 40}}",
        "{name: q, ambient: {test: w, highest_order: 2}}",
        "{name: r, design: {model: b, weights: lqg3, sample_period: 0.003}}",
        f"{{name: s, test: {{duration: 9.0, ground_motion: {EL_CENTRO}, controller: r}}}}",
    )
    expected = [
        "28 mistakes, nothing was started",
        "step a: identify.method: 'papr', expected 'maximum_likelihood', 'vector_fitting' or 'paper'",
        "step c: identify.table_band: [5.0, 1.0], expected two frequencies in Hz, the lower one first",
        "step e: identify.segment: '4096', expected a whole number",
        "step g: identify.mthod: unknown key, did you mean method?",
        "step i: design.gain_margin: -1.0, expected greater than or equal to 0",
        "step k: design.excitation_band: [2.0, 1.0], expected two frequencies in Hz, the lower one first",
        "step n: ambient.band: [9.0, 1.0], expected two frequencies in Hz, the lower one first",
        "step q: ambient.highest_order: 2, expected greater than or equal to 4",
        "step b: identify: identification: modes 2, expected at least 3, one for each floor",
        "step d: identify.command_band: 0.3 to 30 Hz, expected within the 0.3 to 20 Hz of u",
        "step f: identify.table: w: segments of 40000 in 35000 samples, expected 2 to 17500",
        "step f: identify.command: u: segments of 40000 in 35000 samples, expected 2 to 17500",
        *(
            f"step {step}: identify.{test}: local {message}"
            for step, message in (
                ("g1", "rational method: degree 2 and half_width 3, expected degree >= 0 and half_width >= 4"),
                ("g2", "rational method: degree 40 and half_width 20, expected degree >= 0 and half_width >= 42"),
            )
            for test in ("table", "command")
        ),
        "step g3: identify.table: local rational method: 1380 lines in the band, expected at least 1401",
        "step g3: identify.command: local rational method: 1380 lines in the band, expected at least 1401",
        "step g5: identify: identification: reduced_order 16, expected at most the 15 states of the model by method m",
        "step g6: identify: identification: reduced_order 25, expected at most the 24 states of the model by method p",
        "step h: design.weights: weights: measured: a7, expected some of x1",
        f"step j: design.weights: weights file {tmp_path}/other.yaml: noise_to_exitation: unknown key",
        "step l: design.force_limit: [1.0, 2.0] N, expected one for each command of the model (U)",
        "step m: design.sample_period: 0.9 s, expected above 0 and below 0.427 s",
        "step o: ambient: ambient test: band 1 to 900 Hz, expected within 0 to 250 Hz",
        "step p: ambient: ambient test: no channel 'a7', it has x1, x2, x3, xf, a1",
        "step r: design.sample_period: 0.003 s, expected 0.002 s, the rig's, or a whole multiple of it",
        "step s: test.controller: r: sample period 0.003 s, expected 0.002 s, the rig's, or a whole",
    ]
    for line, start in zip(found, expected, strict=False):
        assert line.startswith(start), f"{line}, expected {start}"
    assert len(found) == len(expected)


def test_identification_tests_that_cannot_be_used_together_are_told_before_the_first(tmp_path: Path) -> None:
    multisine = "rms: RMS, band: [0.3, 20.0], seed: 1, period: PERIOD, lines: LINES"

    def both(name: str, lines: str = "even", period: float = 8.192, rms: str = "900.0") -> str:
        table = multisine.replace("RMS", "0.1").replace("PERIOD", "8.192").replace("LINES", "odd")
        braces = multisine.replace("RMS", rms).replace("PERIOD", str(period)).replace("LINES", lines)
        drives = f"ground_motion: {{record: multisine, {table}}}, excitation: {{signal: multisine, {braces}}}"
        return f"{{name: {name}, test: {{duration: 66.0, {drives}}}}}"

    def pushed(name: str, rms: str, signal: str = "white_noise") -> str:
        noise = NOISE.replace("RMS", rms)
        return f"{{name: {name}, test: {{duration: 66.0, excitation: {{signal: {signal}, {noise}}}}}}}"

    noise = NOISE.replace("RMS", "0.1")
    table = f"{{name: w, test: {{duration: 66.0, ground_motion: {{record: white_noise, {noise}}}}}}}"
    top = TOP.replace("rig: ncree_three_storey", "rig: five_storey")
    assert top != TOP

    def said(table_tests: str, command_tests: str, *steps: str) -> list[str]:
        identify = f"{{name: model, identify: {{table: {table_tests}, command: {command_tests}}}}}"
        try:
            checked(tmp_path, *steps, identify, top=top)
        except AbraceError as error:
            return [line.partition("step model: identify.")[2] for line in str(error).splitlines() if "model" in line]
        return []

    assert said("both", "both", both("both")) == []
    (found,) = said("both", "both", both("both", lines="odd"))
    assert found.startswith("table: both has odd lines on the table and odd lines on the braces, expected odd ones on")
    (found,) = said("both", "both", both("both", lines="all"))
    assert found.startswith("table: both has odd lines on the table and all lines on the braces")
    (found,) = said("both", "both", both("both", period=4.096))
    assert found == "table: both has multisines of 8.192 and 4.096 s, expected one period"
    alone = (table, pushed("one", "[900.0, 0.0]"), pushed("two", "[0, 900]"))
    assert said("w", "[one, two]", *alone) == []
    assert said("w", "one", *alone) == ["command: no test drives brace group 2, expected one of every group"]
    (found,) = said("w", "[one, three]", *alone[:2], pushed("three", "900.0"))
    assert found.startswith("command: brace group 1 is driven with other groups in three than in one, expected")
    (found,) = said("w", "[three, four]", table, pushed("three", "900.0"), pushed("four", "900.0", "multisine"))
    assert found == "command: some of three, four are noise and some multisines, expected one kind"
    (found,) = problems(tmp_path, pushed("one", "[9.0, 9.0, 9.0]"), top=top)
    assert "test.excitation: rms [9.0, 9.0, 9.0] N: expected one value for all brace groups, or one for each" in found
    (found,) = problems(tmp_path, pushed("one", "[0.0, 0.0]"), top=top)
    assert "test.excitation.rms: [0.0, 0.0], expected one number for all brace groups or one for each" in found


@pytest.mark.parametrize(
    ("top", "message"),
    [
        ("rig: none", "rig: rig 'none': unknown, expected a file"),
        ("rig: ncree_three_storey\ndevice: none", "rig: device 'none': unknown, expected a file"),
        ("rig: {file: five_storey, run: [abrace_plant, none]}", "rig: package abrace_plant has no executable 'none'"),
    ],
)
def test_a_rig_that_is_not_there_is_told_once_however_many_tests_it_has(tmp_path: Path, top: str, message: str) -> None:
    (found,) = problems(tmp_path, *(f"{{name: {name}, test: {{duration: 9.0}}}}" for name in "abc"), top=top)
    assert found.startswith(message)


def test_peaks_are_predicted_near_those_that_the_demo_measures() -> None:
    plan = check_campaign(DEMO)
    forecast = plan.forecaster.of("controlled")
    assert forecast.note == "lqg3 as designed on the rig's own model"
    measured = {"displacement": 0.02502, "acceleration": 1.713, "force": 15276.0, "command": 14519.0}
    for kind, peak in measured.items():
        assert forecast.peaks[kind].value == pytest.approx(peak, rel=0.06), kind
    assert forecast.peaks["table"] == Peak("displacement", pytest.approx(0.0309, rel=0.01), 0.25, "m", "table")
    assert plan.forecaster.of("uncontrolled").peaks["displacement"].value == pytest.approx(0.07101, rel=0.01)
    assert not plan.cares


def test_limits_that_will_be_exceeded_are_told_and_not_refused(tmp_path: Path) -> None:
    plan = checked(
        tmp_path,
        f"{{name: strong, test: {{duration: 20.0, ground_motion: {EL_CENTRO.replace('0.98', '2.5')}}}}}",
        "{name: pushed, test: {duration: 9.0, excitation: {rms: 4000.0, band: [0, 9.0], seed: 1}, force_limit: [5e3]}}",
        f"{{name: own, test: {{duration: 9., ground_motion: {EL_CENTRO}, controller: {{run: [abrace_lqg, design]}}}}}}",
    )
    starts = [care.partition(" as predicted")[0] for care in plan.cares]
    assert [start.split(" 0.")[0].split(" 1")[0] for start in starts] == [
        "step strong: the rig stops after 2.11 s,",
        "step strong: drift of storey 2",
        "step strong: displacement x3",
        "step strong: acceleration a3",
        "step strong: stroke xf",
        "step pushed: command U reaches its limit of 5000 N (force limit)",
    ]
    assert plan.cares[0].endswith("w: at the end of its range, at -1.5 for 20 ms (interlocks.clipped)")
    assert plan.cares[2].endswith("more than 0.095 m (interlock)")
    assert plan.forecaster.of("own").note == "with zero command: a node of your own is not simulated"


@pytest.mark.parametrize(
    ("interlock", "before", "after"),
    [
        ("velocity", "{value: 0.8,", "{value: 0.24,"),
        ("oscillation", "oscillation: {value: 6000.0,", "oscillation: {value: 1500.0,"),
        ("table_displacement", "{value: 0.24, time", "{value: 0.02, time"),
        ("clipped", "ground_acceleration: {range: 1.5", "ground_acceleration: {range: 0.4"),
    ],
)
def test_the_interlock_that_stops_the_simulated_rig_is_foretold(
    tmp_path: Path, interlock: str, before: str, after: str
) -> None:
    text = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig").read_text()
    assert before in text
    (tmp_path / "rig.yaml").write_text(text.replace(before, after))
    drive = f"ground_motion: {EL_CENTRO}"
    if interlock == "oscillation":
        drive = f"excitation: {{{NOISE.replace('RMS', '4000.0')}}}"
    plan = checked(tmp_path, f"{{name: a, test: {{duration: 8.0, {drive}}}}}", top="rig: rig.yaml\nlockstep: true")
    care = plan.cares[0]
    assert care.endswith(f"(interlocks.{interlock})")
    seconds = float(care.removeprefix("step a: the rig stops after ").partition(" s,")[0])
    rig, test, signals = load_rig(tmp_path / "rig.yaml"), plan.checked.campaign.tests["a"], plan.checked.signals
    laboratory = plan.checked.laboratories.of(test)
    ground = signals.motion(test.ground_motion, 8.0, laboratory) if test.ground_motion else np.zeros(4000)
    force = signals.excitation(test.excitation, 8.0, laboratory)[:, 0] if test.excitation else np.zeros(4000)

    def stopped(time: float) -> str:
        motion = ground[: round(time * rig.sample_rate)]
        return simulated_run(rig, motion, lambda k, *_: [float(force[k])]).facts.get("stopped", "")

    assert not stopped(seconds - 0.05)
    assert stopped(seconds + 0.05).endswith(f"(interlocks.{interlock})")


def test_a_sensor_fault_that_is_asked_for_is_foretold_as_the_stop_that_it_is(tmp_path: Path) -> None:
    plan = checked(
        tmp_path, f"{{name: a, test: {{duration: 4.0, ground_motion: {EL_CENTRO}, sensor_faults: [a2=stuck@1.5]}}}}"
    )
    (care,) = plan.cares
    assert care.startswith("step a: the rig stops after 1.55 s, as predicted: a2: stuck at ")


def test_a_controller_that_makes_the_motion_worse_than_none_is_a_care(tmp_path: Path) -> None:
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    for name, gain in (("softer", 2e4), ("stiffer", -2e4)):
        law = LinearModel([[0.0]], [[1.0]], [[gain]], [[0.0]], ("x3",), ("U",), 1 / rig.sample_rate)
        controller = Controller(name, law, [[0.0]], [[0.0, 0.0]], rig.capacity, "m", "w", "g")
        save_controller(controller, tmp_path / f"{name}.yaml")
    test = f"duration: 20.0, ground_motion: {EL_CENTRO}"
    plan = checked(
        tmp_path, *(f"{{name: {name}, test: {{{test}, controller: {name}.yaml}}}}" for name in ("softer", "stiffer"))
    )
    (care,) = plan.cares
    worse = "softer makes the motion worse than no control, as predicted: rms of the greatest displacement 4 % greater"
    assert care == f"step softer: {worse}"


def test_the_predicted_force_is_that_of_the_actuator_that_is_nearest_to_its_own_limit(tmp_path: Path) -> None:
    """50 kN on floor 1, 100 kN on floor 3: the rig file's limit of 108 kN is that of the stronger one."""
    steps = [
        f"{{name: of_{group}, test: {{duration: 20.0, excitation: {{rms: {rms}, band: [0.3, 20.0], seed: 1}}}}}}"
        for group, rms in (("1", "[9000.0, 9000.0]"), ("2", "[1000.0, 9000.0]"))
    ]
    plan = checked(tmp_path, *steps, top=TOP.replace("ncree_three_storey", "five_storey"))
    found = {test: plan.forecaster.of(test).peaks["force"] for test in ("of_1", "of_2")}
    assert {test: (peak.name, peak.limit) for test, peak in found.items()} == {
        "of_1": ("f1", 54e3),
        "of_2": ("f2", 108e3),
    }


def test_a_design_that_its_model_refuses_is_refused_or_foretold_where_that_comes_later(tmp_path: Path) -> None:
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    save_model(rig.model, tmp_path / "rig.json")
    strict = "weights: lqg3, gain_margin: 40.0"
    (found,) = problems(tmp_path, f"{{name: lqg3, design: {{model: rig.json, {strict}}}}}")
    assert found.startswith("step lqg3: design refused: gain margin")
    text = DEMO.read_text().replace("weights: lqg3", strict)
    (tmp_path / "demo.yaml").write_text(text)
    (care,) = check_campaign(tmp_path / "demo.yaml").cares
    assert care.startswith("step lqg3: design refused: gain margin")
    assert care.endswith("as predicted with the model of the rig file")


def test_a_disk_that_has_room_for_bags_but_not_for_figures_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=3e6))
    assert problems(tmp_path, f"{{name: a, test: {{duration: 9.0, ground_motion: {EL_CENTRO}}}}}") == [
        f"bags of about 1 MB and results of about 4 MB, expected less than the 3 MB free in {Path.cwd()}"
    ]


def test_a_campaign_that_is_stopped_in_its_report_says_how_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    save_model(rig.model, tmp_path / "rig.json")
    path = day(tmp_path, "{name: lqg3, design: {model: rig.json, weights: lqg3}}")
    monkeypatch.setattr("abrace.campaign.runner.Runner.run_step", lambda *_: {})

    def stopped(_: Path) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("abrace.campaign.course.make_report", stopped)
    assert main(["campaign", str(path)]) == 130
    said = "1 of 1 steps are complete, in results/_unfinished/day; the same command continues with the report\n"
    assert said in capsys.readouterr().err


def test_rigs_of_one_campaign_have_one_sample_rate(tmp_path: Path) -> None:
    rig = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig").read_text()
    assert "sample_rate: 500.0" in rig
    (tmp_path / "slow.yaml").write_text(rig.replace("sample_rate: 500.0", "sample_rate: 400.0"))
    test = f"duration: 9.0, ground_motion: {EL_CENTRO}"
    found = problems(tmp_path, f"{{name: a, test: {{{test}}}}}", f"{{name: b, test: {{{test}, rig: slow.yaml}}}}")
    assert found == ["rig: sample rates of 500 and 400 Hz, expected one for all tests"]


def test_folders_that_cannot_be_written_are_told_before_the_first_test(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    step = f"{{name: a, test: {{duration: 9.0, ground_motion: {EL_CENTRO}}}}}"
    Path("results").write_text("")
    assert problems(tmp_path, step) == [f"results in {tmp_path} is a file, expected a folder or nothing"]
    Path("results").unlink()
    monkeypatch.setattr("os.access", lambda path, _: path != Path())  # as on a disk that is mounted to be read
    _, *found = problems(tmp_path, step)
    assert found == [
        f"{folder} in {tmp_path} cannot be written, expected a folder where you may write"
        for folder in ("results", "bags")
    ]


def test_check_says_what_is_done_how_long_it_takes_and_what_is_written_and_moves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["campaign", "demo", "--check"]) == 0
    said = capsys.readouterr().out
    assert "demo: 7 steps, 4 tests" in said
    assert "test of 100 s in lockstep, ncree_three_storey, lqg3" in said
    assert "time: about 1 min 54 s" in said
    assert "writes: bags/demo/TIME/ with 4 bags, about 49 MB" in said
    assert "results/demo/" in said
    assert not list(tmp_path.iterdir())
    (tmp_path / "day.yaml").write_text("name: day\nrig: none\nsteps: [{name: a, test: {duration: 1.0}}]")
    assert main(["campaign", "day.yaml"]) == 2
    assert not (tmp_path / "results").exists(), "nothing was started"
    assert main(["campaign", "day.yaml", "--check"]) == 2
    assert "abrace: campaign file day.yaml: rig: rig 'none': unknown" in capsys.readouterr().err
