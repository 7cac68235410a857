"""Proof before use: what a designed controller will do with each model that there is of the structure.

The controller was designed with one model and will meet a structure that is none of them. So all that can be told
before the first test is told for every model: poles, margins, the rms that an excitation leads to, what becomes of
modes that the design did not know, and what lost samples do. A design that fails is refused, unless it is asked for by
name.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

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

FILE_FORMAT = "abrace proof 1"
UNSTABLE, SHORT_DELAY = "unstable_with_check_model", "short_delay_margin"
OBJECTIONS = (UNSTABLE, SHORT_DELAY)
"""What a design is refused for, by the names by which it can be accepted all the same."""

SHORTEST_DELAY_MARGIN = 0.004
"""Least delay margin at the plant's input [s]: two samples at 500 Hz."""

LOST_IN_A_ROW = (1, 2)


@dataclass(frozen=True)
class ModelProof:
    """What a controller does with one model.

    Parameters
    ----------
    name
        Of the model.
    order
        Its states.
    stable
        Whether the loop is; if not, there are neither margins nor predictions.
    poles
        (frequency [rad/s], damping ratio) of the loop's oscillating poles, slowest first.
    margins
        By the signal at which the loop is broken, the others closed: commands, then measured quantities.
    disk
        Margin of all of these at once.
    prediction
        Rms with zero command and controlled [SI units], by quantity.
    modes
        What becomes of the model's own pole pairs.
    lost
        What one and two lost samples do.
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
    """What a controller does with all models.

    Parameters
    ----------
    models
        The one that it was designed with, then the others.
    commands
        Names of its commands: the plant's inputs.
    excitation
        For which rms values are predicted.
    accepted
        Objections that were accepted by name.
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
    def kept(self) -> float:
        """Least share of its damping that any pole pair of any model keeps; infinite if none oscillates."""
        return min((mode.kept for each in self.models for mode in each.modes), default=np.inf)

    def objections(self) -> dict[str, str]:
        """What speaks against use, out of OBJECTIONS, and why."""
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
        kept = f"; damping kept by every mode: {self.kept:.0%} or more" if np.isfinite(self.kept) else ""
        reasons = self.objections()
        accepted = "".join(f"; accepted by name: {name}, {reasons[name]}" for name in self.accepted)
        return text + kept + accepted

    def to_json(self) -> str:
        """All numbers, SI units; what is infinite is null."""
        content = {
            "format": FILE_FORMAT,
            "summary": self.summary(),
            "accepted": self.accepted,
            "excitation": asdict(self.excitation),
            "margins": asdict(self.margins),
            "least_damping_kept": self.kept,
            "models": [_content(each) for each in self.models],
        }
        return json.dumps(_finite(content), indent=1, allow_nan=False) + "\n"


def prove(designed: ControllerDesign, models: Mapping[str, LinearModel], excitation: Excitation | None = None) -> Proof:
    """Work out what a designed controller does with each model.

    Parameters
    ----------
    designed
        The design.
    models
        By name: first the model that it was designed with, then others.
    excitation
        For which rms values are predicted; banded noise of 0.25 m/s^2 if not given.

    Raises
    ------
    AbraceError
        If a model does not have the controller's signals, or the loop with the first one is not stable.
    """
    excitation = excitation or Excitation()
    own = next(iter(models.values()))
    proofs = []
    for name, model in models.items():
        try:
            proofs.append(_prove_with(name, model, own, designed, excitation))
        except AbraceError as error:
            raise AbraceError(f"proof with model {name}: {error}") from error
    if not proofs[0].stable:
        raise AbraceError(f"proof: the closed loop with {proofs[0].name}, the design's own model, is not stable")
    return Proof(tuple(proofs), designed.controller.outputs, excitation)


def require(proof: Proof, accept: Collection[str] = ()) -> Proof:
    """The proof, with what was accepted by name.

    Parameters
    ----------
    proof
        Of the design.
    accept
        Names out of OBJECTIONS for which it is not refused.

    Raises
    ------
    AbraceError
        If there is another objection; says by which name it can be accepted.
    """
    found = proof.objections()
    for name, reason in found.items():
        if name not in accept:
            raise AbraceError(f"design refused: {reason} (accept: [{name}] to have it all the same)")
    return replace(proof, accepted=tuple(found))


def _prove_with(
    name: str, model: LinearModel, own: LinearModel, designed: ControllerDesign, excitation: Excitation
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
        modes=mode_effects(model, controller, own),
        lost=[lost_samples(model, controller, designed.correction, excitation, count) for count in LOST_IN_A_ROW]
        if stable
        else [],
    )


def _content(proof: ModelProof) -> dict[str, Any]:
    """A model's proof as JSON values, with what is derived."""
    content = asdict(proof)
    content["poles"] = [{"frequency": frequency, "damping": damping} for frequency, damping in proof.poles]
    if proof.disk is not None:
        content["disk"] |= {"gain": proof.disk.gain, "phase": proof.disk.phase}
    content["prediction"] = {
        name: {"zero_command": without, "controlled": controlled}
        for name, (without, controlled) in proof.prediction.items()
    }
    for mode, entry in zip(proof.modes, content["modes"], strict=True):
        entry["kept"] = mode.kept
    return content


def _finite(value: Any) -> Any:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
