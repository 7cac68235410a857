# SPDX-License-Identifier: Apache-2.0
"""All checks on one identification: of the tests, and of the model if there is one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_sysid.models.modal import servo_lags
from abrace_sysid.recordings import LEAST_SECONDS, dead_channels, longest_piece
from abrace_sysid.spectra.fourier import held_input
from abrace_sysid.spectra.periodic_response import find_period
from abrace_sysid.validity import model_findings, rig_findings, sensor_findings
from abrace_sysid.validity.finding import Finding, Validity, Verdict
from abrace_sysid.validity.motion import Motion
from abrace_sysid.validity.residuals import Residual, residual_of, residual_of_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.run import Run
    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.identification import Identification
    from abrace_sysid.spectra.measured_tests import TestData

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
    validity
        The findings.
    residuals
        The residual of each test; empty if there is no model.
    """

    validity: Validity
    residuals: tuple[Residual, ...]


def judge(
    table: Sequence[Run],
    command: Sequence[Run],
    options: IdentificationOptions,
    found: Identification | None,
    failure: str = "",
) -> Judgement:
    """Judge how far an identification can be trusted, and why.

    Parameters
    ----------
    table, command
        The table tests and the command tests, as recorded.
    options
        Options of the identification.
    found
        The identification; None if it failed.
    failure
        Why it failed.
    """
    options = options.of_tests(table, command)
    findings: list[Finding] = []
    not_checked: dict[str, str] = {}
    if found is None:
        meaning, advice = f"nothing was identified: {failure}", "Correct what is named here, and identify again"
        findings.append(Finding("identification", "", 1.0, 0.0, "", Verdict.DONT, "", meaning, advice))
    findings += _of_tests(table, command, options, not_checked)
    residuals: list[Residual] = []
    if found is not None:
        of_model, residuals = _of_model(found, options, findings, not_checked)
        findings += of_model
    else:
        not_checked["residuals, agreement of tests, lag"] = "there is no model"
    names = _short_names([run.source for run in (*table, *command)])

    def spoken(text: str) -> str:
        for source, name in names.items():
            text = text.replace(source, name)
        return text

    findings = [replace(one, where=spoken(one.where), meaning=spoken(one.meaning)) for one in findings]
    not_checked = {spoken(check): spoken(why) for check, why in not_checked.items()}
    residuals = [replace(one, source=spoken(one.source)) for one in residuals]
    return Judgement(Validity(tuple(findings), not_checked), tuple(residuals))


def _short_names(sources: Sequence[str]) -> dict[str, str]:
    """The last parts of the tests' paths, if these are distinct; the longest path first."""
    short = {source: source.rstrip("/").rpartition("/")[2] for source in sorted(set(sources), key=len, reverse=True)}
    return short if len(set(short.values())) == len(short) else {}


def judge_failure(
    table: Sequence[Run], command: Sequence[Run], options: IdentificationOptions, error: AbraceError, progress: float
) -> Judgement | None:
    """Judge the tests of an identification that failed.

    None if it failed because of wrong options or tests, and no finding on the measurements explains the failure.

    Parameters
    ----------
    table, command, options
        As of `judge`.
    error
        Why it failed.
    progress
        Fraction of the identification that was done.
    """
    if any(all(len(run.outputs) * run.sample_period < LEAST_SECONDS for run in tests) for tests in (table, command)):
        return None
    judged = judge(table, command, options, None, str(error))
    return judged if judged.validity.causes or progress >= FITTING else None


def _of_tests(
    table: Sequence[Run], command: Sequence[Run], options: IdentificationOptions, not_checked: dict[str, str]
) -> list[Finding]:
    """Findings that need no model; what could not be checked is added to `not_checked`."""
    findings: list[Finding] = []
    motions: list[tuple[Motion, tuple[float, float]]] = []
    shaken, driven = {run.source for run in table}, {run.source for run in command}
    tests = [(run, options.table_band) for run in table]
    tests += [(run, options.command_band) for run in command if run.source not in shaken]
    for run, band in tests:
        try:
            whole = _whole(run)
        except AbraceError as error:
            not_checked[f"sensors of {run.source}"] = str(error)
            continue
        commands = tuple(name for name in whole.command_names if np.any(held_input(whole, name)))
        inputs = (signals.GROUND, *commands) if run.source in shaken & driven else commands or (signals.GROUND,)
        dead = dead_channels(whole, inputs, band)
        period = max((find_period(held_input(whole, name)) or 0 for name in inputs), default=0) or None
        findings += sensor_findings.dead(whole, inputs, dead)
        findings += sensor_findings.saturated(whole, inputs, tuple(dead), period)
        answering = [name for name in (*whole.names, signals.GROUND) if name not in dead]
        findings += sensor_findings.spiked(whole, answering)
        motion = Motion.of(whole, band[1]).without(dead)
        findings += sensor_findings.contradicting(motion, options.table_band)
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


def _whole(run: Run) -> Run:
    """The longest piece of a test without a gap; an error if a value in it is not finite."""
    whole = longest_piece(run)[0]
    names = (*whole.names, signals.GROUND, *whole.command_names)
    bad = [name for name in names if not np.isfinite(whole.channels([name])).all()]
    if bad:
        raise AbraceError(f"{run.source}: {', '.join(bad)} not finite")
    return whole


def _of_model(
    found: Identification,
    options: IdentificationOptions,
    before: Sequence[Finding],
    not_checked: dict[str, str],
) -> tuple[list[Finding], list[Residual]]:
    """Findings on the model, and the residuals of each test; what could not be checked is added to `not_checked`."""
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
    if estimate is None:
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


def _residuals(found: Identification, data: TestData) -> list[Residual]:
    """The residuals of each test of one input."""
    if data.periodic:
        both = zip(data.responses, data.runs, strict=True)
        return [residual_of_response(response, found.model, run.source) for response, run in both]
    omega = data.responses[0].omega / (2 * np.pi)
    band = (float(omega[0]), float(omega[-1]))
    return [residual_of(run, data.together, found.model, band) for run in data.runs]
