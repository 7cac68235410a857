import json
from dataclasses import replace

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_plant.actuator import Actuator
from abrace_plant.building import Building, modal_damping
from abrace_plant.rig import BraceGroup
from abrace_sysid.identification import IdentificationOptions, identify
from abrace_sysid.validation import compare


def worst(poles, true):
    found = pole_table(poles)
    assert len(found) == len(true)
    frequency = max(abs(a / b - 1) for (a, _), (b, _) in zip(found, true, strict=True))
    return frequency, max(abs(a / b - 1) for (_, a), (_, b) in zip(found, true, strict=True))


def expect_poles_within(identified, rig, frequency, damping):
    true = pole_table(rig.model.poles())
    for poles, expected in ((identified.table_poles, true[:3]), (identified.command_poles, true)):
        frequency_error, damping_error = worst(poles, expected)
        assert frequency_error < frequency, f"{len(poles)} poles: frequency {frequency_error:.4%} off"
        assert damping_error < damping, f"{len(poles)} poles: damping {damping_error:.2%} off"


def test_all_poles_of_four_minute_tests_are_those_of_the_rig(identified, rig):
    expect_poles_within(identified, rig, 0.001, 0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_all_poles_of_two_minute_tests_are_those_of_the_rig(rig, laboratory_of, seed):
    laboratory = laboratory_of(rig, seed)
    found = identify(laboratory.table_test(120), laboratory.command_test(120))
    expect_poles_within(found, rig, 0.002, 0.1)


def test_welch_finds_the_poles_less_well(table_test, command_test, identified, rig):
    welch = identify(table_test, command_test, IdentificationOptions(method="welch"))
    expect_poles_within(welch, rig, 0.005, 0.3)
    true = pole_table(rig.model.poles())
    assert worst(welch.command_poles, true)[1] > worst(identified.command_poles, true)[1]


def test_model_is_the_superposition_of_eqs_6_and_7(identified, command_test):
    model = identified.model
    assert (model.order, model.inputs, model.outputs) == (24, ("w", "U"), command_test.names)
    assert model.input_delay == (0.0, 0.0008)
    assert not model.b[:6, 1].any()
    assert not model.b[6:, 0].any()
    accelerations = [model.outputs.index(name) for name in ("a1", "a2", "a3")]
    others = [model.outputs.index(name) for name in ("x1", "x2", "x3", "xf", "f")]
    assert not model.c[others, 6:18].any(), "Z2 is of the accelerations"
    assert not model.c[accelerations, 18:].any(), "Z3 is of the others"
    building = np.linalg.eigvals(model.a[18:, 18:])
    assert np.allclose(np.sort_complex(building), np.sort_complex(identified.command_poles[:6]))


def test_of_24_states_18_matter_and_8_are_kept(identified):
    hankel = identified.hankel_singular_values
    assert len(hankel) == 24
    assert int(np.sum(hankel > 1e-6 * hankel[0])) == 18
    reduced = identified.reduced
    assert reduced.order == 8
    assert reduced.is_stable()
    assert reduced.input_delay == (0.0, 0.0008)


def test_closed_loop_that_was_not_used_is_predicted(identified, laboratory, controller):
    run = laboratory.earthquake(controller)
    comparison = compare(run, identified.model, controller, laboratory.rig.capacity)
    error, correlation = comparison.normalised_rms_error(), comparison.correlation()
    assert set(error) == {*run.names, "U"}
    assert max(error.values()) < 0.05, error
    assert min(correlation.values()) > 0.998, correlation


def test_zero_command_is_predicted_by_both_models(identified, laboratory):
    run = laboratory.earthquake()
    for model in (identified.model, identified.reduced):
        comparison = compare(run, model, None, laboratory.rig.capacity)
        error = comparison.normalised_rms_error()
        # six poles leave the servo's slow real pole out, which shows in the force alone
        assert error.pop("f") < 0.15
        assert max(error.values()) < 0.03, error


def test_progress_rises_to_one_and_provenance_says_what_was_done(table_test, command_test):
    steps = []
    found = identify(table_test, command_test, progress=lambda step, fraction: steps.append((fraction, step)))
    fractions = [fraction for fraction, _ in steps]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    provenance = json.loads(json.dumps(found.model.provenance))
    assert provenance["bags"] == {"table": "bags/table", "command": "bags/command"}
    assert provenance["options"]["servo_lag"] == 0.0008
    assert "local polynomial" in provenance["method"]["table"]
    assert found.reduced.provenance["bags"] == provenance["bags"]


def test_a_rig_of_two_storeys_is_identified_by_the_same_code(rig, laboratory_of):
    masses, stiffness = np.array([9e3, 8e3]), np.array([[6e6, -3e6], [-3e6, 3e6]])
    two = replace(
        rig,
        building=Building(masses, stiffness, modal_damping(masses, stiffness, np.array([0.01, 0.01]))),
        braces=(BraceGroup(2, 1, 0.9, 1e5, Actuator(3e4, 5e6, 0.0008, 0.5, 4e3)),),
        local_modes=(),
    )
    laboratory = laboratory_of(two)
    options = IdentificationOptions(command_order=4)
    found = identify(laboratory.table_test(120), laboratory.command_test(120), options)
    assert found.model.order == 12
    assert found.model.outputs == ("x1", "x2", "xf", "a1", "a2", "f")
    true = pole_table(two.model.poles())
    for poles in (found.table_poles, found.command_poles):
        frequency, damping = worst(poles, true)
        assert frequency < 0.003
        assert damping < 0.1


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
    "the bags are swapped": (lambda t, c: (c, t), "bags/command: a table test with commands up to"),
    "one bag twice": (lambda t, _: (t, t), "bags/table: rms ground acceleration 0.2"),
    "the table is at rest": (
        lambda t, c: (replace(t, ground_acceleration=c.ground_acceleration), c),
        "expected the first shaken and the second at rest",
    ),
    "the table moves in the command test": (
        lambda t, c: (t, replace(c, ground_acceleration=t.ground_acceleration)),
        "expected the first shaken and the second at rest",
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
    "a gap": (
        lambda t, c: (t, replace(c, sequence=c.sequence + (np.arange(len(c.sequence)) > 500).astype(np.uint64))),
        "bags/command: a gap after sample 500",
    ),
    "another rig": (
        lambda t, c: (replace(t, facts={"rig": "one"}), replace(c, facts={"rig": "other"})),
        "bags/command: rig other, but one in bags/table",
    ),
    "another sample period": (lambda t, c: (t, replace(c, sample_period=0.004)), "sample period 0.004, but 0.002"),
    "two brace groups": (lambda t, c: (replace(t, groups=2), c), "bags/table: 2 brace groups, expected 1"),
    "a dead channel": (lambda t, c: (t, without(c, "a2", 0.25)), "bags/command: channel a2 never changes"),
    "a value that is no number": (
        lambda t, c: (without(t, "x3", np.nan), c),
        "bags/table: channel x3 has a value that",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_tests_that_are_not_what_they_should_be_are_refused(mistake, table_test, command_test):
    spoil, message = MISTAKES[mistake]
    with pytest.raises(AbraceError, match=message):
        identify(*spoil(table_test, command_test))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (IdentificationOptions(method="fft"), "method 'fft', expected 'local_polynomial' or 'welch'"),
        (IdentificationOptions(servo_lag=-0.001), r"servo_lag -0\.001 s, expected a number >= 0"),
        (IdentificationOptions(command_order=11), "command_order 11, expected an even number of at least 6"),
        (IdentificationOptions(command_order=4), "command_order 4, expected an even number of at least 6"),
        (IdentificationOptions(table_band=(5.0, 1.0)), "band 5 to 1 Hz for w, expected within 0 to 250 Hz"),
        (
            IdentificationOptions(table_band=(0.3, 20.0)),
            r"w is not excited from 10.* Hz, expected noise from 0\.3 to 20",
        ),
        (IdentificationOptions(reduced_order=20), "to 20 states, expected 1 to 18"),
    ],
)
def test_options_that_cannot_be_met_are_refused(options, message, table_test, command_test):
    with pytest.raises(AbraceError, match=message):
        identify(table_test, command_test, options)
