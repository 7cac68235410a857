# SPDX-License-Identifier: Apache-2.0
"""Modes: poles, and how much each input drives them; the parameters over which a likelihood is maximised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
