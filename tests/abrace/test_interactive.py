# SPDX-License-Identifier: Apache-2.0
"""`import abrace`: the notebook is run where there is no ROS, and what it gives is looked at."""

import importlib
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.io
from bag_of_run import write_bag
from forked_matlab import matlab_files_by_forks  # noqa: F401
from laboratory import paper_tests
from matplotlib.figure import Figure

import abrace
from abrace_core.model.linear_model import load_covariance
from abrace_core.model.simulation import simulate as simulate_model
from abrace_plant.devices.simulated import SimulatedRig

ROOT = Path(__file__).parents[2]
RIG = "ncree_three_storey"
NOTEBOOK = ROOT / "examples/4_notebook/from_bag_to_controller.ipynb"
WITHOUT_ROS = """
import json, pickle, sys
from pathlib import Path

class NoRos:
    def find_spec(self, name, *_):
        if name.split(".")[0] in ("rclpy", "rcl_interfaces", "ament_index_python", "abrace_interfaces", "std_msgs"):
            raise ImportError(f"no ROS: {name}")

sys.meta_path.insert(0, NoRos())
import abrace, run_notebook

names = {}
ran = run_notebook.run(Path("code.ipynb"), names)
Path("ran.ipynb").write_text(json.dumps(ran))
kept = ("run", "found", "designed", "free", "controlled")
pickle.dump({name: names[name] for name in kept}, open("names.pickle", "wb"))
"""
"""Runs the notebook where nothing of ROS can be imported, and leaves its names."""


def code_of_notebook() -> list[str]:
    """Its lines; those for Jupyter alone and empty ones left out."""
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    lines = [line for cell in cells for line in "".join(cell["source"]).splitlines()]
    return [line for line in lines if line and not line.startswith("%")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the notebook was run."""
    folder = tmp_path_factory.mktemp("laboratory")
    shutil.copy(NOTEBOOK, folder / "code.ipynb")
    for run, name in zip(paper_tests(60.0, 2), ("table_noise", "command_noise"), strict=True):
        write_bag(run, folder / "bags/demo/day" / name)
    command, path = [sys.executable, "-c", WITHOUT_ROS], os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ran = subprocess.run(command, cwd=folder, env=path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return folder


@pytest.fixture(scope="module")
def notebook(folder) -> dict[str, Any]:
    """The names that the notebook leaves."""
    return pickle.loads((folder / "names.pickle").read_bytes())


def shown(notebook: Path) -> list[str]:
    """The words and numbers of a notebook's outputs, cell by cell; "" for a picture."""
    outputs = [output for cell in json.loads(notebook.read_text())["cells"] for output in cell.get("outputs", [])]
    return ["".join(output.get("text") or output["data"].get("text/plain", "")) for output in outputs]


def test_the_notebook_shows_what_it_gives(folder):
    kept, found = shown(NOTEBOOK), shown(folder / "ran.ipynb")
    number = r"-?\d+\.\d+(?:e[+-]\d+)?"
    assert [re.sub(rf"{number}|\s+", "", each) for each in kept] == [
        re.sub(rf"{number}|\s+", "", each) for each in found
    ]
    values = [[float(value) for value in re.findall(number, " ".join(each))] for each in (kept, found)]
    assert len(values[0]) > 100
    assert values[0] == pytest.approx(values[1], rel=0.02, abs=2e-3), "python docs/run_notebook.py makes them again"


def test_the_notebook_goes_from_bags_to_a_controller_in_20_lines(notebook, folder):
    assert len(code_of_notebook()) <= 20
    top = {name: notebook[name].to_pandas()["x3"].std() for name in ("free", "controlled")}
    assert top["controlled"] < 0.4 * top["free"]
    assert abrace.load_controller(folder / "results/lqg3.yaml").law.inputs == ("a1", "a2", "a3")
    assert (folder / "results/lqg3_proof.json").is_file()


@pytest.fixture(scope="module")
def saved(notebook, tmp_path_factory) -> Path:
    """The folder of the identification's results."""
    return Path(notebook["found"].save(tmp_path_factory.mktemp("saved") / "model"))


def test_every_result_prints_in_one_line(notebook):
    of = {name: repr(notebook[name]) for name in ("run", "found", "designed", "controlled")}
    assert of["run"] == "<Run bags/demo/day/table_noise: 64 s at 500 Hz, 3 floors, 1 brace group>"
    assert of["found"].startswith(
        "<Identified: 14 states, reduced to 8, from bags/demo/day/table_noise, bags/demo/day/command_noise: "
    )
    assert of["designed"].startswith("<Design lqg3: a1, a2, a3 to U; gain margin ")
    more = [abrace.load_rig(RIG), abrace.load_record("el_centro"), notebook["found"].model, abrace.characterize(RIG)]
    more += [notebook["designed"].controller, abrace.validate(notebook["controlled"], notebook["found"])]
    for text in (*of.values(), *map(repr, more)):
        assert re.fullmatch(r"<[^\n]{20,250}>", text)
    assert repr(more[0]) == "<Rig ncree_three_storey: 3 floors, 2 braces, 500 Hz>"


def test_tables_are_what_was_measured_and_found(notebook):
    run, found = notebook["run"], notebook["found"]
    table = run.to_pandas()
    assert list(table) == ["x1", "x2", "x3", "xf", "a1", "a2", "a3", "f", "U", "w"]
    np.testing.assert_array_equal(table["a3"], run.channels(["acceleration[2]"])[:, 0])
    assert table.index[-1] == pytest.approx(63.998)
    poles = found.to_pandas()
    assert poles["frequency [Hz]"].iloc[0] == pytest.approx(1.17186, rel=1e-3)
    assert (poles["frequency low"] < poles["frequency [Hz]"]).all()
    assert (poles["frequency [Hz]"] < poles["frequency high"]).all()
    predicted = notebook["designed"].to_pandas()
    assert predicted.loc["x3", "ratio"] == pytest.approx(
        predicted.loc["x3", "controlled"] / predicted.loc["x3", "zero command"]
    )
    assert abrace.characterize(RIG).to_pandas().index.tolist() == ["bare"] * 3 + ["zero command"] * 3 + ["further"] * 3
    assert found.model.to_pandas()["damping ratio"].between(0, 0.1).all()


def test_every_figure_is_a_matplotlib_figure(notebook):
    found, designed = notebook["found"], notebook["designed"]
    for figure in (
        *(found.plot(what) for what in ("transfer_functions", "commands", "confidence", "validity", "reduction")),
        designed.plot(),
        notebook["run"].plot(),
        found.model.plot(["x3"], band=(0.5, 5.0)),
        abrace.load_record("el_centro").plot(),
        abrace.characterize(RIG).plot(),
        abrace.validate(notebook["controlled"], found).plot(["U"]),
    ):
        assert isinstance(figure, Figure)
        assert figure.axes
    with pytest.raises(abrace.AbraceError, match=r"^figure 'poels' of .*: expected one of "):
        found.plot("poels")


def test_a_model_simulates_what_the_rig_does_without_its_noise(notebook, saved):
    quake, found, designed = notebook["controlled"], notebook["found"], notebook["designed"]
    of_model = abrace.simulate(found, quake, controller=designed)
    assert (of_model.names, len(of_model.outputs)) == (quake.names, len(quake.outputs))
    # the node's force fades in within half a second
    assert np.corrcoef(of_model.channels(["x3"])[:, 0], quake.channels(["x3"])[:, 0])[0, 1] > 0.999
    check = abrace.validate(quake, found, controller=designed)
    assert check.to_pandas().loc["x3", "correlation"] > 0.999
    again = abrace.validate(quake, saved, controller=designed)
    assert again.to_pandas().equals(check.to_pandas()), "the folder of the results is as good as the object"


def test_a_folder_of_results_is_designed_with_as_the_identification_is(notebook, saved, tmp_path):
    folder = Path(shutil.copytree(saved, tmp_path / "model"))
    assert repr(abrace.design(folder, "lqg3").proof) == repr(notebook["designed"].proof)
    validity = json.loads((folder / "validity.json").read_text())
    (folder / "validity.json").write_text(json.dumps(validity | {"verdict": "don't trust", "causes": ["wrong unit"]}))
    for given in (folder, folder / "reduced.json"):
        with pytest.raises(abrace.AbraceError, match=r"says don't trust \(wrong unit\)"):
            abrace.design(given, "lqg3")


def test_a_model_to_be_sampled_or_written_can_be_what_has_it_or_a_name(notebook, tmp_path):
    found = notebook["found"]
    assert abrace.discretize(found, 0.002).order == abrace.discretize(found.model, 0.002).order
    assert abrace.discretize(RIG, 0.002).sample_period == 0.002
    abrace.save_model(found, tmp_path / "model.json")
    assert load_covariance(tmp_path / "model.json").shape == found.found.covariance.shape
    np.testing.assert_array_equal(abrace.load_model(tmp_path / "model.json").a, found.model.a)


def test_models_of_python_control_are_taken(notebook):
    found, quake = notebook["found"], notebook["controlled"]
    model = abrace.load_rig(RIG).model.to_control()
    assert abrace.validate(quake, model).to_pandas().loc["x3", "correlation"] > 0.999
    sampled = abrace.discretize(found.reduced, 0.002).to_control()
    assert isinstance(sampled, control.StateSpace)
    assert sampled.input_labels == ["w", "U"]


def test_a_model_without_a_channel_simulates_and_is_compared_by_the_others(notebook):
    found, quake, designed = notebook["found"], notebook["controlled"], notebook["designed"]
    without = found.model.select([name for name in found.model.outputs if name != "x3"])
    run = abrace.simulate(without, quake, controller=designed)
    whole = abrace.simulate(found, quake, controller=designed)
    assert run.names == tuple(name for name in whole.names if name != "x3")
    assert run.without == ("x3",)
    np.testing.assert_allclose(run.channels(["a3", "f"]), whole.channels(["a3", "f"]), rtol=1e-9, atol=1e-12)
    check = abrace.validate(quake, without, controller=designed)
    assert "trust with care" in repr(check)
    assert check.finding.meaning.endswith("not judged: x3 is not in the model")
    check.plot()
    of_another = control.ss(-1, [[1, 1]], 1, 0, inputs=["w", "U"], outputs=["y"])
    assert abrace.simulate(of_another, quake, sample_period=0.002).names == ("y",)


def test_an_ambient_test_gives_the_modes_of_the_building(notebook):
    assert abrace.identify_ambient(notebook["run"]).found.band[1] > 8.0, "without a band as the test shows it"
    modes = abrace.identify_ambient(notebook["run"], band=(0.5, 8.0))
    found = modes.to_pandas()["frequency [Hz]"]
    assert len(found) >= 2, "64 s are short"
    assert all(min(abs(value / true - 1) for true in (1.17186, 3.64993, 6.04221)) < 0.01 for value in found)
    assert repr(modes).endswith(" Hz, from 64 s of a1, a2, a3>")
    assert isinstance(modes.plot(), Figure)


def test_margins_and_matlab_files_of_a_design_and_weights_without_a_file(tmp_path):
    kinds = {"displacement": 1e9, "stroke": 0.0, "acceleration": 0.0, "force": 0.0, "command": 1.0}
    weights = abrace.Weights(measured=["a1", "a2", "a3"], weights=kinds, noise_to_excitation=0.1)
    found = abrace.design(RIG, weights, rig=RIG)
    assert abrace.margins(RIG, found) == found.proof.margins
    abrace.save_mat(found, tmp_path / "k.mat")
    assert abrace.load_controller(tmp_path / "k.mat") == found.controller
    model = abrace.load_rig(RIG).model
    abrace.save_mat(RIG, tmp_path / "model.mat")
    assert abrace.load_model(tmp_path / "model.mat") == model
    assert abrace.margins(tmp_path / "model.mat", found.controller) == found.proof.margins
    with pytest.raises(abrace.AbraceError, match=r"MATLAB file k\.m: expected a name that ends in \.mat"):
        abrace.save_mat(found, "k.m")


SHORT = {"record": "el_centro", "peak_acceleration": 0.98, "duration": 1.0}


def designed(**options):
    return abrace.design(RIG, "lqg3", rig=RIG, **options)


class Push:
    def begin(self, floors, groups, sample_period): ...

    def force(self, sample):
        return 1000.0 + sample.lost


def test_a_controller_of_python_control_and_a_function_close_the_loop_of_a_rig():
    design, motion = designed(), SHORT | {"duration": 6.0}
    law = design.controller.law.to_control()
    same = abrace.simulate(RIG, **motion, controller=design)
    # nothing but the observer's correction in the fade-in differs: some steps of the converter
    np.testing.assert_allclose(abrace.simulate(RIG, **motion, controller=law)["x3"], same["x3"], atol=2e-5)
    assert abrace.margins(RIG, law) == design.proof.margins
    assert abrace.margins(RIG, control.ss(law.A, law.B, law.C, law.D, law.dt, **_labels(law))) == design.proof.margins

    def damper(sample):
        return -2e4 * sample.displacement[0]

    run = abrace.simulate(RIG, **motion, controller=damper)
    assert run.source == f"{RIG}/el_centro/damper"
    # it acts from the next sample on, and until the one after
    np.testing.assert_allclose(run["U"][1002:], -2e4 * run["x1"][1000:-2], atol=1e-6)


def _labels(system):
    return {"inputs": system.input_labels, "outputs": system.output_labels}


def test_a_file_of_a_rig_is_taken_where_its_name_is(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text((ROOT / f"src/abrace_plant/config/{RIG}.yaml").read_text())
    design = abrace.design(path, "half", rig=path)
    assert abrace.margins(str(path), design) == abrace.margins(RIG, design)
    assert abrace.discretize(path, 0.002) == abrace.discretize(RIG, 0.002)


def test_tables_go_to_files_of_other_programs_and_to_a_notebook(tmp_path):
    run, rig = abrace.simulate(RIG, **SHORT), abrace.characterize(RIG)
    run.to_csv(tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().startswith("time [s],x1,x2,x3,xf,a1,a2,a3,f,U,w\n0.0,")
    run.to_mat(tmp_path / "run.mat")
    found = scipy.io.loadmat(tmp_path / "run.mat")
    np.testing.assert_array_equal(found["time_s"][:, 0], run.time)
    np.testing.assert_array_equal(found["x3"][:, 0], run["x3"])
    rig.to_json(tmp_path / "rig.json")
    assert json.loads((tmp_path / "rig.json").read_text())["frequency [Hz]"] == list(rig.to_pandas()["frequency [Hz]"])
    shown = run._repr_html_()
    assert shown.startswith(f"<p>&lt;Run {RIG}/el_centro: 1 s at 500 Hz")
    assert shown.count("<tr") < 30
    for write, name in ((run.to_csv, "run.xlsx"), (rig.to_json, "rig.csv"), (rig.to_mat, "rig")):
        with pytest.raises(abrace.AbraceError, match=f"file {name}: expected a name that ends in "):
            write(name)
    abrace.save_model(RIG, tmp_path / "model.mat")
    assert abrace.load_model(tmp_path / "model.mat") == abrace.load_rig(RIG).model
    with pytest.raises(abrace.AbraceError, match=r"model file m\.txt: expected a name that ends in \.json or \.mat"):
        abrace.save_model(RIG, "m.txt")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: abrace.simulate(RIG, **SHORT, controller=control.ss(-1.0, 1.0, 1.0, 0.0, name="K")),
            "controller K: continuous, expected a discrete one",
        ),
        (
            lambda: abrace.simulate(RIG, **SHORT, controller=lambda _: "much"),
            "<lambda>.force: returned 'much', expected a number for each of 1 brace groups",
        ),
        (
            lambda: abrace.load_rig("ncree"),
            "rig 'ncree': unknown, expected a file ending in .yaml or one of five_storey",
        ),
        (lambda: abrace.load_record("elcentro"), "no such file, and no such name (names: el_centro"),
        (lambda: abrace.simulate(RIG), "simulate: neither record nor command, expected at least one"),
        (
            lambda: abrace.simulate(RIG, **SHORT, lowcut=0.1, taber=1.0),
            "lowcut: unknown key, did you mean low_cut?; taber: ",
        ),
        (lambda: abrace.simulate(RIG, "el_centro", peak_acceleration=30.0), "exceeds the table's limits: "),
        (lambda: abrace.simulate(RIG, command=np.zeros((9, 2))), "command of shape (9, 2), expected (samples, 1)"),
        (lambda: abrace.simulate(RIG, **SHORT, command="noise"), "command 'noise', expected an array or 'white_noise'"),
        (lambda: abrace.simulate(RIG, **SHORT, command=[0.0], controller="lqg.yaml"), "command, expected one of them"),
        (lambda: abrace.Weights(measured=["a1"]), "weights: weights: key is missing; noise_to_excitation: key is"),
        (lambda: abrace.design(RIG, {"measured": ["a1"]}), "weights: weights: key is missing"),
        (lambda: abrace.design(RIG, rig=3), "rig '3': unknown"),
        (lambda: abrace.design(RIG, check_models=3), "check_models 3: expected models by name"),
        (lambda: abrace.explore(RIG, displacment=(0, 1)), "exploration: displacment: unknown key, did you mean disp"),
        (lambda: abrace.save_mat(RIG, 3), "MATLAB file 3: expected a name that ends in .mat"),
        (lambda: abrace.design(abrace.load_rig(RIG), "lqg9"), "weights 'lqg9': unknown, expected a file"),
        (
            lambda: abrace.design(abrace.load_rig(RIG).model.select(inputs=["w", "U"]).to_control()),
            "sample_period: not given, and the model's file does not have it, expected s, or a rig in Python",
        ),
        (lambda: abrace.validate("nowhere", RIG), "nowhere: "),
        (lambda: abrace.validate(abrace.simulate(RIG, **SHORT), 3), "model 3: expected a model, a file (.json)"),
        (lambda: abrace.validate(None, RIG), "test None: expected a Test, a Run, or the folder of a bag"),
        (lambda: abrace.validate([], RIG), "no test given, expected at least one"),
        (lambda: abrace.discretize(RIG, 0.0), "discretize: sample_period 0.0, expected more than 0 s"),
        (lambda: abrace.discretize(RIG, 0.002, {"w": "frist"}), "discretize: hold 'frist', expected zero or first"),
        (lambda: abrace.simulate(RIG, **SHORT, sample_period=0.01), "sample_period 0.01, expected 0.002 s"),
        (lambda: abrace.simulate(RIG, "white_noise", duration=9.0, low_cut=0.5), "a treatment of 'white_noise'"),
        (lambda: abrace.simulate(RIG, ["a", "b"]), "simulate: record ['a', 'b']: expected numbers"),
        (lambda: abrace.simulate(RIG, np.zeros((9, 2))), "of shape (9, 2), expected (samples,)"),
        (lambda: abrace.simulate(RIG, command=[np.inf]), "a command that is not finite, expected forces in N"),
        (lambda: abrace.simulate(RIG, **SHORT, controller=Push), "controller Push is a class, expected Push(...)"),
        (
            lambda: abrace.simulate(RIG, **SHORT, controller=3),
            "controller 3: expected a controller, its file, a design",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(call, message):
    with pytest.raises(abrace.AbraceError) as error:
        call()
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_one_name_needs_no_list():
    run = abrace.simulate(RIG, **SHORT)
    np.testing.assert_array_equal(run.channels("x3"), run.channels(["x3"]))
    assert run.channels([]).shape == (500, 0)
    assert len(run.plot("a3").axes) == 1
    assert abrace.load_rig(RIG).model.select("x3", "w").outputs == ("x3",)
    with pytest.raises(abrace.AbraceError, match=r"^data: no column 'w9', it has x1, x2"):
        abrace.identify_data(run.to_pandas(), "w9", "x3", sample_rate=500.0)


def test_a_test_that_is_played_again_and_a_command_are_treated_as_asked():
    first = abrace.simulate(RIG, "el_centro", peak_acceleration=0.98, duration=3.0)
    again = abrace.simulate(RIG, first)
    # the table plays the sample that it is told one sample later
    assert np.corrcoef(first.ground_acceleration[:-1], again.ground_acceleration[1:])[0, 1] > 0.999
    halved = abrace.simulate(RIG, first, peak_acceleration=0.3, duration=2.9, low_cut=0.3)
    assert len(halved.sequence) == 1450
    assert 0.25 < np.abs(halved.ground_acceleration).max() < 0.31
    assert len(abrace.simulate(RIG, command=np.full(900, 100.0), duration=1.0).sequence) == 500


def test_a_rig_that_was_stopped_is_a_warning(tmp_path):
    class Runaway:
        """Pushes with the motion."""

        last = 0.0

        def begin(self, floors, groups, sample_period): ...

        def force(self, sample):
            moved, self.last = sample.displacement[0] - self.last, sample.displacement[0]
            return 24e3 * np.sign(moved)

    cause = "jumps of fa: 0.219 of the range"
    with pytest.warns(UserWarning, match=f"{RIG}/el_centro/Runaway: the rig was stopped: {re.escape(cause)}"):
        run = abrace.simulate(RIG, "el_centro", peak_acceleration=0.98, duration=6.0, controller=Runaway())
    assert run.command[-1] == 0
    assert run.stopped.startswith(cause)
    assert f"; STOPPED: {cause}" in repr(run)
    write_bag(run, tmp_path / "stopped")
    with pytest.warns(UserWarning, match="the rig was stopped: "):
        assert abrace.read_run(tmp_path / "stopped").stopped == run.stopped


@pytest.mark.filterwarnings("ignore:.*the rig was stopped")
def test_a_clipped_sensor_is_a_warning_that_names_the_run():
    with pytest.warns(UserWarning, match=f"{RIG}/el_centro: w: 39 samples at the end of its range"):
        run = abrace.simulate(RIG, "el_centro", peak_acceleration=2.5, duration=20.0)
    assert repr(run).endswith("; CLIPPED: w 39 samples>")


def test_the_first_calls_of_a_user_of_matlab_work_or_name_the_right_one(notebook):
    run, found, designed = (notebook[name] for name in ("run", "found", "designed"))
    # channels and seconds of a test
    assert (run["x3"] == run.channels(["x3"])[:, 0]).all()
    assert run["x1", "a1"].shape == (len(run.time), 2)
    part = run[10:20]
    assert (part.time[0], len(part.time), len(part.outputs)) == (10.0, 5000, 5000)
    assert (part["a2"] == run["a2"][(run.time >= 10) & (run.time < 20)]).all()
    with pytest.raises(AttributeError, match=r"expected run\['x3'\] for the channel"):
        run.x3  # noqa: B018
    with pytest.raises(abrace.AbraceError, match="no sample of 100 to 200 s"):
        run[100:200]
    for wrong in (slice("a", 3), slice(2, 1), slice(float("nan"), 2)):
        with pytest.raises(abrace.AbraceError, match="expected"):
            run[wrong]
    # matrices, poles and margins on every level
    assert found.A.shape == (found.model.order, found.model.order)
    assert (found.poles == found.model.poles).all()
    assert abs(found.poles[-1]) >= abs(found.poles[0])
    assert designed.controller.poles.real.max() < 0
    assert designed.poles.real.max() < 0
    assert abrace.margins(found.reduced, designed).gain_db >= designed.margins.gain_db
    # a model with a delay goes to python-control and is drawn
    assert found.reduced.to_control().nstates == found.reduced.order + 2 * sum(map(bool, found.reduced.input_delay))
    for drawn, axes in (
        (found.reduced.bode(["x3", "a1"]), 4),
        (found.reduced.step(["x3"], ["U"], 5.0), 1),
        (found.model.compare(run[:10]), 4),
    ):
        assert isinstance(drawn, Figure)
        assert len(drawn.axes) == axes


def test_bode_and_step_draw_the_numbers_of_the_model():
    model = abrace.load_rig(RIG).model
    one = model.select(["x1"], ["U"])
    gain, phase = (axis.lines[0] for axis in model.bode(["x1"], ["U"], (1.0, 5.0)).axes)
    response = one.frequency_response(2 * np.pi * gain.get_xdata())[:, 0, 0]
    np.testing.assert_allclose(gain.get_ydata(), np.abs(response), rtol=1e-9)
    response = one.frequency_response(2 * np.pi * phase.get_xdata())[:, 0, 0]
    turned = np.exp(1j * np.radians(phase.get_ydata()))
    np.testing.assert_allclose(turned, response / np.abs(response), atol=1e-9)
    (step,) = (axis.lines[0] for axis in model.step(["x1"], ["U"], 60.0).axes)
    at_rest = (one.d - one.c @ np.linalg.solve(one.a, one.b))[0, 0]
    assert (step.get_xdata()[0], step.get_xdata()[-1]) == (0.0, pytest.approx(60.0))
    assert step.get_ydata()[-1] == pytest.approx(at_rest, rel=0.01)


@pytest.mark.parametrize(
    ("name", "right"),
    [("read_bag", "read_run"), ("tfestimate", "transfer_functions"), ("lqg", "design"), ("c2d", "discretize")],
)
def test_a_name_of_matlab_tells_the_one_here(name, right):
    with pytest.raises(AttributeError, match=f"no attribute '{name}', expected .*{right}"):
        getattr(abrace, name)


def test_tab_completion_tells_what_a_package_has():
    expected = {"core": "model", "node": "parameters", "bags": "read_run", "plant": "nodes", "sysid": "nodes"}
    expected |= {"lqg": "loop", "studies": "fragility"}
    code = (
        "import importlib, sys\nfor name in sys.argv[1:]:\n    print(*dir(importlib.import_module(f'abrace_{name}')))"
    )
    ran = subprocess.run([sys.executable, "-c", code, *expected], capture_output=True, text=True, check=True)
    for (package, name), line in zip(expected.items(), ran.stdout.splitlines(), strict=True):
        assert name in line.split()
        assert ("AbraceError" in line.split()) == (package == "core")
        assert all(hasattr(importlib.import_module(f"abrace_{package}"), each) for each in line.split())


def test_the_import_costs_nothing_until_a_name_is_used():
    code = (
        "import sys, abrace; print(*sorted({'numpy', 'scipy', 'pydantic', 'matplotlib', 'pandas'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == ""
    assert set(abrace.__all__) <= set(dir(abrace))
    assert all(getattr(abrace, name) is not None for name in abrace.__all__)


def test_a_file_is_simulated_as_it_is_read_and_a_refusal_names_the_arguments_that_simulate_has(tmp_path):
    path = tmp_path / "one.th"
    np.savetxt(path, 0.01 * np.sin(0.3 * np.arange(200)) * np.hanning(200))
    given = {"unit": "g", "record_sample_period": 0.02, "low_cut": 0.3, "channel": 1}
    run = abrace.simulate(RIG, path, **given)
    assert len(run.ground_acceleration) == 1991  # 199 steps of 0.02 s at 500 Hz
    with pytest.raises(abrace.AbraceError, match=r"no times in the file, expected record_sample_period in s$"):
        abrace.simulate(RIG, path, unit="g")
    with pytest.raises(abrace.AbraceError, match="channel of ndarray, expected of a file"):
        abrace.simulate(RIG, np.zeros(10), channel="a")


def test_a_table_is_an_ambient_test(tmp_path):
    random = np.random.default_rng(1)
    model = abrace.LinearModel(
        np.array([[0.0, 1.0], [-100.0, -0.4]]),
        np.array([[0.0], [1.0]]),
        np.eye(2)[:1],
        np.zeros((1, 1)),
        ("u",),
        ("y",),
    )
    y = simulate_model(abrace.discretize(model, 0.02, {}), random.standard_normal((20_000, 1)))
    table = np.column_stack([20.0 * np.arange(len(y)), y, y + 0.1 * y.std() * random.standard_normal(y.shape)])
    np.savetxt(tmp_path / "wind.csv", table, delimiter=",", header="t [ms],top [g],middle [g]", comments="", fmt="%.6g")
    of_file = abrace.identify_ambient(tmp_path / "wind.csv", ["top", "middle"], time="t", band=(0.5, 8.0))
    of_arrays = abrace.identify_ambient({"top": y[:, 0]}, sample_rate=50.0, band=(0.5, 8.0))
    for found in (of_file, of_arrays):
        assert min(abs(mode.frequency / 10.0 - 1) for mode in found.found.modes) < 0.01


@pytest.mark.parametrize("controller", [Push(), "lqg3"])
def test_a_reading_that_is_not_finite_is_an_error_that_names_it(monkeypatch, controller):
    exchange, count = SimulatedRig.exchange, iter(range(10**6))

    def broken(self, *arguments):
        reading = exchange(self, *arguments)
        if next(count) == 400:
            reading.values[5] = np.nan  # x1, x2, x3, xf, a1, a2
        return reading

    monkeypatch.setattr(SimulatedRig, "exchange", broken)
    given = designed() if controller == "lqg3" else controller
    with pytest.raises(abrace.AbraceError, match=r"^acceleration\[1\] of sample \d+ is nan, expected a finite number$"):
        abrace.simulate(RIG, **SHORT, controller=given)
