# SPDX-License-Identifier: Apache-2.0
"""State-space models of transfer functions with a common denominator, and their superposition: Eqs. (3) to (7).

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

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, takes_models
from abrace_sysid.fitting.curve_fit import least_squares
from abrace_sysid.fitting.modal_states import modal_states
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


@takes_models
def unexplained(model: LinearModel, measured: FrequencyResponse) -> NDArray[np.float64]:
    """(channels,) rms of modelled minus measured response over the lines, as a share of the rms of the measured one.

    Parameters
    ----------
    model
        Continuous, with the input and outputs of `measured`.
    measured
        Transfer function as estimated, with hold and delays.
    """
    left_over = sampled_response(model.select(measured.outputs), measured) - measured.response
    return np.asarray(
        np.sqrt(np.mean(np.abs(left_over) ** 2, axis=0) / np.mean(np.abs(measured.response) ** 2, axis=0))
    )


@takes_models
def superpose(parts: Sequence[LinearModel], inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
    """Parallel connection z = z1 + z2 + ...: Eqs. (6) and (7).

    A part contributes zero for those of the `inputs` and `outputs` that it lacks.

    Raises
    ------
    AbraceError
        If two parts have different delays for the same input.
    """
    a = linalg.block_diag(*(part.a for part in parts))
    b, c = np.zeros((len(a), len(inputs))), np.zeros((len(outputs), len(a)))
    d = np.zeros((len(outputs), len(inputs)))
    delay: dict[str, float] = {}
    start = 0
    for part in parts:
        states = slice(start, start + part.order)
        rows = [outputs.index(name) for name in part.outputs]
        columns = [inputs.index(name) for name in part.inputs]
        b[states, columns] = part.b
        c[rows, states] = part.c
        d[np.ix_(rows, columns)] += part.d
        for name, seconds in zip(part.inputs, part.input_delay, strict=True):
            if delay.setdefault(name, seconds) != seconds:
                raise AbraceError(f"superposition: input {name} is delayed by {delay[name]} s and by {seconds} s")
        start += part.order
    return LinearModel(a, b, c, d, inputs, outputs, input_delay=tuple(delay.get(name, 0.0) for name in inputs))
