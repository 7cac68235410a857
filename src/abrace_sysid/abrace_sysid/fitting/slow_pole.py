# SPDX-License-Identifier: Apache-2.0
"""The slow real pole of the servo's integral action, which curve fits of accelerations miss.

This pole is visible in the brace forces of the table test, under zero command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from abrace_sysid.fitting.curve_fit import least_squares
from abrace_sysid.fitting.modal_states import modal_states
from abrace_sysid.spectra.frequency_response import sampled_response

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.spectra.frequency_response import FrequencyResponse


def slow_real_pole(measured: FrequencyResponse, poles: NDArray[np.complex128]) -> float | None:
    """The real pole that explains most of the residual of known poles: that of the servo's integral action.

    Use the table test: over a wide band a real pole would compensate errors of the model class at high frequency.

    Parameters
    ----------
    measured
        Response to one input; the brace forces should be among its channels.
    poles
        The known poles [rad/s]; those beyond the response's band are left out.

    Returns
    -------
    float or None
        [rad/s], negative. None if no pole within the band lowers the error by more than its coefficients would by
        chance (Schwarz 1978).
    """
    known = poles[np.abs(poles) <= measured.omega[-1]]
    noise = np.sqrt(np.mean(measured.sigma**2, axis=0))
    noise = np.maximum(noise, 1e-9 * np.sqrt(np.mean(np.abs(measured.response) ** 2, axis=0)))  # of exact responses

    def misfit(with_poles: NDArray[np.complex128]) -> float:
        basis = sampled_response(modal_states(with_poles, measured.input), measured)
        left_over = basis @ least_squares(basis, measured.response) - measured.response
        return float(np.log(np.sum(np.abs(left_over / noise) ** 2)))

    def misfit_of(exponent: float) -> float:
        return misfit(np.append(known, -np.exp(exponent)))

    bounds = np.log([measured.omega[0], measured.omega[-1]])
    best = optimize.minimize_scalar(misfit_of, bounds=tuple(bounds), method="bounded", options={"xatol": 1e-3})
    values, added = 2 * measured.response.size, len(measured.outputs) + 1
    at_an_end = min(best.x - bounds[0], bounds[1] - best.x) < 0.01
    if at_an_end or values * (misfit(known) - best.fun) < added * np.log(values):
        return None
    return -float(np.exp(best.x))
