# SPDX-License-Identifier: Apache-2.0
"""Models to controllers."""

from __future__ import annotations

from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace.interactive.given import model_of, rig_of, several, weights_of
from abrace.interactive.identification import Identified
from abrace_core.config_file import validated
from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_covariance, load_model
from abrace_core.one_thread import one_thread
from abrace_lqg.of_model import force_limit_of, sample_period_of
from abrace_lqg.proof.files import distrusted
from abrace_lqg.proof.limits import Limits
from abrace_lqg.proof.proven_design import ProvenDesign, proven_design
from abrace_sysid.validity.finding import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace.interactive.given import AnyModel, AnyRig
    from abrace_core.linear_model import LinearModel
    from abrace_lqg.weights import Weights


@one_thread()
def design(
    model: AnyModel,
    weights: Weights | Path | str = "lqg3",
    *,
    rig: AnyRig | None = None,
    check: Mapping[str, AnyModel] | None = None,
    sample_period: float | None = None,
    force_limit: float | Sequence[float] | None = None,
    limits: Mapping[str, float] | None = None,
    accept: Sequence[str] = (),
) -> ProvenDesign:
    """Design an LQG controller and prove it: margins, predicted responses, damping that each mode keeps.

    Parameters
    ----------
    model
        To design with. Of an identification, or the folder of its results, that is its reduced model; the controller
        is then checked with the full one, too, and with models drawn from its covariance.
    weights
        Weights, their file, or the name of some: `lqg1` to `lqg5`, `half` (half the response, on any rig).
    rig
        Which rig: its sample rate and the capacity of its braces; None: that of the tests that the model is from.
    check
        Further models to check with, by name.
    sample_period
        [s]; None: the rig's, or that of the tests.
    force_limit
        [N] of one brace, of every group or for each; None: the rig's.
    limits
        What the controller has to keep, by name: `gain_margin` [dB], `phase_margin` [degrees], `delay_margin` [s],
        `disk_margin`, `damping_kept`.
    accept
        Names of objections in spite of which the controller is made.

    Raises
    ------
    AbraceError
        If model and weights give no controller, with each objection, or where rig and force limit are not known.
    """
    designed_with = model_of(model, design=True)
    models, covariances, distrust = {"model": designed_with}, {}, []
    if isinstance(model, Identified):
        models = {"reduced": designed_with, "full": model.model}
        covariances, distrust = {"full": model.found.covariance}, _distrust(model)
    elif isinstance(model, (str, Path)) and (Path(model).is_dir() or Path(model).suffix == ".json"):
        path = Path(model)
        if path.is_dir():
            path /= "model.json"
            models = {"reduced": designed_with, "full": load_model(path)}
        covariances, distrust = {list(models)[-1]: load_covariance(path)}, list(distrusted([str(path)]))
    models |= {name: model_of(each) for name, each in (check or {}).items()}
    found, name = weights_of(weights)
    period, limit = of_rig(designed_with, rig, sample_period, force_limit)
    return proven_design(
        models,
        weights=found,
        weights_name=name,
        sample_period=period,
        force_limit=limit,
        limits=validated(limits, Limits, "design: limits") if limits else None,
        accept=several(accept),
        covariances={name: each for name, each in covariances.items() if each is not None},
        distrust=distrust,
    )


def _distrust(identified: Identified) -> list[str]:
    """Why no controller is to be designed with an identified model; empty: nothing."""
    verdict, causes = identified.validity.verdict, ", ".join(identified.validity.causes)
    return [f"the identification says {verdict.words} ({causes})"] if verdict is Verdict.DONT else []


def of_rig(model: LinearModel, rig: AnyRig | None, period: float | None, force: Any) -> tuple[float, list[float]]:
    """Sample `period` [s] and `force` limits (commands,) [N]: as given, of the `rig`, or of the `model`'s tests."""
    groups = len(model.inputs) - 1
    if rig is not None:
        known = rig_of(rig)
        period = period or 1 / known.sample_rate
        force = known.capacity.tolist() if force is None else force
    limits: list[Any] = (
        [force] * groups if isinstance(force, Real) else list(several(force)) if force is not None else []
    )
    for name, value in [("sample_period", period), *(("force_limit", each) for each in limits)]:
        if value is not None and not isinstance(value, Real):
            raise AbraceError(f"design: {name} {value!r}, expected a number")
    try:
        return sample_period_of(model, period or 0.0), force_limit_of(model, limits)
    except AbraceError as error:
        raise AbraceError(f"design: {error}; or give the rig, its name or file") from error
