# SPDX-License-Identifier: Apache-2.0
"""Measured structures: `make verify MEASURED=path ROBOT_ARM=path` of their .mat files.

Two shakers at once and 28 accelerometers (DaISy 96-013), and a robot arm, a sweep of 1024 samples (DaISy).

All methods get the first two thirds of the record and are judged by the last third, as variance accounted for:
simulated from the inputs, the initial state fitted. Beside ours: a plain PO-MOESP (Verhaegen 1994; B, D and the initial
state by least squares) and N4SID (SLICOT's IB01 through ctrlsys, all outputs; its own B and D predict nothing, so they
are those of least squares too), each of the order and block rows that predict the last third best: in their favour.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from scipy import signal

from abrace.report.table import Table
from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_sysid.data_identification import identify_data, variance_accounted_for
from abrace_sysid.recorded.test import Test

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


SAMPLE_RATE = 1024.0
INPUTS = tuple(f"flexible_structure_dat_{column}" for column in (1, 2))
OUTPUTS = tuple(f"flexible_structure_dat_{column}" for column in range(3, 31))
ORDERS = (30, 34, 40, 46)
BLOCK_ROWS = {"PO-MOESP": (20, 30, 40), "N4SID": (41, 51)}
"""Those that were best among 20 to 61; N4SID needs more than the order."""
MEAN, LEAST = 0.9985, 0.996
"""Asked of all outputs' variance accounted for."""


ROBOT_ARM = (0.0582, 0.1267)
"""Frequencies of its poles [cycles a sample], by N4SID of order 4."""


def verify_measured(
    flexible: Path | None, robot_arm: Path | None
) -> tuple[dict[str, Any] | None, list[Claim], list[Table]]:
    """Values for verify.json (None without a file), claims, and a table of every output."""
    values, claims, tables = of_flexible_structure(flexible) if flexible else ({}, [], [])
    if robot_arm:
        values["robot_arm"], more = of_robot_arm(robot_arm)
        claims += more
    return values or None, claims, tables


def of_robot_arm(path: Path) -> tuple[dict[str, Any], list[Claim]]:
    """The robot arm from its first two thirds, at the defaults, beside N4SID of order 4."""
    data = Test.read(path, ("robot_arm_dat_1",), ("robot_arm_dat_2",), 1.0)
    used = 2 * len(data.outputs) // 3
    first, last = data.part(0, used), data.part(used, len(data.outputs))
    found = identify_data(first)
    share, peer = (
        float(variance_accounted_for(one, found.in_time(last))[0]) for one in (found.model, n4sid(first, 4, 20))
    )
    hertz = np.array([pair.frequency for pair in found.pairs]) / (2 * np.pi)
    error = max(float(np.abs(hertz / known - 1).min()) for known in ROBOT_ARM)
    claims = [
        Claim("robot arm: variance accounted for, last third", share, 0.998, f"N4SID {peer:.4f}", least=True),
        Claim("robot arm: both pole pairs, frequency", error, 0.01, "-"),
    ]
    return {"variance_accounted_for": share, "n4sid": peer, "frequencies": hertz.tolist()}, claims


def of_flexible_structure(path: Path) -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """The flexible structure from its first two thirds, beside its peers."""
    data = Test.read(path, INPUTS, OUTPUTS, SAMPLE_RATE)
    data = replace(data, excitation=data.excitation - data.excitation.mean(axis=0))
    used = 2 * len(data.outputs) // 3
    first, last = data.part(0, used), data.part(used, len(data.outputs))
    found = identify_data(first)
    shares = {"abrace": variance_accounted_for(found.model, found.in_time(last))}
    orders = {"abrace": f"{found.model.order} states"}
    notes = []
    for name, method in (("PO-MOESP", po_moesp), ("N4SID", n4sid)):
        tried = {}
        for rows, order in product(BLOCK_ROWS[name], ORDERS):
            if method is n4sid and rows <= order:
                continue
            try:
                model = method(first, order, rows)
                tried[rows, order] = variance_accounted_for(model, last)
            except (AbraceError, np.linalg.LinAlgError) as error:
                notes.append(f"{name}, {rows} block rows, order {order}: {error}")
        if tried:
            best = max(tried, key=lambda setting: tried[setting].mean())
            shares[name], orders[name] = tried[best], f"{best[1]} states, {best[0]} block rows"
    ours = shares["abrace"]
    peers = ", ".join(f"{name} {share.mean():.4f}" for name, share in shares.items() if name != "abrace")
    least = ", ".join(f"{name} {share.min():.4f}" for name, share in shares.items() if name != "abrace")
    claims = [
        Claim("flexible structure: variance accounted for, mean", float(ours.mean()), MEAN, peers, least=True),
        Claim("flexible structure: variance accounted for, least", float(ours.min()), LEAST, least, least=True),
    ]
    rows_of_table = [
        (name.removeprefix("flexible_structure_dat_"), *(f"{100 * share[i]:.3f}" for share in shares.values()))
        for i, name in enumerate(OUTPUTS)
    ]
    for title, of in (("mean", np.mean), ("least", np.min)):
        rows_of_table.append((title, *(f"{100 * of(share):.3f}" for share in shares.values())))
    modes = tuple(
        (
            f"{pair.frequency / (2 * np.pi):.3f} ± {1.96 * pair.frequency_deviation / (2 * np.pi):.3f}",
            f"{100 * pair.damping:.3f} ± {196 * pair.damping_deviation:.3f}",
        )
        for pair in found.pairs
    )
    header = ("column", *(f"{name}, {orders[name]}" for name in shares))
    tables = [
        Table(
            "Flexible structure, held-out third: variance accounted for, %", header, tuple(rows_of_table), tuple(notes)
        ),
        Table("Flexible structure: modes, 95 %", ("Hz", "damping %"), modes),
    ]
    values: dict[str, Any] = {"mean_variance_accounted_for": float(ours.mean()), "least": float(ours.min())}
    values["peers"] = {
        name: {"mean": float(share.mean()), "least": float(share.min()), "setting": orders[name]}
        for name, share in shares.items()
    }
    return values, claims, tables


def po_moesp(data: Test, order: int, rows: int) -> LinearModel:
    """Past outputs and inputs as instruments; A and C from the observability matrix, B and D by least squares."""
    u, y = data.excitation, data.outputs - data.outputs.mean(axis=0)
    columns = len(u) - 2 * rows + 1

    def hankel(series: NDArray[np.float64], first: int, last: int) -> NDArray[np.float64]:
        return np.vstack([series[k : k + columns].T for k in range(first, last)])

    stacked = np.vstack([hankel(u, rows, 2 * rows), hankel(u, 0, rows), hankel(y, 0, rows), hankel(y, rows, 2 * rows)])
    lower = np.asarray(np.linalg.qr(stacked.T, mode="r"), dtype=np.float64).T
    inputs, outputs = u.shape[1], y.shape[1]
    first, last = rows * inputs, 2 * rows * inputs + rows * outputs
    left, values, _ = np.linalg.svd(lower[last:, first:last], full_matrices=False)
    observability = left[:, :order] * np.sqrt(values[:order])
    c = observability[:outputs]
    a = np.linalg.lstsq(observability[:-outputs], observability[outputs:], rcond=None)[0]
    return with_inputs(data, a, c)


def with_inputs(data: Test, a: NDArray[np.float64], c: NDArray[np.float64]) -> LinearModel:
    """A discrete model with these A and C, B and D by least squares on the modal states, the initial state free."""
    u, y = data.excitation, data.outputs - data.outputs.mean(axis=0)
    values, vectors = np.linalg.eig(a)
    modal = c @ vectors
    upper = np.flatnonzero(values.imag >= 0)
    weight = 1 / y.std(axis=0)
    direct, _ = np.linalg.qr(u)
    columns = []
    for k in upper:
        driven = [signal.lfilter([0, 1], [1, -values[k]], column.astype(np.complex128)) for column in u.T]
        for state in (*driven, values[k] ** np.arange(len(u))):
            output = np.outer(state, modal[:, k]) * weight
            output = output * (2 if values[k].imag > 0 else 1)
            for part in (output.real, -output.imag) if values[k].imag > 0 else (output.real,):
                columns.append((part - direct @ (direct.T @ part)).ravel())
    basis, right = np.array(columns), (y * weight - direct @ (direct.T @ (y * weight))).ravel()
    solution = np.linalg.lstsq(basis @ basis.T, basis @ right, rcond=1e-14)[0]
    b, place = np.zeros((len(values), u.shape[1]), dtype=np.complex128), 0
    for k in upper:
        size = 2 if values[k].imag > 0 else 1
        for j in range(u.shape[1]):
            parts = solution[place + size * j : place + size * (j + 1)]
            b[k, j] = complex(*parts)
        place += size * (u.shape[1] + 1)
        if size == 2:
            b[np.argmin(np.abs(values - values[k].conj()))] = b[k].conj()
    real_b = np.real(vectors @ b)
    model = LinearModel(a, real_b, c, np.zeros((len(c), u.shape[1])), data.inputs, data.names, data.sample_period)
    return replace(model, d=_direct(model, data))


def _direct(model: LinearModel, data: Test) -> NDArray[np.float64]:
    """D by least squares, the free response fitted with it."""
    u, y = data.excitation, data.outputs - data.outputs.mean(axis=0)
    state = np.zeros((len(u), model.order))
    values, vectors = np.linalg.eig(model.a)
    modal_b = np.linalg.solve(vectors, model.b.astype(np.complex128))
    for k, value in enumerate(values):
        state += np.real(np.outer(signal.lfilter([0, 1], [1, -value], u @ modal_b[k]), vectors[:, k]))
    free = np.column_stack([part for k, v in enumerate(values) if v.imag >= 0 for part in _free(v, len(u))])
    left = y - state @ model.c.T
    return np.asarray(np.linalg.lstsq(np.hstack([u, free]), left, rcond=1e-12)[0][: u.shape[1]].T)


def _free(value: complex, samples: int) -> list[NDArray[np.float64]]:
    decay = np.asarray(value ** np.arange(samples), dtype=np.complex128)
    return [decay.real, decay.imag] if value.imag > 0 else [decay.real]


def n4sid(data: Test, order: int, rows: int) -> LinearModel:
    """A and C by SLICOT's N4SID of all outputs, B and D by least squares."""
    import ctrlsys

    u, y = np.asfortranarray(data.excitation), np.asfortranarray(data.outputs - data.outputs.mean(axis=0))
    scale_u, scale_y = u.std(axis=0), y.std(axis=0)
    u, y = np.asfortranarray(u / scale_u), np.asfortranarray(y / scale_y)
    inputs, outputs = u.shape[1], y.shape[1]
    _, factor, _, _, failed = ctrlsys.ib01ad("N", "C", "N", "O", "N", "N", rows, inputs, outputs, u, y, 0.0, -1.0)
    if failed:
        raise AbraceError(f"IB01AD ends with {failed}, expected 0")
    a, c, *_, failed = ctrlsys.ib01bd("N", "C", "N", rows, order, inputs, outputs, len(u), factor, 0.0)
    if failed:
        raise AbraceError(f"IB01BD ends with {failed}, expected 0")
    return with_inputs(data, a, c * scale_y[:, None])
