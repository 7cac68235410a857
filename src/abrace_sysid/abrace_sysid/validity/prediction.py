# SPDX-License-Identifier: Apache-2.0
"""A finding on the prediction of a test that was not used: what no fit can be good at by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_sysid.validity.finding import Finding, judged

if TYPE_CHECKING:
    from collections.abc import Mapping

MISSED = (0.03, 0.3)
"""Rms error without sensor noise over the measured rms, of the worst channel: from the first on care is needed, from
the second on the model cannot be trusted."""


def prediction_finding(errors: Mapping[str, float]) -> Finding:
    """The finding on a test that a model has predicted.

    Parameters
    ----------
    errors
        By channel: rms without sensor noise, over the measured rms.
    """
    worst = max(errors, key=lambda name: errors[name])
    error = errors[worst]
    verdict = judged(error, *MISSED)
    meaning = f"the worst predicted channel is {worst}: {100 * error:.2g} % off beyond its sensor's noise"
    advice = "See validity.png of the identification for what the model does not contain" if verdict else ""
    return Finding("prediction", worst, error, MISSED[0], "", verdict, "", meaning, advice)
