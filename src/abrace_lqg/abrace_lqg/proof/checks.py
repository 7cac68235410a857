# SPDX-License-Identifier: Apache-2.0
"""Proof before use: the predicted behaviour of a designed controller with every available model of the structure.

The controller is designed with one model, and the structure differs from every model. So the closed loop with each is
analysed before the first test: poles, margins, rms of responses and commands, and damping of unmodelled modes. A design
with an objection is refused unless that objection is accepted by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it
from abrace_core.files.suggestion import expected_of
from abrace_core.model.linear_model import takes_models
from abrace_core.model.signals import unit as signal_unit
from abrace_core.model.verdict import judged, nan_first
from abrace_lqg.analysis.disk_margin import DiskMargin, disk_margin
from abrace_lqg.analysis.margins import Margins, margins_at
from abrace_lqg.analysis.mode_damping import ModeEffect, mode_effects
from abrace_lqg.analysis.named_values import Named
from abrace_lqg.analysis.prediction import Excitation, rms_without_and_with_control
from abrace_lqg.loop import closed_loop_poles, is_stable, sampled
from abrace_lqg.proof.limits import OBJECTIONS, WORDING, Limits, Objection, excitation_of, shortfall

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.design import ControllerDesign

Pole = Annotated[tuple[float, float], Named("frequency_rad_s", "damping_ratio")]
Rms = Annotated[tuple[float, float], Named("zero_command", "controlled")]


@dataclass(frozen=True)
class EnsembleProof:
    """The least that a controller keeps with any of several models drawn from one model's covariance.

    Parameters
    ----------
    count, unstable
        Models, and those with which the loop is not stable; the rest is about the others.
    margins
        Least margins by the command at which the loop is broken.
    disk_margin
        Radius of the disk of all commands and measured quantities at once.
    damping_kept, at
        Least share of its damping that a mode is left with, and its frequency [rad/s].
    """

    count: int
    unstable: int
    margins: dict[str, Margins]
    disk_margin: Number
    damping_kept: Number
    at: Annotated[float, pydantic.Field(alias="at_frequency_rad_s")]

    def __str__(self) -> str:
        return f"{self.count} models drawn from it"


@dataclass(frozen=True)
class ModelProof:
    """Predictions for a controller with one model.

    Parameters
    ----------
    order
        Number of its states.
    stable
        Whether the closed loop is stable; if not, margins and prediction are empty.
    poles
        (frequency [rad/s], damping ratio) of the loop's oscillating poles, slowest first.
    margins
        By the signal at which the loop is broken, the others closed: commands, then measured quantities.
    disk
        Margin for simultaneous changes of all of these signals.
    prediction
        Rms with zero command and controlled [SI units], by quantity.
    modes
        The model's own pole pairs without and with control.
    ensemble
        The least of models as likely as this one; None: it has no covariance.
    """

    name: str
    order: int
    stable: bool
    poles: list[Pole]
    margins: dict[str, Margins]
    disk: DiskMargin | None
    prediction: dict[str, Rms]
    modes: list[ModeEffect]
    ensemble: EnsembleProof | None = None


def _models_of(given: Any) -> list[dict[str, Any]]:
    if not isinstance(given, dict) or not all(isinstance(one, dict) for one in given.values()):
        raise ValueError("an object for each model, by its name")
    return [{"name": name, **one} for name, one in given.items()]


def _by_name(models: Any, write: pydantic.SerializerFunctionWrapHandler) -> dict[str, dict[str, Any]]:
    return {one.pop("name"): one for one in write(models)}


ModelProofs = Annotated[tuple[ModelProof, ...], pydantic.BeforeValidator(_models_of), pydantic.WrapSerializer(_by_name)]
"""In files by the names of the models."""


@dataclass(frozen=True)
class Proof:
    """Predictions for a controller with all models: what is written to NAME_proof.json, and read from it by pydantic.

    Parameters
    ----------
    models
        The design model's first, then the check models'.
    commands
        Names of the commands: the plant's inputs.
    excitation
        The ground motion for which rms values are predicted.
    limits
        What the controller has to keep.
    accepted
        Names of the objections that were accepted.
    distrusted
        For each model that its identification says not to trust, in which file and why.
    units
        SI units of all signals by name, as far as they are known.
    """

    models: ModelProofs
    commands: tuple[str, ...]
    excitation: Excitation
    limits: Limits = field(default_factory=Limits)
    accepted: tuple[Objection, ...] = ()
    distrusted: tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _design_model_first(cls, given: Any) -> Any:
        """The content of a file, in which the order of the models says nothing, with the design model first."""
        if not isinstance(given, dict) or not isinstance(models := given.get("models"), dict):
            return given
        if (first := given.get("design_model")) not in models:
            raise ValueError(f"design_model, one of {', '.join(models)}")
        return {**given, "models": {first: models[first], **models}}

    @pydantic.computed_field  # type: ignore[prop-decorator]
    @property
    def design_model(self) -> str:
        """Name of the model that the controller was designed with."""
        return self.models[0].name

    @property
    def margins(self) -> Margins:
        """The least margins at the plant's inputs, of all models, drawn ones too, with which the loop is stable."""
        found = [each.margins for each in self.models if each.stable]
        found += [each.ensemble.margins for each in self.models if each.ensemble is not None and each.ensemble.margins]
        return Margins.least([one[name] for one in found for name in self.commands])

    @property
    def least_damping_kept(self) -> float:
        """Least `ModeEffect.damping_kept` of all pole pairs of all models, drawn ones too; infinite: there is none."""
        of_modes = [mode.damping_kept for each in self.models for mode in each.modes]
        drawn = [each.ensemble.damping_kept for each in self.models if each.ensemble is not None]
        return min([*of_modes, *drawn], key=nan_first, default=np.inf)

    def objections(self) -> dict[Objection, str]:
        """The reasons against use, by their names in `proof.limits.OBJECTIONS`."""
        found: dict[Objection, str] = {}
        if self.distrusted:
            found["untrusted_model"] = "; ".join(self.distrusted)
        unstable = [f"{each.name} ({each.order} states)" for each in self.models if not each.stable]
        unstable += [
            f"{each.ensemble.unstable} of the {each.ensemble.count} models drawn from {each.name}"
            for each in self.models
            if each.ensemble is not None and each.ensemble.unstable
        ]
        if unstable:
            found["unstable_with_check_model"] = f"the closed loop with {', '.join(unstable)} is not stable"
        for limit, asked in self.limits.model_dump().items():
            short = [one for one in (*self._measured(limit), *self._drawn(limit)) if judged(asked - one[0], 0.0)]
            if short:
                value, where = min(short, key=lambda one: nan_first(one[0]))
                found[WORDING[limit].objection] = shortfall(limit, value, where, asked)
        return found

    def _measured(self, limit: str) -> list[tuple[float, str]]:
        """Each value that a field of `Limits` limits, and where it was found."""
        stable = [each for each in self.models if each.stable]
        if limit == "disk_margin":
            return [(each.disk.alpha, f"with {each.name}") for each in stable if each.disk is not None]
        if limit == "damping_kept":
            return [
                (mode.damping_kept, f"by the mode at {mode.frequency:.1f} rad/s with {each.name}")
                for each in stable
                for mode in each.modes
            ]
        quantity = WORDING[limit].of_margins
        return [
            (getattr(each.margins[name], quantity), f"at {name} with {each.name}")
            for each in stable
            for name in self.commands
        ]

    def _drawn(self, limit: str) -> list[tuple[float, str]]:
        """The same of the models drawn from each."""
        found = []
        for each in self.models:
            one = each.ensemble
            if one is None or one.unstable == one.count:
                continue
            where = f"with one of the {one.count} models drawn from {each.name}"
            if limit == "damping_kept":
                found.append((one.damping_kept, f"by the mode at {one.at:.1f} rad/s {where}"))
            elif limit == "disk_margin":
                found.append((one.disk_margin, where))
            else:
                quantity = WORDING[limit].of_margins
                found += [(getattr(one.margins[name], quantity), f"at {name} {where}") for name in self.commands]
        return found

    def summary(self) -> str:
        """One line for the controller file."""
        models = sum(each.stable for each in self.models)
        drawn = [each.ensemble for each in self.models if each.ensemble is not None]
        disk = [each.disk.alpha for each in self.models if each.disk is not None]
        text = f"{self.margins}, disk margin {min([*disk, *(one.disk_margin for one in drawn)], key=nan_first):.2f}"
        if models > 1 or drawn:
            count = sum(one.count - one.unstable for one in drawn)
            text += f", the least of {models} models" + (f" and {count} drawn from them" if drawn else "")
        least = self.least_damping_kept
        kept = f"; damping kept by every mode: {least:.0%} or more" if least < np.inf or np.isnan(least) else ""
        reasons = self.objections()
        accepted = "".join(f"; accepted by name: {name}, {reasons[name]}" for name in self.accepted)
        return text + kept + accepted


@takes_models
def prove(
    designed: ControllerDesign,
    models: Mapping[str, LinearModel],
    excitation: Excitation | None = None,
    limits: Limits | None = None,
    ensembles: Mapping[str, Sequence[LinearModel]] | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Proof:
    """Analyse the closed loop of a designed controller with each model.

    Parameters
    ----------
    models
        By name: first the model that it was designed with, then the check models.
    excitation
        For which rms values are predicted; None: `excitation_of` the first model.
    limits
        What the controller has to keep; None: `Limits()`.
    ensembles
        By the name of a model others that are as likely; the controller has to keep its limits with them too.
    progress
        Called with the numbers of models that are done, and of all.

    Raises
    ------
    AbraceError
        If a model lacks a signal of the controller, or the loop with the first model is not stable.
    """
    design_model = next(iter(models.values()))
    excitation = excitation or excitation_of(design_model, sample_period=designed.controller.sample_period)
    proofs, done, count = [], 0, len(models) + sum(map(len, (ensembles or {}).values()))

    def advance() -> None:
        nonlocal done
        done += 1
        progress(done, count)

    progress(0, count)
    for name, model in models.items():
        try:
            plant = sampled(model, designed.rig_period)
            one = _prove_with(name, plant, model.order, design_model, designed, excitation)
            advance()
            if drawn := (ensembles or {}).get(name):
                one = replace(one, ensemble=_prove_ensemble(drawn, design_model, designed, advance))
            proofs.append(one)
        except AbraceError as error:
            raise AbraceError(f"proof with model {name}: {error}") from error
    if not proofs[0].stable:
        raise AbraceError(f"proof: the closed loop with {proofs[0].name}, the design's own model, is not stable")
    names = dict.fromkeys(name for model in models.values() for name in (*model.inputs, *model.outputs))
    own = {**design_model.units, **designed.controller.units}
    units = {name: unit for name in names if (unit := own.get(name) or signal_unit(name)) != "-"}
    return Proof(tuple(proofs), designed.controller.outputs, excitation, limits or Limits(), units=units)


def require(proof: Proof, accept: Collection[str] = ()) -> Proof:
    """Refuse the design if there is an objection that is not accepted; return the proof with the accepted ones.

    Parameters
    ----------
    accept
        Names out of `proof.limits.OBJECTIONS`.

    Raises
    ------
    AbraceError
        With each objection that is not accepted, and the names by which they can be; or a name that is none.
    """
    found = proof.objections()
    if unknown := [name for name in accept if name not in OBJECTIONS]:
        raise AbraceError(f"accept {unknown[0]!r}: {expected_of(str(unknown[0]), OBJECTIONS)}")
    refused = {name: reason for name, reason in found.items() if name not in accept}
    if refused:
        raise AbraceError(
            f"design refused: {'; '.join(refused.values())} (accept: [{', '.join(refused)}] to accept it nevertheless)"
        )
    return replace(proof, accepted=tuple(found))


def _prove_with(
    name: str,
    model: LinearModel,
    order: int,
    design_model: LinearModel,
    designed: ControllerDesign,
    excitation: Excitation,
) -> ModelProof:
    """The proof with a discrete `model`, of which the continuous one is of this `order`."""
    controller = designed.controller
    stable = is_stable(model, controller)
    return ModelProof(
        name=name,
        order=order,
        stable=stable,
        poles=closed_loop_poles(model, controller),
        margins=margins_at(model, controller) if stable else {},
        disk=disk_margin(model, controller) if stable else None,
        prediction=rms_without_and_with_control(model, controller, excitation) if stable else {},
        modes=mode_effects(model, controller, design_model),
    )


def _prove_ensemble(
    models: Sequence[LinearModel],
    design_model: LinearModel,
    designed: ControllerDesign,
    advance: Callable[[], None],
) -> EnsembleProof:
    controller = designed.controller
    found: list[dict[str, Margins]] = []
    modes: list[ModeEffect] = []
    disk = np.inf
    for model in (sampled(one, designed.rig_period) for one in models):
        if is_stable(model, controller):
            found.append(margins_at(model, controller, controller.outputs))
            modes += mode_effects(model, controller, design_model)
            disk = min(disk, disk_margin(model, controller, below=disk).alpha, key=nan_first)
        advance()
    least = min(modes, key=lambda mode: nan_first(mode.damping_kept), default=None)
    return EnsembleProof(
        count=len(models),
        unstable=len(models) - len(found),
        margins={name: Margins.least([one[name] for one in found]) for name in controller.outputs if found},
        disk_margin=disk,
        damping_kept=np.inf if least is None else least.damping_kept,
        at=0.0 if least is None else least.frequency,
    )
