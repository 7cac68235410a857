# SPDX-License-Identifier: Apache-2.0
"""The paper's model of the braced building, Eqs. (1) to (10): its order, its letters, one function for each step.

From the transfer functions of eight recorded quantities z = [x1, x2, x3, xf, a1, a2, a3, f] to the table's acceleration
W and to the command U of the braces:

    Eqs. (1), (2)   curve_fit       a ratio of two polynomials of s, by weighted least squares
    Eqs. (3) - (5)  state_space     A1 (table), A2 (command, accelerations), A3 (command, all other quantities)
    Eqs. (6), (7)   superpose       the three parts side by side: 24 states
    Eq. (8)                         y = C_y Z + D_y U + F_y W are rows of z: `model.select(["a1", "a2", "a3"])`
    Eq. (9)         `models.reduction.balanced_truncation`, balanced state reduction (Moore 1981): 8 states
    Eq. (10)                        y_r: the same rows of the reduced model; the noise v is in the design's weights

Two misprints are mended here. The upper right block of Eq. (1) has to be **-**Omega* Lambda Gamma: as printed, the
equation is not that of the least-squares problem. And Gamma in Eq. (2) lacks its last column, g_j alone, that belongs
to a_0.

The paper leaves lambda_j open, "the adjustable weighting parameter for the j th data point". It decides about success:
Eq. (1) minimises sum of lambda_j |B(iw_j) - A(iw_j) g_j|^2, which is the error of g_j times |A|^2, and |A|^2 grows like
w^(2m). With lambda = 1 order 12 finds unstable poles. Two choices were open to the authors: a falling power of w, which
may do or not, and 1 / |A(iw)|^2 of the step before (Sanathanan and Koerner 1963), which does. `curve_fit` begins with
the first and goes on with the second, times the certainty of each data point: without that the smeared peaks of Welch's
method, the paper's "FFT technique", lead to unstable poles again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, takes_models
from abrace_sysid.fitting.curve_fit import require_stable, uncertainty_weights
from abrace_sysid.fitting.options import MORE_PAIRS, POWER, STEPS
from abrace_sysid.models.realization import modal_states

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.spectra.frequency_response import FrequencyResponse


def equation_2(
    w: NDArray[np.float64], g: NDArray[np.complex128], n: int, m: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
    """Omega (N, n + 1), Gamma (N, m) and F (N,) of Eq. (2).

    Parameters
    ----------
    w, g
        (N,) frequencies w_j [rad/s], and the transfer function g_j there.
    n, m
        Orders of the numerator B and of the denominator A.
    """
    iw = 1j * w
    Ω = np.vander(iw, n + 1)
    Γ = np.vander(iw, m) * g[:, None]
    F = iw**m * g
    return np.asarray(Ω), np.asarray(Γ), F


def equation_1(
    Ω: NDArray[np.complex128], Γ: NDArray[np.complex128], F: NDArray[np.complex128], λ: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The coefficients {b} = b_n ... b_0 and {a} = a_(m-1) ... a_0 that solve Eq. (1).

    Parameters
    ----------
    Ω, Γ, F
        Of Eq. (2).
    λ
        (N,) the weight of each data point.
    """
    Λ = λ[:, None]
    ΩH, ΓH = Ω.conj().T, Γ.conj().T
    left = np.block([[ΩH @ (Λ * Ω), -ΩH @ (Λ * Γ)], [-ΓH @ (Λ * Ω), ΓH @ (Λ * Γ)]]).real  # Eq. (1), its sign mended
    right = np.concatenate([ΩH @ (λ * F), -ΓH @ (λ * F)]).real
    ba = _solve(left, right)
    return ba[: Ω.shape[1]], ba[Ω.shape[1] :]


def curve_fit(
    w: NDArray[np.float64],
    g: NDArray[np.complex128],
    n: int,
    m: int,
    λ: NDArray[np.float64] | None = None,
    steps: int = STEPS,
    certainty: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """{b} and the whole denominator [1, {a}] of B(s) / A(s), which fits a transfer function.

    Parameters
    ----------
    w, g, n, m
        As of `equation_2`.
    λ
        (N,) weights of the first step; None: w^POWER.
    steps
        Number of further steps, with λ = 1 / |A|^2 of the step before; 0: λ as given.
    certainty
        (N,) factor of λ in these steps, such as 1 / variance of each data point; None: 1.

    Raises
    ------
    AbraceError
        If there are too few data points, or one is not finite.
    """
    if 2 * len(w) < n + m + 1:
        raise AbraceError(f"curve fit: {len(w)} frequency lines, expected at least {(n + m + 2) // 2}")
    if not np.isfinite(g).all():
        raise AbraceError("curve fit: the transfer function has a value that is not finite")
    λ = power_of_frequency(w) if λ is None else λ
    for _ in range(steps + 1):
        b, a = equation_1(*equation_2(w, g, n, m), λ)
        A = np.concatenate([[1.0], a])
        λ = of_denominator(w, A) * (1.0 if certainty is None else certainty)
    return b, A


def power_of_frequency(w: NDArray[np.float64], exponent: float = POWER) -> NDArray[np.float64]:
    """(N,) λ = w^`exponent`, in units of the highest of the frequencies `w`."""
    return np.asarray((w / w[-1]) ** exponent)


def of_denominator(w: NDArray[np.float64], A: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) λ = 1 / |A(iw)|^2 at `w`, with which Eq. (1) minimises the error of g itself; `A` from the step before."""
    return np.asarray(1 / np.abs(np.polyval(A, 1j * w)) ** 2)


def numerator(w: NDArray[np.float64], g: NDArray[np.complex128], A: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """{b} for a given denominator, "by solving the upper equation in Eq. (1)".

    Parameters
    ----------
    w, g, n
        As of `equation_2`.
    A
        [1, {a}].
    """
    Ω, Γ, F = equation_2(w, g, n, len(A) - 1)
    λ = of_denominator(w, A)
    ΩH = Ω.conj().T
    return _solve((ΩH @ (λ[:, None] * Ω)).real, (ΩH @ (λ * (F + Γ @ A[1:]))).real)


def roots(A: NDArray[np.float64]) -> NDArray[np.complex128]:
    """The poles [rad/s] of a denominator `A`, slowest first, of a pair the one above the real axis first."""
    poles = np.roots(A).astype(np.complex128)
    return np.asarray(poles[np.lexsort((-poles.imag, np.round(np.abs(poles), 9)))])


def state_space(measured: FrequencyResponse, A: NDArray[np.float64], delay: float = 0.0) -> LinearModel:
    """Eq. (3), (4) or (5): the part of one denominator, with the numerators of all channels, n = m.

    Parameters
    ----------
    measured
        Transfer functions without hold and delay.
    A
        The common denominator, [1, {a}].
    delay
        Delay of the input [s] that the part keeps.

    Returns
    -------
    LinearModel
        In modal states, a block for each pair of roots of A: a companion matrix holds numbers from 1 to 1e20.
    """
    p = roots(A)
    part = modal_states(p, measured.input, delay)
    C, D = [], []
    for g in measured.response.T:
        b = numerator(measured.omega, g, A, len(A) - 1)
        residues = np.polyval(b, p) / np.polyval(np.polyder(A), p)  # of B(s) / A(s) = b_n + sum of residues / (s - p)
        C.append([part for r, pole in zip(residues, p, strict=True) for part in _row(r, pole)])
        D.append(b[:1])
    return replace(part, c=np.array(C), d=np.array(D), outputs=measured.outputs)


def _row(residue: complex, pole: complex) -> tuple[float, ...]:
    """The entries of C for a pair (at its pole above the real axis) or a real pole."""
    if pole.imag == 0:
        return (residue.real,)
    return (2 * residue.real, 2 * residue.imag) if pole.imag > 0 else ()


@takes_models
def superpose(parts: Sequence[LinearModel], inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
    """Parallel connection z = z1 + z2 + ...: Eqs. (6) and (7).

    A part contributes zero for those of the `inputs` and `outputs` that it lacks.

    Raises
    ------
    AbraceError
        If two parts have different delays for the same input, or different units of the same signal.
    """
    A = linalg.block_diag(*(part.a for part in parts))  # Eq. (7): A1, A2, A3
    B, C_z = np.zeros((len(A), len(inputs))), np.zeros((len(outputs), len(A)))  # B and E; Eq. (6): [C1 C2 C3]
    D_z = np.zeros((len(outputs), len(inputs)))  # D_z = D2 + D3 and F_z = D1
    delay: dict[str, float] = {}
    units: dict[str, str] = {}
    start = 0
    for part in parts:
        states = slice(start, start + part.order)
        rows = [outputs.index(name) for name in part.outputs]
        columns = [inputs.index(name) for name in part.inputs]
        B[states, columns] = part.b
        C_z[rows, states] = part.c
        D_z[np.ix_(rows, columns)] += part.d
        for name, seconds in zip(part.inputs, part.input_delay, strict=True):
            if delay.setdefault(name, seconds) != seconds:
                raise AbraceError(f"superposition: input {name} is delayed by {delay[name]} s and by {seconds} s")
        for name in (*part.inputs, *part.outputs):
            unit = part.units.get(name, "")
            if units.setdefault(name, unit) != unit:
                raise AbraceError(
                    f"superposition: {name} in {units[name] or 'SI units'!r} and in {unit or 'SI units'!r}"
                )
        start += part.order
    delays = tuple(delay.get(name, 0.0) for name in inputs)
    stated = {name: unit for name, unit in units.items() if unit}
    return LinearModel(A, B, C_z, D_z, inputs, outputs, input_delay=delays, units=stated)


class PaperModel(NamedTuple):
    """The model of Eqs. (6) and (7), and the eigenvalues of A1 and of A2 [rad/s], slowest first."""

    model: LinearModel
    table: NDArray[np.complex128]
    command: NDArray[np.complex128]


def paper_model(
    table: FrequencyResponse,
    commands: Sequence[FrequencyResponse],
    floors: int,
    order: int = 0,
    power: float = POWER,
    steps: int = STEPS,
    delay: float = 0.0,
) -> PaperModel:
    """Eqs. (1) to (7): from measured transfer functions to the superposed model.

    Parameters
    ----------
    table, commands
        Responses of z to the table's acceleration and to each command, as measured: with the hold of the sampled input,
        which is divided out, as no ratio of polynomials holds it.
    floors
        Number of floors: A1 and A3 have two states for each.
    order
        Order m = n of A2; 0: two for each floor, and MORE_PAIRS pairs.
    power, steps
        λ = w^power in the first step of a curve fit; number of further steps with λ = 1 / |A|^2 of the step before.
    delay
        Lag of the actuators [s] from the bench test of Fig. 2: divided out before the fit, and kept as delay of the
        command.

    Raises
    ------
    AbraceError
        If no acceleration is among the channels, or a fit has an unstable pole or too few oscillating ones.
    """
    accelerations = [name for name in table.outputs if name.startswith("a")]
    others = [name for name in table.outputs if name not in accelerations]
    if not accelerations:
        raise AbraceError(f"the paper's method: no acceleration among {', '.join(table.outputs)}, expected one")

    def denominator(measured: FrequencyResponse, m: int) -> NDArray[np.float64]:
        top = measured.outputs.index(accelerations[-1])  # the top floor's
        g, sigma = measured.response[:, top], measured.sigma[:, top]
        λ = power_of_frequency(measured.omega, power)
        A = curve_fit(measured.omega, g, m, m, λ, steps, uncertainty_weights(g, sigma))[1]
        require_stable(roots(A), f"the paper's method: {accelerations[-1]} from {measured.input}, order {m}")
        return A

    order = order or 2 * (floors + MORE_PAIRS)
    free = table.without_hold()
    A1 = denominator(free, 2 * floors)
    parts, poles = [state_space(free, A1)], []  # Eq. (3)
    for command in commands:
        free = command.without_hold(delay)
        A2 = denominator(free, order)
        parts.append(state_space(free.select(accelerations), A2, delay))  # Eq. (4)
        poles.append(roots(A2))
        slowest = poles[-1][poles[-1].imag > 0][:floors]
        A3 = np.real(np.poly(np.concatenate([slowest, slowest.conj()]))).astype(np.float64)
        if others:
            parts.append(state_space(free.select(others), A3, delay))  # Eq. (5)
    model = superpose(parts, (table.input, *(command.input for command in commands)), table.outputs)
    return PaperModel(model, roots(A1), poles[0])


def _solve(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """The solution of normal equations, each unknown in the unit that makes its diagonal 1: w^24 is 1e54."""
    unit = 1 / np.sqrt(np.diag(left))
    return np.asarray(unit * np.linalg.lstsq(left * np.outer(unit, unit), unit * right, rcond=None)[0])
