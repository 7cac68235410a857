# SPDX-License-Identifier: Apache-2.0
"""Where the algebra of loops is abrace's own: it is python-control's on our cases, and why it stays.

Cases: the paper's rig (newtons beside metres, a servo's lag), two brace groups, fifty floors, modes close together.
"""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest
from scipy import linalg

from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel, balanced
from abrace_lqg.design import delayed, design
from abrace_lqg.loop import sampled
from abrace_lqg.proof.limits import excitation_of
from abrace_lqg.riccati import regulator
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig

SOURCES = Path(__file__).parents[2] / "src"
PERIOD = 0.002
OMEGA = np.geomspace(0.5, 1500.0, 400)
Z = np.exp(1j * OMEGA * PERIOD)


def rig(name: str) -> LinearModel:
    return load_rig(SOURCES / f"abrace_plant/config/{name}.yaml").model


def building(floors: int, stiffness: float = 6e7, delay: float = 0.0008) -> LinearModel:
    """Equal floors of 10 t, 2 % of the first mode's damping, a command on the first."""
    mass = 1e4
    k = stiffness * (2 * np.eye(floors) - np.eye(floors, k=1) - np.eye(floors, k=-1))
    k[-1, -1] = stiffness
    slowest = np.sqrt(linalg.eigh(k / mass, eigvals_only=True)[0])
    damping = 0.04 * slowest * np.eye(floors)
    a = np.block([[np.zeros((floors, floors)), np.eye(floors)], [-k / mass, -damping]])
    b = np.zeros((2 * floors, 2))
    b[floors:, 0], b[floors, 1] = -1.0, 1 / mass
    c = np.block([[np.eye(floors), np.zeros((floors, floors))], [-k / mass, -damping]])
    d = np.zeros((2 * floors, 2))
    d[floors, 1] = 1 / mass
    names = [f"{kind}{i + 1}" for kind in "xa" for i in range(floors)]
    return LinearModel(a, b, c, d, ("w", "U"), names, input_delay=(0.0, delay))


def close_modes() -> LinearModel:
    """Two floors that hardly touch: frequencies 0.01 % apart."""
    one, coupling = 400.0, 0.04
    a = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-one, coupling, -0.2, 0], [coupling, -one, 0, -0.2]], dtype=float)
    b = np.array([[0, 0], [0, 0], [-1, 1e-4], [-1, 0]], dtype=float)
    c = np.vstack([np.eye(2, 4), a[2:]])
    return LinearModel(a, b, c, np.array([[0, 0], [0, 0], [0, 1e-4], [0, 0]]), ("w", "U"), ("x1", "x2", "a1", "a2"))


CASES = {
    "rig": lambda: rig("ncree_three_storey"),
    "two groups": lambda: rig("five_storey"),
    "fifty floors": lambda: building(50),
    "close modes": close_modes,
}


def weights(model: LinearModel) -> Weights:
    """Of the kind that every building takes: half the response."""
    commands = len(model.inputs) - 1
    half = load_weights(SOURCES / "abrace_lqg/config/half.yaml")
    unscaled = half.model_copy(update={"scale": None, "weights": half.weights.model_copy(update={"command": 1e-4})})
    return unscaled.of(model.outputs, model.inputs[1 : 1 + commands])


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[LinearModel, LinearModel]:
    """A model, and the law designed with it."""
    model = CASES[request.param]()
    return model, design(model, weights(model), PERIOD).controller


def test_responses_by_poles_and_residues_are_python_controls(case):
    """Margins take the response at thousands of frequencies: residues are some times as fast as a solution for each."""
    model, _ = case
    plant = sampled(model, PERIOD)
    system = plant.to_control()
    own, theirs = plant.frequency_response(OMEGA), np.moveaxis(system(Z, squeeze=False), 2, 0)
    scale = np.abs(theirs).max(axis=0)
    assert (np.abs(own - theirs) / np.where(scale, scale, 1)).max() < 1e-8


@pytest.mark.parametrize(("hold", "method"), [("zero", "zoh"), ("first", "foh")])
def test_a_sampled_model_is_python_controls_which_has_one_hold_for_all_inputs_and_no_delays(case, hold, method):
    """The rig has both holds in one model and a delay within a sample; and its simulator imports no python-control."""
    model, _ = case
    without = LinearModel(model.a, model.b, model.c, model.d, model.inputs, model.outputs)
    own = discretize(without, PERIOD, dict.fromkeys(model.inputs, hold))
    theirs = control.sample_system(without.to_control(), PERIOD, method)(Z, squeeze=False)
    # python-control evaluates both: residues of close modes lose digits, and that is not the subject
    difference = np.abs(own.to_control()(Z, squeeze=False) - theirs).max(axis=2)
    assert (difference / np.abs(theirs).max(axis=2).clip(1e-300)).max() < 1e-9


def test_a_delayed_command_is_that_of_python_controls_pade_in_coordinates_of_one_size():
    """pade's polynomials of 2.4e6 and 1 would be states whose sizes differ as much."""
    model = rig("ncree_three_storey")
    whole = 1.5 * PERIOD + model.input_delay[1]
    ratio = control.tf(*control.pade(whole, 2))(1j * OMEGA)
    undelayed = LinearModel(model.a, model.b, model.c, model.d, model.inputs, model.outputs)
    expected = undelayed.frequency_response(OMEGA)[:, :, 1] * ratio[:, None]
    found = delayed(model, PERIOD, PERIOD).frequency_response(OMEGA)[:, :, 1]
    assert (np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max() < 1e-9


def test_gains_are_python_controls_but_for_the_scaling_that_newtons_beside_metres_need():
    """One step of Newton's method (Kleinman 1968) from the gain shows its error."""
    model = balanced(delayed(rig("five_storey"), PERIOD, PERIOD))
    given = load_rig(SOURCES / "abrace_plant/config/five_storey.yaml")
    half = load_weights(SOURCES / "abrace_lqg/config/half.yaml")
    scaled = scaled_weights(given.model, half, PERIOD, given.capacity.tolist(), excitation_of(given.model))
    names, rows = scaled.weighed(model.outputs)
    b, c, d = model.b[:, 1:], rows @ model.c, rows @ model.d[:, 1:]
    q, r = np.diag(scaled.diagonal(names)), np.diag(scaled.diagonal(model.inputs[1:]))
    whole, cost, cross = r + d.T @ q @ d, c.T @ q @ c, c.T @ q @ d

    def error(gain: np.ndarray) -> float:
        left = cost + gain.T @ whole @ gain - cross @ gain - gain.T @ cross.T
        x = linalg.solve_continuous_lyapunov((model.a - b @ gain).T, -(left + left.T) / 2)
        return np.abs(np.linalg.solve(whole, b.T @ x + cross.T) - gain).max() / np.abs(gain).max()

    plain, _, _ = control.lqr(model.a, b, (cost + cost.T) / 2, (whole + whole.T) / 2, cross, method="scipy")
    assert error(regulator(model.a, b, c, d, q, r)) < 1e-9 < 1e-8 < error(plain)
