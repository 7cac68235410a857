import numpy as np
import pytest

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_sysid.spectra.transfer_function import FrequencyResponse, fitted_delay, hold_and_delay

PERIOD = 0.002


def exact(omega, response, sigma=1e-3):
    return FrequencyResponse("U", ("f",), omega, response[:, None], np.full((len(omega), 1), sigma), PERIOD, "exact")


@pytest.mark.parametrize(("hold", "column"), [("first", 0), ("zero", 1)])
def test_a_hold_taken_out_of_the_sampled_response_leaves_the_continuous_one(rig, hold, column):
    omega = 2 * np.pi * np.linspace(0.5, 10, 200)
    sampled = discretize(rig.model, PERIOD)
    third = list(rig.model.outputs).index("x3")
    measured = exact(omega, sampled.frequency_response(omega)[:, third, column])
    continuous = rig.model.frequency_response(omega)[:, third, column]
    left = measured.without_hold(hold).response[:, 0]
    assert np.linalg.norm(left - continuous) < 2e-3 * np.linalg.norm(continuous)
    assert np.linalg.norm(measured.response[:, 0] - continuous) > np.linalg.norm(left - continuous)


def test_a_known_delay_comes_out_with_the_hold():
    omega = np.linspace(1, 100, 50)
    late = exact(omega, 5 * hold_and_delay(omega, PERIOD, "zero", 0.0008))
    assert np.allclose(late.without_hold("zero", 0.0008).response, 5)
    assert np.allclose(np.angle(late.response[:, 0]), -omega * 0.0018), "half a sample and the delay"
    assert np.allclose(np.angle(hold_and_delay(omega, PERIOD, "first")), 0)
    with pytest.raises(AbraceError, match="hold 'second', expected 'zero' or 'first'"):
        hold_and_delay(omega, PERIOD, "second")


def test_a_delay_is_found_from_the_phase_with_its_standard_deviation():
    random = np.random.default_rng(1)
    omega, deviation = 2 * np.pi * np.linspace(10, 30, 400), 0.02
    clean = np.exp(-1j * omega * 0.0018 + 1j * 2.0 / omega)
    found = []
    for _ in range(100):
        noise = deviation / np.sqrt(2) * (random.standard_normal(400) + 1j * random.standard_normal(400))
        found.append(fitted_delay(exact(omega, clean + noise, deviation), "f", (10, 30)))
    delays, sigmas = np.array(found).T
    assert delays.mean() == pytest.approx(0.0018, abs=4 * delays.std() / 10)
    assert np.mean(sigmas) == pytest.approx(delays.std(), rel=0.25)
    with pytest.raises(AbraceError, match=r"delay of f from U: fewer than 10 lines from 10 to 10.1 Hz"):
        fitted_delay(exact(omega, clean), "f", (10, 10.1))


def test_the_force_of_the_rig_s_servo_has_the_delay_of_a_held_first_order_lag(rig):
    omega = 2 * np.pi * np.linspace(10, 30, 2000)
    force = list(rig.model.outputs).index("f")
    sampled = discretize(rig.model, PERIOD).frequency_response(omega)[:, force, 1]
    delay, _ = fitted_delay(exact(omega, sampled), "f", (10, 30))
    # z-transform of a held lag of 0.8 ms: (1 - p) / (z - p), whose phase falls by T / (1 - p) at low frequency
    assert delay == pytest.approx(PERIOD / (1 - np.exp(-PERIOD / 0.0008)), rel=0.01)
