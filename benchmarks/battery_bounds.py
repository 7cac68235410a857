# SPDX-License-Identifier: Apache-2.0
"""What nobody can do better than in a case of `battery`: the Cramer-Rao bound by the truth's own information.

The unknowns are those of maximum likelihood started at the truth: logarithms of each mode's frequency and damping, and
its residue from each input to each output. Their information is that of the training part, each line weighted by the
inverse of the true noise's spectrum; what the records cannot tell at all is limited by the spread with which the
structures are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from battery_cases import Case
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

STEP = 0.02
"""Step of the numerical derivatives, as a share of the damping ratio (of the half-power width, for the frequency)."""

DRAWN = (0.3, 1.0, 1.0)
"""Standard deviations with which cases are drawn: logarithm of frequency, of damping, and residues."""

IDENTIFIABLE = (0.003, 0.1)
"""Greatest standard deviation of frequency and damping, relative, of a mode that can be identified."""


@dataclass(frozen=True)
class Bounds:
    """The truth's information about one case.

    Parameters
    ----------
    frequency, damping
        (modes,) least relative standard deviation of each mode's frequency and damping.
    loss
        (outputs,) share of the held-out variance that maximum likelihood loses on the mean.
    """

    frequency: Array
    damping: Array
    loss: Array

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """(modes,) which modes can be identified."""
        return np.asarray((self.frequency <= IDENTIFIABLE[0]) & (self.damping <= IDENTIFIABLE[1]))


def bounds(case: Case) -> Bounds:
    """The Cramer-Rao bound of a case, and what its prediction loses by it.

    Parameters
    ----------
    case
        The case; the bound is that of its first two thirds.
    """
    sensitivities = _sensitivities(case)
    training, held_out = np.split(sensitivities, [case.cut])
    lines = np.fft.rfft(training - training.mean(axis=0), axis=0)[1:]
    frequency = np.fft.rfftfreq(len(training), 1 / case.sample_rate)[1:]
    # x = L^-1 s has unit covariance where L L^H is the spectrum
    spectrum: NDArray[Any] = len(training) * case.noise_spectrum(frequency)
    factor = np.linalg.cholesky(spectrum)
    white = np.linalg.solve(factor, lines).reshape(-1, sensitivities.shape[2])
    modes, unknowns = len(case.structure.frequencies), sensitivities.shape[2]
    spread = np.repeat(DRAWN, (modes, modes, unknowns - 2 * modes))
    scaled = white * spread
    information = 2 * np.real(scaled.conj().T @ scaled) + np.eye(len(spread))
    covariance = np.linalg.inv(information) * np.outer(spread, spread)
    deviations = np.sqrt(np.diag(covariance))
    size = case.outputs[case.cut :].std(axis=0)
    left = _without_free_decay(case, held_out / size[:, None])
    variances = np.einsum("tpa,ab,tpb->p", left, covariance, left) / len(left)
    return Bounds(deviations[:modes], deviations[modes : 2 * modes], variances)


def _sensitivities(case: Case) -> Array:
    """(samples, outputs, unknowns) derivatives of the outputs with respect to the unknowns."""
    truth, step = case.structure, 1 / (case.sample_rate * case.over)
    outputs, inputs, modes = truth.residues.shape
    samples = len(case.outputs)
    found = np.zeros((samples, outputs, modes, 2 + outputs * inputs))

    def apart(response: Array) -> Array:
        """(samples, outputs, modes), each mode's part."""
        return np.stack([case.sampled(response[:, :, [k]], truth.residues[:, :, [k]]) for k in range(modes)], axis=2)

    for place, change in enumerate((STEP * truth.dampings, np.full(modes, STEP))):
        sides = []
        for sign in (1, -1):
            moved = (
                {"frequencies": truth.frequencies * np.exp(sign * change)}
                if place == 0
                else {"dampings": truth.dampings * np.exp(sign * change)}
            )
            sides.append(apart(replace(truth, **moved).modal_responses(case.driving, step, case.hold)))
        found[:, :, :, place] = (sides[0] - sides[1]) / (2 * change)
    response = truth.modal_responses(case.driving, step, case.hold)
    for j in range(inputs):
        for k in range(modes):
            one = case.sampled(response[:, [j]][:, :, [k]], np.ones((outputs, 1, 1)))
            for i in range(outputs):
                found[:, i, k, 2 + i * inputs + j] = one[:, i]
    # by unknown, then mode
    return np.asarray(np.moveaxis(found, 3, 2).reshape(samples, outputs, -1))


def _without_free_decay(case: Case, held_out: Array) -> Array:
    """(samples, outputs, unknowns) without what an initial state, which is fitted to the held-out part, explains."""
    truth, samples = case.structure, len(held_out)
    outputs, _, modes = truth.residues.shape
    decay = np.exp(np.outer(np.arange(samples) / case.sample_rate, truth.poles))
    size = case.outputs[case.cut :].std(axis=0)
    # each mode has one shape if its residues have rank one
    shapes = truth.residues[:, 0] / size[:, None]
    basis = np.einsum("tk,pk->tpk", decay, shapes)
    columns = np.concatenate([basis.real, basis.imag], axis=2).reshape(samples * outputs, 2 * modes)
    q, _ = np.linalg.qr(columns)
    flat = held_out.reshape(samples * outputs, -1)
    return np.asarray((flat - q @ (q.T @ flat)).reshape(held_out.shape))
