# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest
from scipy.io import loadmat

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, export_mat, load_model, pole_table, save_model

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
        np.sort_complex(oscillator().poles()), [-ZETA * OMEGA - 1j * damped, -ZETA * OMEGA + 1j * damped]
    )
    (frequency, ratio), *others = pole_table(oscillator().poles())
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
        ({"c": np.ones((4, 2))}, "model matrix c: .*expected .3, 2."),
        ({"b": np.full((2, 2), np.nan)}, "model matrix b: has a value that is not finite"),
        ({"outputs": ("x", "x", "r")}, "each name once"),
        ({"input_delay": (0.1,)}, "one delay >= 0 for each of 2 inputs"),
        ({"input_delay": (0.1, -0.1)}, "one delay >= 0"),
        ({"input_delay": (0.1, float("nan"))}, "one delay >= 0"),
        ({"input_delay": (0.1, 0.0), "sample_period": 0.002}, "a discrete model carries its delays in states"),
    ],
)
def test_matrices_and_names_that_do_not_fit_are_refused(change, message):
    with pytest.raises(AbraceError, match=message):
        oscillator(**change)


@pytest.mark.parametrize(
    "change", [{"c": np.ones((2, 3))}, {"a": -np.eye(4), "b": np.ones((2, 4)), "c": np.ones((3, 4))}]
)
def test_transposed_matrix_is_refused(change):
    with pytest.raises(AbraceError, match="model matrix"):
        oscillator(**change)


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


def test_model_file_of_a_bare_gain_is_read(tmp_path):
    gain = LinearModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[4.0, 5.0]], ("u", "w"), ("y",))
    save_model(gain, tmp_path / "gain.json")
    assert load_model(tmp_path / "gain.json").d.tolist() == [[4.0, 5.0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "No such file"),
        ("{", "not JSON"),
        ("[1]", "expected a JSON object with format 'abrace model 1'"),
        ({"format": "abrace model 9"}, "expected a JSON object with format"),
        ({"b": None}, "key 'b' is missing"),
        ({"c": [[1.0, 2.0]]}, "cannot reshape|expected .3, 2."),
        ({"a": [[0.0, "one"], [1.0, 2.0]]}, "could not convert"),
        ({"d": [[0.0, 0.0], [0.0, 0.0], [0.0, float("nan")]]}, "model matrix d: has a value that is not finite"),
        ({"sample_period": "fast"}, "could not convert"),
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


def test_file_that_cannot_be_written_is_an_error_and_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(AbraceError, match="cannot write"):
        save_model(oscillator(), tmp_path / "file" / "model.json")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_matlab_file_holds_matrices_names_and_delays(tmp_path):
    export_mat(oscillator(input_delay=(0.0, 0.1)), tmp_path / "model.mat")
    content = loadmat(tmp_path / "model.mat", squeeze_me=True)
    np.testing.assert_array_equal(content["A"], oscillator().a)
    assert list(content["inputs"]) == ["u1", "u2"]
    np.testing.assert_array_equal(content["input_delay"], [0.0, 0.1])


def test_python_control_gets_the_same_model_and_no_delays():
    pytest.importorskip("control")
    system = oscillator().to_control()
    assert (system.input_labels, system.output_labels) == (["u1", "u2"], ["x", "v", "r"])
    np.testing.assert_allclose(system(1j * 5.0), oscillator().frequency_response(5.0)[0], rtol=1e-12)
    assert oscillator(sample_period=0.002).to_control().dt == 0.002
    with pytest.raises(AbraceError, match="input delays"):
        oscillator(input_delay=(0.0, 0.1)).to_control()


def test_a_delay_of_a_discrete_model_is_a_pole_that_is_over_at_once():
    delay = LinearModel(np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)), ("u",), ("y",), sample_period=0.002)
    assert delay.poles().real.tolist() == [-np.inf]
    assert delay.is_stable()
