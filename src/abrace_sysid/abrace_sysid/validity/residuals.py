# SPDX-License-Identifier: Apache-2.0
"""Residuals of the model in a test, line by line, compared with the sensors' noise.

The model is simulated with the measured inputs; the leakage of the record's ends, a transient with the model's
own poles, is fitted. Noise explains a part of the residual: that of the outputs' sensors and, through the structure, of
the table's; their levels are read from the record above the excited band. The rest is not described by the model. If it
depends linearly on the input it is dynamics that the model lacks (a mode, a delay); if not, the rig is not linear
(Pintelon and Schoukens 2012, ch. 4; Ljung 1999, sec. 16.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats
from scipy.ndimage import uniform_filter1d

from abrace_core import signals
from abrace_core.discretization import discretize
from abrace_core.linear_model import takes_models
from abrace_sysid.fitting.pole_basis import Sampling
from abrace_sysid.spectra.fourier import spectra_of
from abrace_sysid.spectra.frequency_response import sampled_response
from abrace_sysid.validity.motion import BANDS, noise_level

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_core.run import Run
    from abrace_sysid.measured_data import MeasuredData
    from abrace_sysid.spectra.frequency_response import FrequencyResponse
    from abrace_sysid.spectra.holds import InputHold

SMOOTHED = 41
"""Lines over which the deviations of a periodic test are averaged."""

HALF_WIDTH = 10
"""Lines to each side in which the residual's dependence on the input is one straight line over frequency."""


@dataclass(frozen=True)
class Residual:
    """What a model leaves over of one test.

    Parameters
    ----------
    source
        The test.
    inputs, outputs
        Names.
    omega
        (lines,) [rad/s].
    excitation
        (lines, inputs) spectra of what was excited; ones where `measured` is a transfer function.
    measured, left
        (lines, channels) spectra, and what the model leaves of them.
    noise
        (lines, channels) expected power of what sensors' noise leaves.
    sample_period
        Seconds.
    poles
        Of the model [rad/s].
    holds
        How each input moves between samples.
    excited
        Whether the spectra are those of noise, whose phases are random from line to line.
    """

    source: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    excitation: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    left: NDArray[np.complex128]
    noise: NDArray[np.float64]
    sample_period: float
    poles: NDArray[np.complex128]
    holds: tuple[InputHold, ...]
    excited: bool = True

    @property
    def ratio(self) -> NDArray[np.float64]:
        """(lines, channels) power of the residual over what noise leaves; 1 on the mean of a true model."""
        return np.asarray(np.abs(self.left) ** 2 / self.noise)

    @property
    def excess(self) -> NDArray[np.float64]:
        """(channels,) residual beyond noise, rms, as a share of the response's."""
        beyond = np.mean(np.abs(self.left) ** 2 - self.noise, axis=0)
        return np.asarray(np.sqrt(np.maximum(beyond, 0) / np.mean(np.abs(self.measured) ** 2, axis=0)))

    @property
    def probability(self) -> NDArray[np.float64]:
        """(channels,) that noise alone leaves as much: of a chi-square with two degrees of freedom a line."""
        lines = len(self.omega)
        return np.asarray(stats.chi2.sf(2 * np.sum(self.ratio, axis=0), 2 * lines))

    def whiteness(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Bartlett's test (1955): whether the residual, over its noise, is spread evenly over the band.

        Returns
        -------
        distance, frequency
            (channels,) greatest distance of the cumulative periodogram from a straight line, times the root of the
            lines; and where it rises fastest [rad/s].
        """
        cumulative = np.cumsum(self.ratio, axis=0) / np.sum(self.ratio, axis=0)
        lines = len(self.omega)
        distance = np.abs(cumulative - np.arange(1, lines + 1)[:, None] / lines).max(axis=0) * np.sqrt(lines)
        width = min(2 * HALF_WIDTH + 1, lines)
        sums = np.apply_along_axis(np.convolve, 0, self.ratio, np.ones(width), "same")
        return distance, self.omega[np.argmax(sums, axis=0)]


@dataclass(frozen=True)
class Dependence:
    """How far a residual follows the input.

    Parameters
    ----------
    omega
        (windows,) [rad/s], middle of each window.
    probability
        (windows, channels) that noise shows as much dependence (F test).
    share
        (windows, channels) rms of what follows the input, over that of the response in the window.
    total
        (channels,) the same over the band.
    """

    omega: NDArray[np.float64]
    probability: NDArray[np.float64]
    share: NDArray[np.float64]
    total: NDArray[np.float64]


@takes_models
def residual_of(run: Run, inputs: tuple[str, ...], model: LinearModel, band: tuple[float, float]) -> Residual:
    """What `model` leaves over of a test with noise.

    Parameters
    ----------
    run
        The test, without trends.
    inputs
        Names of all inputs that were excited.
    model
        Continuous, stable.
    band
        [Hz].
    """
    outputs = model.outputs
    spectra = spectra_of(run, inputs, band).select(outputs)
    sampled = discretize(model.select(inputs=inputs), run.sample_period).frequency_response(spectra.omega)
    left = spectra.outputs_spectrum - np.einsum("lom,lm->lo", sampled, spectra.excitation)
    level = {name: noise_level(run.channels([name])[:, 0], run.sample_period, band[1]) for name in outputs}
    power = np.tile(np.array([level[name] ** 2 for name in outputs]), (len(left), 1))
    if signals.GROUND in inputs:
        passed = np.abs(sampled[:, :, inputs.index(signals.GROUND)]) ** 2
        power = power + passed * noise_level(run.ground_acceleration, run.sample_period, band[1]) ** 2
    left = _without_transient(left, spectra.omega, model, run.sample_period, np.sqrt(power))
    measured, period, poles = spectra.outputs_spectrum, run.sample_period, _poles(model)
    lines, excitation, holds = spectra.omega, spectra.excitation, spectra.holds
    return Residual(run.source, inputs, outputs, lines, excitation, measured, left, power, period, poles, holds)


@takes_models
def residual_of_data(data: MeasuredData, model: LinearModel, band: tuple[float, float]) -> Residual:
    """What `model` leaves over of measured data, which may be excited up to half the sample rate.

    No part of such a record is noise alone. Its level is taken from the fifth of the band in which least is left over.

    Parameters
    ----------
    data
        The test.
    model
        Continuous, stable.
    band
        [Hz].
    """
    spectra = spectra_of(data, model.inputs, band).select(model.outputs)
    whole = model if data.hold == "band" else discretize(model, data.sample_period)
    modelled = np.einsum("lom,lm->lo", whole.frequency_response(spectra.omega), spectra.excitation)
    even = np.ones(modelled.shape)
    left = spectra.outputs_spectrum - modelled
    left = _without_transient(left, spectra.omega, model, data.sample_period, even)
    parts = np.array_split(np.abs(left) ** 2, BANDS)
    noise = even * np.min([np.mean(part, axis=0) for part in parts], axis=0)
    return Residual(
        data.source,
        model.inputs,
        model.outputs,
        spectra.omega,
        spectra.excitation,
        spectra.outputs_spectrum,
        left,
        noise,
        data.sample_period,
        _poles(model),
        spectra.holds,
    )


@takes_models
def residual_of_response(measured: FrequencyResponse, model: LinearModel, source: str) -> Residual:
    """What a model leaves over of a transfer function, of a periodic test.

    Parameters
    ----------
    measured
        With its standard deviations.
    model
        Continuous.
    source
        Name of the test.
    """
    left = measured.response - sampled_response(model.select(measured.outputs), measured)
    # a few periods tell little of one line's deviation, and more of its neighbours'
    noise = uniform_filter1d(measured.sigma**2, min(SMOOTHED, len(left)), axis=0, mode="nearest")
    ones, inputs = np.ones((len(left), 1), dtype=np.complex128), (measured.input,)
    period, outputs, poles = measured.sample_period, measured.outputs, _poles(model)
    response, holds = measured.response, (measured.held,)
    return Residual(
        source, inputs, outputs, measured.omega, ones, response, left, noise, period, poles, holds, excited=False
    )


def _poles(model: LinearModel) -> NDArray[np.complex128]:
    return np.linalg.eigvals(model.a).astype(np.complex128)


def _without_transient(
    left: NDArray[np.complex128],
    omega: NDArray[np.float64],
    model: LinearModel,
    sample_period: float,
    level: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """The residual without the leakage that a transient with the model's own poles makes."""
    z, columns = np.exp(1j * omega * sample_period), [np.ones(len(omega), dtype=np.complex128)]
    sampling = Sampling(sample_period)
    for pole in np.linalg.eigvals(model.a):
        if pole.imag > 0:
            one, other = (sampling.transient(p, z)[0] for p in (pole, pole.conjugate()))
            columns += [one + other, 1j * (one - other)]
        elif pole.imag == 0 and abs(pole) < omega[-1]:
            columns.append(sampling.transient(complex(pole), z)[0])
    basis = np.column_stack(columns)
    found = np.empty_like(left)
    for j, column in enumerate(left.T):
        weighted, values = basis / level[:, j, None], column / level[:, j]
        both = np.vstack([weighted.real, weighted.imag])
        scale = np.linalg.norm(both, axis=0)
        solved = np.linalg.lstsq(both / scale, np.concatenate([values.real, values.imag]), rcond=None)[0] / scale
        found[:, j] = column - basis @ solved
    return found


def dependence(residual: Residual) -> Dependence:
    """Whether a residual follows the input: in each window of lines a straight line over frequency, against noise."""
    inputs = residual.excitation.shape[1]
    half = max(HALF_WIDTH, 4 * (inputs + 1))
    width = 2 * half + 1
    starts = np.arange(0, len(residual.omega) - width + 1, half)
    index = starts[:, None] + np.arange(width)
    along = np.linspace(-1, 1, width)[None, :, None]
    excited = residual.excitation[index]
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
    size = np.sum(np.abs(residual.measured[index]) ** 2, axis=1)
    # of what is explained noise would explain its share
    beyond = np.maximum(explained - more * with_input / free, 0)
    total = np.sqrt(beyond.sum(axis=0) / size.sum(axis=0))
    return Dependence(
        residual.omega[starts + half], stats.f.sf(ratio, more, free), np.sqrt(beyond / size), np.asarray(total)
    )


def by_own_modes(residual: Residual) -> NDArray[np.float64]:
    """(channels,) share of a residual beyond noise that vanishes if each input drives each mode as each channel likes.

    A linear rig of which the model has the poles right and shapes, signs or delays wrong; of friction little vanishes.

    Parameters
    ----------
    residual
        Of a test.
    """
    omega, period = residual.omega, residual.sample_period
    z = np.exp(1j * omega * period)
    columns = []
    for k, hold in enumerate(residual.holds):
        sampling, driven = Sampling(period, hold), residual.excitation[:, k]
        columns += [driven, 1j * omega * driven]
        for pole in residual.poles:
            if pole.imag >= 0:
                columns.append(sampling.response(complex(pole), z)[0] * driven)
            if pole.imag > 0:
                columns.append(sampling.response(complex(pole.conjugate()), z)[0] * driven)
    basis = np.column_stack(columns)
    shares = []
    for left, noise in zip(residual.left.T, residual.noise.T, strict=True):
        weight = 1 / np.sqrt(noise)
        weighted = basis * weight[:, None]
        q = np.linalg.qr(weighted / np.linalg.norm(weighted, axis=0))[0]
        own = left * weight
        explained = float(np.sum(np.abs(q.conj().T @ own) ** 2)) - q.shape[1]
        shares.append(explained / max(float(np.sum(np.abs(own) ** 2)) - len(own), 1e-12))
    return np.clip(shares, 0, 1)
