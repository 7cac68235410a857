# SPDX-License-Identifier: Apache-2.0
"""Models and signals in SI units: a stated unit is converted, one that cannot be is refused.

A signal of a rig (`signals.unit`) without a stated unit is in SI units. A signal of another name, as `strain`, keeps a
unit that is not known; no computation needs it in SI units.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.units import UNITS, si_unit, unit_as_stated, unit_of
from abrace_core.model import signals
from abrace_core.model.linear_model import LinearModel, name_and_unit_of, takes_models


def si_factor(name: str, unit: str, where: str) -> tuple[float, str]:
    """The factor from the `unit` of a signal to SI units, and the SI unit.

    >>> si_factor("a1", "gal", "model"), si_factor("strain", "V", "model")
    ((0.01, 'm/s^2'), (1.0, 'V'))

    Parameters
    ----------
    name
        Of the signal, without a unit.
    unit
        As stated; empty or "-": none.
    where
        How an error begins.

    Raises
    ------
    AbraceError
        If the unit is not known, or of another kind of quantity than the signal is.
    """
    own = signals.unit(name)
    wanted = own if own != "-" else ""
    if unit in ("", "-"):
        return 1.0, wanted
    found = unit_as_stated(unit)
    if not wanted:
        return (1.0, unit) if found is None else (found.factor, si_unit(found.dimension))
    dimension = unit_of(wanted).dimension
    if found is None or found.dimension != dimension:
        others = ", ".join(text for text, known in UNITS.items() if known.dimension == dimension and text != wanted)
        raise AbraceError(f"{where} {name} in {unit!r}: expected {wanted}, or a unit that converts to it, as {others}")
    return found.factor, wanted


@takes_models
def in_si_units(model: LinearModel) -> LinearModel:
    """The same `model` with its signals in SI units, their names without units; itself where it is in SI units.

    Its `units` are then those of signals that are no rig's.

    Parameters
    ----------
    model
        With `units`, or with units in names, as `a1 [g]`.

    Raises
    ------
    AbraceError
        As in `si_factor`, or if two signals have one name without their units.
    """
    names, factors, kept = {}, {}, {}
    for kind, known in (("input", model.inputs), ("output", model.outputs)):
        for written in known:
            name, unit = name_and_unit_of(written)
            unit = model.units.get(written, unit)
            factor, si = si_factor(name, unit, f"model {kind}")
            names[written], factors[written] = name, factor
            if signals.unit(name) == "-" and unit and unit != "-":
                kept[name] = si
    if kept == model.units and all(name == written and factors[written] == 1 for written, name in names.items()):
        return model
    into, out_of = (np.array([factors[name] for name in known]) for known in (model.inputs, model.outputs))
    return replace(
        model,
        b=model.b / into,
        c=model.c * out_of[:, None],
        d=model.d * out_of[:, None] / into,
        inputs=tuple(names[name] for name in model.inputs),
        outputs=tuple(names[name] for name in model.outputs),
        units=kept,
    )
