import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel
from abrace_core.simulation import discretize, simulate, simulate_closed_loop

OMEGA, ZETA, PERIOD = 7.3, 0.02, 0.05


def oscillator(delay: float = 0.0, names: tuple[str, ...] = ("u",), gain: float = 0.0) -> LinearModel:
    """x'' + 2 zeta omega x' + omega^2 x = sum of the inputs; outputs x and x + gain u."""
    a = np.array([[0.0, 1.0], [-(OMEGA**2), -2 * ZETA * OMEGA]])
    b = np.array([[0.0] * len(names), [1.0] * len(names)])
    c, d = np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([[0.0] * len(names), [gain] * len(names)])
    return LinearModel(a, b, c, d, names, ("x", "y"), input_delay=(delay,) * len(names))


def step_response(time: np.ndarray) -> np.ndarray:
    """x of the oscillator after a unit step at time 0 (Chopra, sec. 4.3); zero before."""
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    swing = np.cos(damped * time) + ZETA / np.sqrt(1 - ZETA**2) * np.sin(damped * time)
    return np.where(time > 0, (1 - np.exp(-ZETA * OMEGA * np.maximum(time, 0)) * swing) / OMEGA**2, 0.0)


def ramp_response(time: np.ndarray) -> np.ndarray:
    """x after a ramp of slope 1 from time 0; zero before."""
    damped = OMEGA * np.sqrt(1 - ZETA**2)
    decay = np.exp(-ZETA * OMEGA * np.maximum(time, 0))
    swing = 2 * ZETA / OMEGA * np.cos(damped * time) + (2 * ZETA**2 - 1) / damped * np.sin(damped * time)
    return np.where(time > 0, (time - 2 * ZETA / OMEGA + decay * swing) / OMEGA**2, 0.0)


def test_held_step_is_exact_at_the_samples():
    outputs = simulate(discretize(oscillator(), PERIOD), np.ones((400, 1)))
    np.testing.assert_allclose(outputs[:, 0], step_response(np.arange(400) * PERIOD), atol=1e-14)


def test_first_order_hold_is_exact_for_an_input_linear_between_samples():
    time = np.arange(400) * PERIOD
    corner = 3 * PERIOD
    inputs = np.maximum(time - corner, 0)[:, None] - 2 * np.maximum(time - 5 * corner, 0)[:, None]
    outputs = simulate(discretize(oscillator(), PERIOD, {"u": "first"}), inputs)
    np.testing.assert_allclose(
        outputs[:, 0], ramp_response(time - corner) - 2 * ramp_response(time - 5 * corner), atol=1e-13
    )


def test_first_order_hold_agrees_with_scipy_and_passes_direct_terms():
    model = oscillator(gain=0.3)
    inputs = np.random.default_rng(0).standard_normal((300, 1))
    inputs[0] = 0.0
    time = np.arange(300) * PERIOD
    _, expected, _ = signal.lsim((model.a, model.b, model.c, model.d), inputs, time, interp=True)
    found = simulate(discretize(model, PERIOD, {"u": "first"}), inputs)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(samples=st.floats(0.0, 4.5))
def test_delayed_step_is_the_step_shifted_by_any_delay(samples):
    delay = samples * PERIOD
    outputs = simulate(discretize(oscillator(delay), PERIOD), np.ones((200, 1)))
    np.testing.assert_allclose(outputs[:, 0], step_response(np.arange(200) * PERIOD - delay), atol=1e-10)


@pytest.mark.parametrize(("samples", "first"), [(0.0, 0), (0.4, 1), (1.0, 1), (1.5, 2), (3.0, 3)])
def test_direct_term_comes_after_its_delay(samples, first):
    outputs = simulate(discretize(oscillator(samples * PERIOD, gain=1.0), PERIOD), np.ones((8, 1)))
    np.testing.assert_allclose(outputs[:, 1] - outputs[:, 0], [0.0] * first + [1.0] * (8 - first), atol=1e-12)


def test_inputs_keep_their_own_delays_and_holds():
    model = oscillator(names=("w", "U1", "U2"))
    delayed = LinearModel(model.a, model.b, model.c, model.d, model.inputs, model.outputs, input_delay=(0, 0.08, 0.2))
    time = np.arange(300) * PERIOD
    inputs = np.column_stack([time, np.ones(300), np.full(300, -2.0)])
    found = simulate(discretize(delayed, PERIOD, {"w": "first"}), inputs)[:, 0]
    expected = ramp_response(time) + step_response(time - 0.08) - 2 * step_response(time - 0.2)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_discrete_poles_map_back_to_the_continuous_ones():
    found = discretize(oscillator(), PERIOD).poles()
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(oscillator().poles()), rtol=1e-12)


def test_energy_decays_without_input_and_the_decrement_is_that_of_the_damping():
    model = oscillator()
    states = LinearModel(model.a, model.b, np.eye(2), np.zeros((2, 1)), ("u",), ("x", "v"))
    found = simulate(discretize(states, PERIOD), np.zeros((800, 1)), initial=np.array([0.02, 0.1]))
    energy = 0.5 * found[:, 1] ** 2 + 0.5 * OMEGA**2 * found[:, 0] ** 2
    assert (np.diff(energy) < 0).all()
    whole = 2 * np.pi / (OMEGA * np.sqrt(1 - ZETA**2))
    fine = simulate(discretize(states, whole / 20), np.zeros((41, 1)), initial=np.array([0.02, 0.1]))[:, 0]
    decrement = np.log(fine[0] / fine[40]) / 2
    assert decrement == pytest.approx(2 * np.pi * ZETA / np.sqrt(1 - ZETA**2), rel=1e-9)


def test_superposition_holds():
    model = discretize(oscillator(0.07, ("u", "w")), PERIOD, {})
    one, other = np.random.default_rng(1).standard_normal((2, 100, 2))
    np.testing.assert_allclose(
        simulate(model, 2 * one - 3 * other), 2 * simulate(model, one) - 3 * simulate(model, other), atol=1e-12
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: discretize(discretize(oscillator(), PERIOD), PERIOD), "continuous model was expected"),
        (lambda: discretize(oscillator(0.01), PERIOD, {"u": "first"}), "input u has a delay"),
        (lambda: simulate(oscillator(), np.zeros((5, 1))), "discrete model was expected"),
        (lambda: simulate(discretize(oscillator(), PERIOD), np.zeros((5, 2))), "expected .samples, 1."),
        (lambda: simulate(discretize(oscillator(), PERIOD), np.zeros(5)), "expected .samples, 1."),
    ],
)
def test_what_cannot_be_stepped_is_refused(call, message):
    with pytest.raises(AbraceError, match=message):
        call()


def plant_and_controller() -> tuple[LinearModel, LinearModel]:
    plant = discretize(oscillator(names=("w", "U"), gain=0.2), PERIOD, {"w": "first"})
    controller = LinearModel([[0.5]], [[1.0]], [[-2.0]], [[-1.5]], ("y",), ("U",), sample_period=PERIOD)
    return plant, controller


def test_closed_loop_is_the_interconnection_with_one_sample_of_delay():
    plant, controller = plant_and_controller()
    ground = np.random.default_rng(2).standard_normal(200)
    outputs, commands = simulate_closed_loop(plant, controller, ground, np.array([1e9]))
    # states [plant, controller, command in force]: the command of sample k acts from k+1 on
    y_x, y_w, y_u = plant.c[1:2], plant.d[1:2, :1], plant.d[1:2, 1:]
    a = np.block(
        [
            [plant.a, np.zeros((2, 1)), plant.b[:, 1:]],
            [controller.b @ y_x, controller.a, controller.b @ y_u],
            [controller.d @ y_x, controller.c, controller.d @ y_u],
        ]
    )
    b = np.vstack([plant.b[:, :1], controller.b @ y_w, controller.d @ y_w])
    c = np.block([[plant.c, np.zeros((2, 1)), plant.d[:, 1:]], [np.zeros((1, 3)), np.ones((1, 1))]])
    d = np.vstack([plant.d[:, :1], [[0.0]]])
    whole = LinearModel(a, b, c, d, ("w",), ("x", "y", "U"), sample_period=PERIOD)
    expected = simulate(whole, ground[:, None])
    np.testing.assert_allclose(outputs, expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(commands[1:, 0], expected[:-1, 2], atol=1e-12, err_msg="in force until each sample")
    assert commands[0, 0] == 0


def test_closed_loop_commands_are_cut_to_capacity_and_reproduce_the_outputs():
    plant, controller = plant_and_controller()
    ground = 10 * np.random.default_rng(2).standard_normal(200)
    outputs, commands = simulate_closed_loop(plant, controller, ground, np.array([0.4]))
    assert np.abs(commands).max() == 0.4
    assert np.mean(np.abs(commands) == 0.4) > 0.1
    inputs = np.column_stack([ground[:-1], commands[1:, 0]])
    np.testing.assert_allclose(outputs[:-1], simulate(plant, inputs), atol=1e-12)


def test_closed_loop_of_parts_that_do_not_fit_is_refused():
    plant, controller = plant_and_controller()
    slower = LinearModel([[0.5]], [[1.0]], [[-2.0]], [[-1.5]], ("y",), ("U",), sample_period=2 * PERIOD)
    other = LinearModel([[0.5]], [[1.0]], [[-2.0]], [[-1.5]], ("y",), ("U1",), sample_period=PERIOD)
    for wrong in (slower, other):
        with pytest.raises(AbraceError, match=r"the controller gives .*, the model takes U every 0.05 s"):
            simulate_closed_loop(plant, wrong, np.zeros(5), np.array([1.0]))
    assert controller.outputs == ("U",)
