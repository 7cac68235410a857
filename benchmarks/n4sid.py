# SPDX-License-Identifier: Apache-2.0
"""Subspace identification (N4SID, Van Overschee and De Moor 1994), for comparison with abrace's own.

Applies SLICOT's IB01AD and IB01BD, by `ctrlsys`, to one test, decimated so that the excited band fills its spectrum.
A model gets its B and D at the full sample rate, by IB01CD.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_sysid.data_identification import variance_accounted_for
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

MODEL_ROWS = (20, 40, 60)
"""Block rows with which a model is tried; its order has to be less."""

WORST_VECTORS = 1e12
"""Condition of the eigenvectors beyond which A has no root that can be computed."""

SHORTEST = 2.5
"""Samples a period of the highest mode, at least, after decimation."""


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


def n4sid_model(record: Test, order: int, highest: float) -> LinearModel:
    """The discrete model that predicts the record itself best, of several block rows, decimated and not.

    Parameters
    ----------
    record
        The record to which it is fitted.
    order
        Number of states.
    highest
        [Hz] highest mode, by which the record is decimated.

    Raises
    ------
    AbraceError
        If SLICOT refuses the data with all of them.
    """
    u, y = record.excitation - record.excitation.mean(axis=0), record.outputs - record.outputs.mean(axis=0)
    scale_u, scale_y = u.std(axis=0), y.std(axis=0)
    u, y = u / scale_u, y / scale_y
    factor = max(1, int(1 / (record.sample_period * highest * SHORTEST)))
    best: tuple[float, LinearModel] | None = None
    for by in dict.fromkeys((factor, 1)):
        slow_u, slow_y = (signal.decimate(each, by, ftype="fir", axis=0) if by > 1 else each for each in (u, y))
        for rows in MODEL_ROWS:
            if rows <= order or len(slow_u) < 2 * rows * (1 + u.shape[1] + y.shape[1]):
                continue
            found = _a_and_c(slow_u, slow_y, order, rows)
            if found is None:
                continue
            a = _at_full_rate(found[0], by)
            model = None if a is None else _with_b_and_d(record, u, y, a, found[1])
            if model is None:
                continue
            model = replace(model, b=model.b / scale_u, c=model.c * scale_y[:, None])
            model = replace(model, d=model.d * scale_y[:, None] / scale_u)
            share = float(np.min(variance_accounted_for(model, record)))
            if np.isfinite(share) and (best is None or share > best[0]):
                best = share, model
    if best is None:
        raise AbraceError(f"{record.source}: N4SID of order {order} refuses the record")
    return best[1]


def _a_and_c(
    u: NDArray[np.float64], y: NDArray[np.float64], order: int, rows: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """A and C; None: SLICOT has none."""
    import ctrlsys

    u, y = np.asfortranarray(u), np.asfortranarray(y)
    inputs, outputs = u.shape[1], y.shape[1]
    for algorithm in ("C", "Q"):
        _, factor, _, _, failed = ctrlsys.ib01ad(
            "N", algorithm, "N", "O", "N", "N", rows, inputs, outputs, u, y, 0.0, -1.0
        )
        if failed:
            continue
        a, c, *_, failed = ctrlsys.ib01bd("N", "C", "N", rows, order, inputs, outputs, len(u), factor, 0.0)
        if not failed and np.isfinite(a).all():
            return a, c
    return None


def _at_full_rate(a: NDArray[np.float64], by: int) -> NDArray[np.float64] | None:
    """A of every sample from that of each `by`-th, poles outside the unit circle reflected; None: it has no root."""
    values, vectors = np.linalg.eig(a.astype(np.complex128))
    size = np.abs(values)
    if by == 1 and size.max() < 1:
        return a
    if size.min() == 0 or np.linalg.cond(vectors) > WORST_VECTORS:
        return None
    outside = size >= 1
    values[outside] *= (1 - 1e-9) / size[outside] ** 2
    root = np.real(vectors * values ** (1 / by) @ np.linalg.inv(vectors))
    # a single negative pole has no real root
    return np.asarray(root) if np.abs(np.linalg.eigvals(root)).max() < 1 else None


def _with_b_and_d(
    record: Test, u: NDArray[np.float64], y: NDArray[np.float64], a: NDArray[np.float64], c: NDArray[np.float64]
) -> LinearModel | None:
    """The model of these A and C, its B and D by least squares with the initial state; None: SLICOT has none."""
    import ctrlsys

    order, inputs, outputs = len(a), u.shape[1], y.shape[1]
    empty_b, empty_d = np.zeros((order, inputs), order="F"), np.zeros((outputs, inputs), order="F")
    given = np.asfortranarray(a), empty_b, np.asfortranarray(c), empty_d, np.asfortranarray(u), np.asfortranarray(y)
    _, b, d, *_, failed = ctrlsys.ib01cd("X", "C", "D", order, inputs, outputs, *given, 0.0)
    if failed or not (np.isfinite(b).all() and np.isfinite(d).all()):
        return None
    return LinearModel(a, b, c, d, record.inputs, record.names, record.sample_period)


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
