# SPDX-License-Identifier: Apache-2.0
"""The consistent model: one set of poles for every input, so that each mode of the rig appears once.

Eqs. (6) and (7) give the superposed model each building pole three times, from three fits. The command controls none of
the table's copies, and in closed loop the prediction is right only as far as the parts cancel: their differences
oscillate at the building's poles. Here every input has the same poles, those that its band shows, and all channels
their numerators in absolute weights (`realize`); the inputs' copies of a pole are then merged by balanced truncation to
as many states as there are poles.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.curve_fit import require_stable
from abrace_sysid.models.realization import realize, superpose
from abrace_sysid.models.reduction import Reduction, balanced_truncation, typical_scales

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


def realize_together(
    measured: Sequence[FrequencyResponse], poles: NDArray[np.complex128], delays: Mapping[str, float]
) -> LinearModel:
    """One model for several inputs with common poles, each input driving its own copy of them.

    An input gets the poles up to the highest frequency at which its response was measured; those beyond add to the
    direct term, which is fitted.

    Parameters
    ----------
    measured
        One response for each input, or several of the same input (repeated tests), which are fitted together.
    poles
        [rad/s], stable, real or in conjugate pairs, all distinct.
    delays
        Of each input [s]; 0 if not named.

    Returns
    -------
    LinearModel
        Continuous; inputs in the order in which `measured` names them first, outputs likewise.

    Raises
    ------
    AbraceError
        If a pole is unstable, or an input's band shows no pole.
    """
    where = "consistent model"
    require_stable(poles, where)
    inputs = tuple(dict.fromkeys(response.input for response in measured))
    outputs = tuple(dict.fromkeys(name for response in measured for name in response.outputs))
    parts = []
    for name in inputs:
        same = [response for response in measured if response.input == name]
        highest = max(float(response.omega[-1]) for response in same)
        shown = poles[np.abs(poles) <= highest]
        if not len(shown):
            raise AbraceError(f"{where}: no pole up to {highest:.4g} rad/s, where the response to {name} ends")
        parts.append(realize(same, shown, delays.get(name, 0.0)))
    return superpose(parts, inputs, outputs)


def consistent_model(
    measured: Sequence[FrequencyResponse],
    poles: NDArray[np.complex128],
    delays: Mapping[str, float],
    band: tuple[float, float],
    intensity: Mapping[str, float],
) -> Reduction:
    """The model for prediction: numerators of all channels and inputs over common poles, copies merged.

    Parameters
    ----------
    measured, poles, delays
        As in `realize_together`.
    band, intensity
        [Hz], and rms of each input by name, of the typical motion that sets the balancing units.

    Returns
    -------
    Reduction
        Its model has as many states as there are poles, and nearly these poles. With fewer (`balanced_truncation` of
        `realize_together`) the servo's slow pole is the first to go, then local modes.
    """
    whole = realize_together(measured, poles, delays)
    merged = balanced_truncation(whole, len(poles), typical_scales(whole, band, intensity))
    about = {"states": f"consistent, one for each of {len(poles)} common poles"}
    return replace(merged, model=replace(merged.model, provenance=about))
