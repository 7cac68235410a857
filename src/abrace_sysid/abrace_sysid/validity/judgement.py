# SPDX-License-Identifier: Apache-2.0
"""All checks on one identification: of the tests, and of the model if there is one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.verdict import Verdict
from abrace_sysid.data_identification import identify_data, variance_accounted_for
from abrace_sysid.examination import LEAST_SECONDS, examined, require_long
from abrace_sysid.models.modal import servo_lags
from abrace_sysid.recorded.test import given_tests, of_one_rig
from abrace_sysid.validity import model_findings, rig_findings, sensor_findings
from abrace_sysid.validity.finding import Finding, Validity, prediction_finding
from abrace_sysid.validity.kinematics import comparable
from abrace_sysid.validity.motion import Motion
from abrace_sysid.validity.residuals import Residual, residual_of, residual_of_data, residual_of_response

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace_sysid.data_identification import DataIdentification, DataOptions
    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.identification import Identification
    from abrace_sysid.input_tests import InputTests
    from abrace_sysid.recorded.test import AnyTest, Test


FITTING = 0.5
"""Fraction of the progress at which an identification has accepted its tests and options."""

BLOWS = "af"
"""First letters of channels (accelerations, forces) in which impacts of loose pins look like spikes."""

LEAVE_RESIDUALS = ("saturation", "friction", "backlash")
"""Faults that cause a residual which no linear model explains."""


@dataclass(frozen=True)
class Judgement:
    """The findings on an identification, and the residuals for the figure.

    Parameters
    ----------
    residuals
        The residual of each test; empty if there is no model.
    """

    validity: Validity
    residuals: tuple[Residual, ...]


def judge(found: Identification) -> Judgement:
    """Judge how far an identification can be trusted, and why.

    Parameters
    ----------
    found
        The identification; its tests were examined by it.
    """
    not_checked: dict[str, str] = {}
    findings = findings_of_tests(found.tests, found.options, not_checked)
    of_model, residuals = _of_model(found, findings, not_checked)
    return _spoken([*findings, *of_model], not_checked, residuals, found.tests)


def judge_failure(
    table: AnyTest | Sequence[AnyTest],
    command: AnyTest | Sequence[AnyTest],
    options: IdentificationOptions,
    error: AbraceError,
    progress: float = 1.0,
) -> Judgement | None:
    """Judge the tests of an identification that failed.

    None if it failed because of wrong options or tests, and no finding on the measurements explains the failure.

    Parameters
    ----------
    table, command
    error
        Why it failed.
    progress
        Fraction of the identification that was done.
    """
    tables, commands = given_tests(table), given_tests(command)
    if any(all(test.seconds < LEAST_SECONDS for test in tests) for tests in (tables, commands)):
        return None
    options, not_checked = (
        options.of_tests(tables, commands),
        {"residuals, agreement of tests, lag": "there is no model"},
    )
    meaning, advice = f"nothing was identified: {error}", "Correct what is named here, and identify again"
    findings = [Finding.of("identification", "", 1.0, (0.0, 0.0), meaning, "", advice)]
    tests = []
    for test in (*tables, *(one for one in commands if not any(one.is_same(other) for other in tables))):
        both = any(test.is_same(other) for other in tables) and any(test.is_same(other) for other in commands)
        driving = (signals.GROUND, *test.moving) if both else test.moving or (signals.GROUND,)
        band = options.table_band if any(test is one for one in tables) else options.command_band
        try:
            require_long(test)
            tests.append(examined(test, driving, band))
        except AbraceError as why:
            meaning = f"the sensors of {test.source} were not judged: {why}"
            findings.append(Finding.of("sensors", test.source, nan, (0.0,), meaning))
    findings += findings_of_tests(tests, options, not_checked)
    judged = _spoken(findings, not_checked, [], (*tables, *commands))
    return judged if judged.validity.causes or progress >= FITTING else None


def _spoken(
    findings: Sequence[Finding], not_checked: dict[str, str], residuals: Sequence[Residual], tests: Sequence[Test]
) -> Judgement:
    """All that was found, with the tests' short names."""
    names = _short_names([test.source for test in tests])

    def spoken(text: str) -> str:
        for source, name in names.items():
            text = text.replace(source, name)
        return text

    findings = [replace(one, where=spoken(one.where), meaning=spoken(one.meaning)) for one in findings]
    not_checked = {spoken(check): spoken(why) for check, why in not_checked.items()}
    residuals = [replace(one, test=replace(one.test, source=spoken(one.test.source))) for one in residuals]
    return Judgement(Validity(tuple(findings), not_checked), tuple(residuals))


def _short_names(sources: Sequence[str]) -> dict[str, str]:
    """The last parts of the tests' paths, if these are distinct; the longest path first."""
    short = {source: source.rstrip("/").rpartition("/")[2] for source in sorted(set(sources), key=len, reverse=True)}
    return short if len(set(short.values())) == len(short) else {}


def findings_of_tests(
    tests: Sequence[Test], options: IdentificationOptions, not_checked: dict[str, str]
) -> list[Finding]:
    """Findings on examined `tests`, identified with `options`, that need no model.

    What could not be checked is added to `not_checked`.
    """
    findings: list[Finding] = []
    motions: list[tuple[Motion, tuple[float, float]]] = []
    for test in tests:
        findings += sensor_findings.dead(test)
        findings += sensor_findings.saturated(test)
        findings += sensor_findings.spiked(test, [*test.names, signals.GROUND])
        motion = Motion.of(test, options.band_of(test)[1]).without(test.faults)
        if test.faults or comparable(motion):
            findings += sensor_findings.contradicting(motion, options.table_band)
        else:
            not_checked["sensors agree"] = "no two sensors measure the same"
        motions.append((motion, options.table_band))
    if any(one.cause in sensor_findings.WRONG for one in findings):
        not_checked["friction, backlash"] = "the sensors contradict each other"
        return findings
    of_rig = {"friction": rig_findings.friction(motions), "backlash": rig_findings.backlash(motions)}
    for check, found in of_rig.items():
        findings += found
        if not found:
            not_checked[check] = "too few sensors answer"
    if any(one.cause == "backlash" for one in of_rig["backlash"]):
        findings = [one for one in findings if one.cause != "spikes" or one.where[0] not in BLOWS]
    return findings


def _of_model(
    found: Identification, before: Sequence[Finding], not_checked: dict[str, str]
) -> tuple[list[Finding], list[Residual]]:
    """Findings on the model, and the residuals of each test; what could not be checked is added to `not_checked`."""
    options = found.options
    known = [one.cause for one in before if one.verdict and one.cause in LEAVE_RESIDUALS]
    nonlinear = list(dict.fromkeys(known))
    findings: list[Finding] = []
    residuals: list[Residual] = []
    tests = (found.table, *found.commands)
    for data in tests:
        if data.input != data.together[0] and not data.periodic:
            continue
        for residual in _residuals(found, data):
            residuals.append(residual)
            findings += model_findings.unexplained(residual, nonlinear)
    poles, estimate = found.poles, found.poles.estimate
    if estimate is None or found.covariance is None:
        not_checked["agreement of tests, lag"] = f"the method {options.method} gives no intervals"
        return findings, residuals
    findings += model_findings.modes_of_both(poles.table_pairs, poles.common_pairs)
    cause = nonlinear[0] if nonlinear else "tests that differ"
    building = poles.table_pairs
    if len(found.table.together) > 1:
        not_checked["agreement of table and command"] = "noise drove both at once: they have one set of modes"
    else:
        names = found.table.source, found.command.source
        findings += model_findings.disagreeing(
            "two tests", names, poles.table_pairs, poles.command_pairs, cause, building
        )
    top = 2 * np.pi * options.table_band[1]
    findings += model_findings.repeated(found.table, estimate.poles[np.abs(estimate.poles) < top], cause, building)
    for data in found.commands:
        # the lag poles of other servos have no effect in these tests
        driven = estimate.drive[:, estimate.inputs.index(data.input)] != 0
        findings += model_findings.repeated(data, estimate.poles[driven], cause, building)
        highest, force = float(data.responses[0].omega[-1]), data.input.replace("U", "f")
        measured = servo_lags(estimate, highest).get(data.input)
        if measured is None and force in data.outputs:
            measured = model_findings.lag_of_response(data.responses[0], force)
        if measured is not None:
            findings += model_findings.lag(data.input, data.source, measured, options.servo_lag)
    return findings, residuals


def _residuals(found: Identification, data: InputTests) -> list[Residual]:
    """The residuals of each test of one input."""
    if data.periodic:
        both = zip(data.responses, data.tests, strict=True)
        return [residual_of_response(response, found.model, test.source) for response, test in both]
    return [residual_of(test, data.together, found.model, data.responses[0].band) for test in data.tests]


RIG_ALONE = "sensors agree, friction, backlash, lag of the servo"
"""Checks that need a rig's channels."""


def identify_and_judge(
    data: Test | Sequence[Test],
    options: DataOptions,
    progress: Callable[[str, float], None] = lambda _step, _fraction: None,
    validation: Sequence[Test] = (),
) -> tuple[DataIdentification, tuple[Test, ...], Judgement]:
    """Identify from measured data but for a part that is held out, and judge by predicting that.

    Parameters
    ----------
    data, options, progress
        As for `identify_data`.
    validation
        Other records of the structure, that are predicted as well.

    Returns
    -------
    found, held_out, judged
        The identification, the records held out, and what was found of data and model.
    """
    records = given_tests(data)
    of_one_rig([*records, *validation], alike=["inputs"])
    ends = [round((1 - options.held_out) * len(one.outputs)) for one in records]
    found = identify_data([one.part(0, end) for one, end in zip(records, ends, strict=True)], options, progress)
    parts = [one.part(end, len(one.outputs)) for one, end in zip(records, ends, strict=True)]
    held_out = tuple(found.in_time(one) for one in (*parts, *validation) if len(one.outputs))
    return found, held_out, judge_data(found, held_out)


def judge_data(found: DataIdentification, held_out: Sequence[Test]) -> Judgement:
    """Judge how far a model of measured data can be trusted, and why.

    Parameters
    ----------
    found
        The identification.
    held_out
        Records that were not used, moved in time; none: the check "prediction" is not made.
    """
    findings, residuals = _in_time(found), []
    for test in found.tests:
        findings += sensor_findings.dead(test) + sensor_findings.saturated(test)
        findings += sensor_findings.spiked(test, (*test.inputs, *test.names))
    findings += sensor_findings.other_units(found.estimate, found.model.units, found.source)
    nonlinear = [one.cause for one in findings if one.verdict and one.cause == "saturation"]
    for record in found.records:
        residuals.append(residual_of_data(record, found.model.select(record.names), found.band))
        findings += model_findings.unexplained(residuals[-1], nonlinear)
    not_checked = {RIG_ALONE: "the meaning of the data's channels is unknown"}
    if held_out:
        findings.append(_predicted(found, held_out, residuals))
    else:
        not_checked["prediction"] = "held_out is 0 and there is no other record, no data was held out"
    return Judgement(Validity(tuple(findings), not_checked), tuple(residuals))


def _in_time(found: DataIdentification) -> list[Finding]:
    """The finding on delays of outputs; the model has been made without them, and does not suffer."""
    late, period = found.delays, found.tests[0].sample_period
    said = [f"{name} is {delay.words(period)} against the inputs" for name, delay in late.items()]
    meaning = "; ".join(said) or "no output is late or early beyond the uncertainty"
    value = max((abs(delay.seconds) for delay in late.values()), default=0.0)
    where = f"{', '.join(late) or 'all outputs'}, {found.source}"
    limits = sensor_findings.LATE
    return [Finding.of("sensors synchronous", where, value, limits, meaning, unit="s", verdict=Verdict.TRUST)]


def _predicted(found: DataIdentification, held_out: Sequence[Test], residuals: Sequence[Residual]) -> Finding:
    """The finding on the prediction of the records held out, with the noise levels of the records used."""
    missed = 1 - variance_accounted_for(found.model, held_out, found.band)
    noise = np.array([_noise_share(name, residuals, held_out) for name in found.model.outputs])
    errors = np.sqrt(np.maximum(missed - noise, 0))
    shares = dict(zip(found.model.outputs, errors.tolist(), strict=True))
    why = "does not move, or has too few samples or values that are not finite, in the part held out"
    return prediction_finding(shares, {name: why for name, share in shares.items() if not isfinite(share)})


def _noise_share(name: str, residuals: Sequence[Residual], held_out: Sequence[Test]) -> float:
    """The share of noise in an output held out: the first record's that has it; 0: it does not move there."""
    noise = next(one.noise[0, one.test.outputs.index(name)] for one in residuals if name in one.test.outputs)
    moved = [one.channel(name) for one in held_out if name in one.names]
    power = sum(len(each) * float(np.var(each)) for each in moved) / max(sum(map(len, moved)), 1)
    return float(noise / power) if power > 0 else 0.0
