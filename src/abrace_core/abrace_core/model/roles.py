# SPDX-License-Identifier: Apache-2.0
"""Which input of a model disturbs, and which are commands: a rig's `w` and `U`, or inputs of any names."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.linear_model import LinearModel, name_and_unit_of, takes_models

if TYPE_CHECKING:
    from collections.abc import Sequence

DISTURBANCE = "disturbance"
"""Name of the input that is added where every input is a command: a force that acts where the command does."""


@takes_models
def with_roles(model: LinearModel, commands: Sequence[str] = (), disturbance: str = "") -> LinearModel:
    """The `model` from the disturbance and the commands, in this order; itself where its inputs are these.

    Parameters
    ----------
    model
        With inputs of any names; those that have neither role are left out.
    commands
        Names of inputs, with or without their units; none: all but the disturbance.
    disturbance
        Name of an input; if it is also a command, the disturbance is added to this command. Empty: the ground
        acceleration `w`; without one the only input that is no command, or the only command.

    Raises
    ------
    AbraceError
        If a name is no input, or the names do not say which input disturbs.
    """
    plain = {name_and_unit_of(name)[0]: name for name in model.inputs}
    asked = [*commands, *([disturbance] if disturbance else [])]
    unknown = [name for name in asked if name not in model.inputs and name not in plain]
    if unknown:
        raise AbraceError(f"model has no input {', '.join(unknown)}, it has {', '.join(model.inputs)}")
    disturbing = plain.get(disturbance, disturbance) or plain.get(signals.GROUND, "")
    chosen = tuple(plain.get(name, name) for name in commands)
    chosen = chosen or tuple(name for name in model.inputs if name != disturbing)
    others = [name for name in model.inputs if name not in chosen]
    if not disturbing:
        candidates = others or list(chosen)
        if len(candidates) != 1:
            raise AbraceError(
                f"model with inputs {', '.join(model.inputs)}: expected the name of the disturbance, "
                f"one of {', '.join(candidates)}" + ("" if commands else ", or of the commands")
            )
        (disturbing,) = candidates
    if disturbing not in chosen:
        wanted = (disturbing, *chosen)
        return model if wanted == model.inputs else model.select(inputs=wanted)
    kept = model.select(inputs=chosen)
    place, (_, unit) = chosen.index(disturbing), name_and_unit_of(disturbing)
    return replace(
        kept,
        b=np.column_stack([kept.b[:, place], kept.b]),
        d=np.column_stack([kept.d[:, place], kept.d]),
        inputs=(DISTURBANCE, *chosen),
        input_delay=(kept.input_delay[place], *kept.input_delay),
        units={**kept.units, DISTURBANCE: model.units.get(disturbing, unit) or "N"},
    )
