# SPDX-License-Identifier: Apache-2.0
"""Levels of nonlinear distortion of a transfer function, from the lines of a multisine test that no input excites.

The distortion at these lines is representative of that at the excited lines between them (Pintelon and Schoukens
2012, sec. 4.3). Even powers of the input appear at the even lines, odd powers at the odd lines. Divided by the input,
the distortion is the error of the transfer function that it causes, for these phases of the multisine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

NEIGHBOURS = 5
"""Number of unexcited lines, nearest to an excited line, whose power is averaged."""


@dataclass(frozen=True)
class Distortion:
    """Levels of distortion at the lines of a transfer function.

    Parameters
    ----------
    even, odd
        (lines, channels) standard deviations in the response's unit, noise included; NaN: the multisine leaves out no
        even (odd) line.
    """

    even: NDArray[np.float64]
    odd: NDArray[np.float64]

    def select(self, columns: Sequence[int]) -> Distortion:
        """The levels of some channels, given by their `columns`."""
        return Distortion(self.even[:, columns], self.odd[:, columns])

    def shares(self, response: NDArray[np.complex128], sigma: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Noise, even and odd distortion: (channels,) rms over the band, as shares of the response's rms.

        The noise power is subtracted from the distortion. 0: not more than the noise. NaN: no line was left out.

        Parameters
        ----------
        response, sigma
            (lines, channels) transfer function and its standard deviation due to noise.
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
    """Distortion levels at the excited lines, estimated from the lines that no input excites.

    Parameters
    ----------
    lines
        (lines,) numbers of the lines in the band.
    amplitude
        (lines, channels) amplitude of the outputs.
    excitation
        (excited lines,) amplitude of the input.
    excited, unexcited
        (lines,) which lines the input excites, and which no input excites.
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
