"""Proof before use: the predicted behaviour of a designed controller with every available model of the structure.

The controller is designed with one model, and the structure differs from every model. So the closed loop with each is
analysed before the first test: poles, margins, rms of responses and commands, damping of unmodelled modes, and the
effect of lost samples. A design with an objection is refused unless that objection is accepted by name.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_lqg.analysis.disk_margin import DiskMargin, disk_margin
from abrace_lqg.analysis.lost_samples import LostSamples, lost_samples
from abrace_lqg.analysis.margins import Margins, margins_at
from abrace_lqg.analysis.mode_damping import ModeEffect, mode_effects
from abrace_lqg.analysis.prediction import Excitation, rms_without_and_with_control
from abrace_lqg.loop import closed_loop_poles, is_stable

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.design import ControllerDesign

UNSTABLE, SHORT_DELAY = "unstable_with_check_model", "short_delay_margin"
OBJECTIONS = (UNSTABLE, SHORT_DELAY)
"""Names of the reasons for which a design is refused; each can be accepted by name."""

SHORTEST_DELAY_MARGIN = 0.004
"""Least delay margin at the plant's input [s]: two samples at 500 Hz."""

LOST_IN_A_ROW = (1, 2)
"""Numbers of consecutive lost samples whose effect is computed."""


@dataclass(frozen=True)
class ModelProof:
    """Predictions for a controller with one model.

    Parameters
    ----------
    name
        Of the model.
    order
        Number of its states.
    stable
        Whether the closed loop is stable; if not, margins, prediction and lost are empty.
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
    lost
        The effect of one and of two lost samples.
    """

    name: str
    order: int
    stable: bool
    poles: list[tuple[float, float]]
    margins: dict[str, Margins]
    disk: DiskMargin | None
    prediction: dict[str, tuple[float, float]]
    modes: list[ModeEffect]
    lost: list[LostSamples]


@dataclass(frozen=True)
class Proof:
    """Predictions for a controller with all models.

    Parameters
    ----------
    models
        The design model's first, then the check models'.
    commands
        Names of the commands: the plant's inputs.
    excitation
        For which rms values are predicted.
    accepted
        Names of the objections that were accepted.
    """

    models: tuple[ModelProof, ...]
    commands: tuple[str, ...]
    excitation: Excitation
    accepted: tuple[str, ...] = ()

    @property
    def margins(self) -> Margins:
        """The least margins at the plant's inputs, of all models with which the loop is stable."""
        return Margins.least([each.margins[name] for each in self.models if each.stable for name in self.commands])

    @property
    def least_damping_kept(self) -> float:
        """Least `ModeEffect.damping_kept` of all pole pairs of all models; infinite if there is none."""
        return min((mode.damping_kept for each in self.models for mode in each.modes), default=np.inf)

    def objections(self) -> dict[str, str]:
        """The reasons against use, by their names in OBJECTIONS."""
        found = {}
        unstable = [f"{each.name} ({each.order} states)" for each in self.models if not each.stable]
        if unstable:
            found[UNSTABLE] = f"the closed loop with {', '.join(unstable)} is not stable"
        if self.margins.delay < SHORTEST_DELAY_MARGIN:
            delay, least = 1e3 * self.margins.delay, 1e3 * SHORTEST_DELAY_MARGIN
            found[SHORT_DELAY] = f"delay margin {delay:.2f} ms, expected at least {least:g} ms"
        return found

    def summary(self) -> str:
        """One line for the controller file."""
        models = sum(each.stable for each in self.models)
        text = f"{self.margins}" + (f", the least of {models} models" if models > 1 else "")
        least = self.least_damping_kept
        kept = f"; damping kept by every mode: {least:.0%} or more" if np.isfinite(least) else ""
        reasons = self.objections()
        accepted = "".join(f"; accepted by name: {name}, {reasons[name]}" for name in self.accepted)
        return text + kept + accepted


def prove(designed: ControllerDesign, models: Mapping[str, LinearModel], excitation: Excitation | None = None) -> Proof:
    """Analyse the closed loop of a designed controller with each model.

    Parameters
    ----------
    designed
        The design.
    models
        By name: first the model that it was designed with, then the check models.
    excitation
        For which rms values are predicted; None: `Excitation()`.

    Raises
    ------
    AbraceError
        If a model lacks a signal of the controller, or the loop with the first model is not stable.
    """
    excitation = excitation or Excitation()
    design_model = next(iter(models.values()))
    proofs = []
    for name, model in models.items():
        try:
            proofs.append(_prove_with(name, model, design_model, designed, excitation))
        except AbraceError as error:
            raise AbraceError(f"proof with model {name}: {error}") from error
    if not proofs[0].stable:
        raise AbraceError(f"proof: the closed loop with {proofs[0].name}, the design's own model, is not stable")
    return Proof(tuple(proofs), designed.controller.outputs, excitation)


def require(proof: Proof, accept: Collection[str] = ()) -> Proof:
    """Refuse the design if there is an objection that is not accepted; return the proof with the accepted ones.

    Parameters
    ----------
    proof
        Of the design.
    accept
        Names out of OBJECTIONS.

    Raises
    ------
    AbraceError
        With the first objection that is not accepted, and the name by which it can be.
    """
    found = proof.objections()
    for name, reason in found.items():
        if name not in accept:
            raise AbraceError(f"design refused: {reason} (accept: [{name}] to have it all the same)")
    return replace(proof, accepted=tuple(found))


def _prove_with(
    name: str, model: LinearModel, design_model: LinearModel, designed: ControllerDesign, excitation: Excitation
) -> ModelProof:
    controller = designed.controller
    stable = is_stable(model, controller)
    return ModelProof(
        name=name,
        order=model.order,
        stable=stable,
        poles=closed_loop_poles(model, controller),
        margins=margins_at(model, controller) if stable else {},
        disk=disk_margin(model, controller) if stable else None,
        prediction=rms_without_and_with_control(model, controller, excitation) if stable else {},
        modes=mode_effects(model, controller, design_model),
        lost=[
            lost_samples(model, controller, designed.correction, excitation=excitation, in_a_row=count)
            for count in LOST_IN_A_ROW
            if stable
        ],
    )
