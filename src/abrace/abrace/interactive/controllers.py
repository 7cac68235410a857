# SPDX-License-Identifier: Apache-2.0
"""Models to controllers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace.interactive.given import model_of, rig_of, takes, weights_of
from abrace.interactive.identification import Identified
from abrace.interactive.models import covariance_of, distrust_of
from abrace_core import AbraceError
from abrace_core.model.one_thread import one_thread
from abrace_lqg.proof.limits import DesignOptions, of_rig
from abrace_lqg.proof.proven_design import ProvenDesign, proven_design

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace.interactive.given import AnyModel, AnyRig, AnyWeights


@takes(DesignOptions)
@one_thread()
def design(
    model: AnyModel,
    weights: AnyWeights = "lqg3",
    *,
    rig: AnyRig | None = None,
    check_models: Mapping[str, AnyModel] | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> ProvenDesign:
    """Design an LQG controller and prove it: margins, predicted responses, damping that each mode keeps.

    Parameters
    ----------
    model
        To design with, with inputs and outputs of any names. Of a rig's identification, or the folder of its results,
        that is its reduced model; the controller is then checked with the full one, too, and with models drawn from its
        covariance.
    weights
        Weights, their keys and values, their file, or the name of some: `lqg1` to `lqg5`, `half` (half the response, on
        any rig).
    rig
        Which rig: its sample rate and the capacity of its braces; None: that of the tests that the model is from.
    check_models
        Further models to check with, by name.
    progress
        Called with the numbers of models that it is proved with so far, and of all; None: nothing is.
    **options
        As `DesignOptions` has them.

    Raises
    ------
    AbraceError
        If model and weights give no controller, with each objection, or where rig and force limit are not known.
    """
    checked = DesignOptions.of(options)
    if rig is not None:
        known = rig_of(rig)
        checked = of_rig(checked, known.sample_rate, known.capacity)
    designed_with = model_of(model, design=True)
    models = {"model": designed_with}
    if isinstance(model, Identified) or (isinstance(model, (str, Path)) and (Path(model) / "reduced.json").is_file()):
        models = {"reduced": designed_with, "full": model_of(model)}
    covariance = covariance_of(model)
    covariances = {} if covariance is None else {list(models)[-1]: covariance}
    if not isinstance(check_models or {}, Mapping):
        raise AbraceError(f"check_models {check_models!r:.60}: expected models by name")
    models |= {name: model_of(each) for name, each in (check_models or {}).items()}
    found, name = weights_of(weights)
    return proven_design(
        models,
        weights=found,
        weights_name=name,
        options=checked,
        covariances=covariances,
        distrust=distrust_of(model),
        progress=progress or (lambda _done, _all: None),
    )
