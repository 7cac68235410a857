# SPDX-License-Identifier: Apache-2.0
"""Prediction of measured data with unknown initial state: forced response simulated, free response fitted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from abrace_core.linear_model import takes_models
from abrace_core.simulation import simulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.measured_data import MeasuredData


@takes_models
def variance_accounted_for(model: LinearModel, data: MeasuredData) -> NDArray[np.float64]:
    """(outputs,) 1 minus the ratio of the variances of prediction error and measured output.

    Parameters
    ----------
    model, data
        As for `predicted`.
    """
    measured = data.channels(model.outputs)
    return np.asarray(1 - np.var(measured - predicted(model, data), axis=0) / np.var(measured, axis=0))


@takes_models
def predicted(model: LinearModel, data: MeasuredData) -> NDArray[np.float64]:
    """(samples, outputs) the model's response to the inputs, with the initial state that fits the outputs best.

    Parameters
    ----------
    model
        Stable, with inputs and outputs that the data contain. For a continuous model the inputs are taken as
        band-limited; a discrete model is simulated sample by sample.
    data
        The test. The inputs' means are subtracted; the outputs' means are kept.
    """
    inputs = data.channels(model.inputs)
    measured = data.channels(model.outputs)
    inputs, offset = inputs - inputs.mean(axis=0), measured.mean(axis=0)
    samples = len(inputs)
    if model.sample_period:
        forced = simulate(model, inputs)
    else:
        omega = 2 * np.pi * fft.rfftfreq(samples, data.sample_period)
        response = model.frequency_response(omega)
        forced = fft.irfft(np.einsum("fpm,fm->fp", response, fft.rfft(inputs, axis=0)), samples, axis=0)
    values, vectors = np.linalg.eig(model.a)
    step = values if model.sample_period else np.exp(values * data.sample_period)
    upper = np.flatnonzero(values.imag >= 0)
    size = measured.std(axis=0)
    columns = []
    for i in upper:
        free = np.outer(step[i] ** np.arange(samples), (model.c @ vectors[:, i]) / size)
        columns += [free.real.ravel(), free.imag.ravel()] if values[i].imag > 0 else [free.real.ravel()]
    basis = np.column_stack(columns)
    length = np.linalg.norm(basis, axis=0)
    basis /= np.where(length > 0, length, 1.0)
    left_over = ((measured - offset - forced) / size).ravel()
    fitted = basis @ np.linalg.lstsq(basis, left_over, rcond=1e-12)[0]
    return np.asarray(offset + forced + fitted.reshape(forced.shape) * size)
