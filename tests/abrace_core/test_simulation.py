# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate, simulate_closed_loop

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


def test_first_order_hold_agrees_with_scipy_and_passes_direct_terms():
    model = oscillator(gain=0.3)
    inputs = np.random.default_rng(0).standard_normal((300, 1))
    inputs[0] = 0.0
    time = np.arange(300) * PERIOD
    _, expected, _ = signal.lsim((model.a, model.b, model.c, model.d), inputs, time, interp=True)
    found = simulate(discretize(model, PERIOD, {"u": "first"}), inputs)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@settings(max_examples=40)
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
    found = simulate(discretize(delayed, PERIOD), inputs)[:, 0]
    expected = ramp_response(time) + step_response(time - 0.08) - 2 * step_response(time - 0.2)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: discretize(discretize(oscillator(), PERIOD), PERIOD), "expected a continuous model"),
        (lambda: discretize(oscillator(0.01), PERIOD, {"u": "first"}), "input u has a delay"),
        (lambda: simulate(oscillator(), np.zeros((5, 1))), "expected a discrete model"),
        (lambda: simulate(discretize(oscillator(), PERIOD), np.zeros((5, 2))), "expected .samples, 1."),
        (lambda: simulate(discretize(oscillator(), PERIOD), np.zeros(5)), "expected .samples, 1."),
    ],
)
def test_what_cannot_be_stepped_is_refused(call, message):
    with pytest.raises(AbraceError, match=message):
        call()


def plant_and_controller() -> tuple[LinearModel, LinearModel]:
    plant = discretize(oscillator(names=("w", "U"), gain=0.2), PERIOD)
    controller = LinearModel([[0.5]], [[1.0]], [[-2.0]], [[-1.5]], ("y",), ("U",), sample_period=PERIOD)
    return plant, controller


def named(count: int, letter: str) -> tuple[str, ...]:
    return tuple(f"{letter}{i + 1}" for i in range(count))


def random_model(states: int, inputs: int, outputs: int, radius: float, seed: int) -> LinearModel:
    """Random modes on a circle in the z plane, in random coordinates of very unequal units."""
    rng = np.random.default_rng(seed)
    modes = np.zeros((states, states))
    for i in range(0, states - 1, 2):
        turn = rng.uniform(0, np.pi)
        modes[i : i + 2, i : i + 2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    if states % 2:
        modes[-1, -1] = rng.choice([-1.0, 1.0])
    mix, _ = np.linalg.qr(rng.standard_normal((states, states)))
    units = 10.0 ** rng.integers(-5, 6, states)
    a = radius * (mix @ modes @ mix.T) * units / units[:, None]
    b, c = rng.standard_normal((states, inputs)) / units[:, None], rng.standard_normal((outputs, states)) * units
    d = rng.standard_normal((outputs, inputs))
    return LinearModel(a, b, c, d, named(inputs, "u"), named(outputs, "y"), sample_period=PERIOD)


def stepped(model: LinearModel, inputs: np.ndarray) -> np.ndarray:
    """The recursion as it is written."""
    state = np.zeros(model.order)
    outputs = np.zeros((len(inputs), len(model.outputs)))
    for k, u in enumerate(inputs):
        outputs[k] = model.c @ state + model.d @ u
        state = model.a @ state + model.b @ u
    return outputs


def stepped_closed_loop(plant, controller, ground, capacity, correction=None) -> tuple[np.ndarray, np.ndarray]:
    """The graph's timing, step by step: a sample, its command cut, in force from the next sample on."""
    measured = [plant.outputs.index(name) for name in controller.inputs]
    x, q, command = np.zeros(plant.order), np.zeros(controller.order), np.zeros(len(capacity))
    outputs, commands, before = [], [], np.zeros(len(capacity))
    for w in ground:
        drive = np.concatenate([[w], command])
        outputs.append(plant.c @ x + plant.d @ drive)
        commands.append(before)
        y = outputs[-1][measured]
        wanted = controller.c @ q + controller.d @ y
        before, command = command, np.clip(wanted, -capacity, capacity)
        x, q = plant.a @ x + plant.b @ drive, controller.a @ q + controller.b @ y
        if correction is not None:
            q += correction @ (command - wanted)
    return np.array(outputs), np.array(commands)


def assert_equal_to_rounding(found: np.ndarray, expected: np.ndarray) -> None:
    """Every channel within 1e-12 of its peak."""
    assert found.shape == expected.shape
    peaks = np.abs(expected).max(axis=0, initial=0.0)
    worst = np.abs(found - expected).max(axis=0, initial=0.0)
    assert (worst <= 1e-12 * peaks).all(), worst / peaks


@settings(max_examples=60)
@given(
    states=st.integers(0, 9),
    inputs=st.integers(0, 3),
    outputs=st.integers(0, 4),
    samples=st.integers(0, 700),
    radius=st.sampled_from([0.0, 0.5, 0.99, 1.0, 1.02]),
    seed=st.integers(0, 10**6),
)
def test_blocks_give_what_the_recursion_gives(states, inputs, outputs, samples, radius, seed):
    model = random_model(states, inputs, outputs, radius, seed)
    driving = np.random.default_rng(seed + 1).standard_normal((samples, inputs))
    assert_equal_to_rounding(simulate(model, driving), stepped(model, driving))


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_long_record_and_any_layout_of_it_give_what_the_recursion_gives(order):
    model = random_model(12, 2, 5, 0.9999, 3)
    driving = np.asarray(np.random.default_rng(4).standard_normal((20_011, 2)), order=order)
    assert_equal_to_rounding(simulate(model, driving), stepped(model, driving))


def test_motion_that_nothing_excites_does_not_overflow():
    # 3^20000 is beyond all numbers, 0 * 3^20000 is 0; the second mode is stable and driven
    model = LinearModel(
        np.diag([3.0, 0.9]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]], ("u",), ("y",), sample_period=PERIOD
    )
    driving = np.random.default_rng(6).standard_normal((20_000, 1))
    assert_equal_to_rounding(simulate(model, driving), stepped(model, driving))


def test_growth_reaches_as_far_as_numbers_do():
    model = LinearModel([[1.5]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",), sample_period=PERIOD)
    driving = np.zeros((1740, 1))
    driving[0] = 1.0
    np.testing.assert_allclose(simulate(model, driving)[1:, 0], 1.5 ** np.arange(1739.0), rtol=1e-12)
    steep = LinearModel([[1e120]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",), sample_period=PERIOD)
    late = np.array([0.0] * 30 + [1.0, 0.0, 0.0])[:, None]
    np.testing.assert_allclose(simulate(steep, late)[-3:, 0], [0.0, 1.0, 1e120], rtol=1e-12)


@settings(max_examples=40)
@given(
    states=st.integers(0, 6),
    commands=st.integers(0, 2),
    controller_states=st.integers(0, 4),
    samples=st.integers(0, 300),
    radius=st.sampled_from([0.3, 0.9, 1.0]),
    capacity=st.sampled_from([0.01, 0.1, 1e9]),
    seed=st.integers(0, 10**6),
)
def test_closed_loop_is_the_loop_as_it_is_stepped(states, commands, controller_states, samples, radius, capacity, seed):
    plant = random_model(states, 1 + commands, 3, radius, seed)
    law = random_model(controller_states, 2, commands, 0.6, seed + 1)
    # a weak controller: the loop may be cut as often as it likes and does not run away
    law = LinearModel(law.a, law.b, 1e-3 * law.c, 1e-3 * law.d, ("y3", "y1"), plant.inputs[1:], sample_period=PERIOD)
    ground, limit = np.random.default_rng(seed).standard_normal(samples), np.full(commands, capacity)
    found, expected = (run(plant, law, ground, limit) for run in (simulate_closed_loop, stepped_closed_loop))
    for one, other in zip(found, expected, strict=True):
        assert_equal_to_rounding(one, other.reshape(one.shape))
    # small enough that the corrected law, too, is far from running away by itself
    correction = 0.1 * law.b[:, :1] * np.ones(commands) / max(1e-9, np.abs(law.c).max(initial=0.0))
    correction /= max(1.0, np.abs(correction @ law.c).sum() / 0.1)
    found, expected = (
        run(plant, law, ground, limit, correction) for run in (simulate_closed_loop, stepped_closed_loop)
    )
    for one, other in zip(found, expected, strict=True):
        assert_equal_to_rounding(one, other.reshape(one.shape))


def test_closed_loop_holds_a_plant_that_falls_over_fast():
    # plant and controller alone grow threefold a sample, 4e7-fold in 16; the loop's three poles are at zero:
    # what the loop cancels must not be lost in rounding
    plant = LinearModel([[3.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], ("w", "U"), ("y",), sample_period=PERIOD)
    law = LinearModel([[-3.0]], [[1.0]], [[27.0]], [[-9.0]], ("y",), ("U",), sample_period=PERIOD)
    ground = np.random.default_rng(8).standard_normal(400)
    found, commands = simulate_closed_loop(plant, law, ground, np.array([1e9]))
    expected, expected_commands = stepped_closed_loop(plant, law, ground, np.array([1e9]))
    assert_equal_to_rounding(found, expected)
    assert_equal_to_rounding(commands, expected_commands)


def test_closed_loop_goes_on_when_the_controller_alone_runs_away():
    # the controller's state grows to 1e23 times the capacity while the command stays cut and the plant stays exact
    plant = LinearModel([[0.9]], [[1.0, 0.01]], [[1.0]], [[0.0, 0.0]], ("w", "U"), ("y",), sample_period=PERIOD)
    law = LinearModel([[1.2]], [[1.0]], [[1.0]], [[0.0]], ("y",), ("U",), sample_period=PERIOD)
    ground = np.random.default_rng(10).standard_normal(300)
    found, commands = simulate_closed_loop(plant, law, ground, np.array([1.0]))
    expected, expected_commands = stepped_closed_loop(plant, law, ground, np.array([1.0]))
    assert_equal_to_rounding(found, expected)
    np.testing.assert_array_equal(commands[20:], expected_commands[20:])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p, _: simulate(p, np.array([[0.0, 0.0], [np.nan, 0.0]])), "inputs: not finite at sample 1"),
        (lambda p, c: simulate_closed_loop(p, c, np.array([0.0, np.inf]), np.ones(1)), "not finite at sample 1"),
        (lambda p, c: simulate_closed_loop(p, c, np.zeros(5), np.ones(2)), r"capacities of shape \(2,\), expected"),
        (
            lambda p, c: simulate_closed_loop(p, c, np.zeros(5), np.ones(1), np.zeros((2, 1))),
            r"correction of shape \(2, 1\), expected \(1, 1\)",
        ),
        (lambda p, c: simulate_closed_loop(p, c, np.zeros((5, 1)), np.ones(1)), r"shape \(5, 1\)"),
        (
            lambda p, c: simulate_closed_loop(p.select(["x"]), c, np.zeros(5), np.ones(1)),
            "measures y, the model gives x",
        ),
        (lambda p, c: simulate_closed_loop(continuous(p), continuous(c), np.zeros(5), np.ones(1)), "discrete models"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(AbraceError, match=message):
        call(*plant_and_controller())


def continuous(model: LinearModel) -> LinearModel:
    return LinearModel(model.a, model.b, model.c, model.d, model.inputs, model.outputs)
