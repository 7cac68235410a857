# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import pole_table
from abrace_core.model.noise import banded_noise
from abrace_sysid.fitting import servo_forms
from abrace_sysid.fitting.maximum_likelihood import fit_again, fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.servo_forms import ServoForm, fit_rig, fit_with_form, rig_modes
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.frequency_response import FrequencyResponse

BAND = {"w": (0.3, 10.0), "U": (0.3, 30.0)}
TABLE = (0, 1, 2, 3, 6)


@pytest.fixture(scope="module")
def true(rig):
    """Upper poles of the pairs, slowest first, then the servo's real ones."""
    poles = rig.model.poles
    return np.concatenate([poles[poles.imag > 0], poles[poles.imag == 0]])


@pytest.fixture(scope="module")
def rough(true):
    """Starting poles 1 % off in frequency, 30 % off in damping."""
    rough = 1.3 * true.real + 0.99j * true.imag
    rough[-2:] = -8.0, -900.0
    return rough


def observe(run, name):
    return Observation.of_test(Test.of(run), [name], BAND[name])


def errors(estimate, true, pairs):
    """Worst relative errors of frequency and damping ratio."""
    expected = pole_table(true)[:pairs]
    found = estimate.pairs()[:pairs]
    return (
        max(abs(pair.frequency / w - 1) for pair, (w, _) in zip(found, expected, strict=True)),
        max(abs(pair.damping / zeta - 1) for pair, (_, zeta) in zip(found, expected, strict=True)),
    )


@pytest.fixture(scope="module")
def table_lines(table_test):
    return observe(table_test, "w")


@pytest.fixture(scope="module")
def command_lines(command_test):
    return observe(command_test, "U")


def test_a_fit_that_starts_from_another_of_the_same_inputs_has_its_drives(command_lines, table_lines, rough):
    tests = [replace(table_lines.thinned(700), poles=TABLE), command_lines.thinned(700)]
    first = fit_poles(tests, rough, spread="none")
    again = fit_poles(tests, first, most=2, spread="none")
    assert again.cost == pytest.approx(first.cost, abs=0.1)
    np.testing.assert_allclose(again.poles[:3], first.poles[:3], rtol=1e-6)


def test_poles_of_four_minutes_are_accurate_and_those_of_both_tests_together_more_certain(
    table_lines, command_lines, rough, true
):
    table = fit_poles([table_lines], rough[list(TABLE)])
    frequency, damping = errors(table, true, 3)
    assert frequency < 3e-5, f"table: frequency {frequency:.5%} off"
    assert damping < 1e-3, f"table: damping {damping:.4%} off"
    command = fit_poles([command_lines], rough)
    frequency, damping = errors(command, true, 6)
    assert frequency < 1e-4, f"command: frequency {frequency:.5%} off"
    assert damping < 3.5e-3, f"command: damping {damping:.4%} off"
    assert abs(command.poles[-2] / true[-2] - 1) < 0.1
    assert abs(command.poles[-1] / true[-1] - 1) < 0.1
    together = fit_poles([replace(table_lines, poles=TABLE), command_lines], command.poles)
    for one, both in zip(table.pairs()[:3], together.pairs()[:3], strict=True):
        assert both.frequency_deviation < one.frequency_deviation
    assert errors(together, true, 6)[0] < 1e-4


def test_two_inputs_at_once_give_the_poles_of_the_building(laboratory, rough, true):
    ground, command = (banded_noise(60_000, 500, (0.0, 10.0), rms, seed) for rms, seed in ((0.25, 11), (1800.0, 12)))
    run = laboratory.open_loop("bags/both", ground, command)
    test = Observation.of_test(Test.of(run), ["w", "U"], (0.3, 9.9))
    estimate = fit_poles([test], rough[[0, 1, 2, 3, 6, 7]])
    frequency, damping = errors(estimate, true, 3)
    assert frequency < 1e-4, f"frequency {frequency:.5%} off"
    assert damping < 5e-3, f"damping {damping:.4%} off"


def test_one_minute_with_noise_40_db_down_is_enough_from_poles_that_the_search_found(rig, laboratory_of, true):
    run = laboratory_of(rig, 2).table_test(60)
    noise = 10 ** (25 / 20) * np.array([5.6e-5] * 3 + [2.2e-5] + [3.4e-3] * 3 + [16.0])
    loud = replace(run, outputs=run.outputs + noise * np.random.default_rng(5).standard_normal(run.outputs.shape))
    lines = [observe(loud, "w")]
    frequency, damping = errors(fit_with_form(lines, rig_modes(lines, 3), ServoForm(1)), true, 3)
    assert frequency < 1e-4, f"frequency {frequency:.5%} off"
    assert damping < 0.01, f"damping {damping:.3%} off"


def periodic(rig, seed, lines=1500):
    """What a periodic test gives: independent lines, noise known."""
    omega = np.linspace(2, 180, lines)
    model = rig.discrete_model()
    exact = model.select(None, ["U"]).frequency_response(omega)[:, :, 0]
    sigma = np.full(exact.shape, 1e-3 * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0)))
    noise = np.random.default_rng(seed).standard_normal((2, *exact.shape)) / np.sqrt(2)
    response = exact + sigma * (noise[0] + 1j * noise[1])
    return FrequencyResponse("U", rig.model.outputs, omega, response, sigma, 0.002, "periodic")


def test_the_search_finds_the_modes_and_the_description_length_the_servo(rig, true):
    lines = [Observation.of_response(periodic(rig, 1, 800), "periodic")]
    assert np.abs(rig_modes(lines)) == pytest.approx(np.abs(true[:6]), rel=2e-3)
    forms = [ServoForm(0), ServoForm(1), ServoForm(2), ServoForm(2, "lag")]
    best = fit_rig(lines, forms)
    assert (best.poles.imag > 0).sum() == 6
    assert (best.poles.imag == 0).sum() == 2
    assert errors(best, true, 6)[0] < 1e-3
    assert fit_rig(lines, forms[::-1]).poles == pytest.approx(best.poles, rel=1e-6), "whatever is tried first"


def test_as_many_modes_as_are_given(rig):
    lines = [Observation.of_response(periodic(rig, 1, 800), "periodic")]
    assert len(fit_rig(lines, [ServoForm(2)], given=4).pairs()) == 4
    with pytest.raises(AbraceError, match="identification: 20 modes, expected at most"):
        fit_rig([lines[0].thinned(60)], [ServoForm(2)], given=20)


def test_forms_that_fail_say_why(rig, true, monkeypatch):
    lines = Observation.of_response(periodic(rig, 1), "periodic")
    growing = replace(lines, measured=lines.measured.conj())
    with pytest.raises(AbraceError, match="periodic: no mode from 2 to "):
        fit_rig([growing], [ServoForm(0), ServoForm(1)])
    monkeypatch.setattr(servo_forms, "rig_modes", lambda *_: true[:6])
    few = "with 6 modes: 2 real poles: periodic: 12 frequency lines, expected more than"
    with pytest.raises(AbraceError, match=f"periodic: no form of the servos could be fitted {few}"):
        fit_rig([lines.thinned(12)], [ServoForm(2)])


def test_a_mode_that_becomes_unstable_is_left_out_of_the_forms(rig, true, monkeypatch):
    lines = Observation.of_response(periodic(rig, 1), "periodic")
    grown = 1.0 / (1j * lines.omega - (0.1 + 80j)) + 1.0 / (1j * lines.omega - (0.1 - 80j))
    changed = lines.measured + 0.02 * np.abs(lines.measured).max(axis=0) * grown[:, None]
    monkeypatch.setattr(servo_forms, "rig_modes", lambda *_: np.append(true[:6], -0.1 + 80j))
    found = fit_rig([replace(lines, measured=changed)], [ServoForm(2)])
    assert [pair.frequency for pair in found.pairs()] == pytest.approx(np.abs(true[:6]), rel=0.02)


def test_a_test_without_modes_is_an_error_that_says_what_to_do(rig):
    measured = periodic(rig, 1, 800)
    single = np.repeat(1 / (1j * measured.omega[:, None] + 3.0), 8, axis=1)
    noise = 1e-4 * np.random.default_rng(3).standard_normal((2, *single.shape))
    measured = replace(measured, response=single + noise[0] + 1j * noise[1], sigma=np.full(single.shape, 1e-4))
    with pytest.raises(AbraceError, match="periodic: no mode from 2 to 180 rad/s, expected a longer or stronger test"):
        rig_modes([Observation.of_response(measured, "periodic")])


def test_unstable_poles_never_pass(rig, rough):
    measured = periodic(rig, 1)
    growing = replace(measured, response=measured.response.conj())
    with pytest.raises(AbraceError, match=r"periodic: (unstable poles|no maximum)"):
        fit_poles([Observation.of_response(growing, "periodic")], rough)


def test_a_pair_that_becomes_unstable_is_no_mode(rig, true, rough):
    """Lines to which a pair at 80 rad/s is added, stable in a first fit and unstable in the next one."""
    measured = periodic(rig, 1)

    def with_pair(pole: complex) -> list[Observation]:
        added = 1.0 / (1j * measured.omega - pole) + 1.0 / (1j * measured.omega - np.conj(pole))
        changed = measured.response + 0.02 * np.abs(measured.response).max(axis=0) * added.reshape(
            -1, *[1] * (measured.response.ndim - 1)
        )
        return [Observation.of_response(replace(measured, response=changed), "periodic")]

    first = fit_poles(with_pair(-0.3 + 80j), np.append(rough, -0.3 + 80j), spread="none")
    growing = with_pair(0.3 + 80j)
    with pytest.raises(AbraceError, match="periodic: unstable poles"):
        fit_poles(growing, first, spread="none")
    again = fit_again(growing, first, spread="none")
    assert len(again.poles) == len(rough)
    assert errors(again, true, 3)[0] < 1e-2


def test_a_pair_of_noise_is_no_mode(rig, true, rough):
    lines = [Observation.of_response(periodic(rig, 1), "periodic")]
    first = fit_poles(lines, np.append(rough, -0.1 + 92j))
    (noise,) = (pair for pair in first.pairs() if 85 < pair.frequency < 99)
    assert noise.damping < 2 * noise.damping_deviation
    again = fit_again(lines, first)
    assert len(again.poles) == len(rough)
    assert errors(again, true, 6)[0] < 1e-3
    assert fit_again(lines, again).poles == pytest.approx(again.poles, rel=1e-6), "modes stay"


def test_starts_that_lead_nowhere_are_refused(command_lines, rough):
    with pytest.raises(AbraceError, match=r"bags/command: no maximum of the likelihood found .* rad/s; other starting"):
        fit_poles([command_lines], np.array([-1 + 20j, -1 + 20j]))
    with pytest.raises(AbraceError, match="expected upper poles of pairs"):
        fit_poles([command_lines], rough.conj())
    with pytest.raises(AbraceError, match=r"bags/command: poles .*, expected within 0 to 7"):
        fit_poles([replace(command_lines, poles=(3, 9))], rough)


def test_dead_channels_and_too_few_lines_are_named(command_lines, rough):
    dead = command_lines.measured.copy()
    dead[:, 2] = 0
    with pytest.raises(AbraceError, match="bags/command: channel x3 is zero throughout"):
        replace(command_lines, measured=dead)
    few = {name: getattr(command_lines, name)[:20] for name in ("omega", "excitation", "measured", "noise_level")}
    with pytest.raises(AbraceError, match="bags/command: 20 frequency lines, expected more than"):
        fit_poles([replace(command_lines, **few)], rough)
