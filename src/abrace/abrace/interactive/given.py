# SPDX-License-Identifier: Apache-2.0
"""What was given, an object, a name or a file, as the object that the libraries take."""

from __future__ import annotations

import inspect
import re
import textwrap
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import GenericAlias
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar, cast

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.config_file import validated
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import Controller, load_controller
from abrace_core.model.linear_model import LinearModel, load_model, takes_models
from abrace_core.model.response import clipped_sentences
from abrace_lqg.proof.proven_design import ProvenDesign
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import Rig

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import control
    from numpy.typing import NDArray

    from abrace_core.files.options import Options
    from abrace_core.model.own_law import Law
    from abrace_core.model.run import Run

    class HasModels(Protocol):
        """What has a model for prediction: an identification. One of a rig also has a `reduced` one for design."""

        @property
        def model(self) -> LinearModel:
            """The model for prediction."""

    AnyModel: TypeAlias = LinearModel | control.StateSpace | HasModels | Rig | Path | str
    """A model, an object that has one, a model file, the folder of an identification, or the name of a rig."""
    AnyRig: TypeAlias = Rig | Path | str
    """A rig, its file, or the name of one of abrace's."""
    AnyWeights: TypeAlias = Weights | Mapping[str, Any] | Path | str
    """Weights, their keys and values as in a file, a weights file, or the name of one of abrace's."""
    AnyController: TypeAlias = Controller | ProvenDesign | LinearModel | control.StateSpace | Path | str
    """A controller, a design, a controller file, or a discrete StateSpace from measured quantities to commands."""


INNER = " " * 8
Verb = TypeVar("Verb", bound="Callable[..., Any]")


def warn(sentences: Iterable[str]) -> None:
    """Give `sentences` as Python warnings, at the line that called the function which calls this one."""
    for sentence in sentences:
        warnings.warn(sentence, stacklevel=3)


def told_of(run: Run) -> list[str]:
    """What a user has to know of a `run`: what its facts warn of, a stop, clipped sensors; each names the run."""
    stopped = [f"the rig was stopped: {run.stopped}"] if run.stopped else []
    sentences = [*stopped, *clipped_sentences(run.clipped_samples)]
    return [*run.facts.get("warnings", []), *(f"{run.source}: {sentence}" for sentence in sentences)]


def rig_of(given: AnyRig) -> Rig:
    """The rig that was `given`."""
    return (
        given if isinstance(given, Rig) else load_rig(find_file(str(given), "abrace_plant", "config", ".yaml", "rig"))
    )


def rig_or_none(given: Any) -> Rig | None:
    """The rig that was `given` as an object, its file, or its name; None: it is something else."""
    if isinstance(given, Rig):
        return given
    if not isinstance(given, (str, Path)) or Path(given).is_dir() or Path(given).suffix in (".json", ".mat"):
        return None
    return rig_of(given)


@takes_models
def model_of(given: Any, design: bool = False) -> LinearModel:
    """The model that was `given`, an `AnyModel`; for a `design` the reduced one where there are several."""
    if isinstance(given, LinearModel):
        return given
    if (rig := rig_or_none(given)) is not None:
        return rig.model
    if isinstance(given, (str, Path)):
        path = Path(given)
        reduced = path / "reduced.json"
        folder = reduced if design and reduced.is_file() else path / "model.json"
        return load_model(folder if path.is_dir() else path)
    found = (getattr(given, "reduced", None) if design else None) or getattr(given, "model", None)
    if not isinstance(found, LinearModel):
        raise AbraceError(f"model {given!r}: expected a model, a file (.json), an identification or a rig")
    return found


def several(given: Any) -> tuple[Any, ...]:
    """What was `given`, one or several: a single name, file or object is one."""
    return (given,) if isinstance(given, (str, Path)) or not isinstance(given, Iterable) else tuple(given)


@takes_models
def controller_of(given: Any, force_limit: Sequence[float] | NDArray[np.float64] = ()) -> Controller:
    """The controller that was `given`, an `AnyController`; a StateSpace has the `force_limit` (commands,) [N]."""
    if isinstance(given, ProvenDesign):
        return given.controller
    if isinstance(given, (str, Path)):
        return load_controller(given)
    if isinstance(given, LinearModel):
        name, commands = str(given.provenance.get("system", "own")), len(given.outputs)
        if not given.sample_period:
            raise AbraceError(f"controller {name}: continuous, expected a discrete one, as control.sample_system gives")
        if len(force_limit) != commands:
            limit = list(force_limit) or "not known"
            raise AbraceError(f"controller {name}: {commands} commands, force limit {limit}, expected one of each")
        correction = np.zeros((given.order, commands))
        prediction = np.zeros((len(given.inputs), given.order + commands))
        return Controller(name, given, correction, prediction, np.array(force_limit), "", "own", "")
    if not isinstance(given, Controller):
        raise AbraceError(f"controller {given!r:.60}: expected a controller, its file, a design, or a law of one's own")
    return given


@takes_models
def law_of(given: Any) -> Law | None:
    """The law of one's own that was `given`, as an object or a function of the sample; None: it is no such."""
    if hasattr(given, "begin"):
        return cast("Law", given)
    if not callable(given):
        return None
    name = getattr(given, "__name__", type(given).__name__)
    return cast("Law", type(name, (), {"begin": staticmethod(lambda *_: None), "force": staticmethod(given)})())


def weights_of(given: AnyWeights) -> tuple[Weights, str]:
    """The weights that were `given`, and their name."""
    if isinstance(given, Weights):
        return given, "own"
    if isinstance(given, Mapping):
        return validated(given, Weights, "weights"), "own"
    path = find_file(str(given), "abrace_lqg", "config", ".yaml", "weights")
    return load_weights(path), path.name


def takes(options: type[Options]) -> Callable[[Verb], Verb]:
    """Give a verb the signature and the docstring of the `options` for which its last argument `**options` stands."""

    def documented(verb: Verb) -> Verb:
        known = inspect.signature(verb).parameters
        named = [each for each in known.values() if each.kind != inspect.Parameter.VAR_KEYWORD]
        lines = []
        for name, option in options.listed().items():
            if name in known:
                continue
            field = options.model_fields[name]
            default = inspect.Parameter.empty if option.required else field.get_default(call_default_factory=True)
            annotation = GenericAlias(tuple, (option.kind, ...)) if option.many else field.annotation
            named.append(
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            )
            lines += [f"    {name}", *textwrap.wrap(option.text(), 112, initial_indent=INNER, subsequent_indent=INNER)]
        verb.__signature__ = inspect.Signature(named)  # type: ignore[attr-defined]
        verb.__doc__ = re.sub(r"    \*\*options\n(?:        .*\n)+", "\n".join([*lines, ""]), verb.__doc__ or "")
        return verb

    return documented
