# SPDX-License-Identifier: Apache-2.0
"""A model whose signals are in g and kN, as sensors gave them, in the place of the one in SI units."""

from dataclasses import astuple, replace

import numpy as np
import pytest

import abrace
from abrace import LinearModel

WEIGHTS = {
    "measured": ["a*"],
    "noise_to_excitation": 0.2,
    "weights": {"displacement": 0, "stroke": 0, "acceleration": 1.0, "force": 0, "command": 1e-8},
}
UNITS = {"w": "g", "U": "kN", "a1": "g"}


def storey() -> LinearModel:
    """One storey of 1800 kg at 2 Hz, its brace force U late by 5 ms: a1 [m/s^2]."""
    mass, damping, stiffness = 1800.0, 1200.0, 3.0e5
    a = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, -200.0]])
    return LinearModel(a, [[0, 0], [-1, 0], [0, 200.0]], [a[1]], [[0, 0]], ("w", "U"), ("a1",))


def in_g() -> LinearModel:
    """The same as sensors that read g and kN give it."""
    model = storey()
    return replace(model, b=model.b * [9.80665, 1000.0], c=model.c / 9.80665, units=UNITS)


def designed(model: object) -> object:
    return abrace.design(model, WEIGHTS, force_limit=[2000.0], sample_period=0.002)


@pytest.mark.parametrize(
    "given",
    [
        pytest.param(in_g(), id="units"),
        pytest.param(in_g().to_control(), id="python-control"),
        pytest.param(replace(in_g(), inputs=("w [g]", "U [kN]"), outputs=("a1 [g]",), units={}), id="names"),
    ],
)
def test_a_design_of_a_model_in_g_and_kn_has_the_margins_of_the_structure(given):
    found = designed(given)
    expected = astuple(designed(storey()).margins)
    np.testing.assert_allclose(astuple(found.margins), expected, rtol=1e-6)
    on_the_structure = abrace.margins(abrace.discretize(storey(), 0.002), found)
    np.testing.assert_allclose(astuple(on_the_structure), expected, rtol=1e-6)
    np.testing.assert_allclose(astuple(abrace.margins(given, found)), expected, rtol=1e-6)


def test_a_design_names_the_model_whose_unit_it_cannot_convert():
    volts = replace(storey(), units={"U": "V"})
    with pytest.raises(abrace.AbraceError, match=r"^design with model: model input U in 'V': expected N, or a unit"):
        designed(volts)
    with pytest.raises(abrace.AbraceError, match=r"^design with other: model input U in 'V': expected N, or a unit"):
        abrace.design(storey(), WEIGHTS, force_limit=[2000.0], sample_period=0.002, check_models={"other": volts})


@pytest.mark.filterwarnings("ignore:the model has no")
def test_a_simulation_pushes_newtons_and_moves_the_table_in_si_units():
    motion, force = np.sin(np.arange(1000) * 0.024), 500.0 * np.cos(np.arange(1000) * 0.05)
    found, expected = (
        abrace.simulate(model, motion, command=force, sample_period=0.002).channels(["a1"])
        for model in (in_g(), storey())
    )
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    with pytest.raises(abrace.AbraceError, match="model input w in 'V': expected m/s"):
        abrace.simulate(replace(storey(), units={"w": "V"}), motion, sample_period=0.002)


def test_figures_of_a_model_show_its_units():
    for figure in (in_g().plot(), in_g().bode(), in_g().step()):
        axis = figure.axes[0]
        assert axis.get_title(loc="left") == "from w [g]"
        assert axis.get_legend_handles_labels()[1] == ["a1 [g]"]
        assert "SI units" not in axis.get_ylabel()
    assert storey().plot().axes[0].get_ylabel() == "gain [SI units]"
