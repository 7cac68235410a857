# SPDX-License-Identifier: Apache-2.0
"""All checks on an identification from measured data, for which the meaning of the channels is unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_sysid.free_prediction import variance_accounted_for
from abrace_sysid.recordings import at_extremes, dead_channels
from abrace_sysid.validity import model_findings, sensor_findings
from abrace_sysid.validity.finding import Finding, Validity
from abrace_sysid.validity.judgement import Judgement
from abrace_sysid.validity.prediction import prediction_finding
from abrace_sysid.validity.residuals import residual_of_data

if TYPE_CHECKING:
    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.measured_data import MeasuredData
    from abrace_sysid.validity.residuals import Residual

RIG_ALONE = "sensors agree, friction, backlash, lag of the servo"
"""Checks that need a rig's channels."""


def judge_data(data: MeasuredData, found: DataIdentification, held_out: MeasuredData) -> Judgement:
    """Judge how far a model of measured data can be trusted, and why.

    Parameters
    ----------
    data
        The data that the identification used, as measured.
    found
        The identification.
    held_out
        The part of the record that was not used; if empty, the check "prediction" is not made.
    """
    dead = dead_channels(data, data.inputs, found.band)
    findings = sensor_findings.dead(data, data.inputs, dead)
    answering = [name for name in (*data.inputs, *data.names) if name not in dead]
    clipped = {name: at_extremes(data.channels([name])[:, 0]) for name in answering}
    findings += sensor_findings.at_ends(data.source, clipped, len(data.outputs), data.inputs)
    findings += sensor_findings.spiked(data, answering)
    residual = residual_of_data(found.data, found.model, found.band)
    nonlinear = [one.cause for one in findings if one.verdict and one.cause == "saturation"]
    findings += model_findings.unexplained(residual, nonlinear)
    not_checked = {RIG_ALONE: "the meaning of the data's channels is unknown"}
    if len(held_out.outputs):
        findings.append(_predicted(found, held_out, residual))
    else:
        not_checked["prediction"] = "held_out is 0, no data was held out"
    return Judgement(Validity(tuple(findings), not_checked), (residual,))


def _predicted(found: DataIdentification, held_out: MeasuredData, residual: Residual) -> Finding:
    """The finding on the prediction of the part held out, with the noise level of the part used."""
    missed = 1 - variance_accounted_for(found.model, held_out)
    noise = residual.noise[0] / np.var(held_out.channels(found.model.outputs), axis=0)
    errors = np.sqrt(np.maximum(missed - noise, 0))
    return prediction_finding(dict(zip(found.model.outputs, errors.tolist(), strict=True)))
