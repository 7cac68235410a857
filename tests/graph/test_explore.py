# SPDX-License-Identifier: Apache-2.0
"""The node `explore` as a process: from models to a trade-off, a controller of it, and an end that leaves nothing."""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from abrace.processes.group import find_executable
from abrace_core.controller_file import load_controller
from abrace_core.linear_model import LinearModel, save_model
from abrace_core.node import find_file
from abrace_lqg.batches.parts import read_parts
from abrace_lqg.weights import KindWeights, Weights, save_weights
from abrace_plant.rig.file import load_rig


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """The rig's own model."""
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    path = tmp_path_factory.mktemp("model") / "rig.json"
    save_model(rig.model, path)
    return path


def command(**parameters: object) -> list[str]:
    given = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    return [str(find_executable("abrace_lqg", "explore")), "--ros-args", *given]


def run_node(**parameters: object) -> subprocess.CompletedProcess:
    return subprocess.run(command(**parameters), capture_output=True, text=True, timeout=120, check=False)


def members(session: int) -> list[str]:
    """The running processes of a session."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of_session = status.read_text().rpartition(")")[2].split()[:4]
        except OSError:  # it ended meanwhile
            continue
        if int(of_session) == session and state != "Z":
            found.append(status.parent.name)
    return found


def test_sets_are_tried_drawn_and_picked(model, tmp_path):
    ended = run_node(
        model=model, simulation_model=model, sets=7, noise="[1, 2]", noise_duration=10.0, output=tmp_path / "found"
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    assert "8 sets of weights, 2 loops each: 16 closed loops" in ended.stdout
    assert re.search(r"exploration: done in \d:\d\d, 8 of 8 sets", ended.stdout)
    content = json.loads((tmp_path / "found/exploration.json").read_text())
    assert [each["number"] for each in content["sets"]] == list(range(8))
    assert content["sets"][0]["relative"]["x3"]["rms"] < 0.8
    assert (tmp_path / "found/trade_off.png").stat().st_size > 10_000
    assert (tmp_path / "found/robust.png").stat().st_size > 10_000
    assert len((tmp_path / "found/exploration.csv").read_text().splitlines()) == 9

    short = ["abrace", "explore", f"output:={tmp_path / 'found'}", "pick:=0"]
    ended = subprocess.run(short, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stderr
    assert load_controller(tmp_path / "found/set_0.yaml").law.inputs == ("a1", "a2", "a3")


def test_weights_are_ranked_over_models_intensities_and_faults(tmp_path):
    a = np.array([[-0.2, 10.0], [-10.0, -0.2]])
    c = np.array([[0.0, 0.1], [1.0, -10.0]])
    model = LinearModel(a, [[0.1, 0.0], [-1.0, 1e-3]], c, [[0.0, 0.0], [0.0, 1e-3]], ("w", "U"), ("x1", "a1"))
    covariance = np.zeros((16, 16))
    covariance[1, 1] = 0.25
    save_model(model, tmp_path / "model.json", covariance)
    given = {"model": tmp_path / "model.json", "simulation_model": tmp_path / "model.json", "sets": 2, "noise": 1}
    given |= {"weights": tmp_path / "weights.yaml", "noise_duration": 10.0, "output": tmp_path / "found"}
    given |= {"sample_period": 0.01, "force_limit": "[500.0]", "peak_acceleration": "[0.5, 2.0]", "models": 3}
    kinds = KindWeights(displacement=1e8, stroke=0.0, acceleration=0.0, force=0.0, command=1.0)
    save_weights(Weights(measured=["a1"], weights=kinds, noise_to_excitation=0.1), tmp_path / "weights.yaml", "")
    ended = run_node(**given, acceleration="[0.0, 0.0]", faults="[a1=0, a1=1.1]", interlocks="[x1=0.02]", quantile=0.75)
    assert ended.returncode == 0, ended.stderr
    assert "3 sets of weights, 18 loops each: 54 closed loops" in ended.stdout
    assert "robust: 0.75 of 18 loops respond no more" in ended.stdout
    assert "most robust, with no more command rms than the given weights" in ended.stdout
    content = json.loads((tmp_path / "found/exploration.json").read_text())
    assert (content["models"], content["faults"], content["quantile"]) == (3, ["a1=0", "a1=1.1"], 0.75)
    assert content["intensities"] == [0.5, 2.0]
    assert all(each["loops"] == 18 for each in content["sets"])
    loops = read_parts(tmp_path / "found/loops").to_pandas()
    assert len(loops) == 54
    assert len(loops.groupby(["set", "model", "fault", "intensity"])) == 54
    tripped = loops[loops.interlock == "x1"]
    assert len(tripped) == sum(each["interlocked"] for each in content["sets"])
    assert set(tripped.intensity) <= {2.0}


def test_ctrl_c_ends_the_node_and_its_processes_and_says_so(model, tmp_path):
    output = tmp_path / "found"
    exploring = command(model=model, simulation_model=model, sets=4000, noise=1, noise_duration=10.0, output=output)
    with subprocess.Popen(
        exploring, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as node:
        assert node.stdout is not None
        assert "4001 sets" in node.stdout.readline()
        while len(members(node.pid)) < 3:  # the node, the tracker of multiprocessing, a process of Dask
            assert node.poll() is None
        os.killpg(node.pid, signal.SIGINT)  # as a terminal does: the processes get it too
        _, errors = node.communicate(timeout=120)
    assert node.returncode == 0, errors
    assert errors == "explore: stopped before it was done\n"
    deadline = time.monotonic() + 60.0
    while left := members(node.pid):  # the tracker ends when it finds the node gone
        assert time.monotonic() < deadline, f"processes {left} are left"
    assert not (output / "exploration.json").exists()


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"output": "o"}, "parameter model: not given, expected -p model:=FILE"),
        ({"output": "o", "pick": 1}, "o/exploration.json: No such file"),
        (
            {"output": "o", "noise": 1, "scheduler": "tcp://127.0.0.1:1"},
            "Dask scheduler tcp://127.0.0.1:1: does not answer",
        ),
        ({"output": "o", "sets": 2}, "no records"),
        ({"output": "o", "stroke": "[-1.0, 1.0]"}, "span of stroke"),
        ({"output": "o", "force": "[-1.0]"}, "parameter force: [-1.0], expected two numbers"),
        ({"output": "o", "noise": 1, "faults": "a1"}, "parameter faults: a1: expected NAME=NUMBER, such as a1=0"),
        ({"output": "o", "noise": 1, "interlocks": "q=1"}, "interlock q: the model has no such quantity"),
        ({"output": "o", "bags": "no_bag"}, "no_bag: no such bag"),
        ({"output": "o", "noise": 1, "measured": "a9"}, "weights: measured: a9, expected some of x1"),
    ],
)
def test_wrong_input_gives_one_line_exit_code_2_and_writes_nothing(model, tmp_path, monkeypatch, parameters, expected):
    monkeypatch.chdir(tmp_path)
    models = {} if len(parameters) == 1 or "pick" in parameters else {"model": model, "simulation_model": model}
    ended = run_node(**models, **parameters)
    assert ended.returncode == 2
    assert expected in ended.stderr
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert not list(tmp_path.iterdir())
