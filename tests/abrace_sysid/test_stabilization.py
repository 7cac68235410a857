# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_sysid.figures.identification import stabilization_diagram
from abrace_sysid.fitting.stabilization import modal_assurance, stabilization
from abrace_sysid.spectra.frequency_response import FrequencyResponse


@pytest.fixture(scope="module")
def found(rig):
    omega = np.linspace(2, 180, 800)
    exact = rig.discrete_model().select(None, ["U"]).frequency_response(omega)[:, :, 0]
    sigma = np.full(exact.shape, 1e-3 * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0)))
    real, imaginary = np.random.default_rng(3).standard_normal((2, *sigma.shape)) / np.sqrt(2)
    measured = FrequencyResponse(
        "U", rig.model.outputs, omega, exact + sigma * (real + 1j * imaginary), sigma, 0.002, "periodic"
    )
    return stabilization(measured, range(12, 21, 2))


def test_the_rigs_modes_stay_and_poles_of_noise_do_not(found, rig):
    highest = found.orders[-1]
    stable = highest.frequency[highest.same]
    expected = pole_table(rig.model.poles())
    assert max(len(poles.frequency) for poles in found.orders) > len(expected), "poles of noise were expected too"
    assert [round(w, 1) for w in stable] == [round(w, 1) for w, _ in expected]


def test_stability_in_shape_or_damping_needs_stability_in_frequency(found):
    for poles in found.orders:
        assert not (poles.same_damping & ~poles.same_frequency).any()
        assert not (poles.same_shape & ~poles.same_frequency).any()
    assert not found.orders[0].same_frequency.any(), "the lowest order has none below it to be like"


def test_modal_assurance_is_one_for_the_same_shape_and_zero_for_orthogonal_ones():
    shapes = np.array([[1, 1j, 0], [1, -1j, 0]])
    assert np.allclose(modal_assurance(shapes, 3j * shapes), np.eye(2))


def test_the_diagram_draws_every_pole_once(found):
    figure = stabilization_diagram(found, [7.36])
    lines = [line for axis in figure.axes for line in axis.lines if line.get_linestyle() == "None"]
    drawn = sum(len(line.get_xdata()) for line in lines)
    assert drawn == sum(len(poles.frequency) for poles in found.orders)
    assert "frequency [Hz]" in [axis.get_xlabel() for axis in figure.axes]


def test_orders_that_do_not_rise_are_refused(found):
    with pytest.raises(AbraceError, match=r"orders \(4, 4\), expected two or more that rise"):
        stabilization(replace(found.measured), (4, 4))
