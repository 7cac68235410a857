# SPDX-License-Identifier: Apache-2.0
import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from forked_matlab import matlab_files_by_forks  # noqa: F401
from scipy.io import loadmat, savemat

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, load_model, pole_table, save_mat, save_model

OMEGA, ZETA = 7.3, 0.02


def oscillator(**change: object) -> LinearModel:
    """x'' + 2 zeta omega x' + omega^2 x = u1 + 3 u2, with outputs x, x' and the acceleration less u1."""
    a = np.array([[0.0, 1.0], [-(OMEGA**2), -2 * ZETA * OMEGA]])
    b = np.array([[0.0, 0.0], [1.0, 3.0]])
    c = np.vstack([np.eye(2), a[1]])
    d = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 3.0]])
    arguments = {"a": a, "b": b, "c": c, "d": d, "inputs": ("u1", "u2"), "outputs": ("x", "v", "r")} | change
    return LinearModel(**arguments)


def test_poles_are_those_of_the_oscillator():
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    np.testing.assert_allclose(
        np.sort_complex(oscillator().poles), [-ZETA * OMEGA - 1j * damped, -ZETA * OMEGA + 1j * damped]
    )
    (frequency, ratio), *others = pole_table(oscillator().poles)
    assert (frequency, ratio) == pytest.approx((OMEGA, ZETA))
    assert not others


def test_pole_table_is_slowest_first_and_leaves_real_poles_out():
    poles = np.array([-3.0, -1 + 20j, -1 - 20j, -0.1 + 5j, -0.1 - 5j, -1e-3 + 0j])
    table = np.array(pole_table(poles))
    np.testing.assert_allclose(table[:, 0], np.abs([-0.1 + 5j, -1 + 20j]))
    np.testing.assert_allclose(table[:, 1], [0.1 / abs(-0.1 + 5j), 1 / abs(-1 + 20j)])


@pytest.mark.parametrize(("pole", "stable"), [(-1e-6, True), (0.0, False), (1e-3, False)])
def test_stability_is_strict(pole, stable):
    model = LinearModel([[pole]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",))
    assert model.is_stable() is stable
    discrete = LinearModel([[np.exp(pole)]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",), sample_period=1.0)
    assert discrete.is_stable() is stable


def test_frequency_response_is_the_closed_form_with_delays():
    omega = np.array([0.5, 7.3, 40.0])
    model = oscillator(input_delay=(0.0, 0.013))
    x = 1 / (OMEGA**2 - omega**2 + 2j * ZETA * OMEGA * omega)
    delay = np.exp(-0.013j * omega)
    response = model.frequency_response(omega)
    assert response.shape == (3, 3, 2)
    np.testing.assert_allclose(response[:, 0, 0], x, rtol=1e-12)
    np.testing.assert_allclose(response[:, 1, 1], 3j * omega * x * delay, rtol=1e-12)
    # x'' = u1 + 3 u2 - 2 zeta omega x' - omega^2 x
    np.testing.assert_allclose(response[:, 2, 0], -(omega**2) * x - 1, rtol=1e-12)
    np.testing.assert_allclose(response[:, 2, 1], -3 * omega**2 * x * delay, rtol=1e-12)


def test_frequency_response_of_a_model_with_no_eigenvector_basis():
    double_pole = LinearModel([[-2.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], ("u",), ("y",))
    omega = np.array([0.1, 3.0])
    np.testing.assert_allclose(double_pole.frequency_response(omega)[:, 0, 0], 1 / (2 + 1j * omega) ** 2, rtol=1e-12)


def test_frequency_response_of_a_discrete_model_and_of_a_bare_gain():
    omega = np.array([1.0, 9.0])
    lag = LinearModel([[0.0]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",), sample_period=0.1)
    np.testing.assert_allclose(lag.frequency_response(omega)[:, 0, 0], np.exp(-0.1j * omega), rtol=1e-12)
    gain = LinearModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[4.0]], ("u",), ("y",))
    np.testing.assert_allclose(gain.frequency_response(omega)[:, 0, 0], 4.0)


def test_select_takes_rows_and_columns_by_name_and_in_order():
    model = oscillator(input_delay=(0.0, 0.013))
    part = model.select(["r", "x"], ["u2"])
    omega = np.array([3.0])
    assert (part.inputs, part.outputs, part.input_delay) == (("u2",), ("r", "x"), (0.013,))
    chosen = model.frequency_response(omega)[:, [2, 0]][:, :, [1]]
    np.testing.assert_allclose(part.frequency_response(omega), chosen, rtol=1e-13)
    with pytest.raises(AbraceError, match="no output 'q', it has x, v, r"):
        model.select(["q"])
    with pytest.raises(AbraceError, match="no input 'w', it has u1, u2"):
        model.select(inputs=["w"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"a": np.ones((2, 3))}, "model matrix a: shape .*expected .2, 2."),
        ({"b": np.full((2, 2), np.nan)}, "model matrix b: has a value that is not finite"),
        ({"outputs": ("x", "x", "r")}, "each name once"),
        ({"input_delay": (0.1,)}, "one delay >= 0 for each of 2 inputs"),
        ({"input_delay": (0.1, -0.1)}, "one delay >= 0"),
        ({"a": [[1.0, 2.0], [3.0]]}, "model matrix a: .*expected numbers of shape .2, 2."),
        ({"inputs": "uv"}, "model inputs 'uv': expected a list of names"),
        ({"sample_period": float("nan")}, "model sample_period nan s: expected"),
        ({"input_delay": (0.1, 0.0), "sample_period": 0.002}, "a discrete model carries its delays in states"),
    ],
)
def test_matrices_and_names_that_do_not_fit_are_refused(change, message):
    with pytest.raises(AbraceError, match=message):
        oscillator(**change)


def test_a_model_does_not_change_after_it_was_made():
    a = np.array([[-1.0]])
    model = LinearModel(a, np.eye(1), np.eye(1), np.zeros((1, 1)), ("u",), ("y",))
    a[0, 0] = 5.0
    assert model.is_stable()
    for one in (model, replace(model, inputs=("w",)), copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        for key in "abcd":
            with pytest.raises(ValueError, match="read-only"):
                getattr(one, key)[0, 0] = 5.0


def test_models_of_equal_numbers_and_names_are_equal():
    model = oscillator(input_delay=(0.0, 0.013))
    same = oscillator(input_delay=(0.0, 0.013), provenance={"method": "by hand"})
    assert model == same
    assert hash(model) == hash(same)
    assert {model, same} == {model}
    assert pickle.loads(pickle.dumps(model)) == model
    d = same.d + 0.0
    d[0, 0] = -0.0
    assert hash(oscillator(d=d, input_delay=(0.0, 0.013))) == hash(model), "-0.0 equals 0.0"
    for change in ({"a": model.a * (1 + 1e-15)}, {"inputs": ("u1", "u3")}, {"input_delay": (0.0, 0.0)}):
        assert replace(model, **change) != model
    assert oscillator(sample_period=0.1) != oscillator()
    assert model != "model"


def test_model_file_gives_back_every_bit(tmp_path):
    model = oscillator(input_delay=(0.0, 1 / 3), provenance={"bags": ["a", "b"], "method": "fit", "order": 6})
    path = tmp_path / "made" / "model.json"
    save_model(model, path)
    read = load_model(path)
    for key in "abcd":
        assert getattr(read, key).tobytes() == getattr(model, key).tobytes()
    for key in ("inputs", "outputs", "input_delay", "sample_period", "provenance"):
        assert getattr(read, key) == getattr(model, key)
    assert [entry.name for entry in path.parent.iterdir()] == ["model.json"], "nothing left beside it"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "No such file"),
        ("{", "line 1: not JSON: column 2"),
        ({"format": "abrace model 9"}, "expected a JSON object with format"),
        ({"b": None}, "b: key is missing"),
        ({"a": [[0.0, 1.0], [1.0]]}, "model matrix a: .*expected numbers of shape"),
        ({"d": [[0.0, 0.0], [0.0, 0.0], [0.0, float("nan")]]}, r"d\.2\.1: nan, expected a finite number"),
        ({"sample_period": -3}, "sample_period: -3, expected greater than or equal to 0"),
        ({"sample_period": 10**400}, "sample_period: inf, expected a finite number"),
        ({"inputs": "w"}, "inputs: 'w', expected a valid list"),
        ({"provenance": 7}, "provenance: 7, expected keys and values"),
    ],
)
def test_bad_model_file_gives_one_line_that_names_it(tmp_path, change, message):
    path = tmp_path / "model.json"
    if isinstance(change, str):
        path.write_text(change)
    elif change is not None:
        save_model(oscillator(), path)
        content = json.loads(path.read_text()) | change
        path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    with pytest.raises(AbraceError, match=message) as caught:
        load_model(path)
    assert str(caught.value).startswith(f"model file {path}: ")
    assert "\n" not in str(caught.value)


def test_matlab_file_holds_matrices_names_and_delays(tmp_path):
    save_mat(oscillator(input_delay=(0.0, 0.1)), tmp_path / "model.mat")
    content = loadmat(tmp_path / "model.mat", squeeze_me=True)
    for key in "abcd":
        np.testing.assert_array_equal(content[key.upper()], getattr(oscillator(), key))
    assert list(content["inputs"]) == ["u1", "u2"]
    assert list(content["outputs"]) == ["x", "v", "r"]
    assert content["Ts"] == 0.0
    np.testing.assert_array_equal(content["input_delay"], [0.0, 0.1])
    save_mat(oscillator(sample_period=0.002), tmp_path / "model.mat")
    assert loadmat(tmp_path / "model.mat")["Ts"] == 0.002


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"<!doctype html><p>not found", "a web page in place of the file"),
        (b"version https://git-lfs.github.com/spec/v1", "a pointer of git-LFS"),
        (b"A B C", "a text, expected a MATLAB file"),
        (b"MATLAB", "a text, expected a MATLAB file"),
    ],
)
def test_a_text_named_as_a_matlab_file_is_called_what_it_is_once(tmp_path, content, words):
    path = tmp_path / "model.mat"
    path.write_bytes(content)
    with pytest.raises(AbraceError, match=f"^model file {path}: {words}") as raised:
        load_model(path)
    assert str(raised.value).count(str(path)) == 1


def test_a_matlab_file_is_read_back_and_one_of_matlabs_own_without_names(tmp_path):
    for model in (oscillator(input_delay=(0.0, 0.1)), oscillator(sample_period=0.002)):
        save_mat(model, tmp_path / "model.mat")
        assert load_model(tmp_path / "model.mat") == model
    savemat(tmp_path / "own.mat", {"A": -1.0, "B": [[1.0, 2.0]], "C": 3.0, "D": [[0.0, 0.0]], "Ts": 0.0})
    own = load_model(tmp_path / "own.mat")
    assert (own.inputs, own.outputs, own.sample_period, own.b.tolist()) == (("u1", "u2"), ("y",), 0.0, [[1.0, 2.0]])
    savemat(tmp_path / "less.mat", {"A": -1.0, "B": [[1.0, 2.0]], "C": 3.0})
    less = load_model(tmp_path / "less.mat")
    assert (less.d.tolist(), less.sample_period) == ([[0.0, 0.0]], 0.0), "continuous, and nothing passes through"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"A": -1.0}, r"no variable 'B', expected A, B, C \(and D, Ts\)"),
        ({"A": "text", "B": 1.0, "C": 1.0, "D": 0.0}, "could not convert string to float"),
        ({"A": -1.0, "B": [1.0, 2.0], "C": 1.0, "D": 0.0, "Ts": 0.0}, "model matrix d: shape"),
    ],
)
def test_a_matlab_file_that_is_no_model_is_refused(content, message, tmp_path):
    savemat(tmp_path / "own.mat", content)
    with pytest.raises(AbraceError, match=f"model file .*own.mat: {message}"):
        load_model(tmp_path / "own.mat")
    with pytest.raises(AbraceError, match=r"model file .*none\.mat: No such file"):
        load_model(tmp_path / "none.mat")
    for damage in (b"\x89HDF\r\n\x1a\n" + bytes(600), b"MATLAB 5.0 MAT-file" + bytes(200)):
        (tmp_path / "damaged.mat").write_bytes(damage)
        with pytest.raises(AbraceError, match=r"model file .*damaged\.mat: .*MATLAB file of version"):
            load_model(tmp_path / "damaged.mat")


def test_python_control_gets_the_same_model_with_delays_as_states():
    pytest.importorskip("control")
    system = oscillator().to_control()
    assert (system.input_labels, system.output_labels) == (["u1", "u2"], ["x", "v", "r"])
    np.testing.assert_allclose(system(1j * 5.0), oscillator().frequency_response(5.0)[0], rtol=1e-12)
    assert oscillator(sample_period=0.002).to_control().dt == 0.002
    late, omega = oscillator(input_delay=(0.0, 0.004)), 2 * np.pi * 20.0
    assert late.to_control().nstates == late.order + 2
    np.testing.assert_allclose(late.to_control()(1j * omega), late.frequency_response(omega)[0], rtol=1e-4)


def test_a_delay_of_a_discrete_model_is_a_pole_that_is_over_at_once():
    delay = LinearModel(np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)), ("u",), ("y",), sample_period=0.002)
    assert delay.poles.real.tolist() == [-np.inf]
    assert delay.is_stable()
