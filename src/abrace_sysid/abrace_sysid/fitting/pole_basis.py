# SPDX-License-Identifier: Apache-2.0
"""Responses of single poles as the sampled rig shows them: hold and the transient of a finite record included.

The state of a pole p with input u obeys dx/dt = p x + u. Between samples u is held or linear, so that the state at the
samples is exactly

    x(z) = F_p(z) u(z) + z / (z - a) x_0 / sqrt(N),    a = exp(p T),

where the second term is the leakage of a discrete Fourier transform of N samples, from the difference x_0 between the
states at the record's ends (Pintelon and Schoukens 2012, sec. 6.3.2). Both terms are exact, and analytic in p, so that
their derivatives are exact too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import InputHold


@dataclass(frozen=True)
class Sampling:
    """How an input moves between samples.

    Parameters
    ----------
    sample_period
        T [s].
    hold
        "zero" (held), "first" (linear) or "band" (band-limited).
    """

    sample_period: float
    hold: InputHold = "zero"

    def response(
        self, pole: complex, z: NDArray[np.complex128], delay: float = 0.0
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """F_p and its derivative with respect to p.

        Parameters
        ----------
        pole
            p [rad/s], not 0.
        z
            (lines,) exp(i w T).
        delay
            Delay of a held input [s]; other inputs have none.
        """
        period = self.sample_period
        if delay:
            return self._delayed(pole, z, delay)
        if self.hold == "band":
            response = np.asarray(1 / (1j * np.angle(z) / period - pole), dtype=np.complex128)
            return response, response * response
        a = np.exp(pole * period)
        step, step_slope = _step(pole, period)
        below = 1 / (z - a)
        if self.hold == "zero":
            response = step * below
            return response, (step_slope + period * a * response) * below
        ramp = (step - period) / (pole * period)
        ramp_slope = step_slope / (pole * period) - ramp / pole
        response = ((step - ramp) + ramp * z) * below
        return response, ((step_slope - ramp_slope) + ramp_slope * z + period * a * response) * below

    def _delayed(
        self, pole: complex, z: NDArray[np.complex128], delay: float
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """`response` to a held input that changes within a sample period."""
        period = self.sample_period
        samples = whole_samples(delay, period)
        a, recent = np.exp(pole * period), (samples + 1) * period - delay
        before = np.exp(pole * recent)
        first, first_slope = _step(pole, recent)
        second = (a - before) / pole
        second_slope = (period * a - recent * before - second) / pole
        below, later = 1 / (z - a), z.conj()  # on the unit circle 1 / z
        response = (first + second * later) * below
        slope = (first_slope + second_slope * later + period * a * response) * below
        if samples:
            whole = z ** -float(samples)
            return response * whole, slope * whole
        return response, slope

    def transient(
        self, pole: complex, z: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """z / (z - a) and its derivative with respect to p, arguments as in `response`: leakage of a `pole` at `z`."""
        a = np.exp(pole * self.sample_period)
        below = 1 / (z - a)
        response = z * below
        return response, self.sample_period * a * response * below


def whole_samples(delay: float, period: float) -> int:
    """Number of whole sample periods of `period` [s] in a `delay` [s]."""
    return int(delay // period)


def _step(pole: complex, span: float) -> tuple[complex, complex]:
    """The state `span` seconds after a unit step, (exp(p span) - 1) / p, and its derivative with respect to p."""
    step = np.expm1(pole * span) / pole
    return step, (span * np.exp(pole * span) - step) / pole


def sides_of(pole: complex) -> tuple[complex, ...]:
    """The `pole` of a pair and its conjugate, or a real pole alone."""
    return (pole, pole.conjugate()) if pole.imag > 0 else (pole.real,)


def forced(
    poles: Sequence[complex] | NDArray[np.complex128],
    z: NDArray[np.complex128],
    samplings: Sequence[Sampling],
    excitation: NDArray[np.complex128],
    delays: Sequence[float] | NDArray[np.float64] | None = None,
) -> list[NDArray[np.complex128]]:
    """The states of the poles under each input alone, as columns (lines,) with real coefficients: two of a pair.

    Parameters
    ----------
    poles
        [rad/s], of each pair the one above the real axis, and real ones.
    z
        (lines,) exp(i w T).
    samplings, excitation
        How each input moves between samples, and (lines, inputs) spectra of the inputs.
    delays
        (inputs,) [s]; None: none.
    """
    columns, later = [], np.zeros(len(samplings)) if delays is None else delays
    for pole in poles:
        for sampling, drive, delay in zip(samplings, excitation.T, later, strict=True):
            sides = [(drive * sampling.response(side, z, delay)[0])[:, None] for side in sides_of(pole)]
            columns += combined(sides, np.ones(1))
    return columns


def transients(
    poles: Sequence[complex] | NDArray[np.complex128], z: NDArray[np.complex128], sampling: Sampling
) -> list[NDArray[np.complex128]]:
    """The leakage of the poles, as columns (lines,) with real coefficients: two of a pair.

    Parameters
    ----------
    poles, z
        As for `forced`.
    sampling
        Of any input; its sample period is used.
    """
    columns = []
    for pole in poles:
        columns += combined([sampling.transient(side, z)[0][:, None] for side in sides_of(pole)], np.ones(1))
    return columns


def combined(sides: Sequence[NDArray[np.complex128]], vector: NDArray[Any]) -> list[NDArray[np.complex128]]:
    """Two real combinations of the responses (lines, inputs) of both `sides` of a pair, weighted by a `vector`.

    A real pole has one side and one combination.
    """
    if len(sides) == 1:
        return [sides[0] @ vector]
    above, below = sides[0] @ vector, sides[1] @ vector.conj()
    return [(above + below) / 2, (above - below) * 0.5j]
