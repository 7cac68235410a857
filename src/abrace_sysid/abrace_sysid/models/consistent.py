# SPDX-License-Identifier: Apache-2.0
"""The consistent model: one set of poles for every input, so that each mode of the rig appears once.

The superposed model of Eqs. (6) and (7) contains each building pole three times, from three fits. The commands do not
control the table's copies. In closed loop its prediction is right only as far as the three parts cancel, and their
differences oscillate at the building's poles. In the consistent model all inputs share the poles that their bands
contain. The numerators of all channels are fitted with absolute weights (`realize`). Balanced truncation then merges
the inputs' copies of each pole, down to as many states as there are poles.
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

    An input drives the poles up to the highest frequency at which its response was measured. The effect of faster
    poles is in the direct term, which is fitted.

    Parameters
    ----------
    measured
        The measured responses; several of the same input (repeated tests) are fitted together.
    poles
        [rad/s], stable, real or in conjugate pairs, all distinct.
    delays
        Delay of each input [s]; 0 for inputs not in it.

    Returns
    -------
    LinearModel
        Continuous; inputs and outputs in the order of their first appearance in `measured`.

    Raises
    ------
    AbraceError
        If a pole is unstable, or an input's response contains no pole.
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
    """The model for prediction: common poles, numerators fitted for all channels and inputs, copies of poles merged.

    Parameters
    ----------
    measured, poles, delays
        As in `realize_together`.
    band, intensity
        Band [Hz], and rms of each input by name, of the motion that sets the balancing units (`typical_scales`).

    Returns
    -------
    Reduction
        Its model has as many states as there are poles, and nearly these poles. A reduction to fewer states
        (`balanced_truncation` of `realize_together`) first drops the servo's slow pole, then local modes.
    """
    whole = realize_together(measured, poles, delays)
    merged = balanced_truncation(whole, len(poles), typical_scales(whole, band, intensity))
    about = {"states": f"consistent, one for each of {len(poles)} common poles"}
    return replace(merged, model=replace(merged.model, provenance=about))
