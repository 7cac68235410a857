# SPDX-License-Identifier: Apache-2.0
"""Relative weights scaled to a rig from one number: the wanted reduction, or the share of force to use.

The weights of each kind are relative. Each signal's is divided by its mean square with zero command under the
excitation of the design, each command's by the square of its force limit. One factor on all weights but the commands'
is then found such that the predicted responses, or commands, meet the target.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, takes_models
from abrace_core.model.si_units import in_si_units
from abrace_lqg.analysis.prediction import predicted_rms
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights, is_of_kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_lqg.analysis.prediction import Excitation

DECADES = 8.0
"""The factor is sought from this power of ten below 1 to above it."""

STEPS = 12
"""Bisections: the factor is then known to 1 %."""

DEVIATIONS = 3.0
"""A command's greatest value, in its rms."""

ACCURATE = 0.02
"""Greatest difference from the target."""


@takes_models
def scaled_weights(
    model: LinearModel,
    weights: Weights,
    sample_period: float,
    force_limit: Sequence[float],
    excitation: Excitation,
    rig_period: float | None = None,
) -> Weights:
    """The weights in SI units, for one rig and its names; without a scale only names with a wildcard are expanded.

    Parameters
    ----------
    model
        The model that the controller is designed on.
    weights
        Relative weights, with their `scale`.
    sample_period
        Sample period of the controller [s].
    force_limit
        (commands,) [N].
    excitation
        The disturbance, under which reduction and force are predicted.
    rig_period
        As in `design`.

    Raises
    ------
    AbraceError
        If a name is none of the model's, there is not one force limit for each command, nothing is there
        to reduce, or no factor reaches the target.
    """
    model = in_si_units(model)
    commands = model.inputs[1:]
    if len(force_limit) != len(commands):
        expected = ", ".join(commands)
        raise AbraceError(
            f"force_limit: {list(force_limit)} N, expected one for each command of the model ({expected})"
        )
    weights = weights.of(model.outputs, commands)
    if weights.scale is None:
        return weights
    plant = sampled(model, rig_period or sample_period)
    names, rows = weights.weighed(model.outputs)
    seen = LinearModel(plant.a, plant.b, rows @ plant.c, rows @ plant.d, plant.inputs, names, plant.sample_period)
    without = predicted_rms(seen, None, excitation)
    unit = {name: 1 / without[name] ** 2 for name in names if without[name] > 0}
    unit |= {name: 1 / limit**2 for name, limit in zip(commands, force_limit, strict=True)}
    relative = {name: value * weights.relative.get(name, 1.0) for name, value in unit.items()}
    floors = [name for name in model.outputs if is_of_kind(name, "displacement")]
    floors = floors or [name for name in model.outputs if weights.signals.get(name)]
    floors = floors or [name for name in model.outputs if is_of_kind(name, "acceleration")]
    if weights.scale.reduction is not None and not floors:
        raise AbraceError(
            f"weights: scale.reduction: the model has no displacements and no accelerations, only "
            f"{', '.join(model.outputs)}, expected scale.force, or weights by name in signals"
        )

    def with_factor(power: float) -> Weights:
        kinds = {
            name: value * (1.0 if name == "command" else 10.0**power)
            for name, value in weights.weights.model_dump().items()
        }
        own = {name: value * (1.0 if name in commands else 10.0**power) for name, value in weights.signals.items()}
        scaled = weights.weights.model_copy(update=kinds)
        changed = {"weights": scaled, "signals": own, "relative": relative, "scale": None}
        return weights.model_copy(update=changed)

    def reached(power: float) -> float:
        controller = design(model, with_factor(power), sample_period, rig_period).controller
        rms = predicted_rms(plant, controller, excitation)
        if weights.scale is not None and weights.scale.reduction is not None:
            return 1 - float(np.mean([rms[name] / without[name] for name in floors]))
        return max(DEVIATIONS * rms[name] / limit for name, limit in zip(commands, force_limit, strict=True))

    asked = weights.scale.reduction or weights.scale.force or 0.0
    low, high, found = -DECADES, DECADES, 0.0
    for _ in range(STEPS):
        middle = (low + high) / 2
        try:
            found = reached(middle)
        except AbraceError:  # weights too large for an accurate solution
            found = np.inf
        low, high = (middle, high) if found < asked else (low, middle)
    found = reached(low)
    if not abs(found - asked) <= ACCURATE:
        (name,) = weights.scale.model_dump(exclude_none=True)
        bound = "most" if found < asked else "least"
        raise AbraceError(f"weights: scale.{name}: {asked:g}, expected {found:.2g} at {bound} on this rig")
    return with_factor(low)
