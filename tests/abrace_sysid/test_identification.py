# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from identification_accuracy import Trial, coverage, true_pairs, worst_errors, worst_of

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_core.noise import banded_noise
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building import Building, modal_damping
from abrace_plant.rig.model import BraceGroup
from abrace_plant.rig.sensors import SensorSet
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.fitting.order_selection import no_modes
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.identification import identify
from abrace_sysid.spectra.estimation import TransferFunctionOptions
from abrace_sysid.validation import compare
from abrace_sysid.validity.judgement import judge


def errors(pairs, true):
    """Worst relative error of frequency and of damping ratio."""
    found = np.array([(pair.frequency, pair.damping) for pair in pairs])
    return np.abs(found / np.array(true)[: len(found)] - 1).max(axis=0)


def expect_poles_within(identified, rig, table, command):
    """Within fractions of frequency and damping, from the table test and from the command test."""
    true = pole_table(rig.model.poles())
    for pairs, asked, count in ((identified.poles.table_pairs, table, 3), (identified.poles.command_pairs, command, 6)):
        assert len(pairs) == count
        found = errors(pairs, true)
        assert (found < asked).all(), f"{count} pairs: frequency and damping {found} off, asked {asked}"


# The table of what has to be reached, worst pole: seconds, then (frequency, damping) from table and command
ACCURACY = {
    300: ((0.0003, 0.01), (0.001, 0.035)),
    600: ((0.0001, 0.005), (0.0006, 0.02)),
    120: ((0.001, 0.10), (0.001, 0.10)),
}


@pytest.mark.parametrize(("seed", "seconds"), [(1, 120), (2, 120), (1, 300), (2, 300), (1, 600)])
def test_poles_are_as_accurate_as_the_length_of_the_tests_allows(rig, laboratory_of, seconds, seed):
    laboratory = laboratory_of(rig, seed)
    found = identify(laboratory.table_test(seconds), laboratory.command_test(seconds))
    expect_poles_within(found, rig, *ACCURACY[seconds])


def test_multisines_of_328_s_find_the_poles(rig, laboratory_of):
    laboratory = laboratory_of(rig, 3)
    found = identify(laboratory.multisine_test(True, False), laboratory.multisine_test(False, True))
    assert found.table.periodic
    assert "multisine, 4 periods" in found.table_response.method
    expect_poles_within(found, rig, (0.0002, 0.005), (0.0002, 0.005))


def test_multisines_on_both_inputs_at_once_find_the_poles_from_one_test(rig, laboratory_of):
    both = laboratory_of(rig, 3).multisine_test(True, True)
    expect_poles_within(identify(both, both), rig, (0.0002, 0.005), (0.0003, 0.01))


def test_noise_on_both_inputs_at_once_gives_all_modes_within_the_band_of_both(rig, laboratory_of):
    laboratory = laboratory_of(rig, 3)
    ground = banded_noise(40_000, 500.0, (0.0, 30.0), 0.25, 1)
    both = laboratory.open_loop("bags/both", ground, banded_noise(40_000, 500.0, (0.0, 30.0), 1800.0, 2))
    found = identify(both, both, IdentificationOptions(table_band=(0.3, 30.0)))
    assert found.warnings == ("bags/both: noise on table and commands at once is used from 0.3 to 30 Hz",)
    own = pole_table(rig.model.poles())
    assert [pair.frequency for pair in found.poles.common_pairs] == pytest.approx([w for w, _ in own], rel=3e-4)
    assert found.reduced.order == 8
    ground = laboratory.earthquake()
    error = compare(ground, found.model, None, rig.capacity).noise_free_error()
    assert max(error.values()) < 0.02, error
    validity = judge([both], [both], IdentificationOptions(table_band=(0.3, 30.0)), found).validity
    assert "agreement of table and command" in validity.not_checked
    assert "two tests" not in {finding.check for finding in validity.findings}


def test_95_percent_intervals_hold_most_of_the_true_poles(rig, laboratory_of):
    true = np.array(pole_table(rig.model.poles()))
    inside = []
    for seed in range(4):
        laboratory = laboratory_of(rig, seed)
        found = identify(laboratory.table_test(120), laboratory.command_test(120))
        for pair, (frequency, damping) in zip(found.poles.common_pairs, true, strict=True):
            for (low, high), value in ((pair.frequency_interval, frequency), (pair.damping_interval, damping)):
                inside.append(low < value < high)
    assert 0.8 < np.mean(inside) <= 1.0


@pytest.mark.parametrize(
    ("fit", "table", "command"),
    [("vector_fitting", (0.0002, 0.005), (0.0005, 0.02)), ("sk", (0.001, 0.02), (0.001, 0.04))],
)
def test_other_methods_find_the_poles_less_well(table_test, command_test, identified, rig, fit, table, command):
    other = identify(table_test, command_test, IdentificationOptions(fit=fit, command_order=12, servo_lag=0.0008))
    expect_poles_within(other, rig, table, command)
    true = pole_table(rig.model.poles())
    assert (errors(other.poles.command_pairs, true) > errors(identified.poles.command_pairs, true)).all()
    assert np.isnan(other.poles.command_pairs[0].frequency_deviation), "and do not say how well"


def test_the_papers_equation_fails_on_the_command_and_says_so(table_test, command_test):
    with pytest.raises(AbraceError, match="paper of U, order 12: "):
        identify(table_test, command_test, IdentificationOptions(fit="paper", command_order=12))


def test_welch_gives_a_worse_transfer_function_and_the_same_poles(table_test, command_test, identified, rig):
    options = IdentificationOptions(transfer_function=TransferFunctionOptions(method="welch"))
    welch = identify(table_test, command_test, options)
    expect_poles_within(welch, rig, (0.0003, 0.01), (0.001, 0.035))
    true = discretize(rig.model, 0.002)

    def error(response):
        exact = true.frequency_response(response.omega)[:, :, 1]
        return np.sqrt(np.mean(np.abs(response.response - exact) ** 2) / np.mean(np.abs(exact) ** 2))

    assert error(welch.command_response) > 5 * error(identified.command_response)


def test_repeated_tests_tell_more_than_one(rig, laboratory_of):
    one, two = laboratory_of(rig, 1), laboratory_of(rig, 2)
    single = identify(one.table_test(90), one.command_test(90))
    repeated = identify([one.table_test(90), two.table_test(90)], [one.command_test(90), two.command_test(90)])
    assert "2 records" in repeated.table_response.method
    deviations = [[pair.frequency_deviation for pair in each.poles.common_pairs] for each in (single, repeated)]
    assert np.mean(np.array(deviations[1]) / np.array(deviations[0])) < 0.9
    expect_poles_within(repeated, rig, (0.0003, 0.01), (0.001, 0.035))


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
    own = rig.model.poles()
    for pole in identified.model.poles():
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


def test_a_lag_that_is_not_the_one_given_is_named(table_test, command_test):
    found = identify(table_test, command_test, IdentificationOptions(servo_lag=0.003))
    assert found.warnings[0].startswith(
        "bags/command: U lags by 0.81 ms, servo_lag is 3 ms: the models have the measured"
    )
    assert found.reduced.input_delay[1] == pytest.approx(0.00081, abs=1e-5)


def test_closed_loop_that_was_not_used_is_predicted(identified, laboratory, controller):
    run = laboratory.earthquake(controller)
    comparison = compare(run, identified.model, controller, laboratory.rig.capacity)
    error, correlation = comparison.noise_free_error(), comparison.correlation()
    assert set(error) == {*run.names, "U"}
    assert max(error.values()) < 0.03, error
    assert min(correlation.values()) > 0.999, correlation


def test_zero_command_is_predicted_with_the_force(identified, laboratory):
    comparison = compare(laboratory.earthquake(), identified.model, None, laboratory.rig.capacity)
    error = comparison.noise_free_error()
    assert max(error.values()) < 0.02, error


def test_progress_rises_to_one_and_provenance_says_what_was_done(table_test, command_test):
    steps = []
    found = identify(table_test, command_test, progress=lambda step, fraction: steps.append((fraction, step)))
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
    found = identify(laboratory.table_test(120), laboratory.command_test(120))
    own = pole_table(other.model.poles())
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
    assert no_modes(None, np.linspace(2.0, 188.0, 100)) == []


def test_a_rig_of_two_storeys_is_identified_by_the_same_code(rig, laboratory_of):
    masses, stiffness = np.array([9e3, 8e3]), np.array([[6e6, -3e6], [-3e6, 3e6]])
    two = replace(
        rig,
        building=Building(masses, stiffness, modal_damping(masses, stiffness, np.array([0.01, 0.01]))),
        braces=(BraceGroup(2, 1, 0.9, 1e5, Actuator(3e4, 5e6, 0.0008, 0.5, 4e3)),),
        local_modes=(),
    )
    laboratory = laboratory_of(two)
    found = identify(laboratory.table_test(120), laboratory.command_test(120))
    assert found.superposed.order == 12
    assert found.model.outputs == ("x1", "x2", "xf", "a1", "a2", "f")
    true = pole_table(two.model.poles())
    for pairs in (found.poles.table_pairs, found.poles.command_pairs):
        frequency, damping = errors(pairs, true)
        assert frequency < 0.003
        assert damping < 0.1


# --- hard cases ------------------------------------------------------------------------------------------------------


def test_one_minute_is_enough_for_the_building(rig, laboratory_of):
    laboratory = laboratory_of(rig, 4)
    found = identify(laboratory.table_test(60), laboratory.command_test(60))
    expect_poles_within(found, rig, (0.001, 0.02), (0.002, 0.05))


def test_noise_of_40_db_leaves_the_building_within_a_hundredth(rig, laboratory_of):
    sensors = SensorSet(
        **{
            kind: replace(getattr(rig.sensors, kind), noise=0.01 / 1.3 * getattr(rig.sensors, kind).range)
            for kind in ("displacement", "stroke", "acceleration", "force", "ground_acceleration")
        }
    )
    laboratory = laboratory_of(replace(rig, sensors=sensors), 1)
    found = identify(laboratory.table_test(300), laboratory.command_test(300))
    true = pole_table(rig.model.poles())
    for pairs in (found.poles.table_pairs, found.poles.command_pairs[:3]):
        frequency, damping = errors(pairs, true)
        assert frequency < 0.001
        assert damping < 0.03


def test_a_dead_channel_is_named_and_the_others_come_out(table_test, command_test, rig):
    found = identify(table_test, without(command_test, "a2", 0.25))
    assert found.warnings == ("bags/command: channel a2 is left out: never changes from 0.25",)
    assert found.model.outputs == ("x1", "x2", "x3", "xf", "a1", "a3", "f")
    expect_poles_within(found, rig, (0.0003, 0.01), (0.001, 0.035))


def test_a_gap_leaves_the_longest_whole_piece(table_test, command_test, rig):
    gap = command_test.sequence + (np.arange(len(command_test.sequence)) > 20_000).astype(np.uint64)
    found = identify(table_test, replace(command_test, sequence=gap))
    (warning,) = found.warnings
    assert "bags/command: a gap after sample 20000 (1 samples, 0.002 s)" in warning
    assert len(found.command.runs[0].sequence) == len(gap) - 20_001
    expect_poles_within(found, rig, (0.0003, 0.01), (0.001, 0.035))


def test_a_clipped_input_is_refused_with_the_count(table_test, command_test):
    clipped = replace(command_test, command=np.clip(command_test.command, -3000.0, 3000.0))
    with pytest.raises(AbraceError, match=r"bags/command: input U is clipped, \d+ of 122000 samples"):
        identify(table_test, clipped)


def without(run, name, value):
    outputs = run.outputs.copy()
    outputs[:, run.names.index(name)] = value
    return replace(run, outputs=outputs)


def low_passed(series, highest):
    spectrum = np.fft.rfft(series, axis=0)
    spectrum[np.fft.rfftfreq(len(series), 0.002) > highest] = 0
    return np.fft.irfft(spectrum, len(series), axis=0)


def cut(run, samples):
    kept = slice(0, samples)
    return replace(
        run,
        sequence=run.sequence[kept],
        outputs=run.outputs[kept],
        ground_acceleration=run.ground_acceleration[kept],
        command=run.command[kept],
    )


MISTAKES = {
    "the bags are swapped": (lambda t, c: (c, t), "bags/command: U up to .* N, expected 0"),
    "one bag twice": (lambda t, _: (t, t), "bags/table: U is not excited"),
    "the table is at rest": (
        lambda t, c: (replace(t, ground_acceleration=c.ground_acceleration), c),
        "bags/command: rms of w .* expected the first at rest",
    ),
    "the table moves in the command test": (
        lambda t, c: (t, replace(c, ground_acceleration=t.ground_acceleration)),
        "bags/command: rms of w .* expected the first at rest",
    ),
    "no command in the command test": (
        lambda t, c: (t, replace(c, command=0 * c.command)),
        r"bags/command: U is not excited from 0\.3 to 3\.27 Hz, expected noise from 0\.3 to 30 Hz",
    ),
    "noise of too narrow a band": (
        lambda t, c: (t, replace(c, command=low_passed(c.command, 20.0))),
        "bags/command: U is not excited from 21.1 to 24.1 Hz",
    ),
    "a short test": (lambda t, c: (cut(t, 20_000), c), "bags/table: 40 s, expected at least 60 s"),
    "gaps everywhere": (
        lambda t, c: (t, replace(c, sequence=c.sequence + (np.arange(len(c.sequence)) // 9000).astype(np.uint64))),
        "bags/command: a gap after sample 8999 .* and 12 more; the longest whole piece has 18 s, expected at least 60",
    ),
    "no test": (lambda t, _: (t, ()), "identification: no command test, expected at least one"),
    "five floors": (lambda t, c: (t, replace(c, floors=5)), "bags/command: floors 5, but 3 in bags/table"),
    "dead channels": (lambda t, c: (t, replace(c, outputs=0 * c.outputs)), "no channel is a response to U"),
    "another rig": (
        lambda t, c: (replace(t, facts={"rig": "one"}), replace(c, facts={"rig": "other"})),
        "bags/command: rig other, but one in bags/table",
    ),
    "another sample period": (lambda t, c: (t, replace(c, sample_period=0.004)), "sample period 0.004, but 0.002"),
    "two brace groups": (lambda t, c: (t, replace(c, groups=2)), "bags/command: brace groups 2, but 1 in bags/table"),
    "a value that is no number": (
        lambda t, c: (without(t, "x3", np.nan), c),
        "bags/table: channel x3 has 122000 values that are not finite, first at sample 0",
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
        (IdentificationOptions(fit="fft"), "fit 'fft', expected one of maximum_likelihood, vector_fitting, sk, paper"),
        (
            IdentificationOptions(transfer_function=TransferFunctionOptions(method="fft")),
            "method 'fft', expected 'local_rational'",
        ),
        (IdentificationOptions(servo_lag=-0.001), r"servo_lag -0\.001 s, expected a number >= 0"),
        (IdentificationOptions(command_order=11), "command_order 11, expected an even number of at least 6"),
        (IdentificationOptions(command_order=4), "command_order 4, expected an even number of at least 6"),
        (IdentificationOptions(table_band=(5.0, 1.0)), "band 5 to 1 Hz for w, expected within 0 to 250 Hz"),
        (
            IdentificationOptions(table_band=(0.3, 20.0)),
            r"w is not excited from 10.* Hz, expected noise from 0\.3 to 20",
        ),
        (IdentificationOptions(reduced_order=30), "to 30 states, expected 1 to"),
    ],
)
def test_options_that_cannot_be_met_are_refused(options, message, table_test, command_test):
    with pytest.raises(AbraceError, match=message):
        identify(table_test, command_test, options)


# --- what `make verify` makes of it ----------------------------------------------------------------------------------

OWN = {"table": [(7.0, 0.01), (23.0, 0.02)], "command": [(7.0, 0.01), (23.0, 0.02)]}


def trial_of(seed, factor, paper="unstable poles"):
    """A trial of 600 s, its frequencies too great by a factor, their standard deviation 0.001 of them."""
    pairs = tuple(PoleInterval(factor * w, zeta, 1e-3 * w, 1e-3 * zeta) for w, zeta in OWN["table"])
    return Trial(600, seed, {"table": pairs}, {"paper": {"table": paper}})


def test_worst_error_is_of_the_nearest_pair_and_a_pair_that_is_missed_counts():
    frequency, damping = worst_errors([(23.0, 0.03), (7.07, 0.01), (50.0, 0.5)], OWN["table"])
    assert (frequency, damping) == pytest.approx((0.01, 0.5))
    assert worst_errors([(7.0, 0.01)], OWN["table"])[0] > 0.5


def test_worst_over_seeds_is_none_where_a_method_refused_one_and_says_how_many():
    trials = [trial_of(0, 1.0), trial_of(1, 0.98, OWN["table"]), trial_of(2, 1.01), trial_of(8, 2.0)]
    assert worst_of("ours", "table_600", trials, OWN)["frequency_error"] == pytest.approx(0.02), "of seeds 0 to 7"
    assert worst_of("paper", "table_600", trials, OWN) == {
        "frequency_error": None,
        "damping_error": None,
        "failed": "unstable poles",
        "failed_seeds": 2,
    }


def test_coverage_is_the_share_of_frequencies_and_damping_ratios_in_their_intervals():
    assert coverage("table", [trial_of(0, 1.0), trial_of(1, 1.0015)], OWN) == 1.0
    assert coverage("table", [trial_of(0, 1.0), trial_of(1, 1.0025)], OWN) == 0.75, "two frequencies of eight are not"


def test_true_pairs_are_the_buildings_from_the_table_and_all_six_from_the_command(rig):
    pairs = true_pairs(rig)
    assert (len(pairs["table"]), len(pairs["command"]), len(pairs["common"])) == (3, 6, 6)
    assert pairs["command"][:3] == pairs["table"]
