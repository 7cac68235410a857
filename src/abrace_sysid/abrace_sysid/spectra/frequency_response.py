# SPDX-License-Identifier: Apache-2.0
"""A measured transfer function with its uncertainty: the curves of Figs. 3 to 5.

It is the response of the *sampled* rig: from an input's value at each sample (a command held until the next, a ground
acceleration linear in between) to the recorded outputs. So a continuous model is sampled in the same way before it is
compared with it, and fits of continuous models remove hold and delay first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.discretization import HOLDS, discretize
from abrace_core.linear_model import takes_models

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.discretization import Hold
    from abrace_core.linear_model import LinearModel
    from abrace_sysid.spectra.distortion import Distortion
    from abrace_sysid.spectra.holds import InputHold


@dataclass(frozen=True)
class FrequencyResponse:
    """A measured transfer function from one input to several outputs.

    Parameters
    ----------
    input
        Name of the input.
    outputs
        Names of the outputs.
    omega
        (lines,) [rad/s], rising.
    response
        (lines, channels) complex, of the sampled rig: hold and delays included.
    sigma
        (lines, channels) standard deviation of `response`.
    sample_period
        Seconds.
    method
        Description of the estimation method.
    hold
        How the input moves between samples; None: as the rig's of that name does.
    distortion
        Levels of nonlinear distortion, from a multisine; None: not known.
    """

    input: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    sigma: NDArray[np.float64]
    sample_period: float
    method: str
    hold: InputHold | None = None
    distortion: Distortion | None = None

    @property
    def held(self) -> InputHold:
        """How the input moves between samples."""
        return self.hold or HOLDS.get(self.input, "zero")

    def select(self, outputs: Sequence[str]) -> FrequencyResponse:
        """The same estimate with only these outputs, in this order."""
        columns = [self.outputs.index(name) for name in outputs]
        return replace(
            self,
            outputs=tuple(outputs),
            response=self.response[:, columns],
            sigma=self.sigma[:, columns],
            distortion=None if self.distortion is None else self.distortion.select(columns),
        )

    def without_hold(self, delay: float = 0.0) -> FrequencyResponse:
        """The response with the hold of its input and a known `delay` [s] taken out."""
        factor = hold_and_delay(self.omega, self.sample_period, HOLDS.get(self.input, "zero"), delay)
        size = np.abs(factor)[:, None]
        return replace(self, response=self.response / factor[:, None], sigma=self.sigma / size, distortion=None)


def hold_and_delay(
    omega: NDArray[np.float64], sample_period: float, hold: Hold, delay: float = 0.0
) -> NDArray[np.complex128]:
    """(lines,) the factor of hold and delay in a response far below half the sample rate (Franklin et al. 1998, ch. 6).

    Parameters
    ----------
    omega
        (lines,) [rad/s].
    sample_period
        Seconds.
    hold
        "zero": half a sample late; "first": not late.
    delay
        Further delay [s].
    """
    sinc = np.sinc(omega * sample_period / (2 * np.pi))
    if hold == "first":
        return np.asarray(sinc**2 * np.exp(-1j * omega * delay))
    return np.asarray(sinc * np.exp(-1j * omega * (delay + sample_period / 2)))


@takes_models
def sampled_response(model: LinearModel, measured: FrequencyResponse) -> NDArray[np.complex128]:
    """(lines, model's outputs) response of a continuous model, sampled as a measured one was, hold and delay included.

    Parameters
    ----------
    model
        With the input of `measured` among its inputs.
    measured
        Whose input, lines and sample period are used.
    """
    if measured.held == "band":
        return model.select(inputs=[measured.input]).frequency_response(measured.omega)[:, :, 0]
    sampled = discretize(model.select(inputs=[measured.input]), measured.sample_period)
    return sampled.frequency_response(measured.omega)[:, :, 0]
