"""Poles by subspace identification (N4SID, Van Overschee and De Moor 1994), a second opinion beside our own.

SLICOT's IB01AD and IB01BD through `ctrlsys` on one test, decimated so that the excited band fills its spectrum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.fourier import held_input

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.run import Run

FILL = 0.8
"""Share of the decimated half sample rate that the excited band may fill: the rest is the decimation filter's slope."""

BLOCK_ROWS = 30
"""Least number of block rows of the Hankel matrices; from 20 on the poles hardly change."""

RANK_DEFICIENT = (4, 5)
"""IB01AD's warnings that the input's lines are too few for the block rows: the projection is rank-deficient, and what
follows is no model."""


def n4sid_poles(run: Run, input_name: str, order: int) -> NDArray[np.complex128]:
    """Continuous poles [rad/s] of a test, slowest first.

    Parameters
    ----------
    run
        The test.
    input_name
        The input that was excited.
    order
        States of the model. All eight channels speak: the table test shows the servo's slow pole and a local mode
        beside the building (order 8 or 9), the command test 13 poles.

    Raises
    ------
    AbraceError
        If SLICOT refuses the data or warns that they do not tell the model.
    """
    import ctrlsys  # needs NumPy 2

    excitation = held_input(run, input_name)
    factor = _decimation(excitation)
    u = signal.decimate(excitation - excitation.mean(), factor, ftype="fir")[:, None]
    y = signal.decimate(run.outputs - run.outputs.mean(axis=0), factor, ftype="fir", axis=0)
    u, y = np.asfortranarray(u / u.std()), np.asfortranarray(y / y.std(axis=0))
    rows, inputs, outputs = max(BLOCK_ROWS, 2 * order), u.shape[1], y.shape[1]
    _, factor_r, _, warning, failed = ctrlsys.ib01ad(
        "N", "C", "N", "O", "N", "N", rows, inputs, outputs, u, y, 0.0, -1.0
    )
    if failed:
        raise AbraceError(f"{run.source}: IB01AD ends with {failed}, expected 0")
    if warning in RANK_DEFICIENT:
        raise AbraceError(
            f"{run.source}: IB01AD warns {warning}, the oblique projection of {rows} block rows of {input_name} is "
            "rank-deficient, expected full rank"
        )
    a, *_, failed = ctrlsys.ib01bd("N", "C", "N", rows, order, inputs, outputs, len(u), factor_r, 0.0)
    if failed:
        raise AbraceError(f"{run.source}: IB01BD ends with {failed}, expected 0")
    poles = np.log(np.linalg.eigvals(a).astype(np.complex128)) / (run.sample_period * factor)
    return np.asarray(poles[np.argsort(np.abs(poles), kind="stable")])


def _decimation(excitation: NDArray[np.float64]) -> int:
    """By how much the sample rate may fall: 99 % of the input's power stays within FILL of its half."""
    power = np.cumsum(np.abs(np.fft.rfft(excitation - excitation.mean())) ** 2)
    share = np.searchsorted(power, 0.99 * power[-1]) / len(power)
    return max(1, int(FILL / share))
