# SPDX-License-Identifier: Apache-2.0
"""Modes: poles, and how much each input drives them; the parameters over which a likelihood is maximised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_sysid.fitting.curve_fit import stacked
from abrace_sysid.fitting.observation import names_of
from abrace_sysid.fitting.pole_basis import transients
from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate


LEAST_DELAY, MOST_DELAY = 1e-8, 0.1
"""Limits of an input's delay that is estimated [s]."""


@dataclass(frozen=True)
class Modes:
    """Poles, and how much each input drives them.

    Parameters
    ----------
    poles
        (poles,) [rad/s], of each pair the one above the real axis, and real ones.
    drive
        (poles, inputs) complex, of a real pole real; rows of unit length over the inputs in `driven`, zero elsewhere.
    driven
        (poles, inputs) whether an input drives a mode.
    fixed
        (poles,) whether a pole is fixed.
    delays
        (inputs,) delay of each input [s].
    delayed
        (inputs,) whether the delay of an input is a parameter.
    direct
        (inputs,) whether an input has direct terms. (For a sampled rig a delay of less than a sample period has the
        same effect as a direct term, so an input has one or the other.)
    """

    poles: NDArray[np.complex128]
    drive: NDArray[np.complex128]
    driven: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    delays: NDArray[np.float64]
    delayed: NDArray[np.bool_]
    direct: NDArray[np.bool_]

    @cached_property
    def directions(self) -> list[NDArray[np.complex128]]:
        """Of each mode (inputs, directions) orthonormal changes of its drive, orthogonal to it; real for real poles."""
        return [across(*mode) for mode in zip(self.drive, self.driven, self.poles.imag > 0, strict=True)]

    def parameters(self) -> list[tuple[int, int | None, slice]]:
        """For each parameter its mode, direction of the drive (None: the pole itself) and columns; poles first."""
        found: list[tuple[int, int | None, slice]] = [(k, None, s) for k, s in enumerate(columns_of(self.poles))]
        end = found[-1][2].stop
        for mode, pole in enumerate(self.poles):
            for direction in range(max(0, int(self.driven[mode].sum()) - 1)):
                size = 2 if pole.imag > 0 else 1
                found.append((mode, direction, slice(end, end + size)))
                end += size
        return found

    @property
    def size(self) -> int:
        """Number of parameters: those of `parameters`, then the delays that are free."""
        return self.parameters()[-1][2].stop + int(self.delayed.sum())

    def delay_columns(self) -> dict[int, int]:
        """By input whose delay is a parameter, the delay's column."""
        end = self.parameters()[-1][2].stop
        return {int(i): end + k for k, i in enumerate(np.flatnonzero(self.delayed))}

    def moved(self, step: NDArray[np.float64], fastest: float) -> Modes:
        """The modes after a step of the parameters; real poles stop at `fastest`, a pair across the real axis is NaN.

        Delays stay between LEAST_DELAY and MOST_DELAY.
        """
        poles, drive, delays = self.poles.copy(), self.drive.copy(), self.delays.copy()
        for i, column in self.delay_columns().items():
            delays[i] = np.clip(delays[i] + step[column], LEAST_DELAY, MOST_DELAY)
        for mode, direction, columns in self.parameters():
            parts = step[columns]
            by = complex(*parts)
            if direction is None:
                poles[mode] += by
                if len(parts) == 1:
                    poles[mode] = max(poles[mode].real, -fastest)
                elif poles[mode].imag <= 0:
                    poles[mode] = np.nan
            else:
                drive[mode] += by * self.directions[mode][:, direction]
        return replace(self, poles=poles, drive=drive / np.linalg.norm(drive, axis=1, keepdims=True), delays=delays)


def across(drive: NDArray[np.complex128], driven: NDArray[np.bool_], paired: bool) -> NDArray[np.complex128]:
    """(inputs, directions) orthonormal vectors, orthogonal to a drive.

    Parameters
    ----------
    drive
        (inputs,).
    driven
        (inputs,) whether an input can drive the mode; the others are zero in all vectors.
    paired
        Whether the mode is a pair of poles; vectors of a real pole are real.
    """
    inputs = np.flatnonzero(driven)
    found = np.zeros((len(drive), max(0, len(inputs) - 1)), dtype=np.complex128)
    if found.size:
        own = drive[inputs][:, None]
        found[inputs] = np.linalg.qr(own if paired else own.real, mode="complete")[0][:, 1:]
    return found


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
    outputs = names_of(observations)[1]
    direct = np.ones(len(inputs), dtype=np.bool_) if delays is None else np.isnan(delays)
    delays = np.zeros(len(inputs)) if delays is None else np.nan_to_num(delays)
    shows = np.zeros((len(poles), len(inputs)), dtype=np.bool_)
    residues = np.zeros((len(outputs), len(poles), len(inputs)), dtype=np.complex128)
    levels, times = np.zeros(len(outputs)), np.zeros(len(outputs))
    for observation in observations:
        shown = list(observation.shown(poles))
        later = delays[[inputs.index(name) for name in observation.inputs]]
        of_inputs, noise = _residues(observation, poles[shown], later)
        own = [outputs.index(name) for name in observation.outputs]
        levels[own] += np.log(noise) - np.log(noise).mean()
        times[own] += 1
        for name, of_input in zip(observation.inputs, np.moveaxis(of_inputs, 2, 0), strict=True):
            shows[shown, inputs.index(name)] = True
            residues[np.ix_(own, shown, [inputs.index(name)])] += of_input[:, :, None]
    # channels have one scale for all tests, otherwise a mode would have another shape in each of them
    residues /= np.exp(levels / times)[:, None, None]
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
    states = observation.states(poles, delays)
    basis: list[NDArray[np.complex128]] = [*states, *observation.excitation.T]
    if observation.transient:
        basis += transients(poles, z, observation.samplings[0])
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
