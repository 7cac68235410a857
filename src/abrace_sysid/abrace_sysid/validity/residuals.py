# SPDX-License-Identifier: Apache-2.0
"""Residuals of the model in a test, line by line, compared with the sensors' noise.

The model is simulated with the measured inputs. The leakage of the record's ends, a transient with the model's poles,
is fitted. Noise explains a part of the residual: the noise of the output sensors, and that of the table's
accelerometer, which acts through the structure. Both levels are estimated from the record above the excited band. The
model does not describe the rest. If the rest depends linearly on the input, the model lacks dynamics (a mode, a delay);
if not, the rig is nonlinear (Pintelon and Schoukens 2012, ch. 4; Ljung 1999, sec. 16.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats
from scipy.ndimage import uniform_filter1d

from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import takes_models
from abrace_sysid.fitting.curve_fit import stacked, triangular_factor
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.pole_basis import forced, transients
from abrace_sysid.spectra.frequency_response import sampled_response
from abrace_sysid.validity.motion import BANDS, noise_level

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.recorded.test import Test
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

SMOOTHED = 41
"""Number of lines over which the noise power of a periodic test is averaged."""

HALF_WIDTH = 10
"""Half-width [lines] of the windows in which the residual over the input is taken as a straight line over frequency."""


@dataclass(frozen=True)
class Residual:
    """The residual of a model in one test.

    Parameters
    ----------
    test
        The lines of the test; `transient`: of noise, whose phases are random from line to line.
    left
        (lines, channels) spectra of the residual, measured minus modelled.
    noise
        (lines, channels) expected power of the residual due to sensor noise.
    poles
        Poles of the model [rad/s].
    """

    test: Observation
    left: NDArray[np.complex128]
    noise: NDArray[np.float64]
    poles: NDArray[np.complex128]

    @property
    def ratio(self) -> NDArray[np.float64]:
        """(lines, channels) power of the residual over that due to noise; its mean is 1 for a correct model."""
        return np.asarray(np.abs(self.left) ** 2 / self.noise)

    @property
    def excess(self) -> NDArray[np.float64]:
        """(channels,) rms of the residual, noise subtracted, as a share of the response's rms."""
        beyond = np.mean(np.abs(self.left) ** 2 - self.noise, axis=0)
        return np.asarray(np.sqrt(np.maximum(beyond, 0) / np.mean(np.abs(self.test.measured) ** 2, axis=0)))

    @property
    def probability(self) -> NDArray[np.float64]:
        """(channels,) probability of such a residual by noise alone (chi-square, two degrees of freedom a line)."""
        lines = len(self.test.omega)
        return np.asarray(stats.chi2.sf(2 * np.sum(self.ratio, axis=0), 2 * lines))

    def whiteness(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Bartlett's test (1955) of whether the residual, normalised by its noise, is spread evenly over the band.

        Returns
        -------
        distance, frequency
            (channels,) greatest distance of the cumulative periodogram from a straight line, times the square root of
            the number of lines; and the frequency at which it rises fastest [rad/s].
        """
        cumulative = np.cumsum(self.ratio, axis=0) / np.sum(self.ratio, axis=0)
        lines = len(self.test.omega)
        distance = np.abs(cumulative - np.arange(1, lines + 1)[:, None] / lines).max(axis=0) * np.sqrt(lines)
        width = min(2 * HALF_WIDTH + 1, lines)
        sums = np.apply_along_axis(np.convolve, 0, self.ratio, np.ones(width), "same")
        return distance, self.test.omega[np.argmax(sums, axis=0)]


@dataclass(frozen=True)
class Dependence:
    """The linear dependence of a residual on the input.

    Parameters
    ----------
    omega
        (windows,) [rad/s], middle of each window.
    probability
        (windows, channels) probability that noise alone shows as much dependence (F test).
    total
        (channels,) rms of the part that depends on the input, over the response's rms.
    """

    omega: NDArray[np.float64]
    probability: NDArray[np.float64]
    total: NDArray[np.float64]


@takes_models
def residual_of(test: Test, inputs: tuple[str, ...], model: LinearModel, band: tuple[float, float]) -> Residual:
    """The residual of `model` in a test with noise.

    Parameters
    ----------
    test
        The test, trends removed.
    inputs
        Names of all inputs that were excited.
    model
        Continuous, stable.
    band
        [Hz].
    """
    outputs = model.outputs
    lines = Observation.of_test(test, inputs, band, outputs)
    sampled = discretize(model.select(inputs=inputs), test.sample_period).frequency_response(lines.omega)
    left = lines.measured - np.einsum("lom,lm->lo", sampled, lines.excitation)
    power = np.tile(noise_level(test, outputs, band[1]) ** 2, (len(left), 1))
    if signals.GROUND in inputs:
        passed = np.abs(sampled[:, :, inputs.index(signals.GROUND)]) ** 2
        power = power + passed * noise_level(test, [signals.GROUND], band[1]) ** 2
    return Residual(lines, _without_transient(left, lines, model, np.sqrt(power)), power, model.poles)


@takes_models
def residual_of_data(test: Test, model: LinearModel, band: tuple[float, float]) -> Residual:
    """The residual of `model` in measured data, which may be excited up to half the sample rate.

    No part of such a record contains only noise. So the noise level is that of the residual in the fifth of the band in
    which the residual is least.

    Parameters
    ----------
    test
    model
        Continuous, stable.
    band
        [Hz].
    """
    lines = Observation.of_test(test, model.inputs, band, model.outputs)
    whole = model if test.hold == "band" else discretize(model, test.sample_period, test.holds)
    left = lines.measured - np.einsum("lom,lm->lo", whole.frequency_response(lines.omega), lines.excitation)
    even = np.ones(left.shape)
    left = _without_transient(left, lines, model, even)
    parts = np.array_split(np.abs(left) ** 2, BANDS)
    noise = even * np.min([np.mean(part, axis=0) for part in parts], axis=0)
    return Residual(lines, left, noise, model.poles)


@takes_models
def residual_of_response(measured: FrequencyResponse, model: LinearModel, source: str) -> Residual:
    """The residual of a model in a transfer function from a periodic test.

    Parameters
    ----------
    source
    measured
        The transfer function, with its standard deviations.
    model
        Continuous.
    """
    left = measured.response - sampled_response(model.select(measured.outputs), measured)
    # a few periods give a poor estimate of one line's noise: average over neighbouring lines
    noise = uniform_filter1d(measured.sigma**2, min(SMOOTHED, len(left)), axis=0, mode="nearest")
    return Residual(Observation.of_response(measured, source), left, noise, model.poles)


def _without_transient(
    left: NDArray[np.complex128], lines: Observation, model: LinearModel, level: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """The residual after subtraction of the leakage, fitted as a transient with the model's poles."""
    poles = model.poles
    shown = poles[(poles.imag > 0) | ((poles.imag == 0) & (np.abs(poles) < lines.omega[-1]))]
    constant = np.ones(len(left), dtype=np.complex128)
    basis = np.column_stack([constant, *transients(shown, lines.z, lines.samplings[0])])
    found = np.empty_like(left)
    for j, column in enumerate(left.T):
        both = np.column_stack([basis, column]).astype(np.complex128) / level[:, j, None]
        triangle = triangular_factor(stacked(both))
        scale = np.linalg.norm(triangle[:-1, :-1], axis=0)
        solved = np.linalg.lstsq(triangle[:-1, :-1] / scale, triangle[:-1, -1], rcond=None)[0] / scale
        found[:, j] = column - basis @ solved
    return found


def dependence(residual: Residual) -> Dependence:
    """Test the dependence of a residual on the input: a straight line over frequency times the input in each window."""
    inputs = residual.test.excitation.shape[1]
    half = max(HALF_WIDTH, 4 * (inputs + 1))
    width = 2 * half + 1
    starts = np.arange(0, len(residual.test.omega) - width + 1, half)
    index = starts[:, None] + np.arange(width)
    along = np.linspace(-1, 1, width)[None, :, None]
    excited = residual.test.excitation[index]
    smooth = np.broadcast_to(np.ones((1, width, 1), dtype=np.complex128), (len(starts), width, 1))
    leaked = np.concatenate([smooth, along * smooth], axis=2)
    both = np.concatenate([leaked, excited, along * excited], axis=2)
    left = residual.left[index]

    def rest(columns: NDArray[np.complex128]) -> NDArray[np.complex128]:
        q = np.linalg.qr(columns)[0]
        return np.asarray(left - q @ (q.conj().transpose(0, 2, 1) @ left))

    without, with_input = (np.sum(np.abs(rest(columns)) ** 2, axis=1) for columns in (leaked, both))
    more, free = 4 * inputs, 2 * (width - 2 - 2 * inputs)
    explained = without - with_input
    ratio = explained / more / np.maximum(with_input / free, np.finfo(float).tiny)
    size = np.sum(np.abs(residual.test.measured[index]) ** 2, axis=1)
    # subtract the part that would be explained if the residual were noise
    beyond = np.maximum(explained - more * with_input / free, 0)
    total = np.sqrt(beyond.sum(axis=0) / size.sum(axis=0))
    return Dependence(residual.test.omega[starts + half], stats.f.sf(ratio, more, free), np.asarray(total))


def by_own_modes(residual: Residual) -> NDArray[np.float64]:
    """(channels,) share of the residual beyond noise that responses of the model's modes explain.

    The size of each mode's response to each input is fitted freely in each channel. If the model of a linear rig has
    the right poles but wrong shapes, signs or delays, this explains most of the residual; of a residual due to friction
    it explains little.

    Parameters
    ----------
    residual
        Residual of a test.
    """
    omega, driven = residual.test.omega, residual.test.excitation
    poles = residual.poles[residual.poles.imag >= 0]
    states = forced(poles, residual.test.z, residual.test.samplings, driven)
    basis = np.column_stack([driven, 1j * omega[:, None] * driven, *states])
    shares = []
    for left, noise in zip(residual.left.T, residual.noise.T, strict=True):
        weight = 1 / np.sqrt(noise)
        weighted = basis * weight[:, None]
        own = left * weight
        # the last column of R has the projection on all columns before it
        both = np.column_stack([weighted / np.linalg.norm(weighted, axis=0), own])
        triangle = np.asarray(np.linalg.qr(both, mode="r"))
        explained = float(np.sum(np.abs(triangle[:-1, -1]) ** 2)) - weighted.shape[1]
        shares.append(explained / max(float(np.sum(np.abs(own) ** 2)) - len(own), 1e-12))
    return np.clip(shares, 0, 1)
