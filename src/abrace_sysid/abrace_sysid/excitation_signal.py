# SPDX-License-Identifier: Apache-2.0
"""The commands of an identification test: banded white noise or a multisine for every brace group."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.multisine import repeated_multisine
from abrace_core.model.noise import banded_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray


def excitation_signal(given: Any, groups: int) -> NDArray[np.float64]:
    """The signal of each brace group, (samples, groups) [N]; multisines of different groups are orthogonal.

    A group with rms 0 stays at rest; the others have the same signals as if it did not.

    Parameters
    ----------
    given
        Parameter values of the node `excitation`.

    Raises
    ------
    AbraceError
        If the parameters do not describe a possible signal.
    """
    rate, band = given.sample_rate, (given.band[0], given.band[1])
    each = list(given.rms) * groups if len(given.rms) == 1 else list(given.rms)
    if len(each) != groups or not any(each):
        raise AbraceError(
            f"rms {list(given.rms)} N: expected one value for all brace groups, or one for each of {groups}, "
            "and more than 0 for one group at least"
        )

    def of(group: int, rms: float) -> NDArray[np.float64]:
        if given.signal == "white_noise":
            return banded_noise(round(given.duration * rate), rate, band, rms, given.seed + group)
        return repeated_multisine(
            given.duration,
            given.period,
            rate,
            band,
            rms,
            given.seed,
            given.lines,
            share=(group, groups),
        )

    driven = {group: of(group, rms) for group, rms in enumerate(each) if rms}
    rest = np.zeros_like(next(iter(driven.values())))
    return np.column_stack([driven.get(group, rest) for group in range(groups)])
