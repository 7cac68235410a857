# SPDX-License-Identifier: Apache-2.0
"""Starting values of modes from given poles: the residues of each mode, approximated by rank one, shape times drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_sysid.fitting.condensed_lines import combined, stacked
from abrace_sysid.fitting.modes import Modes
from abrace_sysid.fitting.pole_basis import sides_of
from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate

COINCIDENT = 1e-5
"""Least singular value of the basis, relative to the greatest: coincident poles, of equal servos, share a residue."""


def starting_modes(
    observations: Sequence[Observation],
    inputs: Sequence[str],
    poles: NDArray[np.complex128],
    driven: NDArray[np.bool_] | None = None,
    fixed: NDArray[np.bool_] | None = None,
    delays: NDArray[np.float64] | None = None,
) -> tuple[Modes, NDArray[np.float64]]:
    """Modes with these poles, and a unit for each input, so that all inputs drive the modes equally strongly.

    Parameters
    ----------
    observations
        The tests.
    inputs
        Names of all inputs.
    poles
        [rad/s], of each pair the one above the real axis, and real ones.
    driven
        (poles, inputs) whether an input can drive a mode; None: all that the tests show.
    fixed
        (poles,) whether a pole is fixed; None: none is.
    delays
        (inputs,) starting values of the delays [s] of inputs without direct terms; 0: no delay, which stays fixed. NaN:
        an input with direct terms. None: all inputs have direct terms.

    Returns
    -------
    modes, unit
        The modes in these units; (inputs,).
    """
    channels = observations[0].measured.shape[1]
    direct = np.ones(len(inputs), dtype=np.bool_) if delays is None else np.isnan(delays)
    delays = np.zeros(len(inputs)) if delays is None else np.nan_to_num(delays)
    shows = np.zeros((len(poles), len(inputs)), dtype=np.bool_)
    residues = np.zeros((channels, len(poles), len(inputs)), dtype=np.complex128)
    levels = np.zeros(channels)
    for observation in observations:
        shown = list(observation.shown(poles))
        later = delays[[inputs.index(name) for name in observation.inputs]]
        of_inputs, noise = _residues(observation, poles[shown], later)
        levels += np.log(noise) - np.log(noise).mean()
        for name, of_input in zip(observation.inputs, np.moveaxis(of_inputs, 2, 0), strict=True):
            shows[shown, inputs.index(name)] = True
            residues[:, shown, inputs.index(name)] += of_input
    # channels have one scale for all tests, otherwise a mode would have another shape in each of them
    residues /= np.exp(levels / len(observations))[:, None, None]
    driven = shows if driven is None else shows & driven
    residues *= driven
    unit = np.sqrt(np.sum(np.abs(residues) ** 2, axis=(0, 1)))
    unit = 1 / np.where(unit > 0, unit, 1.0)
    drive = np.zeros((len(poles), len(inputs)), dtype=np.complex128)
    for mode, pole in enumerate(poles):
        scaled = residues[:, mode] * unit
        drive[mode] = np.linalg.svd(scaled if pole.imag > 0 else scaled.real, full_matrices=False)[2][0]
        drive[mode, ~driven[mode]] = 0
        length = np.linalg.norm(drive[mode])
        drive[mode] = drive[mode] / length if length > 0 else driven[mode] / np.sqrt(driven[mode].sum())
    fixed = np.zeros(len(poles), dtype=np.bool_) if fixed is None else fixed
    return Modes(poles, drive, driven, fixed, delays, delays > 0, direct), unit


def modes_of(estimate: PoleEstimate) -> tuple[Modes, NDArray[np.float64]]:
    """Modes and units as `starting_modes` gives them, from a fit of tests with the same inputs.

    Parameters
    ----------
    estimate
        The fit.
    """
    size = np.linalg.norm(estimate.drive, axis=0)
    unit = 1 / np.where(size > 0, size, 1.0)
    drive = estimate.drive * unit
    drive /= np.linalg.norm(drive, axis=1, keepdims=True)
    delays = np.nan_to_num(estimate.delays)
    fixed, direct = np.zeros(len(drive), dtype=np.bool_), np.isnan(estimate.delays)
    return Modes(estimate.poles, drive, drive != 0, fixed, delays, delays > 0, direct), unit


def _residues(
    observation: Observation, poles: NDArray[np.complex128], delays: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """(channels, poles, inputs) residues of each input alone, and (channels,) rms of the residual."""
    z, count = observation.z, len(observation.inputs)
    basis: list[NDArray[np.complex128]] = []
    for pole in poles:
        sides = sides_of(pole)
        for sampling, drive, delay in zip(observation.samplings, observation.excitation.T, delays, strict=True):
            basis += combined([(drive * sampling.response(side, z, delay)[0])[:, None] for side in sides], np.ones(1))
    basis += list(observation.excitation.T)
    if observation.transient:
        for pole in poles:
            sides = sides_of(pole)
            basis += combined([observation.samplings[0].transient(side, z)[0][:, None] for side in sides], np.ones(1))
    weight = 1 / observation.noise_level[:, None]
    columns, measured = stacked(np.column_stack(basis) * weight), stacked(observation.measured * weight)
    scale = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(scale > 0, scale, 1.0)
    coefficients = np.linalg.lstsq(columns, measured, rcond=COINCIDENT)[0]
    noise = np.sqrt(np.mean((measured - columns @ coefficients) ** 2, axis=0))
    coefficients = (coefficients / np.where(scale > 0, scale, 1.0)[:, None]).T
    found = np.zeros((len(coefficients), len(poles), count), dtype=np.complex128)
    for mode, columns_of_mode in enumerate(columns_of(poles)):
        size = columns_of_mode.stop - columns_of_mode.start
        parts = coefficients[:, count * columns_of_mode.start : count * columns_of_mode.stop]
        parts = parts.reshape(len(coefficients), count, size)
        found[:, mode] = parts[:, :, 0] + (1j * parts[:, :, 1] if size == 2 else 0)
    return found, np.maximum(noise, np.finfo(float).tiny)
