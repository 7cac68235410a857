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
"""Share of the decimated half sample rate that the excited band may fill: the rest is the decimation filter's slope.
More where the input has nothing at all above its band, as a multisine."""

BLOCK_ROWS = 30
"""Least number of block rows of the Hankel matrices; from 20 on the poles hardly change."""

EXCITED = 1e-8
"""Least singular value of the input's Hankel matrix, over the greatest, of an input that excites all block rows.
White noise has 3e-6, a multisine at FILL 1e-10: SLICOT then finds good poles or none at all, as the last bits fall."""


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
        If the input does not excite all block rows, or SLICOT refuses the data.
    """
    import ctrlsys  # needs NumPy 2

    rows = max(BLOCK_ROWS, 2 * order)
    factor, u = _decimated(run.source, input_name, held_input(run, input_name), 2 * rows)
    y = signal.decimate(run.outputs - run.outputs.mean(axis=0), factor, ftype="fir", axis=0)
    u, y = np.asfortranarray(u[:, None] / u.std()), np.asfortranarray(y / y.std(axis=0))
    inputs, outputs = u.shape[1], y.shape[1]
    _, factor_r, _, _, failed = ctrlsys.ib01ad("N", "C", "N", "O", "N", "N", rows, inputs, outputs, u, y, 0.0, -1.0)
    if failed:
        raise AbraceError(f"{run.source}: IB01AD ends with {failed}, expected 0")
    a, *_, failed = ctrlsys.ib01bd("N", "C", "N", rows, order, inputs, outputs, len(u), factor_r, 0.0)
    if failed:
        raise AbraceError(f"{run.source}: IB01BD ends with {failed}, expected 0")
    poles = np.log(np.linalg.eigvals(a).astype(np.complex128)) / (run.sample_period * factor)
    return np.asarray(poles[np.argsort(np.abs(poles), kind="stable")])


def _decimated(
    source: str, input_name: str, excitation: NDArray[np.float64], rows: int
) -> tuple[int, NDArray[np.float64]]:
    """By how much the sample rate falls, and the input at that rate, which excites all rows of its Hankel matrix."""
    excitation = excitation - excitation.mean()
    power = np.cumsum(np.abs(np.fft.rfft(excitation)) ** 2)
    share = np.searchsorted(power, 0.99 * power[-1]) / len(power)
    for factor in range(max(1, int(FILL / share)), max(1, int(1 / share)) + 1):
        u = signal.decimate(excitation, factor, ftype="fir") if factor > 1 else excitation
        singular_values = np.linalg.svd(np.lib.stride_tricks.sliding_window_view(u, rows), compute_uv=False)
        if singular_values[-1] > EXCITED * singular_values[0]:
            return factor, u
    raise AbraceError(f"{source}: {input_name} does not excite {rows} block rows, whatever the sample rate")
