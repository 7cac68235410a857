# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from laboratory import Laboratory

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel
from abrace_core.run import Run
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import Treatment, prepare
from abrace_plant.rig.published import INTENSITY
from abrace_plant.rig.sensors import Measurement
from abrace_sysid.fitting.slow_pole import slow_real_pole
from abrace_sysid.models.consistent import consistent_model, realize_together
from abrace_sysid.models.reduction import balanced_truncation, typical_scales
from abrace_sysid.spectra.estimation import TransferFunctionOptions, frequency_responses
from abrace_sysid.spectra.frequency_response import FrequencyResponse
from abrace_sysid.validation import compare

BAND = (0.3, 30.0)
LAG = {"U": 0.0008}
POLES = np.array([-4.0 + 0j, -0.1 + 7.3j, -0.1 - 7.3j, -0.5 + 23j, -0.5 - 23j, -2.0 + 90j, -2.0 - 90j])


def two_inputs():
    """Seven states, both inputs driving all of them: what a rig is."""
    random = np.random.default_rng(2)
    a = np.zeros((7, 7))
    a[0, 0] = -4.0
    for i, pole in ((1, POLES[1]), (3, POLES[3]), (5, POLES[5])):
        a[i : i + 2, i : i + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    b, c, d = random.standard_normal((7, 2)), random.standard_normal((3, 7)), random.standard_normal((3, 2))
    return LinearModel(a, b * [1.0, 1e-3], c, d * [1.0, 1e-5], ("w", "U"), ("x1", "a1", "f"), input_delay=(0, 0.0008))


def measured(model, name, highest=30.0, outputs=("x1", "a1", "f"), lines=600):
    omega = 2 * np.pi * np.linspace(0.2, highest, lines)
    sampled = discretize(model.select(outputs, [name]), 0.002).frequency_response(omega)[:, :, 0]
    return FrequencyResponse(name, outputs, omega, sampled, np.full(sampled.shape, 1e-6), 0.002, "exact")


def test_exact_responses_give_back_the_rig_with_each_pole_once():
    rig = two_inputs()
    found = consistent_model([measured(rig, "w"), measured(rig, "U")], POLES, LAG, BAND, INTENSITY).model
    assert found.order == 7
    assert (found.inputs, found.outputs, found.input_delay) == (rig.inputs, rig.outputs, rig.input_delay)
    assert np.allclose(np.sort_complex(found.poles()), np.sort_complex(POLES), rtol=1e-5)
    omega = np.geomspace(1, 180, 200)
    assert np.allclose(found.frequency_response(omega), rig.frequency_response(omega), rtol=1e-5, atol=1e-8)


def test_an_input_has_only_the_poles_that_its_band_shows():
    rig = two_inputs()
    whole = realize_together([measured(rig, "w", 10.0), measured(rig, "U")], POLES, LAG)
    assert whole.order == 5 + 7
    assert np.abs(whole.select(inputs=["w"]).b[5:]).max() == 0
    with pytest.raises(AbraceError, match=r"no pole up to 6\.283 rad/s, where the response to w ends"):
        realize_together([measured(rig, "w", 1.0)], POLES[1:], LAG)


def test_repeated_tests_of_one_input_are_fitted_together():
    rig = two_inputs()
    response = measured(rig, "U")
    low, high = (replace(response, response=factor * response.response) for factor in (0.9, 1.1))
    both = realize_together([low, high], POLES, LAG)
    assert both.order == 7
    assert np.allclose(both.c, realize_together([response], POLES, LAG).c, rtol=1e-9)


def test_a_dead_channel_is_left_out_and_the_others_come_out():
    rig = two_inputs()
    names = ("x1", "f")
    found = consistent_model(
        [measured(rig, "w", outputs=names), measured(rig, "U", outputs=names)], POLES, LAG, BAND, INTENSITY
    )
    omega = np.geomspace(1, 180, 50)
    expected = rig.select(names).frequency_response(omega)
    assert found.model.outputs == names
    assert np.allclose(found.model.frequency_response(omega), expected, rtol=1e-5, atol=1e-8)


def test_unstable_poles_are_refused():
    rig = two_inputs()
    with pytest.raises(AbraceError, match="consistent model: unstable poles"):
        realize_together([measured(rig, "w")], -POLES.conj(), LAG)


def test_the_slow_real_pole_is_found_beside_the_known_ones():
    assert slow_real_pole(measured(two_inputs(), "w"), POLES[1:]) == pytest.approx(-4.0, rel=1e-3)


def test_no_real_pole_is_found_where_there_is_none():
    building = realize_together([measured(two_inputs(), "w")], POLES[1:5], {})
    response = measured(building, "w", 10.0)
    random = np.random.default_rng(3)
    noise = 1e-3 * random.standard_normal((2, *response.response.shape))
    noisy = replace(response, response=response.response + noise[0] + 1j * noise[1], sigma=0 * response.sigma + 1e-3)
    assert slow_real_pole(noisy, POLES[1:5]) is None


def test_the_servo_s_slow_pole_is_found_in_a_table_test_of_300_s(rig, responses):
    (true,) = (pole.real for pole in rig.model.poles() if pole.imag == 0 and abs(pole) < 100)
    assert slow_real_pole(responses[0], poles_with_the_accuracy_of_300_s(rig)) == pytest.approx(true, rel=0.1)


def controlled(laboratory, controller, ground, seed):
    """The rig under a controller that sees its sensors' readings, noise included."""
    rig, model = laboratory.rig, laboratory.model
    sensors = Measurement(rig.sensors.channels(rig.floors, rig.groups, rig.groups), seed, model.sample_period)
    seen = [model.outputs.index(name) for name in controller.inputs]
    state, law, command = np.zeros(model.order), np.zeros(controller.order), np.zeros(1)
    readings, in_force = np.empty((len(ground), 9)), np.empty((len(ground), 1))
    for k, acceleration in enumerate(ground):
        driven = np.array([acceleration, command[0]])
        readings[k] = sensors.read(np.append(model.c @ state + model.d @ driven, acceleration))
        in_force[k] = command
        command = np.clip(controller.c @ law + controller.d @ readings[k, seen], -rig.capacity, rig.capacity)
        law = controller.a @ law + controller.b @ readings[k, seen]
        state = model.a @ state + model.b @ driven
    sequence = np.arange(len(ground), dtype=np.uint64)
    return Run("bags/controlled", 0.002, sequence, 3, 1, readings[:, :-1], readings[:, -1], in_force)


@pytest.fixture(scope="module")
def responses(rig):
    laboratory = Laboratory(rig, seed=5)
    options = TransferFunctionOptions("local_polynomial")
    return (
        *frequency_responses(laboratory.table_test(300), ["w"], (0.3, 10.0), options),
        *frequency_responses(laboratory.command_test(300), ["U"], BAND, options),
    )


@pytest.fixture(scope="module")
def predictions(rig, weights_file, responses):
    """Comparisons of El Centro at 0.1 g, by model and test."""
    table, command = responses
    laboratory = Laboratory(rig, seed=6)
    known = poles_with_the_accuracy_of_300_s(rig)
    poles = np.append(slow_real_pole(table, known), known)
    whole = realize_together([table, command], poles, LAG)
    eight = balanced_truncation(whole, 8, typical_scales(whole, BAND, INTENSITY)).model
    models = {"consistent": consistent_model([table, command], poles, LAG, BAND, INTENSITY).model, "states_8": eight}
    controller = design(eight, load_weights(weights_file), 0.002).controller
    ground = prepare(
        read_record("el_centro"), 500.0, Treatment(peak_acceleration=0.980665, duration=100, band_limit=25)
    )
    tests = {
        "zero": (laboratory.open_loop("bags/zero", ground, 0 * ground), None),
        "closed": (controlled(laboratory, controller, ground, 7), controller),
    }
    return {
        (name, test): compare(run, model, law, rig.capacity)
        for name, model in models.items()
        for test, (run, law) in tests.items()
    }


@pytest.fixture(scope="module")
def weights_file(pytestconfig):
    return pytestconfig.rootpath / "src/abrace_lqg/config/lqg3.yaml"


def poles_with_the_accuracy_of_300_s(rig):
    """The rig's oscillating poles, 0.03 % of frequency and 1 % of damping off."""
    random = np.random.default_rng(5)
    pairs = []
    for pole in rig.model.poles():
        if pole.imag > 0:
            frequency = abs(pole) * (1 + 3e-4 * random.choice([-1, 1]))
            damping = -pole.real / abs(pole) * (1 + 1e-2 * random.choice([-1, 1]))
            upper = frequency * (-damping + 1j * np.sqrt(1 - damping**2))
            pairs += [upper, upper.conjugate()]
    return np.array(pairs)


def test_el_centro_with_zero_command_is_predicted_within_2_percent_in_every_channel(predictions):
    comparison = predictions["consistent", "zero"]
    error = comparison.noise_free_error()
    assert set(error) == {"x1", "x2", "x3", "xf", "a1", "a2", "a3", "f"}
    assert max(error.values()) < 0.02, error
    assert comparison.peak_rms_error() < 0.015


def test_el_centro_under_lqg3_is_predicted_within_3_percent_in_every_channel(predictions):
    comparison = predictions["consistent", "closed"]
    error = comparison.noise_free_error()
    a1 = error.pop("a1")
    assert set(error) == {"x1", "x2", "x3", "xf", "a2", "a3", "f", "U"}
    assert max(error.values()) < 0.03, error
    assert a1 < 0.05
    assert comparison.peak_rms_error() < 0.015


def test_eight_states_predict_the_closed_loop_worse(predictions):
    eight, whole = (predictions[name, "closed"].noise_free_error() for name in ("states_8", "consistent"))
    assert min(eight[name] / whole[name] for name in ("x1", "x2", "x3")) > 2
