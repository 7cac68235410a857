# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from laboratory import Laboratory

from abrace_core import AbraceError
from abrace_core.model.linear_model import pole_table
from abrace_core.model.multisine import repeated_multisine
from abrace_core.model.table_signals import table_noise
from abrace_plant.rig.file import load_rig
from abrace_sysid.examination import prepared
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.fitting.pole_fits import _observations
from abrace_sysid.fitting.servo_forms import ServoForm, fit_rig
from abrace_sysid.identification import identify
from abrace_sysid.input_tests import input_tests
from abrace_sysid.recorded.test import Test
from abrace_sysid.validation import compare
from abrace_sysid.validity.judgement import judge
from abrace_sysid.validity.kinematics import kinematics
from abrace_sysid.validity.mechanics import backlashes, floor_masses
from abrace_sysid.validity.motion import Motion
from abrace_sysid.validity.rig_findings import backlash

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
OPTIONS = IdentificationOptions(table_band=(0.3, 25.0))
SECONDS, SECONDS_STEPPED = 100, 40
"""Of tests; of those of a building that is worn, which is stepped from sample to sample."""
RMS = 3500.0


@pytest.fixture(scope="module")
def five():
    """Five storeys, brace groups at floors 1 and 3."""
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/five_storey.yaml")


@pytest.fixture(scope="module")
def rest():
    return np.zeros(len(noise(1, RMS)))


@pytest.fixture(scope="module")
def commands(five, rest):
    """The tests of the two groups, by the way in which they are excited."""
    return {kind: commands_of(five, rest, kind) for kind in ("each group alone", "noise at once")}


@pytest.fixture(scope="module")
def table(five, rest):
    return table_of(five, rest)


def test_sensors_of_a_tall_building_that_moves_almost_as_one_do_not_contradict_each_other():
    """Ten floors in the table's test: their displacements are so much alike that sensor noise tells them apart."""
    ten = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ten_storey.yaml")
    ground = Laboratory._noise(SECONDS, 25.0, 0.25, 3)
    run = Laboratory(ten, 1).open_loop("bags/table", ground, np.zeros((len(ground), ten.groups)))
    found = kinematics(Motion.of(Test.of(run), 25.0), (0.3, 25.0))
    assert set(found.contradictions) >= {"xf1", "xf2", "xf3", "xf4"}
    assert max(found.contradictions.values()) < 0.001, found.contradictions
    assert not found.changes


def noise(seed, rms, seconds=SECONDS):
    return Laboratory._noise(seconds, 30.0, rms, seed)


def table_of(five, rest, seconds=SECONDS):
    ground = Laboratory._noise(seconds, 25.0, 0.25, 3)
    return Laboratory(five, 1).open_loop("bags/table", ground, np.column_stack([rest, rest]))


def commands_of(five, rest, kind, seconds=SECONDS):
    laboratory = Laboratory(five, 2)
    one, two = noise(1, RMS, seconds), noise(2, RMS, seconds)
    if kind == "each group alone":
        alone = (("bags/U1", [one, rest]), ("bags/U2", [rest, two]))
        return [laboratory.open_loop(source, rest, np.column_stack(both)) for source, both in alone]
    return [laboratory.open_loop("bags/both", rest, np.column_stack([one, two]))]


def test_two_brace_groups_are_identified_with_modes_common_to_all_tests(five, commands, table):
    found = identify(table, commands["each group alone"], OPTIONS)
    assert not found.warnings
    assert [data.input for data in found.commands] == ["U1", "U2"]
    assert found.model.inputs == ("w", "U1", "U2")
    assert found.model.order == 2 * 7 + 4, "seven pairs, and of each servo a slow pole and a lag"
    assert found.model.input_delay == pytest.approx((0.0, 0.0005, 0.001), abs=1e-4), "the digital servos' steps"
    fast = np.sort(five.model.poles.real)[:2]  # -1 / lag, with the building
    assert found.reduced.input_delay == pytest.approx((0.0, 0.0005 - 1 / fast[0], 0.001 - 1 / fast[1]), abs=5e-5)
    assert found.reduced.order == 10, "two states for each mode of the building"
    own = np.array(pole_table(five.model.poles))
    pairs = np.array([(pair.frequency, pair.damping) for pair in found.poles.common_pairs])
    assert len(pairs) == len(own) == 7
    frequency, damping = np.abs(pairs[: len(own)] / own - 1).max(axis=0)
    assert frequency < 5e-4
    assert damping < 0.01
    ground = Laboratory._noise(30, 12.0, 0.5, 9)
    other = Laboratory(five, 5).open_loop("bags/other", ground, np.zeros((len(ground), 2)))
    error = compare(other, found.model, None, five.capacity).noise_free_error()
    assert max(error[name] for name in other.names) < 0.015, error
    assert found.reduced.is_stable()


def motions_of(worn):
    """Of a building that is worn, in the tests of the table and of each group alone."""
    rest, seconds = np.zeros(len(noise(1, RMS, SECONDS_STEPPED))), SECONDS_STEPPED
    tests = [table_of(worn, rest, seconds), *commands_of(worn, rest, "each group alone", seconds)]
    return [Motion.of(Test.of(test), 25.0) for test in tests]


def test_floor_masses_follow_from_all_tests_together_also_with_friction(five):
    worn = replace(five, building=replace(five.building, friction=(0.0, 0.0, 0.0, 300.0, 0.0)))
    masses = floor_masses([(motion, OPTIONS.table_band) for motion in motions_of(worn)])
    assert [masses[floor] for floor in range(1, 6)] == pytest.approx(five.building.masses, rel=0.03)


def test_a_clearance_greater_than_the_stroke_is_backlash_and_no_fault_of_a_sensor(five):
    first, second = five.braces
    motions = motions_of(replace(five, braces=(first, replace(second, backlash=2e-4))))
    assert np.std(motions[-1].series(motions[-1].spectra["xf2"], (0.3, 25.0))) < 2e-4
    for motion in motions:
        found = kinematics(motion, OPTIONS.table_band)
        assert not found.changes
        assert max(found.contradictions.values()) < 0.01
    findings = backlash([(motion, OPTIONS.table_band) for motion in motions])
    assert [finding.cause for finding in findings] == ["backlash"]
    assert findings[0].where == "brace group 2"
    assert backlashes(motions[-1], OPTIONS.table_band)[1].clearance == pytest.approx(2e-4, rel=0.15)


def test_a_group_that_no_test_excites_is_named(commands, table):
    only_one = commands["each group alone"][:1]
    with pytest.raises(AbraceError, match="bags/U1: U2 zero throughout, expected a test of every command"):
        identify(table, only_one, OPTIONS)


def test_a_group_tested_alone_and_with_the_other_is_refused(commands, table):
    mixed = commands["each group alone"][:1] + commands["noise at once"]
    with pytest.raises(AbraceError, match="expected every command either alone or always with the same commands"):
        identify(table, mixed, OPTIONS)


def test_groups_excited_by_the_same_noise_are_refused(five, rest, table):
    both = Laboratory(five, 2).open_loop("bags/same", rest, np.column_stack([noise(1, RMS), noise(1, RMS)]))
    with pytest.raises(AbraceError, match="zero, or repeats another"):
        identify(table, both, OPTIONS)


def test_the_papers_method_takes_several_groups(five, commands, table):
    """As the paper one input at a time. The likelihood's first poles are those of vector fitting, of both at once."""
    found = identify(table, commands["each group alone"], OPTIONS.model_copy(update={"method": "paper"}))
    true = [w for w, _ in pole_table(five.model.poles)]
    assert [pair.frequency for pair in found.poles.table_pairs] == pytest.approx(true[:5], rel=0.01)


def test_multisines_on_table_and_both_groups_lose_no_channel_and_are_not_taken_for_nonlinear(five):
    """After one period of 16 s the slowest mode still decays; f1 and f2 answer the commands far more than the table."""
    periods, period = 4, 16.384
    parts = [
        repeated_multisine(periods * period, period, 500.0, (0.3, high), rms, 1, lines, share)
        for high, rms, lines, share in (
            (25.0, 0.25, "odd", (0, 1)),
            (30.0, 3500.0, "even", (0, 2)),
            (30.0, 7000.0, "even", (1, 2)),
        )
    ]
    run = Laboratory(five, 3).open_loop("bags/all", parts[0], np.column_stack(parts[1:]))
    found = identify(run, run)
    assert found.model.outputs == run.names
    assert not found.warnings
    own = np.array(pole_table(five.model.poles))
    pairs = np.array([(pair.frequency, pair.damping) for pair in found.poles.common_pairs])[: len(own)]
    assert np.abs(pairs / own - 1).max(axis=0) == pytest.approx(0, abs=0.02)
    validity = judge(found).validity
    assert validity.verdict.words == "trust", validity.text()


def test_a_mode_just_above_the_band_of_the_table_is_no_reason_to_refuse_it(five):
    six = replace(load_rig(CONFIG / "six_storey.yaml"), sensors=five.sensors)
    ground = table_noise(100_000, 500.0, (0.1, 10.4), 0.25, 1)
    run = Laboratory(six, 1).open_loop("bags/table", ground, np.zeros((len(ground), 2)))
    options = IdentificationOptions().of_tests([Test.of(run)], [Test.of(run)])
    bands = {"w": options.table_band}
    (data,) = input_tests((prepared(Test.of(run), bands),), bands, options)
    found = fit_rig(_observations([data]), [ServoForm(1), ServoForm(0)])
    below = [pair[0] for pair in pole_table(six.model.poles)][:5]
    np.testing.assert_allclose([pair.frequency for pair in found.pairs()][:5], below, rtol=1e-3)
