# SPDX-License-Identifier: Apache-2.0
"""Models sampled, and written to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from abrace.interactive.data import IdentifiedData
from abrace.interactive.given import controller_of, model_of
from abrace.interactive.identification import Identified
from abrace_core import AbraceError
from abrace_core.model import discretization, linear_model
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.verdict import Verdict
from abrace_lqg.analysis.margins import margins as found_margins
from abrace_lqg.loop import sampled
from abrace_lqg.proof.files import distrusted
from abrace_lqg.proof.limits import rig_period_of
from abrace_lqg.proof.proven_design import ProvenDesign

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from abrace.interactive.given import AnyController, AnyModel
    from abrace_core.model.discretization import Hold
    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.analysis.margins import Margins


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
    """Write a model to a JSON file or, where the name ends in .mat, one for MATLAB.

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
        If the name of the file ends in neither .json nor .mat, or it cannot be written.
    """
    if str(path).endswith(".mat"):
        linear_model.save_mat(model_of(model), path)
    elif str(path).endswith(".json"):
        linear_model.save_model(model_of(model), path, covariance_of(model) if covariance is None else covariance)
    else:
        raise AbraceError(f"model file {path}: expected a name that ends in .json or .mat")


def save_mat(given: AnyModel | Controller | ProvenDesign, path: Path | str) -> None:
    """Write a model or a controller to a MATLAB file, which `load_model` and `load_controller` read.

    Parameters
    ----------
    given, path
        What is written, and where: A, B, C, D, Ts, names and delays; of a controller also G and P of its observer
        and the force limits [N].

    Raises
    ------
    AbraceError
        If the name of the file does not end in .mat, or it cannot be written.
    """
    if not str(path).endswith(".mat"):
        raise AbraceError(f"MATLAB file {path}: expected a name that ends in .mat")
    if isinstance(given, (Controller, ProvenDesign)):
        save_controller(controller_of(given), path)
    else:
        linear_model.save_mat(model_of(given), path)


@linear_model.takes_models
def margins(model: AnyModel, controller: AnyController) -> Margins:
    """The stability margins at the commands of a loop, the least of all commands, each broken with the others closed.

    Parameters
    ----------
    model, controller
        Of the loop, with the rig's timing: a command acts from the rig's next sample on.

    Raises
    ------
    AbraceError
        If the loop is not stable, or the controller is for another rig.
    """
    law = controller if isinstance(controller, linear_model.LinearModel) else controller_of(controller).law
    plant = model_of(model)
    return found_margins(plant if plant.sample_period else sampled(plant, rig_period_of(plant, law.sample_period)), law)


def covariance_of(given: AnyModel) -> NDArray[np.float64] | None:
    """The covariance of the parameters of the model that was `given`; None: not known."""
    if isinstance(given, Identified):
        return given.found.covariance
    return linear_model.load_covariance(path) if (path := _model_file(given)) else None


def distrust_of(given: AnyModel) -> list[str]:
    """Why no controller is to be designed with the model that was `given`; empty: nothing is known against it."""
    if isinstance(given, (Identified, IdentifiedData)):
        verdict, causes = given.validity.verdict, ", ".join(given.validity.causes)
        return [f"the identification says {verdict.words} ({causes})"] if verdict is Verdict.DONT else []
    return list(distrusted([str(path)])) if (path := _model_file(given)) else []


def _model_file(given: AnyModel) -> Path | None:
    """The JSON file of the model that was `given`, by its name or an identification's folder; None: another thing."""
    if not isinstance(given, (str, Path)):
        return None
    path = Path(given) / "model.json" if Path(given).is_dir() else Path(given)
    return path if path.suffix == ".json" else None
