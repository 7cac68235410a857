# SPDX-License-Identifier: Apache-2.0
"""`import abrace`: notebook and page are run where there is no ROS, and what they give is looked at."""

import inspect
import json
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import control
import numpy as np
import pandas
import pytest
from matplotlib.figure import Figure

import abrace
from abrace_core.linear_model import load_covariance

ROOT = Path(__file__).parents[2]
RIG = "ncree_three_storey"
NOTEBOOK, PAGE = ROOT / "docs/from_bag_to_controller.ipynb", ROOT / "docs/python.md"
TUTORIAL = ROOT / "docs/paper.md"
WITHOUT_ROS = """
import ast, pickle, sys

class NoRos:
    def find_spec(self, name, *_):
        if name.split(".")[0] in ("rclpy", "rcl_interfaces", "ament_index_python", "abrace_interfaces", "std_msgs"):
            raise ImportError(f"no ROS: {name}")

sys.meta_path.insert(0, NoRos())
import abrace
from abrace_core.linear_model import load_covariance
from bag_of_run import write_bag

write_bag(abrace.simulate("ncree_three_storey", "white_noise", duration=64.0), "bags/table_noise")
write_bag(abrace.simulate("ncree_three_storey", command="white_noise", duration=64.0), "bags/command_noise")
names, done = {}, set()
for statement in ast.parse(open("code.py").read()).body:
    if ast.dump(statement) not in done:  # the pages begin as the notebook does
        exec(compile(ast.Module([statement], []), "code.py", "exec"), names)
    done.add(ast.dump(statement))
kept = ("run", "found", "designed", "free", "controlled", "modes", "peaks", "check")
pickle.dump({name: names[name] for name in kept}, open("names.pickle", "wb"))
"""
"""Makes the bags of the notebook, runs it and the pages where nothing of ROS can be imported, and leaves its names."""


def code_of_notebook() -> list[str]:
    """Its lines; those for Jupyter alone and empty ones left out."""
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells), "outputs are not kept"
    lines = [line for cell in cells for line in "".join(cell["source"]).splitlines()]
    return [line for line in lines if line and not line.startswith("%")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the notebook was run, then the page and the tutorial on the paper."""
    folder = tmp_path_factory.mktemp("laboratory")
    pages = [
        code for page in (PAGE, TUTORIAL) for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    ]
    (folder / "code.py").write_text("\n".join([*code_of_notebook(), *pages]))
    ran = subprocess.run([sys.executable, "-c", WITHOUT_ROS], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    (folder / "printed.txt").write_text(ran.stdout)
    return folder


@pytest.fixture(scope="module")
def notebook(folder) -> dict[str, Any]:
    """The names that the notebook and the page leave."""
    return pickle.loads((folder / "names.pickle").read_bytes())


def test_the_notebook_goes_from_bags_to_a_controller_in_20_lines(notebook, folder):
    assert len(code_of_notebook()) <= 20
    top = {name: notebook[name].to_pandas()["x3"].std() for name in ("free", "controlled")}
    assert top["controlled"] < 0.4 * top["free"]
    assert abrace.load_controller(folder / "results/lqg3.yaml").law.inputs == ("a1", "a2", "a3")
    assert (folder / "results/lqg3_proof.json").is_file()


def test_every_result_prints_in_one_line(notebook):
    of = {name: repr(notebook[name]) for name in ("run", "found", "designed", "controlled")}
    assert of["run"] == "<Run bags/table_noise: 64 s at 500 Hz, 3 floors, 1 brace group>"
    assert of["found"].startswith("<Identified: 14 states, reduced to 8, from bags/table_noise, bags/command_noise: ")
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
        *(designed.plot(what) for what in ("loop", "poles", "prediction")),
        notebook["run"].plot(),
        found.model.plot(["x3"], band=(0.5, 5.0)),
        abrace.load_record("el_centro").plot(),
        abrace.characterize(RIG).plot(),
        abrace.validate(notebook["controlled"], found).plot(["U"]),
    ):
        assert isinstance(figure, Figure)
        assert figure.axes
    for thing in (found, designed):
        with pytest.raises(abrace.AbraceError, match=r"^figure 'poels' of .*: expected one of "):
            thing.plot("poels")


def test_a_model_simulates_what_the_rig_does_without_its_noise(notebook, tmp_path):
    quake, found, designed = notebook["controlled"], notebook["found"], notebook["designed"]
    of_model = abrace.simulate(found, quake, controller=designed)
    assert (of_model.names, len(of_model.outputs)) == (quake.names, len(quake.outputs))
    # the node's force fades in within half a second
    assert np.corrcoef(of_model.channels(["x3"])[:, 0], quake.channels(["x3"])[:, 0])[0, 1] > 0.999
    check = abrace.validate(quake, found, controller=designed)
    assert check.to_pandas().loc["x3", "correlation"] > 0.999
    saved = abrace.validate(quake, found.save(tmp_path / "model"), controller=designed)
    assert saved.to_pandas().equals(check.to_pandas()), "the folder of the results is as good as the object"


def test_a_folder_of_results_is_designed_with_as_the_identification_is(notebook, tmp_path):
    found = notebook["found"]
    folder = Path(found.save(tmp_path / "model"))
    of_folder, of_object = (abrace.design(each, "lqg3") for each in (folder, found))
    assert repr(of_folder.proof) == repr(of_object.proof)
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


def test_an_ambient_test_gives_the_modes_of_the_building(notebook):
    modes = abrace.identify_ambient(notebook["run"], band=(0.5, 8.0))
    found = modes.to_pandas()["frequency [Hz]"]
    assert len(found) >= 2, "64 s are short"
    assert all(min(abs(value / true - 1) for true in (1.17186, 3.64993, 6.04221)) < 0.01 for value in found)
    assert repr(modes).endswith(" Hz, from 64 s of a1, a2, a3>")
    assert isinstance(modes.plot(), Figure)


def test_frames_are_identified(notebook):
    frame = notebook["run"].to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    with pytest.raises(abrace.AbraceError, match=r"^data: no column 'ground', 'x9', it has x1, x2"):
        abrace.identify_data(frame, ["ground"], ["x1", "x9"], sample_rate=500.0)


RUN = "bags/table_noise"
SHORT = {"record": "el_centro", "peak_acceleration": 0.98, "duration": 1.0}


def designed(**options):
    return abrace.design(RIG, "lqg3", rig=RIG, **options)


def assessed(**options):
    return abrace.fragility(RIG, **{"limits": {"x3": 0.05}, "intensities": [1.0], "noise": 1, **options})


class Push:
    def begin(self, floors, groups, sample_period): ...

    def force(self, sample):
        return 1000.0 + sample.lost


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: abrace.load_rig("ncree"),
            "rig 'ncree': unknown, expected a file ending in .yaml or one of five_storey",
        ),
        (lambda: abrace.load_record("elcentro"), "no such file, and no such name (names: el_centro"),
        (lambda: abrace.simulate(RIG), "simulate: neither record nor command, expected at least one"),
        (lambda: abrace.simulate(RIG, **SHORT, lowcut=0.1, taber=1.0), "simulate: lowcut, taber: unknown, expected a"),
        (lambda: abrace.simulate(RIG, "el_centro", peak_acceleration=30.0), "exceeds the table's limits: "),
        (lambda: abrace.simulate(RIG, command=np.zeros((9, 2))), "command of shape (9, 2), expected (samples, 1)"),
        (lambda: abrace.simulate(RIG, **SHORT, command="noise"), "command 'noise', expected an array or 'white_noise'"),
        (lambda: abrace.simulate(RIG, **SHORT, command=[0.0], controller="lqg.yaml"), "command, expected one of them"),
        (lambda: abrace.design(abrace.load_rig(RIG), "lqg9"), "weights 'lqg9': unknown, expected a file"),
        (
            lambda: abrace.design(abrace.load_rig(RIG).model.select(inputs=["w", "U"]).to_control()),
            "design: sample_period: not given, and the model's file does not have it, expected s; or give the rig",
        ),
        (lambda: abrace.validate("nowhere", RIG), "nowhere: "),
        (lambda: abrace.validate(abrace.simulate(RIG, **SHORT), 3), "model 3: expected a model, a file (.json)"),
        (lambda: abrace.validate(None, RIG), "test None: expected a Run, or the folder of its bag"),
        (lambda: abrace.validate([], RIG), "no test given, expected at least one"),
        (
            lambda: abrace.identify_data({"w": [1.0] * 9, "x": [1.0] * 9}, "w", sample_rate=9.0, band=5.0),
            "band 5.0: exp",
        ),
        (lambda: abrace.identify(RUN, RUN, table_band=(0.1, None)), "band (0.1, None): expected two frequencies in Hz"),
        (lambda: designed(limits={"gain": 1.0}), "design: limits: gain: unknown key"),
        (
            lambda: designed(limits={"gain_margin": np.nan}),
            "design: limits: gain_margin: nan, expected a finite number",
        ),
        (lambda: designed(accept="small_gain_margins"), "accept 'small_gain_margins': expected one of damping_lost, "),
        (lambda: designed(force_limit="24 kN"), "design: force_limit '24 kN', expected a number"),
        (lambda: assessed(limits={"x3": "5 cm"}), "limits x3='5 cm': expected a value above 0 for some of x1"),
        (lambda: assessed(noise=["a"]), "noise 'a': expected seeds, whole numbers from 0 on"),
        (lambda: assessed(noise_duration=np.nan), "noise_duration nan: expected seconds above 0"),
        (lambda: abrace.discretize(RIG, 0.0), "discretize: sample_period 0.0, expected more than 0 s"),
        (lambda: abrace.discretize(RIG, 0.002, {"w": "frist"}), "discretize: hold 'frist', expected zero or first"),
        (lambda: abrace.simulate(RIG, **SHORT, seed=-1), "simulate: seed -1, expected a whole number from 0 on"),
        (lambda: abrace.simulate(RIG, **SHORT, sample_period=0.01), "sample_period 0.01, expected 0.002 s"),
        (lambda: abrace.simulate(RIG, "white_noise", duration=9.0, low_cut=0.5), "a treatment of 'white_noise'"),
        (lambda: abrace.simulate(RIG, "white_noise", duration=np.nan), "duration nan: expected 0 or more"),
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
    data = abrace.identify_data
    with pytest.raises(abrace.AbraceError, match="no column 'w9', it has"):
        data({"w": np.ones(9), "x3": np.ones(9)}, "w9", "x3", sample_rate=100.0)


def test_a_test_that_is_played_again_and_a_command_are_treated_as_asked():
    first = abrace.simulate(RIG, "el_centro", peak_acceleration=0.98, duration=3.0)
    again = abrace.simulate(RIG, first)
    # the table plays the sample that it is told one sample later
    assert np.corrcoef(first.ground_acceleration[:-1], again.ground_acceleration[1:])[0, 1] > 0.999
    halved = abrace.simulate(RIG, first, peak_acceleration=0.3, duration=2.9, low_cut=0.3)
    assert len(halved.sequence) == 1450
    assert 0.25 < np.abs(halved.ground_acceleration).max() < 0.31
    assert len(abrace.simulate(RIG, command=np.full(900, 100.0), duration=1.0).sequence) == 500


def test_a_rig_that_was_stopped_is_a_warning():
    class Runaway:
        def begin(self, floors, groups, sample_period): ...

        def force(self, sample):
            return 24e3 * np.sign(sample.displacement[0] - 1e-4)

    with pytest.warns(UserWarning, match="the rig was stopped: "):
        run = abrace.simulate(RIG, "el_centro", peak_acceleration=0.98, duration=6.0, controller=Runaway())
    assert run.command[-1] == 0


def test_the_page_runs_where_there_is_no_ros(notebook, folder):
    peaks = notebook["peaks"]
    assert peaks["LQG3"] < 0.6 * peaks["zero command"]
    assert peaks["damper"] < 0.8 * peaks["zero command"]
    found = notebook["modes"].to_pandas()["frequency [Hz]"]
    assert found.tolist() == pytest.approx([1.17186, 3.64993, 6.04221], rel=1e-3)
    assert (folder / "validity.png").stat().st_size > 10_000


def test_the_tutorial_on_the_paper_runs_where_there_is_no_ros(folder):
    printed = (folder / "printed.txt").read_text()
    assert "x3: " in printed
    assert ", the paper's experiment 2.488 cm" in printed


def test_the_page_has_every_function_with_its_arguments():
    (block,) = re.findall(r"```text\n(.*?)```", PAGE.read_text(), re.DOTALL)
    stated = dict(re.findall(r"^(\w+)(\(.*\))$", block, re.MULTILINE))
    functions = {name: getattr(abrace, name) for name in abrace.__all__ if inspect.isroutine(getattr(abrace, name))}
    for name, function in functions.items():
        parameters = inspect.signature(function).parameters.values()
        bare = [each.replace(annotation=inspect.Parameter.empty) for each in parameters]
        assert stated.pop(name) == str(inspect.Signature(bare)), name
    assert not stated


def test_the_import_costs_nothing_until_a_name_is_used():
    code = (
        "import sys, abrace; print(*sorted({'numpy', 'scipy', 'pydantic', 'matplotlib', 'pandas'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == ""
    assert set(abrace.__all__) <= set(dir(abrace))
    assert all(getattr(abrace, name) is not None for name in abrace.__all__)
