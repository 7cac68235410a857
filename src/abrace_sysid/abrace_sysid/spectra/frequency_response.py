# SPDX-License-Identifier: Apache-2.0
"""A measured transfer function with its uncertainty: the curves of Figs. 3 to 5.

It is the response of the *sampled* rig, from the input's values at the samples to the recorded outputs. A command is
held until the next sample; a ground acceleration is linear between samples. So a continuous model is discretised in the
same way before it is compared, and fits of continuous models first remove hold and delay.
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
        Behaviour of the input between samples; None: that of the rig's input with this name.
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
        """Behaviour of the input between samples."""
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
        """The response with the effect of the input's hold and of a known `delay` [s] removed."""
        factor = hold_and_delay(self.omega, self.sample_period, HOLDS.get(self.input, "zero"), delay)
        size = np.abs(factor)[:, None]
        return replace(self, response=self.response / factor[:, None], sigma=self.sigma / size, distortion=None)


def hold_and_delay(
    omega: NDArray[np.float64], sample_period: float, hold: Hold, delay: float = 0.0
) -> NDArray[np.complex128]:
    """(lines,) factor of hold and delay in the response, for frequencies far below half the sample rate.

    Discrete equivalents: Franklin et al. 1998, ch. 6.

    Parameters
    ----------
    omega
        (lines,) [rad/s].
    sample_period
        Seconds.
    hold
        "zero": a zero-order hold, half a sample of delay; "first": linear interpolation, no delay.
    delay
        Further delay [s].
    """
    sinc = np.sinc(omega * sample_period / (2 * np.pi))
    if hold == "first":
        return np.asarray(sinc**2 * np.exp(-1j * omega * delay))
    return np.asarray(sinc * np.exp(-1j * omega * (delay + sample_period / 2)))


@takes_models
def sampled_response(model: LinearModel, measured: FrequencyResponse) -> NDArray[np.complex128]:
    """(lines, model's outputs) response of a continuous model, discretised as the measured one, with hold and delay.

    Parameters
    ----------
    model
        Continuous; its inputs include the input of `measured`.
    measured
        Measured response; its input, lines and sample period are used.
    """
    if measured.held == "band":
        return model.select(inputs=[measured.input]).frequency_response(measured.omega)[:, :, 0]
    sampled = discretize(model.select(inputs=[measured.input]), measured.sample_period)
    return sampled.frequency_response(measured.omega)[:, :, 0]
