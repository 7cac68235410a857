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

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.discretization import HOLDS, discretize
from abrace_core.model.linear_model import takes_models
from abrace_core.model.plotted import figure_of
from abrace_core.model.tabular import Tabular

if TYPE_CHECKING:
    from collections.abc import Sequence

    import control
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_core.model.discretization import Hold
    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.recorded.test import InputHold


@dataclass(frozen=True)
class FrequencyResponse(Tabular):
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
    """

    input: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    sigma: NDArray[np.float64]
    sample_period: float
    method: str
    hold: InputHold | None = None

    @property
    def held(self) -> InputHold:
        """Behaviour of the input between samples."""
        return self.hold or HOLDS.get(self.input, "zero")

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz]."""
        low, high = (self.omega[[0, -1]] / (2 * np.pi)).tolist()
        return low, high

    def __repr__(self) -> str:
        low, high = self.band
        return (
            f"<FrequencyResponse: {self.input} to {', '.join(self.outputs)}, {low:.3g} to {high:.3g} Hz, {self.method}>"
        )

    def select(self, outputs: Sequence[str]) -> FrequencyResponse:
        """The same estimate with only these outputs, in this order, in either form (`signals.positions`)."""
        columns = signals.positions(outputs, self.outputs, f"transfer functions from {self.input}: no output")
        return replace(
            self,
            outputs=tuple(self.outputs[i] for i in columns),
            response=self.response[:, columns],
            sigma=self.sigma[:, columns],
        )

    def without_hold(self, delay: float = 0.0) -> FrequencyResponse:
        """The response with the effect of the input's hold and of a known `delay` [s] removed."""
        factor = hold_and_delay(self.omega, self.sample_period, HOLDS.get(self.input, "zero"), delay)
        size = np.abs(factor)[:, None]
        return replace(self, response=self.response / factor[:, None], sigma=self.sigma / size)

    def to_pandas(self) -> pandas.DataFrame:
        """Real and imaginary part and standard deviation of each output, a row for each frequency [Hz]."""
        import pandas

        columns: dict[str, NDArray[np.float64]] = {}
        for name, response, sigma in zip(self.outputs, self.response.T, self.sigma.T, strict=True):
            columns |= {f"{name} real": response.real, f"{name} imaginary": response.imag, f"{name} deviation": sigma}
        return pandas.DataFrame(columns, index=pandas.Index(self.omega / (2 * np.pi), name="frequency [Hz]"))

    def to_control(self) -> control.FRD:
        """The response as python-control's FRD, its signals by their names; the noise is not in it."""
        import control

        response = self.response.T[:, None, :]
        names = {"inputs": [self.input], "outputs": list(self.outputs)}
        return control.FRD(response, self.omega, dt=self.sample_period, **names)

    def plot(self, channels: Sequence[str] = ()) -> Figure:
        """Amplitude and phase with the standard deviation.

        Parameters
        ----------
        channels
            Outputs to draw; none: all.
        """
        return figure_of(self, "plot", channels)


def mean_of(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """The mean of independent estimates of one transfer function, from periodic tests with other phases.

    Parameters
    ----------
    responses
        Of the same input and outputs, at the same frequencies.

    Raises
    ------
    AbraceError
        If the frequencies differ.
    """
    first = responses[0]
    if any(not np.array_equal(first.omega, other.omega) for other in responses):
        raise AbraceError(f"transfer functions from {first.input}: the tests excite other lines, expected one of them")
    if len(responses) == 1:
        return first
    count = len(responses)
    sigma = np.sqrt(np.sum([one.sigma**2 for one in responses], axis=0)) / count
    method = f"{first.method}, {count} tests"
    response = np.mean([one.response for one in responses], axis=0)
    return replace(first, response=response, sigma=sigma, method=method)


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
