# SPDX-License-Identifier: Apache-2.0
"""The weights file: what is read, written and refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_lqg.weights import Weights, load_weights, save_weights, signal_kind

LQG3 = Path(__file__).parents[2] / "src/abrace_lqg/config/lqg3.yaml"
G = 9.80665


def changed(tmp_path: Path, old: str, new: str) -> Path:
    text = LQG3.read_text()
    assert old in text
    path = tmp_path / "weights.yaml"
    path.write_text(text.replace(old, new))
    return path


def test_lqg3_measures_three_accelerations_with_the_papers_units_as_commented():
    weights = load_weights(LQG3)
    assert weights.measured == ["a1", "a2", "a3"]
    # a displacement of 1 cm costs as much as 10^(4.69/2) kgf of command, an acceleration a3 of 1 g as 10^(8.211/2) kgf
    assert weights.weights.displacement * 0.01**2 == pytest.approx(10**4.69 * G**2, rel=1e-3)
    a1, a2, a3 = weights.diagonal(["a1", "a2", "a3"])
    assert a1 * G**2 == pytest.approx(10**7.738 * G**2, rel=1e-3)
    assert a2 * G**2 == pytest.approx(10**7.768 * G**2, rel=1e-3)
    assert a3 * G**2 == pytest.approx(10**8.211 * G**2, rel=1e-3)
    assert weights.weights.command == 1.0
    assert weights.noise_to_excitation == pytest.approx(10**-0.661, rel=1e-3)


def test_each_signal_gets_the_weight_of_its_kind():
    weights = load_weights(LQG3)
    kinds = weights.weights
    expected = [kinds.displacement, kinds.stroke, kinds.acceleration, kinds.force, kinds.command]
    np.testing.assert_array_equal(weights.diagonal(["x2", "xf", "a3", "f1", "U"]), expected)


def test_a_signal_that_is_named_has_a_multiple_of_its_kinds_weight(tmp_path: Path):
    weights = load_weights(changed(tmp_path, "a1: 0.3365", "x2: 0.25"))
    kinds = weights.weights
    expected = [kinds.displacement, 0.25 * kinds.displacement, kinds.acceleration]
    np.testing.assert_allclose(weights.diagonal(["x1", "x2", "a1"]), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  command: 1.0 ", "  command: 0.0 ", "weights.command"),
        ("  stroke: 0.0 ", "  strokes: 0.0 ", "weights.stroke: key is missing|weights.strokes: unknown key"),
        ("a1: 0.3365", "strain: 0.3170", "relative.*'strain'"),
        ("a1: 0.3365", "a1: 0.0", "relative.a1"),
        ("[a1, a2, a3]", "[a1, a1]", "measured.*each name once"),
        ("noise_to_excitation: 0.2183", "noise_to_excitation: 0", "noise_to_excitation"),
    ],
)
def test_a_mistake_is_named_with_file_and_key(tmp_path: Path, old: str, new: str, message: str):
    path = changed(tmp_path, old, new)
    with pytest.raises(AbraceError, match=message) as error:
        load_weights(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("name", ["disp3", "damper", "drive", "Vout", "xfloor", "floor", "a", "x", "Uf", "d", "x1m"])
def test_a_name_of_ones_own_is_not_weighed_by_its_first_letter(name: str):
    with pytest.raises(AbraceError, match=f"signal '{name}': no weight for it, expected a name such as x1"):
        signal_kind(name)


def made(**changes: object) -> Weights:
    content = {
        "measured": ["a*"],
        "weights": {"displacement": 0.0, "stroke": 0.0, "acceleration": 0.0, "force": 0.0, "command": 1.0},
        "noise_to_excitation": 0.2,
    }
    content["weights"] |= changes.pop("kinds", {})
    return Weights.model_validate(content | changes)


def test_drift_and_base_shear_are_sums_of_what_is_recorded():
    weights = made(kinds={"drift": 4.0, "base_shear": 9.0}, masses=[10.0, 20.0])
    outputs = ("x1", "x2", "xf", "a1", "a2", "f")
    names, rows = weights.weighed(outputs)
    assert names == (*outputs, "d1", "d2", "V")
    moved = np.array([1.0, 3.0, 0.0, 5.0, 7.0, 0.0])
    np.testing.assert_array_equal((rows @ moved)[6:], [1.0, 2.0, 190.0])
    np.testing.assert_array_equal(weights.diagonal(names)[6:], [4.0, 4.0, 9.0])


@pytest.mark.parametrize("changes", [{}, {"kinds": {"displacement": 5.0}}, {"signals": {"a1": 0.0}}])
def test_weights_of_which_none_is_of_an_output_of_the_model_are_refused(changes: dict):
    with pytest.raises(
        AbraceError, match=r"all weights but that of the command are zero, expected one above 0 of a1, f$"
    ):
        made(**changes).weighed(("a1", "f"))
    made(kinds={"force": 1e-30}).weighed(("a1", "f"))


def test_noise_is_set_sensor_by_sensor_and_a_star_stands_for_all_floors():
    weights = made(noise={"a2": 3.0}).of(("x1", "x2", "a1", "a2"), ("U",))
    assert weights.measured == ["a1", "a2"]
    np.testing.assert_allclose(weights.noise_intensity(), [0.2, 0.6])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"measured": ["x*"]}, r"measured: x\*, expected some of a1"),
        ({"noise": {"x1": 2.0}}, "noise: x1, expected some of a1, a2"),
        ({"relative": {"a3": 2.0}}, "relative: a3, expected some of a1"),
        ({"kinds": {"base_shear": 1.0}, "masses": [1.0]}, "masses: 1 of 0 floors"),
    ],
)
def test_names_that_a_model_has_not_are_refused(changes: dict, message: str):
    with pytest.raises(AbraceError, match=message):
        made(**changes).of(("a1", "a2"), ("U",))


def test_weights_with_sums_noise_and_scale_read_back(tmp_path: Path):
    kinds = {"drift": 4.0, "base_shear": 9.0}
    weights = made(kinds=kinds, masses=[10.0, 20.0], noise={"a2": 3.0}, scale={"force": 0.3})
    save_weights(weights, tmp_path / "w.yaml", "a test")
    assert load_weights(tmp_path / "w.yaml") == weights
