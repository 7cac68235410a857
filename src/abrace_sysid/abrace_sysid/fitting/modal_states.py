# SPDX-License-Identifier: Apache-2.0
"""Modal states: the states of a model with given poles and unknown residues.

Each pole pair has a real 2 x 2 block, [[re, im], [-im, re]], driven through its first state, and each real pole has one
state. Their responses and the input itself are the columns of a linear least-squares problem for the residues.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray


def modal_states(poles: NDArray[np.complex128], input_name: str, delay: float = 0.0) -> LinearModel:
    """A model whose outputs are its own modal states and, last, the (delayed) input itself.

    Parameters
    ----------
    poles
        [rad/s], real or in conjugate pairs, all distinct.
    input_name
        Name of the input.
    delay
        Delay of the input [s].
    """
    blocks: list[NDArray[np.float64]] = []
    drive: list[float] = []
    for pole in poles:
        if pole.imag > 0:
            blocks.append(np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]))
            drive += [1.0, 0.0]
        elif pole.imag == 0:
            blocks.append(np.array([[pole.real]]))
            drive.append(1.0)
    a = linalg.block_diag(*blocks)
    n = len(a)
    if n != len(poles):
        raise AbraceError(f"modal states: {len(poles)} poles make {n} states, expected conjugate pairs")
    c, d = np.vstack([np.eye(n), np.zeros((1, n))]), np.vstack([np.zeros((n, 1)), np.ones((1, 1))])
    names = (*(f"state{i + 1}" for i in range(n)), "direct")
    return LinearModel(a, np.array(drive)[:, None], c, d, (input_name,), names, input_delay=(delay,))
