# SPDX-License-Identifier: Apache-2.0
"""Models sampled, and written to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from abrace.interactive.given import model_of
from abrace.interactive.identification import Identified
from abrace_core import discretization, linear_model

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from abrace.interactive.given import AnyModel
    from abrace_core.discretization import Hold
    from abrace_core.linear_model import LinearModel


def discretize(model: AnyModel, sample_period: float, holds: Mapping[str, Hold] = discretization.HOLDS) -> LinearModel:
    """The exact discrete equivalent of a continuous model, input delays included.

    Parameters
    ----------
    model
        Its delays need not be multiples of the sample period, and become states.
    sample_period
        [s].
    holds
        Of the inputs by name: "zero", held at each sample's value, or "first", linear from one to the next; "zero" for
        those not named.

    Raises
    ------
    AbraceError
        If the model is discrete already, or a hold or the sample period is none.
    """
    return discretization.discretize(model_of(model), sample_period, holds)


def save_model(model: AnyModel, path: Path | str, covariance: NDArray[np.float64] | None = None) -> None:
    """Write a model to a JSON file.

    Parameters
    ----------
    model, path
        What is written, and where.
    covariance
        Of its parameters, symmetric, with which `design` draws models; None: that of the identification that was
        given, if it was one.

    Raises
    ------
    AbraceError
        If it cannot be written.
    """
    linear_model.save_model(model_of(model), path, covariance_of(model) if covariance is None else covariance)


def covariance_of(given: AnyModel) -> NDArray[np.float64] | None:
    """Of the parameters of the model that was `given`; None: not known."""
    if isinstance(given, Identified):
        return given.found.covariance
    if isinstance(given, (str, Path)):
        path = Path(given) / "model.json" if Path(given).is_dir() else Path(given)
        return linear_model.load_covariance(path) if path.suffix == ".json" else None
    return None
