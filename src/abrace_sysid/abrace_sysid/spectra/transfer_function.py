"""A measured transfer function, with its uncertainty, and what is known beforehand taken out of it: hold and delay.

The curves of Figs. 3 to 5. What is measured is the response of the *sampled* rig: from an input's value at each sample
(a command held until the next, a ground acceleration linear in between) to the recorded outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.discretization import Hold


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
        How it was estimated, in words.
    coherence
        (lines, channels) from 0 to 1: the share of each output's power that the input explains.
    """

    input: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    sigma: NDArray[np.float64]
    sample_period: float
    method: str
    coherence: NDArray[np.float64] | None = None

    def select(self, outputs: Sequence[str]) -> FrequencyResponse:
        """The same estimate with only these outputs, in this order."""
        columns = [self.outputs.index(name) for name in outputs]
        return replace(
            self,
            outputs=tuple(outputs),
            response=self.response[:, columns],
            sigma=self.sigma[:, columns],
            coherence=None if self.coherence is None else self.coherence[:, columns],
        )

    def divided_by(self, factor: NDArray[np.complex128]) -> FrequencyResponse:
        """The response with a known factor (lines,), such as a hold's, taken out."""
        return replace(self, response=self.response / factor[:, None], sigma=self.sigma / np.abs(factor)[:, None])

    def without_hold(self, hold: Hold, delay: float = 0.0) -> FrequencyResponse:
        """The response with the hold of its input and a known delay [s] taken out."""
        return self.divided_by(hold_and_delay(self.omega, self.sample_period, hold, delay))


def hold_and_delay(
    omega: NDArray[np.float64], sample_period: float, hold: Hold, delay: float = 0.0
) -> NDArray[np.complex128]:
    """(lines,) what a held input and a delay do to a slow enough response (Franklin, Powell and Workman 1998, ch. 6).

    Parameters
    ----------
    omega
        (lines,) [rad/s].
    sample_period
        Seconds.
    hold
        "zero": constant until the next sample, half a sample late; "first": linear in between, not late.
    delay
        Further delay [s].
    """
    sinc = np.sinc(omega * sample_period / (2 * np.pi))
    if hold == "zero":
        return np.asarray(sinc * np.exp(-1j * omega * (delay + sample_period / 2)))
    if hold == "first":
        return np.asarray(sinc**2 * np.exp(-1j * omega * delay))
    raise AbraceError(f"hold {hold!r}, expected 'zero' or 'first'")


def fitted_delay(response: FrequencyResponse, output: str, band: tuple[float, float]) -> tuple[float, float]:
    """Delay [s] of an output and its standard deviation, from the phase where the gain tends to a positive constant.

    Made for the actuator's force over the command at the high end of the band. There the mass that it pushes answers
    with a phase that falls as 1/omega: the phase is fitted by -omega delay + b / omega, weighted by its uncertainty.
    A held first-order lag tau that is sampled itself, as the force is, shows T / (1 - exp(-T / tau)), not T / 2 + tau.
    The standard deviation is the noise's; modes within the band cost some 0.3 % beside it.

    Parameters
    ----------
    response
        The transfer function; its hold is part of the delay unless it was taken out.
    output
        Name of the output.
    band
        Lowest and highest frequency [Hz] of the lines that are used.

    Raises
    ------
    AbraceError
        If the band has fewer than 10 lines.
    """
    omega = response.omega
    inside = (omega >= 2 * np.pi * band[0]) & (omega <= 2 * np.pi * band[1])
    if np.count_nonzero(inside) < 10:
        raise AbraceError(
            f"delay of {output} from {response.input}: fewer than 10 lines from {band[0]:g} to {band[1]:g} Hz"
        )
    column = response.outputs.index(output)
    omega, g, sigma = omega[inside], response.response[inside, column], response.sigma[inside, column]
    weight = np.abs(g) / sigma
    regressors = np.column_stack([-omega, 1 / omega])
    scale = np.linalg.norm(regressors, axis=0)
    weighted = weight[:, None] * regressors / scale
    inverse = np.linalg.inv(weighted.T @ weighted)
    phase = np.unwrap(np.angle(g))
    solution = inverse @ (weighted.T @ (weight * phase))
    # the phase has half of the variance; what the model misses counts as noise
    left_over = weight * (phase - regressors / scale @ solution)
    variance = max(float(np.sum(left_over**2)) / (len(omega) - 2), 0.5)
    return float(solution[0] / scale[0]), float(np.sqrt(variance * inverse[0, 0]) / scale[0])
