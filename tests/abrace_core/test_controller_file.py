# SPDX-License-Identifier: Apache-2.0
"""The controller's parameter file: bit for bit there and back, doubles that stay doubles, and clear refusals."""

from __future__ import annotations

import array
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from forked_matlab import matlab_files_by_forks  # noqa: F401

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller, controller_from_parameters, load_controller, save_controller
from abrace_core.model.linear_model import LinearModel, save_mat

if TYPE_CHECKING:
    from pathlib import Path


def controller() -> Controller:
    """One with numbers that are hard to write: whole, tiny, huge, and with 17 digits."""
    random = np.random.default_rng(2)
    a = np.triu(random.standard_normal((4, 4)) * 10.0 ** random.integers(-30, 30, (4, 4)), 1) + 0.5 * np.eye(4)
    a[0] = [0.1, 0.0, 1e-5, 1e22]
    b, c, d, g, p = (random.standard_normal(shape) for shape in ((4, 3), (1, 4), (1, 3), (4, 1), (3, 5)))
    b[:, 0] = [np.nextafter(1, 2), 2.2250738585072014e-308, 1.7976931348623157e308, -3.0]
    law = LinearModel(a, b, c, d, ("a1", "a2", "a3"), ("U",), 0.002)
    facts = "reduced: 8 states", 'q: 1 # "two"', "gain 10 dB\nphase 60"
    return Controller("lqg3", law, g, p, np.array([24516.625]), *facts)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save_controller(controller(), tmp_path / "lqg3.yaml")
    return tmp_path / "lqg3.yaml"


def test_it_comes_back_bit_for_bit(path: Path):
    saved, found = controller(), load_controller(path)
    for key in "abcd":
        assert getattr(found.law, key).tobytes() == getattr(saved.law, key).tobytes(), key
    for key in ("correction", "prediction"):
        assert getattr(found, key).tobytes() == getattr(saved, key).tobytes(), key
    assert found.law.inputs == ("a1", "a2", "a3")
    assert found.law.outputs == ("U",)
    assert found.law.sample_period == 0.002
    assert found.force_limit.tolist() == [24516.625]
    assert (found.name, found.model, found.weights) == ("lqg3", "reduced: 8 states", 'q: 1 # "two"')
    assert found.margins == "gain 10 dB phase 60"


def test_the_same_controller_gives_the_same_bytes(path: Path, tmp_path: Path):
    save_controller(load_controller(path), tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == path.read_bytes()


def test_every_number_of_a_matrix_has_a_point_and_is_a_double_to_yaml(path: Path):
    content = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    for key in ("a_d", "b_d", "c_d", "d_d", "g_d", "p_d", "force_limit"):
        assert {type(value) for value in content[key]} == {float}, key
        listed = re.search(rf"{key}: \[([^\]]*)\]", path.read_text())
        assert listed
        assert all(re.fullmatch(r"\s*-?\d+\.\d+(e[+-]\d+)?\s*", text) for text in listed[1].split(","))
    assert type(content["sample_period"]) is float
    assert type(content["states"]) is int


def test_a_subnormal_number_which_ros_cannot_read_is_written_as_zero(tmp_path: Path):
    law = controller().law
    a = law.a.copy()
    a[0] = [0.5, 5e-324, -1e-310, 2.0]
    save_controller(replace(controller(), law=replace(law, a=a)), tmp_path / "lqg3.yaml")
    assert load_controller(tmp_path / "lqg3.yaml").law.a[0].tolist() == [0.5, 0.0, 0.0, 2.0]


def test_a_node_makes_the_same_controller_from_its_parameters(path: Path):
    values = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    for key in ("a_d", "b_d", "c_d", "d_d", "g_d", "p_d", "force_limit"):
        values[key] = array.array("d", values[key])  # as rclpy gives double arrays
    found = controller_from_parameters(values, "controller")
    np.testing.assert_array_equal(found.law.a, controller().law.a)


def test_a_parameter_that_a_node_was_not_given_is_named(path: Path):
    values = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    with pytest.raises(AbraceError, match="controller: c_d"):
        controller_from_parameters(values | {"c_d": None}, "controller")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (r"    force_limit: .*\n", "", "force_limit: key is missing"),
        (r"    states: 4\n", "    states: 5\n", "a_d: 16 numbers, expected 5 rows of 5"),
        (r"measured: .*\n", "measured: [a1, a1, a2]\n", "each name once"),
        (r"d_d: \[[^\]]*\]", "d_d: [1.0, two, 2.0]", r"d_d\.1: 'two'"),
        (r"g_d: \[[^\]]*\]", "g_d: [1.0, 2.0]", "g_d: 2 numbers, expected 4 rows of 1"),
        (r"a_d: \[\s*0\.1,", "a_d: [1.1,", r"not stable \(spectral radius of a_d 1\.1\), expected less than 1"),
        (r"force_limit: .*\n", "force_limit: [1.0, 2.0]\n", "force_limit"),
        (r"    states: 4\n", "    states: 4\n    gain: 2.0\n", "gain: unknown key"),
        (r"/\*\*:", "controller:", "key is missing|unknown key"),
        (r"/\*\*:", "/**: [", "not YAML"),
    ],
)
def test_a_mistake_is_named_with_file_and_key(path: Path, old: str, new: str, said: str):
    text, count = re.subn(old, new, path.read_text())
    assert count == 1
    path.write_text(text)
    with pytest.raises(AbraceError, match=said) as error:
        load_controller(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("limit", [[1.0, 2.0], [-1.0], [np.inf]])
def test_a_force_limit_that_is_none_is_refused(limit: list[float]):
    with pytest.raises(AbraceError, match="force_limit"):
        replace(controller(), force_limit=np.array(limit))


@pytest.mark.parametrize("key", ["correction", "prediction"])
def test_an_observer_that_does_not_fit_the_law_is_refused(key: str):
    with pytest.raises(AbraceError, match=rf"controller lqg3: {key}: shape \(2, 2\), expected"):
        replace(controller(), **{key: np.zeros((2, 2))})
    with pytest.raises(AbraceError, match=f"controller lqg3: {key}: has a value that is not finite"):
        replace(controller(), **{key: getattr(controller(), key) * np.inf})


def test_a_controller_goes_to_matlab_and_back(tmp_path: Path):
    given = replace(controller(), margins="gain 10 dB")
    save_controller(given, tmp_path / "k.mat")
    assert load_controller(tmp_path / "k.mat") == given


def test_a_matlab_file_without_an_observer_is_no_controller(tmp_path: Path):
    save_mat(controller().law, tmp_path / "model.mat")
    with pytest.raises(AbraceError, match=r"controller file .*model\.mat: no variable G, expected one of save_mat"):
        load_controller(tmp_path / "model.mat")
    observer = {"name": "lqg3", "G": np.zeros((1, 1)), "P": np.zeros((1, 1)), "force_limit": 1.0}
    save_mat(controller().law, tmp_path / "model.mat", observer)
    with pytest.raises(AbraceError, match=r"controller file .*model\.mat: controller lqg3: correction: shape \(1, 1\)"):
        load_controller(tmp_path / "model.mat")


def test_a_continuous_law_is_refused():
    with pytest.raises(AbraceError, match="discrete"):
        replace(controller(), law=replace(controller().law, sample_period=0.0))


def test_a_controller_is_a_value():
    one, same = controller(), controller()
    assert one == same
    assert hash(one) == hash(same)
    assert one != replace(one, force_limit=np.array([1000.0]))
    with pytest.raises(ValueError, match="read-only"):
        one.force_limit[0] = 1e9
