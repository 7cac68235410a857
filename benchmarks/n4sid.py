# SPDX-License-Identifier: Apache-2.0
"""Poles by subspace identification (N4SID, Van Overschee and De Moor 1994), for comparison with abrace's own.

Applies SLICOT's IB01AD and IB01BD, by `ctrlsys`, to one test, decimated so that the excited band fills its spectrum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from abrace_core import AbraceError
from abrace_sysid.recorded.test import Test

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.run import Run

FILL = 0.5
"""Share of the decimated half sample rate that the excited band fills, where the input has noise above it too. With 0.8
the errors of damping are up to four times as large."""

FULL = 0.9
"""Greatest share, of an input that has nothing at all above its band, as a multisine."""

BLOCK_ROWS = (60, 30)
"""Block rows of the Hankel matrices: the first of these that the input excites. More are no better and take longer;
with 30 the errors of damping from 600 s are half as large again."""

STANDS_OUT = 2.0
"""A singular value counts as a state if it is so many times the one at the number of block rows, which is noise."""

EXCITED = 1e-8
"""Least singular value of the input's Hankel matrix, over the greatest, of an input that excites all block rows.
White noise has 1e-7, a multisine at FILL 1e-10: SLICOT then finds good poles or none at all, as the last bits fall."""


def n4sid_poles(run: Run, input_name: str) -> NDArray[np.complex128]:
    """Continuous poles [rad/s] of a test, slowest first; their number is found from the singular values.

    Parameters
    ----------
    run
        The test.
    input_name
        The input that was excited.

    Raises
    ------
    AbraceError
        If the input does not excite all block rows, or SLICOT refuses the data.
    """
    import ctrlsys  # needs NumPy 2

    rows, factor, u = _decimated(run.source, input_name, Test.of(run).channel(input_name))
    y = signal.decimate(run.outputs - run.outputs.mean(axis=0), factor, ftype="fir", axis=0)
    u, y = np.asfortranarray(u[:, None] / u.std()), np.asfortranarray(y / y.std(axis=0))
    inputs, outputs = u.shape[1], y.shape[1]
    _, factor_r, values, _, failed = ctrlsys.ib01ad(
        "N", "C", "N", "O", "N", "N", rows, inputs, outputs, u, y, 0.0, -1.0
    )
    if failed:
        raise AbraceError(f"{run.source}: IB01AD ends with {failed}, expected 0")
    order = int(np.count_nonzero(values[:rows] > STANDS_OUT * values[rows - 1]))
    if not order:
        raise AbraceError(f"{run.source}: no singular value stands out, expected some of a structure")
    a, *_, failed = ctrlsys.ib01bd("N", "C", "N", rows, order, inputs, outputs, len(u), factor_r, 0.0)
    if failed:
        raise AbraceError(f"{run.source}: IB01BD ends with {failed}, expected 0")
    poles = np.log(np.linalg.eigvals(a).astype(np.complex128)) / (run.sample_period * factor)
    return np.asarray(poles[np.argsort(np.abs(poles), kind="stable")])


def _decimated(source: str, input_name: str, excitation: NDArray[np.float64]) -> tuple[int, int, NDArray[np.float64]]:
    """Block rows, by how much the sample rate falls, and the input at that rate, which excites these rows."""
    excitation = excitation - excitation.mean()
    power = np.cumsum(np.abs(np.fft.rfft(excitation)) ** 2)
    share = np.searchsorted(power, 0.99 * power[-1]) / len(power)
    for rows in BLOCK_ROWS:
        for factor in range(max(1, int(FILL / share)), max(1, int(FULL / share)) + 1):
            u = signal.decimate(excitation, factor, ftype="fir") if factor > 1 else excitation
            windows = np.lib.stride_tricks.sliding_window_view(u, 2 * rows)
            singular_values = np.linalg.svd(windows, compute_uv=False)
            if singular_values[-1] > EXCITED * singular_values[0]:
                return rows, factor, u
    raise AbraceError(f"{source}: {input_name} does not excite {BLOCK_ROWS[-1]} block rows, whatever the sample rate")
