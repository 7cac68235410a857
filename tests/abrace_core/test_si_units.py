# SPDX-License-Identifier: Apache-2.0
"""Units of a model's signals: kept by whatever is done with the model, converted to SI units, or refused."""

from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel, load_model, save_mat, save_model
from abrace_core.model.si_units import in_si_units, si_factor
from abrace_core.model.simulation import simulate_closed_loop

UNITS = {"w": "g", "U": "kN", "x1": "mm", "a1": "gal"}
TO_SI = {"w": 9.80665, "U": 1000.0, "x1": 0.001, "a1": 0.01}  # NIST SP 811: exact, all of them


def storey() -> LinearModel:
    """One floor of 1000 kg at 2 Hz, pushed by U: x1 [m] and the absolute acceleration a1 [m/s^2]."""
    a = np.array([[0.0, 1.0], [-((4 * np.pi) ** 2), -0.8]])
    b = np.array([[0.0, 0.0], [-1.0, 1e-3]])
    return LinearModel(a, b, np.vstack([[1.0, 0.0], a[1]]), [[0, 0], [0, 1e-3]], ("w", "U"), ("x1", "a1"))


def measured() -> LinearModel:
    """The same floor as sensors show it that state `UNITS`."""
    into, out_of = (np.array([TO_SI[name] for name in names]) for names in (("w", "U"), ("x1", "a1")))
    model = storey()
    d = model.d * into / out_of[:, None]
    return replace(model, b=model.b * into, c=model.c / out_of[:, None], d=d, units=UNITS)


def assert_same(found: LinearModel, expected: LinearModel) -> None:
    omega = np.array([1.0, 12.0, 100.0])
    assert (found.inputs, found.outputs, found.units) == (expected.inputs, expected.outputs, expected.units)
    np.testing.assert_allclose(found.frequency_response(omega), expected.frequency_response(omega), rtol=1e-12)


def test_a_model_in_g_kn_mm_and_gal_is_that_in_si_units():
    assert_same(in_si_units(measured()), storey())


def test_a_model_in_si_units_stays_as_it_is():
    model = storey()
    assert in_si_units(model) is model


def test_units_in_names_are_converted_and_leave_the_names():
    named = replace(
        measured(), inputs=("w [g]", "U [kN]"), outputs=("x1 (mm)", "a1 [gal]"), units={}
    )  # nothing but the names states them
    assert_same(in_si_units(named), storey())


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("g", 9.80665),
        ("mg", 9.80665e-3),
        ("cm/s^2", 0.01),
        ("mm/s²", 0.001),
        ("gal", 0.01),
        ("in/s^2", 0.0254),
        ("ft/s^2", 0.3048),
    ],
)
def test_units_of_acceleration_have_the_factors_of_their_definitions(unit, factor):
    assert si_factor("a1", unit, "") == (pytest.approx(factor, rel=1e-12), "m/s^2")


@pytest.mark.parametrize(("unit", "factor"), [("kN", 1e3), ("kgf", 9.80665), ("lbf", 4.4482216152605)])
def test_units_of_force_have_the_factors_of_their_definitions(unit, factor):
    assert si_factor("U", unit, "") == (pytest.approx(factor, rel=1e-12), "N")


@pytest.mark.parametrize(
    ("units", "message"),
    [
        (
            {"U": "V"},
            r"^model input U in 'V': expected N, or a unit that converts to it, as kN, MN, kgf, tf, lbf, kip$",
        ),
        ({"a1": "mm"}, r"^model output a1 in 'mm': expected m/s\^2, or a unit that converts to it, as g$"),
    ],
)
def test_a_unit_that_is_not_known_or_of_another_quantity_is_refused(units, message):
    with pytest.raises(AbraceError, match=message):
        in_si_units(replace(storey(), units=units))


def test_a_signal_that_is_no_rigs_keeps_a_unit_that_is_not_known():
    model = replace(storey(), inputs=("w", "valve"), outputs=("strain", "a1"), units={"valve": "V", "strain": "V"})
    assert in_si_units(model) == model


def test_units_are_kept_by_selection_sampling_and_delays():
    model = replace(measured(), input_delay=(0.0, 0.003))
    assert discretize(model, 0.002).units == UNITS
    assert model.delays_as_states().units == UNITS
    assert model.select(["a1"], ["U"]).units == {"U": "kN", "a1": "gal"}


def test_files_and_python_control_give_units_back(tmp_path):
    model = measured()
    save_model(model, tmp_path / "model.json")
    save_mat(model, tmp_path / "model.mat")
    assert load_model(tmp_path / "model.json") == model
    assert load_model(tmp_path / "model.mat") == model
    assert model.to_control().input_labels == ["w [g]", "U [kN]"]
    assert LinearModel.from_control(model.to_control()) == model


def test_a_model_file_without_units_is_in_si_units(tmp_path):
    save_model(storey(), tmp_path / "model.json")
    assert "units" not in (tmp_path / "model.json").read_text()
    assert load_model(tmp_path / "model.json").units == {}


def test_models_that_differ_in_units_are_not_equal_and_a_unit_of_no_signal_is_refused():
    assert replace(storey(), units=UNITS) != storey()
    assert hash(replace(storey(), units=UNITS)) == hash(replace(storey(), units=dict(reversed(UNITS.items()))))
    with pytest.raises(AbraceError, match="model units of x9: expected of some of w, U, x1, a1"):
        replace(storey(), units={"x9": "mm"})


def test_a_simulated_loop_takes_and_gives_si_units():
    law = LinearModel([], [], [], [[-50.0]], ("a1",), ("U",), 0.002)  # U [N] = -50 kg a1
    ground = np.sin(np.arange(2000) * 0.024)
    found, expected = (
        simulate_closed_loop(discretize(model, 0.002), law, ground, np.array([20.0]))
        for model in (measured(), storey())
    )
    assert np.abs(expected[1]).max() == 20.0, "the limit has to act in this test"
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
