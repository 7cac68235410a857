# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_sysid.models.realization import modal_states, realize
from abrace_sysid.paper import superpose
from abrace_sysid.spectra.frequency_response import FrequencyResponse

POLES = np.array([-0.11 + 7.3j, -0.11 - 7.3j, -0.5 + 23j, -0.5 - 23j, -40 + 0j])


def given_model(input_name, delay):
    states = modal_states(POLES, input_name, delay)
    random = np.random.default_rng(1)
    c, d = random.standard_normal((2, 5)), random.standard_normal((2, 1))
    return LinearModel(states.a, states.b, c, d, (input_name,), ("x1", "a1"), input_delay=(delay,))


def test_modal_states_have_the_poles_and_show_themselves_and_the_input():
    states = modal_states(POLES, "U", 0.001)
    assert np.allclose(np.sort_complex(states.poles), np.sort_complex(POLES))
    at_7 = states.frequency_response(7.0)[0, :, 0]
    assert np.allclose(at_7[-1], np.exp(-7j * 0.001))
    with pytest.raises(AbraceError, match="expected conjugate pairs"):
        modal_states(POLES[:3], "U", 0.0)


@pytest.mark.parametrize(("input_name", "delay"), [("w", 0.0), ("U", 0.0), ("U", 0.0008), ("U", 0.0045)])
def test_a_sampled_response_is_realised_exactly_hold_and_delay_included(input_name, delay):
    model = given_model(input_name, delay)
    omega = np.linspace(2, 190, 300)
    sampled = discretize(model, 0.002).frequency_response(omega)[:, :, 0]
    measured = FrequencyResponse(input_name, ("x1", "a1"), omega, sampled, np.ones((300, 2)), 0.002, "exact")
    found = realize(measured, POLES, delay)
    assert found.input_delay == (delay,)
    assert (found.inputs, found.outputs) == ((input_name,), ("x1", "a1"))
    assert np.allclose(found.c, model.c, atol=1e-8)
    assert np.allclose(found.d, model.d, atol=1e-8)


def test_several_responses_of_one_input_share_their_numerators_and_others_are_refused():
    model = given_model("U", 0.0008)
    omega = np.linspace(2, 190, 300)
    sampled = discretize(model, 0.002).frequency_response(omega)[:, :, 0]
    whole = FrequencyResponse("U", ("x1", "a1"), omega, sampled, np.ones((300, 2)), 0.002, "exact")
    low, high = (
        replace(whole, omega=omega[part], response=sampled[part], sigma=whole.sigma[part])
        for part in (slice(0, 120), slice(120, 300))
    )
    assert np.allclose(realize([low, high], POLES, 0.0008).c, realize(whole, POLES, 0.0008).c, rtol=1e-9)
    with pytest.raises(AbraceError, match="responses of x1, a1 to w and of x1, a1 to U, expected the same"):
        realize([low, replace(high, input="w")], POLES, 0.0008)


def test_superposition_adds_responses_and_gives_zeros_elsewhere():
    one, two, three = given_model("w", 0.0), given_model("U", 0.0008), given_model("U", 0.0008)
    whole = superpose([one, two.select(["a1"]), three.select(["x1"])], ("w", "U"), ("x1", "a1", "f"))
    assert whole.order == 15
    assert whole.input_delay == (0.0, 0.0008)
    response = whole.frequency_response([5.0, 50.0])
    assert np.allclose(response[:, :2, 0], one.frequency_response([5.0, 50.0])[:, :, 0])
    assert np.allclose(response[:, :2, 1], two.frequency_response([5.0, 50.0])[:, :, 0])
    assert not response[:, 2].any()


def test_parts_that_delay_one_input_differently_are_refused():
    with pytest.raises(AbraceError, match=r"input U is delayed by 0\.0 s and by 0\.0008 s"):
        superpose([given_model("U", 0.0), given_model("U", 0.0008)], ("U",), ("x1", "a1"))
