# SPDX-License-Identifier: Apache-2.0
"""What was given, an object, a name or a file, as the object that the libraries take."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from abrace_bags import read_runs
from abrace_core.controller_file import Controller, load_controller
from abrace_core.errors import AbraceError
from abrace_core.installed import find_file
from abrace_core.linear_model import LinearModel, load_model, takes_models
from abrace_core.run import Run
from abrace_lqg.proof.proven_design import ProvenDesign
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import Rig

if TYPE_CHECKING:
    from collections.abc import Sequence

    import control

    class HasModels(Protocol):
        """What has a model for prediction, and one for design: an identification."""

        @property
        def model(self) -> LinearModel:
            """For prediction."""

        @property
        def reduced(self) -> LinearModel:
            """For design."""

    AnyModel: TypeAlias = LinearModel | control.StateSpace | HasModels | Rig | Path | str
    """A model, an object that has one, a model file, the folder of an identification, or the name of a rig."""
    AnyRig: TypeAlias = Rig | Path | str
    """A rig, its file, or the name of one of abrace's."""
    AnyRun: TypeAlias = Run | Path | str
    """A test, or the folder of its bag."""
    AnyController: TypeAlias = Controller | ProvenDesign | Path | str
    """A controller, a design, or a controller file."""


def warn(sentences: Iterable[str]) -> None:
    """Give `sentences` as Python warnings, at the line that called the function which calls this one."""
    for sentence in sentences:
        warnings.warn(sentence, stacklevel=3)


def rig_of(given: AnyRig) -> Rig:
    """The rig that was `given`."""
    return (
        given if isinstance(given, Rig) else load_rig(find_file(str(given), "abrace_plant", "config", ".yaml", "rig"))
    )


@takes_models
def model_of(given: Any, design: bool = False) -> LinearModel:
    """The model that was `given`, an `AnyModel`; for a `design` the reduced one where there are several."""
    if isinstance(given, LinearModel):
        return given
    if isinstance(given, Rig):
        return given.model
    if isinstance(given, (str, Path)):
        path = Path(given)
        if path.is_dir():
            return load_model(path / ("reduced.json" if design else "model.json"))
        return load_model(path) if path.suffix == ".json" or path.is_file() else rig_of(given).model
    found = getattr(given, "reduced" if design else "model", None)
    if not isinstance(found, LinearModel):
        raise AbraceError(f"model {given!r}: expected a model, a file (.json), an identification or a rig")
    return found


def several(given: Any) -> tuple[Any, ...]:
    """What was `given`, one or several: a single name, file or object is one."""
    return (given,) if isinstance(given, (str, Path)) or not isinstance(given, Iterable) else tuple(given)


def band_of(given: Any) -> tuple[float, float]:
    """The band that was `given` [Hz], two numbers."""
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError) as error:
        raise AbraceError(f"band {given!r:.60}: expected two frequencies in Hz") from error
    return low, high


def runs_of(given: AnyRun | Sequence[AnyRun]) -> list[Run]:
    """The tests that were `given`, one or several; a bag may hold several."""
    each = several(given)
    if not each:
        raise AbraceError("no test given, expected at least one")
    for one in each:
        if not isinstance(one, (Run, str, Path)):
            raise AbraceError(f"test {one!r:.60}: expected a Run, or the folder of its bag")
    return [run for one in each for run in ([one] if isinstance(one, Run) else read_runs(one))]


def controller_of(given: AnyController) -> Controller:
    """The controller that was `given`."""
    if isinstance(given, ProvenDesign):
        return given.controller
    if isinstance(given, (str, Path)):
        return load_controller(given)
    if not isinstance(given, Controller):
        raise AbraceError(f"controller {given!r:.60}: expected a controller, its file, a design, or a law of one's own")
    return given


def weights_of(given: Weights | Path | str) -> tuple[Weights, str]:
    """The weights that were `given`, and their name."""
    if isinstance(given, Weights):
        return given, "own"
    path = find_file(str(given), "abrace_lqg", "config", ".yaml", "weights")
    return load_weights(path), path.name
