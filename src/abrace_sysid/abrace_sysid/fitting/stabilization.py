# SPDX-License-Identifier: Apache-2.0
"""Stabilisation diagram: poles of rising order, and which of them stay the same from order to order.

Poles of the structure appear at every order with the same frequency, damping ratio and mode shape; poles due to noise
do not (Peeters and De Roeck 2001, sec. 4). Mode shapes are compared by the modal assurance criterion (Allemang 1982).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.curve_fit import uncertainty_weights
from abrace_sysid.fitting.vector_fitting import HEAVY_DAMPING, fit_common_poles, thinned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.spectra.frequency_response import FrequencyResponse

LINES = 1500
"""Greatest number of frequency lines that are fitted: enough to locate poles."""

ITERATIONS = 10

FREQUENCY, DAMPING, SHAPE = 0.005, 0.05, 0.02
"""Greatest differences between a pole and the nearest one of the order below that count as the same: relative in
frequency and damping ratio, 1 minus the modal assurance criterion in shape."""


@dataclass(frozen=True)
class OrderPoles:
    """The oscillating, stable poles of one order.

    Parameters
    ----------
    order
        Number of fitted poles.
    frequency, damping
        (poles,) modulus [rad/s] and damping ratio, slowest first.
    shapes
        (poles, channels) complex.
    same_frequency, same_damping, same_shape
        (poles,) whether the order below has the same pole, in that respect.
    """

    order: int
    frequency: NDArray[np.float64]
    damping: NDArray[np.float64]
    shapes: NDArray[np.complex128]
    same_frequency: NDArray[np.bool_]
    same_damping: NDArray[np.bool_]
    same_shape: NDArray[np.bool_]

    @property
    def same(self) -> NDArray[np.bool_]:
        """(poles,) whether a pole is the same in all respects."""
        return self.same_frequency & self.same_damping & self.same_shape


@dataclass(frozen=True)
class Stabilization:
    """Poles of rising order of one measured transfer function.

    Parameters
    ----------
    measured
        The fitted response.
    orders
        Lowest order first.
    """

    measured: FrequencyResponse
    orders: tuple[OrderPoles, ...]


def stabilization(measured: FrequencyResponse, orders: Sequence[int] = tuple(range(2, 21))) -> Stabilization:
    """Fit common poles of all channels at each order.

    Parameters
    ----------
    measured
        The response, hold and delays included.
    orders
        Numbers of poles, rising.

    Raises
    ------
    AbraceError
        If the orders do not rise, or the lines are too few for them.
    """
    if len(orders) < 2 or (np.diff(orders) <= 0).any():
        raise AbraceError(f"stabilisation diagram: orders {tuple(orders)}, expected two or more that rise")
    fewer = thinned(measured, LINES)
    found: list[OrderPoles] = []
    for order in orders:
        fit = fit_common_poles(fewer, order, uncertainty_weights(fewer.response, fewer.sigma), ITERATIONS)
        poles = fit.poles
        within = (poles.imag > measured.omega[0]) & (poles.imag < measured.omega[-1]) & (poles.real < 0)
        chosen = np.flatnonzero(within & (-poles.real < HEAVY_DAMPING * np.abs(poles)))
        frequency, damping = np.abs(poles[chosen]), -poles[chosen].real / np.abs(poles[chosen])
        same = _same(frequency, damping, fit.shapes[chosen], found[-1] if found else None)
        found.append(OrderPoles(order, frequency, damping, fit.shapes[chosen], *same))
    return Stabilization(measured, tuple(found))


def modal_assurance(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Modal assurance criterion of mode shapes, 1 for the same shape and 0 for orthogonal ones (Allemang 1982).

    Parameters
    ----------
    one, other
        (modes, channels) and (other modes, channels).

    Returns
    -------
    NDArray
        (modes, other modes).
    """
    product = np.abs(one.conj() @ other.T) ** 2
    sizes = np.outer(np.sum(np.abs(one) ** 2, axis=1), np.sum(np.abs(other) ** 2, axis=1))
    return np.asarray(product / np.maximum(sizes, np.finfo(float).tiny))


def _same(
    frequency: NDArray[np.float64],
    damping: NDArray[np.float64],
    shapes: NDArray[np.complex128],
    below: OrderPoles | None,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each pole is the same as its nearest in the order below: in frequency, damping ratio and shape."""
    if below is None or not len(below.frequency) or not len(frequency):
        none = np.zeros(len(frequency), dtype=np.bool_)
        return none, none, none
    nearest = np.argmin(np.abs(frequency[:, None] - below.frequency), axis=1)
    same_frequency = np.abs(frequency / below.frequency[nearest] - 1) < FREQUENCY
    same_damping = same_frequency & (np.abs(damping / below.damping[nearest] - 1) < DAMPING)
    # channels are normalised, otherwise the forces would dominate every shape
    size = np.maximum(np.sqrt(np.mean(np.abs(shapes) ** 2, axis=0)), np.finfo(float).tiny)
    agreement = modal_assurance(shapes / size, below.shapes / size)[np.arange(len(frequency)), nearest]
    return same_frequency, same_damping, same_frequency & (1 - agreement < SHAPE)
