# SPDX-License-Identifier: Apache-2.0
"""State-space models of transfer functions with given poles: Eqs. (3) to (5), the numerators fitted to sampled data.

The poles determine A and B of the modal states. The numerators (order n = m) then are one row of C and D for each
output. These rows follow from a linear least-squares problem, like the upper half of Eq. (1), but well conditioned at
any order.

The rows are fitted with equal (absolute) weights, by the response of the *discretised* model with hold and delay, so
that the model predicts the measured samples. Relative weights would be worse: in closed loop z1, z2 and z3 nearly
cancel, and any inconsistency between them is amplified.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_sysid.fitting.curve_fit import least_squares
from abrace_sysid.spectra.frequency_response import FrequencyResponse, sampled_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def realize(
    measured: FrequencyResponse | Sequence[FrequencyResponse], poles: NDArray[np.complex128], delay: float = 0.0
) -> LinearModel:
    """The model with given poles that fits a measured transfer function best: Eq. (3), (4) or (5).

    Parameters
    ----------
    measured
        Transfer function as estimated, with hold and delay. Several of the same input and outputs are fitted together.
    poles
        [rad/s].
    delay
        Input delay [s]; the model has it as `input_delay`.

    Raises
    ------
    AbraceError
        If the responses differ in input or outputs.
    """
    responses = (measured,) if isinstance(measured, FrequencyResponse) else tuple(measured)
    name, outputs = responses[0].input, responses[0].outputs
    for other in responses[1:]:
        if (other.input, other.outputs) != (name, outputs):
            raise AbraceError(
                f"realisation: responses of {', '.join(other.outputs)} to {other.input} and of {', '.join(outputs)} "
                f"to {name}, expected the same input and outputs"
            )
    states = modal_states(poles, name, delay)
    basis = np.vstack([sampled_response(states, response) for response in responses])
    rows = least_squares(basis, np.vstack([response.response for response in responses])).T
    return replace(states, c=rows[:, :-1], d=rows[:, -1:], outputs=outputs)


def modal_states(poles: NDArray[np.complex128], input_name: str, delay: float = 0.0) -> LinearModel:
    """A model whose outputs are its own modal states and, last, the (delayed) input itself.

    Parameters
    ----------
    input_name
    poles
        [rad/s], real or in conjugate pairs, all distinct.
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
