# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import pole_table
from abrace_core.model.noise import banded_noise
from abrace_core.model.verdict import Verdict
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.fitting.servo_forms import no_modes
from abrace_sysid.identification import identify
from abrace_sysid.recorded.test import Test
from abrace_sysid.validation import compare
from abrace_sysid.validity.judgement import judge


def errors(pairs, true):
    """Worst relative error of frequency and of damping ratio."""
    found = np.array([(pair.frequency, pair.damping) for pair in pairs])
    return np.abs(found / np.array(true)[: len(found)] - 1).max(axis=0)


def expect_poles_within(identified, rig, table, command):
    """Within fractions of frequency and damping, from the table test and from the command test."""
    true = pole_table(rig.model.poles)
    for pairs, asked, count in ((identified.poles.table_pairs, table, 3), (identified.poles.command_pairs, command, 6)):
        assert len(pairs) == count
        found = errors(pairs, true)
        assert (found < asked).all(), f"{count} pairs: frequency and damping {found} off, asked {asked}"


@pytest.fixture(scope="module")
def of_a_minute(rig, laboratory_of):
    laboratory = laboratory_of(rig, 4)
    return identify(laboratory.table_test(60), laboratory.command_test(60))


def test_poles_are_as_accurate_as_the_length_of_the_tests_allows(identified, of_a_minute, rig):
    """Of 240 and of 60 s; of many seeds and lengths, and their intervals: `make verify`."""
    expect_poles_within(identified, rig, (0.0003, 0.01), (0.001, 0.035))
    expect_poles_within(of_a_minute, rig, (0.001, 0.02), (0.002, 0.05))


def test_tests_of_a_rig_that_state_g_and_mm_give_the_model_in_si_units(of_a_minute, rig, laboratory_of):
    laboratory = laboratory_of(rig, 4)
    stated = []
    for test in map(Test.of, (laboratory.table_test(60), laboratory.command_test(60))):
        factors = [{"a1": 1 / 9.80665, "x2": 1000.0}.get(name, 1.0) for name in test.names]
        stated.append(replace(test, outputs=test.outputs * factors, units={"a1": "g", "x2": "mm"}))
    found, omega = identify(*stated).model, 2 * np.pi * np.array([1.0, 4.0, 10.0])
    assert found.units == {}
    np.testing.assert_allclose(
        found.frequency_response(omega), of_a_minute.model.frequency_response(omega), rtol=1e-3, atol=1e-9
    )


def test_multisines_on_both_inputs_at_once_find_the_poles_from_one_test(rig, laboratory_of):
    both = laboratory_of(rig, 3).multisine_test(True, True)
    found = identify(both, both)
    assert found.table.periodic
    assert "multisine, 4 periods" in found.table_response.method
    expect_poles_within(found, rig, (0.0002, 0.005), (0.0003, 0.01))


def test_noise_on_both_inputs_at_once_gives_all_modes_within_the_band_of_both(rig, laboratory_of):
    laboratory = laboratory_of(rig, 3)
    ground = banded_noise(40_000, 500.0, (0.0, 30.0), 0.25, 1)
    both = laboratory.open_loop("bags/both", ground, banded_noise(40_000, 500.0, (0.0, 30.0), 1800.0, 2))
    found = identify(both, both, IdentificationOptions(table_band=(0.3, 30.0)))
    assert found.warnings == ("bags/both: noise on table and commands at once is used from 0.3 to 30 Hz",)
    own = pole_table(rig.model.poles)
    assert [pair.frequency for pair in found.poles.common_pairs] == pytest.approx([w for w, _ in own], rel=3e-4)
    assert found.reduced.order == 8
    ground = laboratory.earthquake()
    error = compare(ground, found.model, None, rig.capacity).noise_free_error()
    assert max(error.values()) < 0.02, error
    validity = judge(found).validity
    assert "agreement of table and command" in validity.not_checked
    assert "two tests" not in {finding.check for finding in validity.findings}


def test_vector_fitting_finds_the_poles_less_well_and_without_intervals(table_test, command_test, identified, rig):
    other = identify(table_test, command_test, IdentificationOptions(method="vector_fitting"))
    expect_poles_within(other, rig, (0.0002, 0.005), (0.0005, 0.02))
    true = pole_table(rig.model.poles)
    assert (errors(other.poles.command_pairs, true) > errors(identified.poles.command_pairs, true)).all()
    assert np.isnan(other.poles.command_pairs[0].frequency_deviation), "no intervals"
    assert (other.covariance, other.model.order, other.reduced.order) == (None, 14, 8)
    omega = np.linspace(2, 180, 500)
    for name, most in (("w", 0.01), ("U", 0.02)):
        ours, own = (
            discretize(model.select(rig.model.outputs, [name]), 0.002).frequency_response(omega)[:, :, 0]
            for model in (other.model, rig.model)
        )
        shown = omega < (63 if name == "w" else 190)
        error = np.linalg.norm((ours - own)[shown], axis=0) / np.linalg.norm(own[shown], axis=0)
        assert error.max() < most, (name, error)


def test_repeated_tests_tell_more_than_one(of_a_minute, rig, laboratory_of):
    one, two = laboratory_of(rig, 4), laboratory_of(rig, 2)
    repeated = identify([one.table_test(60), two.table_test(60)], [one.command_test(60), two.command_test(60)])
    assert "2 records" in repeated.table_response.method
    deviations = [[pair.frequency_deviation for pair in each.poles.common_pairs] for each in (of_a_minute, repeated)]
    assert np.mean(np.array(deviations[1]) / np.array(deviations[0])) < 0.9
    expect_poles_within(repeated, rig, (0.001, 0.02), (0.001, 0.035))


def test_superposed_model_is_that_of_eqs_6_and_7(identified, command_test):
    model = identified.superposed
    assert (model.order, model.inputs, model.outputs) == (24, ("w", "U"), command_test.names)
    assert model.input_delay == pytest.approx((0.0, 0.0008054), abs=2e-6), "as the tests show"
    assert not model.b[:6, 1].any()
    assert not model.b[6:, 0].any()
    accelerations = [model.outputs.index(name) for name in ("a1", "a2", "a3")]
    others = [model.outputs.index(name) for name in ("x1", "x2", "x3", "xf", "f")]
    assert not model.c[others, 6:18].any(), "Z2 is of the accelerations"
    assert not model.c[accelerations, 18:].any(), "Z3 is of the others"
    building = np.linalg.eigvals(model.a[18:, 18:])
    assert np.allclose(np.sort_complex(building), np.sort_complex(identified.poles.command[:6]))


def test_consistent_model_has_each_motion_once_and_8_states_are_kept(identified, rig):
    assert identified.model.order == 14, "six pairs, the servo's slow pole and its lag"
    assert identified.model.input_delay == (0.0, 0.0), "the lag is a state"
    own = rig.model.poles
    for pole in identified.model.poles:
        assert np.abs(own - pole).min() < 0.02 * abs(pole)
    assert identified.reduced.order == 8
    assert identified.reduced.is_stable()


def test_the_model_is_the_likelihoods_and_meets_the_rig_in_the_whole_band(identified, rig):
    for name, highest in (("w", 10.0), ("U", 30.0)):
        omega = 2 * np.pi * np.linspace(0.3, highest, 2000)
        own, found = (
            discretize(model.select(inputs=[name]), 0.002).frequency_response(omega)[:, :, 0]
            for model in (rig.model, identified.model)
        )
        error = np.sqrt(np.mean(np.abs(found - own) ** 2, axis=0) / np.mean(np.abs(own) ** 2, axis=0))
        assert error.max() < 0.0015, f"{name}: {error}"


def test_a_lag_that_is_not_the_one_given_is_named(identified):
    judged = judge(replace(identified, options=identified.options.model_copy(update={"servo_lag": 0.003}))).validity
    assert (judged.verdict, judged.causes) == (Verdict.CARE, ("lag",))
    assert judged.reasons[0].meaning == "U acts 0.81 ms late in command, servo_lag says 3 ms"
    assert identified.reduced.input_delay[1] == pytest.approx(0.00081, abs=1e-5)


def test_closed_loop_that_was_not_used_is_predicted(identified, laboratory, controller):
    run = laboratory.earthquake(controller)
    comparison = compare(run, identified.model, controller, laboratory.rig.capacity)
    error, correlation = comparison.noise_free_error(), comparison.correlation()
    assert set(error) == {*run.names, "U"}
    assert max(error.values()) < 0.03, error
    assert min(correlation.values()) > 0.999, correlation


def test_progress_rises_to_one_and_provenance_says_what_was_done(identified_with_steps):
    found, steps = identified_with_steps
    fractions = [fraction for fraction, _ in steps]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    provenance = json.loads(json.dumps(found.model.provenance))
    assert provenance["bags"] == {"table": ["bags/table"], "command": ["bags/command"]}
    assert provenance["options"]["servo_lag"] == 0.0
    assert provenance["lags"]["U"] == pytest.approx(0.000805, abs=5e-6)
    assert "local rational" in provenance["method"]["table"]
    assert found.reduced.provenance["bags"] == provenance["bags"]


def test_a_local_mode_among_the_buildings_hides_none_of_them(rig, laboratory_of):
    among = replace(rig.local_modes[0], frequency=30.0)
    other = replace(rig, local_modes=(among, *rig.local_modes[1:]))
    laboratory = laboratory_of(other)
    found = identify(laboratory.table_test(60), laboratory.command_test(60))
    own = pole_table(other.model.poles)
    building = [pair for pair in own if abs(pair[0] - 30.0) > 1 and pair[0] < 50.0]
    assert len(building) == 3
    assert [pair.frequency for pair in found.poles.table_pairs] == pytest.approx([w for w, _ in building], rel=1e-3)
    assert len(found.poles.command_pairs) == len(own) == 6
    assert np.abs(found.poles.building[::2]) == pytest.approx([w for w, _ in building], rel=1e-3)
    assert not found.warnings


def test_a_pair_beyond_the_band_or_damped_too_much_is_no_mode():
    pairs = [PoleInterval(w, zeta, 0.01, 0.001) for w, zeta in ((7.0, 0.01), (60.0, 0.99), (200.0, 0.02), (1.0, 0.1))]
    estimate = SimpleNamespace(pairs=lambda: pairs)
    assert no_modes(estimate, np.linspace(2.0, 188.0, 100)) == pairs[1:]


# --- hard cases ------------------------------------------------------------------------------------------------------


def test_a_clipped_input_is_refused_with_the_count(table_test, command_test):
    clipped = replace(command_test, command=np.clip(command_test.command, -3000.0, 3000.0))
    with pytest.raises(AbraceError, match=r"bags/command: input U is clipped, \d+ of 122000 samples"):
        identify(table_test, clipped)


# of one test alone: test_recorded_test.py
SERIES = ("sequence", "outputs", "ground_acceleration", "command")
MISTAKES = {
    "the bags are swapped": (lambda t, c: (c, t), "bags/command: U up to .* N, expected 0"),
    "one bag twice": (lambda t, _: (t, t), "bags/table: U is not excited"),
    "two tests of one name": (
        lambda t, c: (replace(t, command=c.command, source="one"), replace(c, source="one")),
        "one: U up to .* N, expected 0",
    ),
    "a test without samples": (
        lambda t, c: (replace(t, **{name: getattr(t, name)[:0] for name in SERIES}), c),
        "bags/table: 0 s, expected at least 60 s",
    ),
    "no test": (lambda t, _: (t, ()), "no test given, expected at least one"),
    "five floors": (lambda t, c: (t, replace(c, floors=5)), "bags/command: floors 5, expected 3, as in bags/table"),
    "another rig": (
        lambda t, c: (replace(t, facts={"rig": "one"}), replace(c, facts={"rig": "other"})),
        "bags/command: rig other, expected one, as in bags/table",
    ),
    "another sample period": (lambda t, c: (t, replace(c, sample_period=0.004)), "sample period 0.004, expected 0.002"),
    "two brace groups": (
        lambda t, c: (t, replace(c, groups=2, braces=(1, 1), command=np.hstack([c.command, c.command]))),
        "bags/command: brace groups 2, expected 1, as in bags/table",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_tests_that_are_not_what_they_should_be_are_refused(mistake, table_test, command_test):
    spoil, message = MISTAKES[mistake]
    options = IdentificationOptions(table_band=(0.3, 10.0), command_band=(0.3, 30.0))
    with pytest.raises(AbraceError, match=message):
        identify(*spoil(table_test, command_test), options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fft"}, "identification: method: 'fft', expected 'maximum_likelihood'"),
        ({"servo_lag": -0.001}, r"servo_lag: -0\.001, expected greater than or equal to 0"),
        ({"servo_lag": np.nan}, "servo_lag: nan, expected a finite number"),
        ({"reduced_order": 8.5}, r"reduced_order: 8\.5, expected a valid integer"),
        ({"modes": 2}, "modes 2, expected at least 3, one for each floor"),
        (
            {"table_band": (5.0, 1.0)},
            r"table_band: \(5\.0, 1\.0\), expected two frequencies in Hz, the lower one first",
        ),
        ({"table_band": 5.0}, r"table_band: 5\.0, expected two frequencies in Hz"),
        ({"table_band": (0.3, 20.0)}, r"w is not excited from 10.* Hz, expected noise from 0\.3 to 20"),
        ({"table_band": (0.3, 300.0)}, "band 0.3 to 300 Hz for w, expected within 0 to 250 Hz"),
    ],
)
def test_options_that_cannot_be_met_are_refused(options, message, table_test, command_test):
    with pytest.raises(AbraceError, match=message):
        identify(table_test, command_test, IdentificationOptions.of(options))


def test_options_are_what_they_can_only_mean():
    options = IdentificationOptions(reduced_order=8.0, table_band=[1, 9], servo_lag=np.float64(0.001))
    assert (options.reduced_order, options.table_band, options.servo_lag) == (8, (1.0, 9.0), 0.001)
    assert isinstance(options.reduced_order, int)
