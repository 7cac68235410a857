# SPDX-License-Identifier: Apache-2.0
"""What a model says of its rig: sample period and force limits of controllers, and the band of ground motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, pole_table, takes_models
from abrace_lqg.analysis.prediction import Excitation

if TYPE_CHECKING:
    from collections.abc import Sequence

AROUND_SLOWEST = (0.5, 4.0)
"""The band of ground motions includes the slowest mode's frequency times these two: most earthquakes move it."""


@takes_models
def sample_period_of(model: LinearModel, given: float = 0.0) -> float:
    """The sample period [s] of a controller for a model: the one that was `given`, or that of the model's tests.

    Raises
    ------
    AbraceError
        If neither is known, or the model's slowest mode cannot be sampled with it.
    """
    found = given or model.provenance.get("sample_period")
    if not found:
        raise AbraceError("sample_period: not given, and the model's file does not have it, expected s")
    for frequency, _ in pole_table(model.poles())[:1]:
        most = np.pi / frequency
        if not 0 < float(found) < most:
            raise AbraceError(
                f"sample_period: {float(found):g} s, expected above 0 and below {most:.3g} s, "
                "half the slowest mode's period"
            )
    return float(found)


@takes_models
def force_limit_of(model: LinearModel, given: Sequence[float] = ()) -> list[float]:
    """The force limits (commands,) [N] of a controller: those `given`, or the capacity of the rig of the model's tests.

    Raises
    ------
    AbraceError
        If neither is known.
    """
    found = list(given) or model.provenance.get("force_limit")
    if not found:
        commands = ", ".join(model.inputs[1:])
        raise AbraceError(
            f"force_limit: not given, and the model's file does not have it, expected N, one for each of {commands}"
        )
    return [float(limit) for limit in found]


@takes_models
def excitation_of(model: LinearModel, rms: float = 0.25, band: Sequence[float] = ()) -> Excitation:
    """The ground acceleration for which a design predicts responses.

    Parameters
    ----------
    model
        Continuous.
    rms
        [m/s^2].
    band
        [Hz]; empty: 0.3 to 10 Hz, and wider where the slowest mode is nearer to an end than `AROUND_SLOWEST`.

    Raises
    ------
    AbraceError
        If the rms or the band is not possible.
    """
    if band:
        if len(band) != 2:
            raise AbraceError(f"excitation_band: {list(band)}, expected two frequencies in Hz")
        return Excitation(rms, (band[0], band[1]))
    low, high = Excitation().band
    for frequency, _ in pole_table(model.poles())[:1]:
        slowest = frequency / (2 * np.pi)
        low, high = min(low, AROUND_SLOWEST[0] * slowest), max(high, AROUND_SLOWEST[1] * slowest)
    return Excitation(rms, (float(low), float(high)))
