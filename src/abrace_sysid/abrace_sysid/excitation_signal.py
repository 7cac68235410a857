# SPDX-License-Identifier: Apache-2.0
"""The commands of an identification test: banded white noise or a multisine for every brace group."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.multisine import repeated_multisine
from abrace_core.noise import banded_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray


def excitation_signal(given: Any, groups: int) -> NDArray[np.float64]:
    """The signal of each brace group, (samples, groups) [N]; multisines of different groups are orthogonal.

    Parameters
    ----------
    given
        Parameter values of the node `excitation`.
    groups
        Number of brace groups.

    Raises
    ------
    AbraceError
        If the parameters do not describe a possible signal.
    """
    rate, band = given.sample_rate, (given.band[0], given.band[1])

    def of(group: int) -> NDArray[np.float64]:
        if given.signal == "white_noise":
            return banded_noise(round(given.duration * rate), rate, band, given.rms, given.seed + group)
        return repeated_multisine(
            given.duration,
            given.period,
            rate,
            band,
            given.rms,
            given.seed,
            given.lines,
            given.slope,
            share=(group, groups),
        )

    return np.column_stack([of(group) for group in range(groups)])
