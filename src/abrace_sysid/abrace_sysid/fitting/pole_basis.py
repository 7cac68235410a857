"""Responses of single poles as the sampled rig shows them: hold, delay and the transient of a finite record included.

A pole p answers an input u with the state dx/dt = p x + u. Between samples u is held (delayed or not) or linear, which
makes the state at the samples exactly

    x(z) = F_p(z) u(z) + z / (z - a) x_0 / sqrt(N),    a = exp(p T),

where the second term is what a discrete Fourier transform of N samples sees of the difference between the states at the
record's beginning and end: its leakage (Pintelon and Schoukens 2012, sec. 6.3.2). Both terms are exact, and analytic in
p, so that their derivatives are exact too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.discretization import Hold


@dataclass(frozen=True)
class Sampling:
    """How an input moves between samples.

    Parameters
    ----------
    sample_period
        T [s].
    hold
        "zero" (held) or "first" (linear).
    delay
        Of a held input [s].
    """

    sample_period: float
    hold: Hold = "zero"
    delay: float = 0.0

    def direct(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(lines,) response of the direct term at `z`: the (delayed) input as the samples show it."""
        whole, late = self._whole_and_late()
        return z ** -(whole + (late > 0))

    def response(
        self, pole: complex, z: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """F_p and its derivative with respect to p.

        Parameters
        ----------
        pole
            p [rad/s], not 0.
        z
            (lines,) exp(i w T).
        """
        period = self.sample_period
        a = np.exp(pole * period)
        step, step_slope = _step(pole, period)
        if self.hold == "first":
            ramp = (step - period) / (pole * period)
            ramp_slope = step_slope / (pole * period) - ramp / pole
            above = (step - ramp) + ramp * z
            above_slope = (step_slope - ramp_slope) + ramp_slope * z
        else:
            whole, late = self._whole_and_late()
            recent, recent_slope = _step(pole, (1 - late) * period)
            above = z**-whole * (recent + (step - recent) / z)
            above_slope = z**-whole * (recent_slope + (step_slope - recent_slope) / z)
        below = 1 / (z - a)
        response = above * below
        return response, (above_slope + period * a * response) * below

    def transient(
        self, pole: complex, z: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """z / (z - a) and its derivative with respect to p, arguments as in `response`: leakage of a `pole` at `z`."""
        a = np.exp(pole * self.sample_period)
        below = 1 / (z - a)
        response = z * below
        return response, self.sample_period * a * response * below

    def _whole_and_late(self) -> tuple[int, float]:
        """Whole samples of the delay, and the share of a sample beyond them."""
        whole, late = divmod(self.delay / self.sample_period, 1.0)
        if late > 1 - 1e-9:
            return int(whole) + 1, 0.0
        return int(whole), late if late > 1e-9 else 0.0


def _step(pole: complex, span: float) -> tuple[complex, complex]:
    """The state that a unit step leaves after `span` seconds, (exp(p span) - 1) / p, and its derivative with p."""
    step = np.expm1(pole * span) / pole
    return step, (span * np.exp(pole * span) - step) / pole
