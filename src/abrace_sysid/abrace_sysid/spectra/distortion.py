# SPDX-License-Identifier: Apache-2.0
"""Levels of nonlinear distortion for a transfer function, from the lines of a multisine that no input excites.

The distortion at these lines is representative of that at the excited lines between them (Schoukens and Pintelon
2012, sec. 4.3): even powers of the input at the even lines, odd ones at the odd lines. Divided by the input it is
in the unit of the transfer function: the error that the distortion causes there, for these phases of the multisine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

NEIGHBOURS = 5
"""Lines nearest to an excited one that are averaged."""


@dataclass(frozen=True)
class Distortion:
    """Levels of distortion at the lines of a transfer function.

    Parameters
    ----------
    even, odd
        (lines, channels) standard deviations in the response's unit, the noise among them; NaN: no such line was left
        out.
    """

    even: NDArray[np.float64]
    odd: NDArray[np.float64]

    def select(self, columns: Sequence[int]) -> Distortion:
        """The same of some channels, given by their `columns`."""
        return Distortion(self.even[:, columns], self.odd[:, columns])

    def shares(self, response: NDArray[np.complex128], sigma: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Of noise, even and odd distortion: (channels,) rms over the band, as shares of the response's rms.

        The noise is taken out of the distortion; 0: no more than noise is seen, NaN: no line was left out.

        Parameters
        ----------
        response, sigma
            (lines, channels) the transfer function and its standard deviation by noise.
        """
        size = np.mean(np.abs(response) ** 2, axis=0)
        noise = np.mean(sigma**2, axis=0)
        found = {"noise": np.sqrt(noise / size)}
        for kind, level in (("even", self.even), ("odd", self.odd)):
            found[kind] = np.sqrt(np.maximum(np.mean(level**2, axis=0) - noise, 0) / size)
        return found


def distortion_beside(
    lines: NDArray[np.int64],
    amplitude: NDArray[np.float64],
    excitation: NDArray[np.float64],
    excited: NDArray[np.bool_],
    unexcited: NDArray[np.bool_],
) -> Distortion:
    """Levels at the excited lines, from those that no input excites.

    Parameters
    ----------
    lines
        (lines,) numbers of the lines in the band.
    amplitude
        (lines, channels) of the outputs.
    excitation
        (excited lines,) amplitude of the input.
    excited, unexcited
        (lines,) which lines the input excites, and which none does.
    """

    def level(which: NDArray[np.bool_]) -> NDArray[np.float64]:
        at = lines[excited]
        if not which.any():
            return np.full((len(at), amplitude.shape[1]), np.nan)
        distance = np.abs(at[:, None] - lines[which])
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
        power = np.mean(amplitude[which][nearest] ** 2, axis=1)
        return np.asarray(np.sqrt(power) / excitation[:, None])

    return Distortion(level(unexcited & (lines % 2 == 0)), level(unexcited & (lines % 2 == 1)))
