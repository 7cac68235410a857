# SPDX-License-Identifier: Apache-2.0
"""What validity says of a linear rig, and of each planted fault."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from computed_once import computed_once
from faultless import accusations, faultless
from laboratory import Laboratory

from abrace_core import AbraceError
from abrace_core.model.noise import banded_noise
from abrace_core.model.verdict import Verdict
from abrace_core.model.verdict import judged as verdict_on
from abrace_sysid.examination import examined
from abrace_sysid.figures.validity import validity_figure
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.identification import identify
from abrace_sysid.recorded.test import Test
from abrace_sysid.results import write_validity
from abrace_sysid.validation import compare, predicted
from abrace_sysid.validity import rig_findings
from abrace_sysid.validity.finding import Finding, Validity
from abrace_sysid.validity.judgement import judge, judge_failure
from abrace_sysid.validity.kinematics import kinematics
from abrace_sysid.validity.mechanics import Backlash, backlashes, storey_frictions
from abrace_sysid.validity.model_findings import disagreeing, lag, lag_of_response, unexplained
from abrace_sysid.validity.motion import Motion
from abrace_sysid.validity.sensor_findings import contradicting, dead, saturated, spiked

BAND, OPTIONS = (0.3, 10.0), IdentificationOptions(servo_lag=0.0008)
SIX_MODES = OPTIONS.model_copy(update={"modes": 6})
"""As many as the rig has: no other number is tried."""
SECONDS = 80.0


@pytest.fixture(scope="module")
def judged(identified, tmp_path_factory):
    return computed_once(tmp_path_factory, "judged", lambda: judge(identified))


def changed(run, name, change):
    outputs = run.outputs.copy()
    outputs[:, run.names.index(name)] = change(outputs[:, run.names.index(name)])
    return replace(run, outputs=outputs)


def swapped(run, one, other):
    columns = [run.names.index(one), run.names.index(other)]
    outputs = run.outputs.copy()
    outputs[:, columns] = outputs[:, columns[::-1]]
    return replace(run, outputs=outputs)


def begin_of(run, samples):
    parts = ("sequence", "outputs", "ground_acceleration", "command")
    return replace(run, **{name: getattr(run, name)[:samples] for name in parts})


def changes(run):
    """Of its first half minute."""
    motion = Motion.of(Test.of(begin_of(run, 16_000)), 10.0)
    return [(one.kind, one.channels, one.unit) for one in kinematics(motion, BAND).changes]


def shaken(rig, **of_rig):
    ground = banded_noise(int(SECONDS * 500), 500.0, (0.0, 10.0), 0.25, 77)
    return Laboratory(replace(rig, **of_rig), 5).open_loop("bags/shaken", ground, 0 * ground)


def test_a_linear_rig_is_trusted(judged):
    assert judged.validity.verdict == Verdict.TRUST
    assert judged.validity.causes == ()
    assert judged.validity.not_checked == {}
    assert judged.validity.text() == "validity: trust"


def test_residuals_of_a_linear_rig_are_as_large_as_its_noise(judged):
    assert len(judged.residuals) == 2
    for residual in judged.residuals:
        assert residual.ratio.mean(axis=0) == pytest.approx(1.0, abs=0.15)
        assert residual.excess.max() < 0.004


def test_repeated_multisines_of_a_building_that_has_changed_between_them_disagree(rig, laboratory_of):
    softer = replace(rig, building=replace(rig.building, stiffness=0.98 * rig.building.stiffness))

    def repeated(*rigs, table):
        runs = [laboratory_of(one, seed).multisine_test(table, not table, 3) for seed, one in enumerate(rigs, 3)]
        return [replace(run, source=f"bags/test_{number}") for number, run in enumerate(runs, 1)]

    table, command = repeated(rig, rig, table=True), repeated(rig, softer, table=False)
    validity = judge(identify(table, command, SIX_MODES)).validity
    (same, other) = [finding for finding in validity.findings if finding.check == "repeated tests"]
    assert (same.verdict, other.verdict) == (Verdict.TRUST, Verdict.CARE), (same, other)
    assert re.search(r"test_1 and test_2 do not agree: mode at .* Hz, frequency -(0\.9|1\.0)\d %", other.meaning)


@pytest.mark.parametrize("both", [("x1", "x2"), ("a2", "a3"), ("x1", "xf"), ("x2", "a2"), ("x3", "f")])
def test_swapped_sensors_are_named(table_test, both):
    assert changes(swapped(table_test, *both)) == [("swapped", both, "")]


@pytest.mark.parametrize(
    ("name", "factor", "unit"),
    [("a1", 1 / 9.80665, "g"), ("x2", 1000.0, "mm"), ("xf", 100.0, "cm"), ("a3", 100.0, "cm/s^2"), ("f", 0.001, "kN")],
)
def test_a_channel_in_another_unit_is_named_with_the_unit(command_test, name, factor, unit):
    assert changes(changed(command_test, name, lambda values: factor * values)) == [("unit", (name,), unit)]


def test_a_sensor_of_the_wrong_sign_is_named(table_test):
    assert changes(changed(table_test, "a2", np.negative)) == [("reversed", ("a2",), "")]
    assert changes(replace(table_test, ground_acceleration=-table_test.ground_acceleration)) == [
        ("reversed", ("w",), "")
    ]


def test_the_stroke_of_a_brace_between_two_floors_has_the_sign_of_the_upper_one(table_test):
    lower, upper = table_test.channels(["x1", "x2"]).T

    def spanned(sign):
        return changed(table_test, "xf", lambda _: sign * (0.78 * upper - 0.8 * lower))

    assert changes(spanned(1.0)) == []
    assert changes(spanned(-1.0)) == [("reversed", ("xf",), "")]


def test_a_force_that_stays_at_zero_while_it_reverses_and_the_blow_after_it_are_no_spikes(command_test):
    force, floor = (command_test.channels([name])[:, 0] for name in ("f", "a1"))
    after = 10 + np.flatnonzero(force[9:-11] * force[10:-10] < 0)
    fastest = after[np.argsort(np.abs(force[after]))[-10:]]
    force[fastest] = 0.0
    floor[fastest] += 2.0 * np.std(floor)
    loose = changed(changed(command_test, "f", lambda _: force), "a1", lambda _: floor)
    (found,) = spiked(Test.of(loose), command_test.names)
    assert found.verdict == Verdict.TRUST, found.meaning
    (found,) = spiked(Test.of(changed(command_test, "a1", lambda _: floor)), command_test.names)
    assert "a1 has 10 spikes" in found.meaning


@pytest.mark.parametrize("name", ["x1", "a2", "f"])
def test_spikes_are_counted_and_named_and_noise_is_none(table_test, command_test, name):
    where, size = np.array([9000, 21000, 21500]), np.array([3.0, -2.0, 1.5])

    def spoilt(values):
        found = values.copy()
        found[where] += size * np.std(values)
        return found

    for run in (table_test, command_test):
        (clean,) = spiked(Test.of(run), (*run.names, "w"))
        assert clean.verdict == Verdict.TRUST
        (found,) = spiked(Test.of(changed(run, name, spoilt)), run.names)
        assert (found.cause, found.verdict, found.where) == ("spikes", Verdict.CARE, f"{name}, {run.source}")
        assert f"{name} has 3 spikes" in found.meaning
        many = changed(run, name, lambda values: np.where(np.arange(len(values)) % 50 == 49, 5 * values.std(), values))
        assert spiked(Test.of(many), run.names)[0].verdict == Verdict.DONT


@pytest.mark.parametrize("seed", [9111, 9121, 9112, 9127, 9123])
def test_close_modes_isolators_and_stiff_rigs_without_a_fault_accuse_nobody(seed):
    kind, rig = faultless(seed)
    assert [finding.meaning for finding in accusations(rig, seed, 60.0)] == [], kind


def test_two_faults_are_both_named(table_test):
    found = changes(changed(swapped(table_test, "x1", "x2"), "a3", lambda values: values / 9.80665))
    assert set(found) == {("swapped", ("x1", "x2"), ""), ("unit", ("a3",), "g")}


def test_a_late_accelerometer_is_measured(table_test):
    def late(values):
        when = np.arange(len(values))
        return np.interp(when - 1.5, when, values)

    found = kinematics(Motion.of(Test.of(changed(table_test, "a2", late)), 10.0), BAND)
    assert found.changes == ()
    assert found.lags == pytest.approx({"a1": 0.0, "a2": 0.003, "a3": 0.0, "w": 0.0}, abs=2e-4)
    moved = replace(table_test, ground_acceleration=late(table_test.ground_acceleration))
    found = kinematics(Motion.of(Test.of(moved), 10.0), BAND)
    assert found.lags == pytest.approx({"a1": 0.0, "a2": 0.0, "a3": 0.0, "w": 0.003}, abs=2e-4)
    (found,) = backlashes(Motion.of(Test.of(changed(table_test, "xf", late)), 10.0), BAND)
    assert found.lag == pytest.approx(0.003, abs=2e-4)


@pytest.mark.parametrize(("deviation", "named"), [(0.0013, False), (0.0001, True)])
def test_a_stroke_is_late_only_if_that_is_certain(monkeypatch, table_test, deviation, named):
    """A weakly shaken tower of 0.2 Hz: 3.0 ms, give or take 1.3."""
    stroke = Backlash(1, "xf", 0.0, 1e-4, 0.0, -0.003, deviation)
    monkeypatch.setattr(rig_findings, "backlashes", lambda _motion, _band: (stroke,))
    found = rig_findings.backlash([(Motion.of(Test.of(table_test), BAND[1]), BAND)])
    assert [one.cause for one in found if one.verdict] == (["lag"] if named else [])


def test_friction_of_a_storey_is_measured_in_newtons_and_of_the_others_none(rig):
    run = shaken(rig, building=replace(rig.building, friction=(0.0, 50.0, 0.0)))
    first, second, third = (one for _, one in storey_frictions([(Motion.of(Test.of(run), 10.0), BAND)]))
    assert second.force == pytest.approx(50.0, rel=0.15)
    assert second.acceleration > 20 * second.deviation
    assert second.opposite > 20
    for other in (first, third):
        assert abs(other.acceleration) < 4.5 * other.deviation
        assert abs(other.force) < 3


def test_backlash_of_the_pins_is_measured_in_metres(rig):
    (group,) = rig.braces
    (found,) = backlashes(Motion.of(Test.of(shaken(rig, braces=(replace(group, backlash=5e-4),))), 10.0), BAND)
    assert found.clearance == pytest.approx(5e-4, rel=0.1)
    (none,) = backlashes(Motion.of(Test.of(shaken(rig)), 10.0), BAND)
    assert abs(none.clearance) < 4.5 * none.deviation


def test_a_mode_that_the_order_leaves_out_is_named_with_its_frequency(table_test, command_test):
    options = OPTIONS.model_copy(update={"modes": 5})
    validity = judge(identify(begin_of(table_test, 50_000), begin_of(command_test, 50_000), options)).validity
    assert validity.verdict == Verdict.CARE
    assert validity.causes == ("mode missed",)
    assert "a mode at 9 Hz, 1.2 % of damping" in validity.text()


def test_two_tests_of_one_name_are_both_judged_and_one_test_given_twice_is_judged_once(table_test, command_test):
    def answers(table, command):
        judged = judge_failure([begin_of(table, 40_000)], [begin_of(command, 40_000)], OPTIONS, AbraceError("no"))
        return sum(finding.check == "channels respond" for finding in judged.validity.findings)

    assert answers(replace(table_test, source="one"), replace(command_test, source="one")) == 2
    assert answers(table_test, replace(table_test, source="a copy")) == 1


def test_a_dead_channel_is_named(table_test, command_test):
    still = [
        changed(begin_of(run, 40_000), "a2", lambda values: 0 * values + 0.25) for run in (table_test, command_test)
    ]
    (found,) = dead(examined(Test.of(still[0]), ("w",), BAND))
    assert (found.cause, found.verdict) == ("dead channel", Verdict.CARE)
    assert "a2 is dead in bags/table: never changes from 0.25" in found.meaning
    validity = judge_failure([still[0]], [still[1]], OPTIONS, AbraceError("no")).validity
    assert validity.causes == ("dead channel",)
    assert {"friction", "backlash"} <= {finding.check for finding in validity.findings}
    quiet = replace(table_test, ground_acceleration=np.full(len(table_test.outputs), 0.01))
    (found,) = dead(examined(Test.of(quiet), ("w",), BAND))
    assert found.where == "w, bags/table"


def test_what_cannot_be_checked_is_said(table_test, command_test):
    still = [changed(run, "a2", np.zeros_like) for run in (table_test, command_test)]
    still = [changed(run, "x2", np.zeros_like) for run in still]
    short = replace(begin_of(table_test, 1000), source="bags/short")
    validity = judge_failure([still[0], short], [still[1]], OPTIONS, AbraceError("no")).validity
    assert validity.not_checked["friction"] == "too few sensors answer"
    (unjudged,) = (finding for finding in validity.findings if finding.check == "sensors")
    assert (unjudged.where, unjudged.verdict) == ("short", Verdict.CARE)
    assert "2 s, expected at least 60 s" in unjudged.meaning


def test_a_saturated_channel_is_named_by_its_samples_and_by_the_flags_of_the_response(table_test):
    cut = changed(table_test, "a1", lambda values: np.clip(values, -2.5 * np.std(values), 2.5 * np.std(values)))
    (found,) = saturated(examined(Test.of(cut), ("w",), BAND))
    assert (found.cause, found.verdict) == ("saturation", Verdict.CARE)
    assert found.where == "a1, bags/table"
    flags = np.zeros(len(table_test.outputs), dtype=np.uint64)
    flags[500:520] = 1 << table_test.names.index("a2")
    (found,) = saturated(examined(Test.of(replace(table_test, clipped=flags)), ("w",), BAND))
    assert found.where == "a2, bags/table"
    assert saturated(examined(Test.of(table_test), ("w",), BAND))[0].verdict == Verdict.TRUST


def test_where_nothing_is_identified_the_reason_and_the_fault_are_named(table_test, command_test):
    table_test, command_test = (begin_of(run, 40_000) for run in (table_test, command_test))
    force = np.clip(command_test.command, -3000.0, 3000.0)
    cut = replace(command_test, command=force)
    with pytest.raises(AbraceError, match="clipped") as failed:
        identify(table_test, cut)
    validity = judge_failure([table_test], [cut], OPTIONS, failed.value).validity
    assert validity.verdict == Verdict.DONT
    assert "saturation" in validity.causes
    assert "nothing was identified: command: input U is clipped" in validity.text()
    assert "there is no model" in validity.not_checked["residuals, agreement of tests, lag"]


def test_wrong_options_and_tests_in_the_wrong_place_are_no_matter_of_validity(table_test, command_test):
    table_test, command_test = (begin_of(run, 40_000) for run in (table_test, command_test))
    swapped = judge_failure([command_test], [table_test], OPTIONS, AbraceError("expected 0"), 0.0)
    assert swapped is None
    cut = replace(command_test, command=np.clip(command_test.command, -3000.0, 3000.0))
    of_clipped = judge_failure([table_test], [cut], OPTIONS, AbraceError("clipped"), 0.0)
    assert of_clipped is not None
    assert of_clipped.validity.causes == ("saturation",)
    not_converged = judge_failure([table_test], [command_test], OPTIONS, AbraceError("no maximum"), 0.75)
    assert not_converged is not None
    assert not_converged.validity.verdict == Verdict.DONT


def test_a_test_that_was_not_used_is_predicted_or_not(laboratory, rig, identified):
    quake = laboratory.earthquake(seconds=20)
    good = predicted(compare(quake, identified.model, None, rig.capacity))
    assert (good.verdict, good.check) == (Verdict.TRUST, "prediction")
    wrong = replace(identified.model, c=0.9 * identified.model.c)
    bad = predicted(compare(quake, wrong, None, rig.capacity))
    assert bad.verdict == Verdict.CARE
    assert bad.value == pytest.approx(0.1, abs=0.02)
    assert "% off beyond its sensor's noise" in bad.meaning


def test_what_is_no_number_is_never_trusted(judged):
    fine = Finding("any", "x1", 0.1, 1.0, "", Verdict.TRUST, "friction", "", "Free it")
    assert (fine.cause, fine.advice) == ("", ""), "what is fine has neither"
    assert Validity((), {}).verdict == Verdict.CARE
    assert replace(fine, value=np.nan).verdict == Verdict.CARE
    assert replace(fine, value=np.nan).content["value"] is None
    assert [verdict_on(value, 0.03, 0.3) for value in (np.nan, np.inf, 0.3)] == [1, 2, 1]
    assert verdict_on(0.0, np.nan) == Verdict.CARE
    (residual, *_) = judged.residuals
    blind = replace(residual, left=np.where(np.arange(residual.left.shape[1]) == 2, np.nan, residual.left))
    checks = {one.check: one.verdict for one in unexplained(blind, [])}
    assert checks == dict.fromkeys(("residual", "whiteness", "independence"), Verdict.CARE)


def test_sensors_of_which_no_two_can_be_compared_are_not_judged(table_test):
    alone = Motion.of(Test.of(table_test), 10.0).without([name for name in table_test.names if name != "x2"])
    (found,) = contradicting(alone, BAND)
    assert found.verdict == Verdict.CARE
    assert found.meaning.startswith("no two sensors of bags/table measure the same")


def test_two_estimates_agree_within_their_deviations_and_where_the_difference_is_small():
    building = (PoleInterval(7.0, 0.014, 1e-4, 1e-5), PoleInterval(23.0, 0.024, 1e-3, 1e-5))

    def finding(one, other):
        (found,) = disagreeing("two tests", ("one", "other"), (one,), (other,), "friction", building)
        return found.verdict, found.cause

    first, local = building[0], PoleInterval(56.0, 0.01, 1e-3, 1e-5)
    assert finding(first, replace(first, damping=0.0141)) == (
        Verdict.TRUST,
        "",
    )  # 0.7 %, of which noise makes 7 deviations
    assert finding(first, replace(first, damping=0.016)) == (Verdict.CARE, "friction")
    uncertain = replace(first, damping=0.016, damping_deviation=1e-3)
    assert finding(first, uncertain) == (Verdict.TRUST, "")
    assert finding(first, replace(first, damping=0.03)) == (Verdict.DONT, "friction")
    assert finding(local, replace(local, damping=0.03)) == (Verdict.CARE, "a mode too many")
    unknown = replace(first, damping=0.03, damping_deviation=np.nan)
    assert finding(first, unknown) == (Verdict.DONT, "friction"), "no deviation excuses a difference"


def test_a_lag_is_compared_with_the_bench_test_where_there_was_one():
    (same,), (other,), (alone,) = (lag("U", "bags/command", 0.003, given) for given in (0.0028, 0.0008, 0.0))
    assert (same.verdict, other.verdict, alone.verdict) == (Verdict.TRUST, Verdict.CARE, Verdict.TRUST)
    assert other.cause == "lag"
    assert alone.meaning == "U acts 3 ms late in bags/command, no bench test to compare with"


def test_the_lag_of_a_servo_too_slow_for_a_pole_is_that_of_its_phase(identified):
    own = identified.command_response
    slow = replace(own, response=own.response * np.exp(-1j * own.omega * 0.006)[:, None])
    lag = lag_of_response(own, "f")
    assert lag == pytest.approx(0.0008, abs=4e-4)
    assert lag_of_response(slow, "f") == pytest.approx(lag + 0.006, abs=1e-4)


def test_files_say_verdict_causes_and_every_check(judged, tmp_path):
    write_validity(judged, tmp_path)
    content = json.loads((tmp_path / "validity.json").read_text())
    assert content["verdict"] == "trust"
    assert content["causes"] == []
    checks = {finding["check"] for finding in content["findings"]}
    assert {"sensors agree", "friction", "backlash", "residual", "whiteness", "independence", "two tests"} <= checks
    for finding in content["findings"]:
        assert set(finding) == {
            "check", "where", "value", "limit", "unit", "verdict", "cause", "meaning", "advice"
        }  # fmt: skip
    assert (tmp_path / "validity.svg").stat().st_size > 20_000


def test_the_figure_has_the_verdict_on_top_and_a_bar_for_each_check(judged):
    bad = Finding("friction", "storey 1", 0.004, 2e-4, "", Verdict.CARE, "friction", "friction in storey 1", "Free it")
    worse = replace(bad, check="sensors agree", verdict=Verdict.DONT, cause="wrong unit", advice="Correct it")
    validity = Validity((*judged.validity.findings, bad, worse), {})
    assert validity.verdict == Verdict.DONT
    assert validity.causes == ("wrong unit", "friction")
    figure = validity_figure(validity, judged.residuals)
    texts = [text.get_text() for part in figure.subfigs for text in part.texts]
    assert texts[0] == "Don't trust: wrong unit, friction"
    assert any("Correct it" in text and "Free it" in text for text in texts)
    (bars,) = (axis for axis in figure.axes if axis.get_xlabel() == "value over its limit [-]")
    checks = [finding.check for finding in validity.worst]
    assert [label.get_text() for label in bars.get_yticklabels()] == checks
    # without a model: no spectra
    assert len(validity_figure(validity, ()).axes) == 1
