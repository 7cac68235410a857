# SPDX-License-Identifier: Apache-2.0
"""The finding on the prediction of a test that was not used for identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_sysid.validity.finding import Finding, judged

if TYPE_CHECKING:
    from collections.abc import Mapping

MISSED = (0.03, 0.3)
"""Limits of the worst channel's rms error, sensor noise subtracted, over the measured rms: "trust with care" above the
first, "don't trust" above the second."""


def prediction_finding(errors: Mapping[str, float]) -> Finding:
    """The finding on a test that a model has predicted.

    Parameters
    ----------
    errors
        Rms error of each channel, sensor noise subtracted, over the measured rms.
    """
    worst = max(errors, key=lambda name: errors[name])
    error = errors[worst]
    verdict = judged(error, *MISSED)
    meaning = f"the worst predicted channel is {worst}: {100 * error:.2g} % off beyond its sensor's noise"
    advice = "See validity.png of the identification for what the model does not contain" if verdict else ""
    return Finding("prediction", worst, error, MISSED[0], "", verdict, "", meaning, advice)
