# SPDX-License-Identifier: Apache-2.0
"""A linear structure by its modes, the truth of a case of `battery`: transfer functions and exact responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """A linear structure by its modes.

    Parameters
    ----------
    frequencies, dampings
        (modes,) undamped angular frequency [rad/s], ascending, and damping ratio.
    residues
        (outputs, inputs, modes): how much of each mode's response to each input each output has.
    measured
        "displacement"; "acceleration", under forces; "absolute acceleration", under base motion.
    """

    frequencies: Array
    dampings: Array
    residues: Array
    measured: str

    @property
    def poles(self) -> NDArray[np.complex128]:
        """(modes,) poles above the real axis [rad/s]."""
        return np.asarray(self.frequencies * (-self.dampings + 1j * np.sqrt(1 - self.dampings**2)))

    def numerators(self, s: NDArray[Any]) -> NDArray[np.complex128]:
        """Numerators of the modes' transfer functions, over s^2 + 2 zeta w s + w^2.

        Parameters
        ----------
        s
            Laplace variable [rad/s], its last axis that of the modes or 1.
        """
        w, zeta = self.frequencies, self.dampings
        if self.measured == "displacement":
            return np.asarray(w**2 + 0 * s)
        return np.asarray(s**2 + 0 * w if self.measured == "acceleration" else 2 * zeta * w * s + w**2)

    def transfer(self, frequency: NDArray[Any]) -> NDArray[np.complex128]:
        """(lines, outputs, inputs) transfer functions.

        Parameters
        ----------
        frequency
            (lines,) Hz.
        """
        s, w = 2j * np.pi * frequency[:, None], self.frequencies
        modal = self.numerators(s) / (s**2 + 2 * self.dampings * w * s + w**2)
        return np.asarray(np.einsum("fn,pmn->fpm", modal, self.residues))

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D from all inputs, with displacement and velocity of each mode and input in turn as states."""
        outputs, inputs, modes = self.residues.shape
        w, zeta = self.frequencies, self.dampings
        one = np.block([[np.zeros((modes, modes)), np.eye(modes)], [-np.diag(w**2), -np.diag(2 * zeta * w)]])
        sign = -1.0 if self.measured == "acceleration" else 1.0
        of_velocity = 0.0 if self.measured == "displacement" else 2 * zeta * w
        a, b = np.kron(np.eye(inputs), one), np.kron(np.eye(inputs), np.repeat([[0.0], [1.0]], modes, axis=0))
        c = np.hstack(
            [sign * np.hstack([each * w**2, each * of_velocity]) for each in np.moveaxis(self.residues, 1, 0)]
        )
        d = self.residues.sum(axis=2) if self.measured == "acceleration" else np.zeros((outputs, inputs))
        return a, b, c, d

    def modal_responses(self, inputs: Array, step: float, hold: str = "first") -> Array:
        """(steps, inputs, modes) response of each mode to each input, from rest, of unit residue; exact for its hold.

        Parameters
        ----------
        inputs
            (steps, inputs).
        step
            Time between two of them [s].
        hold
            "first": linear in between; "zero": held.
        """
        found = np.empty((*inputs.shape, len(self.frequencies)))
        direct = 1.0 if self.measured == "acceleration" else 0.0
        poles = self.poles
        residues = np.diagonal(self.numerators(poles[:, None])) / (2j * poles.imag)
        for k, (pole, residue) in enumerate(zip(poles, residues, strict=True)):
            whole = np.expm1(pole * step)
            held, ramp = whole / pole, (whole - pole * step) / (pole**2 * step)
            taps = [0, held] if hold == "zero" else [ramp, held - ramp]
            state = signal.lfilter(taps, [1, -1 - whole], inputs, axis=0)
            found[:, :, k] = direct * inputs + 2 * np.real(residue * state)
        return found
