# SPDX-License-Identifier: Apache-2.0
"""Poles fitted to all lines of any records, each line of each output with its own noise.

At a line w of a record the model is exact, whatever the excitation (`pole_basis`):

    Y(w) = sum over poles of [ R F_p(w) U(w) + T_p(w) ] + D U(w) + ends + E(w)

with residues R that all records share and one free decay T of each pole in each record. `ends` are the first and last
samples, where the periodic continuation of a band-limited input errs, and a drift in proportion to time. All but the
poles is linear and real, and eliminated (variable projection, Golub and Pereyra 1973, Kaufman 1975). The parameters of
a pole are the logarithms of its frequency and of its damping ratio: it is stable whatever the step.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_sysid.fitting.curve_fit import stacked
from abrace_sysid.fitting.observation import ENDS, names_of
from abrace_sysid.fitting.pole_basis import forced, sides_of
from abrace_sysid.fitting.pole_estimate import columns_of
from abrace_sysid.fitting.record_columns import RecordColumns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation

USUAL_DAMPING, FACTOR = 0.015, 2.0
"""Median of damping ratios and standard deviation of their logarithm: it decides only where the records do not."""

LEAST_DAMPING, MOST_DAMPING = 2e-6, 0.6
"""Limits of a pole's damping ratio."""

RIDGE = 1e-11
"""Added to the normal equations of columns of unit length; one step of refinement takes its effect away."""

TRIES = 7
"""Most attempts to find a step that lowers the cost."""

APART = 4
"""Up to so many outputs each has a noise of its own spectrum; more have one in common, each with its own level."""

AT_A_TIME = 64
"""Candidates whose gains are computed together."""


class Lines:
    """The lines of all records, in units of each channel's rms, and the columns by which poles act on them.

    An input that a record does not have is at rest in it; an output that it does not have is not fitted there.

    Parameters
    ----------
    observations
        Of the records.
    fixed_poles
        [rad/s], upper or real ones, with free residues: they represent modes above the lines, and poles of servos.
    at_rest
        Whether all records begin at rest, so that no pole has a free decay.

    Attributes
    ----------
    inputs, outputs
        Their numbers.
    driven, present
        (records, inputs) and (records, outputs) which of them each record has.
    places
        Of each record, indices of its inputs among all.
    groups
        Outputs of the same records whose noise has one spectrum.
    per_input
        Number of columns of each input that do not depend on a pole: its direct term, and those of the fixed poles.
    fixed
        All columns that do not depend on a pole, real parts above imaginary ones.
    deviation
        (lines, outputs) standard deviation of the noise, of the outputs of a group in proportion.
    """

    def __init__(
        self, observations: Sequence[Observation], fixed_poles: NDArray[np.complex128], at_rest: bool = False
    ) -> None:
        self.at_rest = at_rest
        self.omega = np.concatenate([one.omega for one in observations])
        ends = np.cumsum([0, *(len(one.omega) for one in observations)])
        self.rows = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        inputs, outputs = names_of(observations)
        self.inputs, self.outputs = len(inputs), len(outputs)
        self.driven, self.present = (
            np.array([np.isin(names, getattr(one, kind)) for one in observations])
            for names, kind in ((inputs, "inputs"), (outputs, "outputs"))
        )
        self.places = [np.array([inputs.index(name) for name in one.inputs]) for one in observations]
        self._shown = np.repeat(self.present, np.diff(ends), axis=0)
        self.excitation, self.measured = (
            np.zeros((len(self.omega), count), dtype=np.complex128) for count in (self.inputs, self.outputs)
        )
        for one, rows, places in zip(observations, self.rows, self.places, strict=True):
            self.excitation[rows, places] = one.excitation
            self.measured[rows, [outputs.index(name) for name in one.outputs]] = one.measured
        units = np.sqrt(np.mean(np.abs(self.excitation) ** 2, axis=0))
        self.excitation /= units
        self.measured /= np.sqrt(np.sum(np.abs(self.measured) ** 2, axis=0) / np.sum(self._shown, axis=0))
        unit = dict(zip(inputs, units, strict=True))
        self.observations = tuple(replace(one.in_units(unit), from_rest=at_rest) for one in observations)
        self.per_input = 1 + columns_of(fixed_poles)[-1].stop if len(fixed_poles) else 1
        count, blocks, kept = self.inputs * self.per_input, [], []
        for one, own in zip(self.observations, self.places, strict=True):
            of_inputs = [
                [drive, *forced(fixed_poles, one.z, [sampling], drive[:, None])]
                for sampling, drive in zip(one.samplings, one.excitation.T, strict=True)
            ]
            ends_of_it = [*(one.z ** -float(sample) for sample in ENDS), one.z / (one.z - 1)] if one.is_record else []
            blocks.append(stacked(np.column_stack([*itertools.chain(*of_inputs), *ends_of_it])))
            driven = (self.per_input * own[:, None] + np.arange(self.per_input)).ravel()
            kept.append(np.concatenate([driven, count + np.arange(len(ends_of_it))]))
            count += len(ends_of_it)
        self.fixed = self._columns(count, kept, blocks)
        self.groups = [np.array([o]) for o in range(self.outputs)]
        if self.outputs > APART:
            patterns = np.unique(self.present, axis=1).T
            self.groups = [np.flatnonzero((each == self.present.T).all(axis=1)) for each in patterns]
        self.deviation = np.ones(self.measured.shape)

    @property
    def values(self) -> int:
        """Number of complex values that were measured."""
        return int(self._shown.sum())

    @property
    def forced_parts(self) -> int:
        """Number of real unknowns of a pole's forced part: two for each input and output of one record."""
        return 2 * int((self.driven.T.astype(int) @ self.present > 0).sum())

    @property
    def free_parts(self) -> int:
        """Number of real unknowns of a pole's free decays: two for each output and record with leakage."""
        return 2 * int(self.present[[one.transient for one in self.observations]].sum())

    def level(self) -> NDArray[np.float64]:
        """(lines,) the noise's standard deviation, over the outputs measured the geometric mean, median of each 1."""
        relative = np.log(np.where(self._shown, self.deviation, np.nan))
        return np.asarray(np.exp(np.nanmean(relative - np.nanmedian(relative, axis=0), axis=1)))

    def weight(
        self, deviation: NDArray[np.float64], group: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(2 lines,) weights of a group's first output, and (group,) deviations of its outputs in units of the first.

        Parameters
        ----------
        deviation
            (lines, outputs) of the noise.
        group
            One of the groups.
        """
        shown, first = self._shown[:, group[0]], deviation[:, group[0]]
        line = int(np.argmax(shown))
        weight = np.where(shown, np.sqrt(2) / first, 0.0)
        return np.tile(weight, 2), deviation[line, group] / first[line]

    @property
    def per_pole(self) -> int:
        """Number of columns of a pole: two for each input and for each record."""
        return 2 * (self.inputs + len(self.rows))

    def columns(self, poles: NDArray[np.complex128], slopes: bool = False) -> RecordColumns:
        """The columns of each pole, forced ones first, `per_pole` of each; or their derivatives by it.

        Parameters
        ----------
        poles
            Upper ones.
        slopes
            Whether the derivatives are asked for.
        """
        part, blocks, places = int(slopes), [], []
        for number, one in enumerate(self.observations):
            of_pole = self.of_record(number)
            own, half = len(of_pole), len(one.omega)
            block = np.empty((2 * half, own * len(poles)), order="F")
            real, imaginary = block[:half], block[half:]
            for i, pole in enumerate(poles):
                sides = sides_of(pole)
                for j in range(len(one.inputs)):
                    above, below = (one.state(side, j)[part] for side in sides)
                    _fill(real, imaginary, own * i + 2 * j, above, below, -pole.real)
                if own > 2 * len(one.inputs):
                    sampling = one.samplings[0]
                    above, below = (sampling.transient(side, one.z)[part] for side in sides)
                    size = -pole.real * sampling.sample_period
                    _fill(real, imaginary, own * (i + 1) - 2, above, below, size)
            blocks.append(block)
            places.append((self.per_pole * np.arange(len(poles))[:, None] + of_pole).ravel())
        return self._columns(self.per_pole * len(poles), places, blocks)

    def of_record(self, number: int) -> NDArray[np.int64]:
        """Which of a pole's columns the record of this number has."""
        inputs = self.places[number]
        decay = (
            []
            if self.at_rest or not self.observations[number].transient
            else [2 * (self.inputs + number), 2 * (self.inputs + number) + 1]
        )
        return np.array([*np.column_stack([2 * inputs, 2 * inputs + 1]).ravel(), *decay])

    def _columns(
        self, count: int, places: Sequence[NDArray[np.int64]], blocks: Sequence[NDArray[np.float64]]
    ) -> RecordColumns:
        """So many columns, made of a block of each record."""
        half = len(self.omega)
        rows = tuple(np.concatenate([np.r_[each], half + np.r_[each]]) for each in self.rows)
        return RecordColumns(2 * half, count, rows, tuple(places), tuple(blocks))


def _fill(
    real: NDArray[np.float64],
    imaginary: NDArray[np.float64],
    place: int,
    above: NDArray[np.complex128],
    below: NDArray[np.complex128],
    by: float,
) -> None:
    """Write the two real combinations of both sides of a pair (`pole_basis.combined`) to columns from `place`."""
    total, apart = 0.5 * by * (above + below), 0.5 * by * (above - below)
    real[:, place], imaginary[:, place] = total.real, total.imag
    real[:, place + 1], imaginary[:, place + 1] = -apart.imag, apart.real


def poles_of(parameters: NDArray[np.float64]) -> NDArray[np.complex128]:
    """The upper poles of `parameters` (poles, 2), logarithms of frequency [rad/s] and damping ratio."""
    size, damping = np.exp(parameters[:, 0]), np.exp(parameters[:, 1])
    return np.asarray(size * (-damping + 1j * np.sqrt(1 - damping**2)))


def parameters_of(poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(poles, 2) logarithms of frequency and damping ratio of upper poles."""
    size = np.abs(poles)
    return np.column_stack([np.log(size), np.log(np.clip(-poles.real / size, LEAST_DAMPING, MOST_DAMPING))])


@dataclass(frozen=True)
class LineFit:
    """Residues, decays, direct terms and ends of given poles, by weighted least squares.

    Parameters
    ----------
    lines, poles
    usual
        (poles, 2) expected damping ratio and standard deviation of its logarithm.
    deviation
        (lines, outputs) of the noise, with which it was fitted.
    coefficients
        (coefficients, outputs).
    residual
        (2 lines, outputs) in standard deviations of the noise.
    weighted, factors, norms
        Of each group of outputs: columns in standard deviations of its first output, Cholesky factor of their products,
        and lengths, by which these are divided.
    """

    lines: Lines
    poles: NDArray[np.complex128]
    usual: NDArray[np.float64]
    deviation: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    residual: NDArray[np.float64]
    weighted: tuple[RecordColumns, ...]
    factors: tuple[NDArray[np.float64], ...]
    norms: tuple[NDArray[np.float64], ...]

    @classmethod
    def at(cls, lines: Lines, poles: NDArray[np.complex128], usual: NDArray[np.float64] | None = None) -> LineFit:
        """The fit with these poles and the lines' present noise; dampings `usual` as in `LineFit`, None: as of any."""
        usual = np.tile((USUAL_DAMPING, FACTOR), (len(poles), 1)) if usual is None else usual
        columns = lines.columns(poles).beside(lines.fixed)
        measured = stacked(lines.measured)
        coefficients, residual = np.empty((columns.count, lines.outputs)), np.empty_like(measured)
        each, factors, norms = [], [], []
        for group in lines.groups:
            weight, size = lines.weight(lines.deviation, group)
            own = columns.weighted(weight)
            normal = own.squares()
            norm = np.sqrt(np.diag(normal))
            norm[norm == 0] = 1.0
            normal /= norm[:, None] * norm
            normal[np.diag_indices_from(normal)] += RIDGE
            factor = linalg.cholesky(normal, lower=True, check_finite=False)
            target = measured[:, group] * weight[:, None]
            found, left = np.zeros((len(norm), len(group))), target
            for _ in range(2):
                found = found + _solved(factor, own.onto(left) / norm[:, None]) / norm[:, None]
                left = target - own.times(found)
            residual[:, group], coefficients[:, group] = left / size, found
            each.append(own)
            factors.append(factor)
            norms.append(norm)
        return cls(
            lines, poles, usual, lines.deviation, coefficients, residual, tuple(each), tuple(factors), tuple(norms)
        )

    @property
    def misfit(self) -> float:
        """Sum of the squared residuals: chi-square."""
        return float(np.sum(self.residual**2))

    @property
    def surprise(self) -> NDArray[np.float64]:
        """(poles,) distance of the damping from the usual one, in standard deviations."""
        return np.asarray((parameters_of(self.poles)[:, 1] - np.log(self.usual[:, 0])) / self.usual[:, 1])

    @property
    def cost(self) -> float:
        """The misfit, and what the dampings' distance from usual ones adds."""
        return self.misfit + float(self.surprise @ self.surprise)

    def of_pole(self, i: int) -> NDArray[np.float64]:
        """(columns, outputs) the coefficients of the pole `i`."""
        per = self.lines.per_pole
        return self.coefficients[per * i : per * (i + 1)]

    def errors(self) -> NDArray[np.complex128]:
        """(lines, outputs) what the fit leaves."""
        half = len(self.lines.omega)
        scale = self.deviation / np.sqrt(2)
        return np.asarray((self.residual[:half] + 1j * self.residual[half:]) * scale)

    def responses(self) -> NDArray[np.complex128]:
        """(lines, outputs, inputs) the forced response to each input."""
        lines, m = self.lines, self.lines.inputs
        start = lines.per_pole * len(self.poles)
        direct = self.coefficients[start : start + m * lines.per_input : lines.per_input]
        found = np.repeat(direct.T[None].astype(np.complex128), len(lines.omega), axis=0)
        if not len(self.poles):
            return found
        own = self.coefficients[:start].reshape(len(self.poles), lines.per_pole, lines.outputs)
        residues = -self.poles.real[:, None, None] * (own[:, 0 : 2 * m : 2] + 1j * own[:, 1 : 2 * m : 2]) / 2
        for one, rows, places in zip(lines.observations, lines.rows, lines.places, strict=True):
            for j, sampling in zip(places, one.samplings, strict=True):
                sides = [[sampling.response(side, one.z)[0] for side in sides_of(pole)] for pole in self.poles]
                above, below = (np.column_stack(each) for each in zip(*sides, strict=True))
                found[rows, :, j] += above @ residues[:, j] + below @ residues[:, j].conj()
        return found

    def curvature(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Of half the cost: Gauss and Newton's second derivatives (parameters, parameters), and descent (parameters,).

        A residual's derivative by a pole is columns' derivatives times coefficients, less what the residues take up:
        the products of the columns serve all outputs of a group.
        """
        count, per = len(self.poles), self.lines.per_pole
        turned = np.empty((count, 2, per, self.lines.outputs))
        for i, pole in enumerate(self.poles):
            size, damping = abs(pole), -pole.real / abs(pole)
            by_damping = size * (-damping - 1j * damping**2 / np.sqrt(1 - damping**2))
            c = self.of_pole(i)
            for kind, step in enumerate((pole, by_damping)):
                pairs = (c[0::2] + 1j * c[1::2]) * step
                turned[i, kind] = np.stack([pairs.real, pairs.imag], axis=1).reshape(c.shape)
        slopes = self.lines.columns(self.poles, slopes=True)
        normal, descent = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        for group, basis, factor, norm in zip(self.lines.groups, self.weighted, self.factors, self.norms, strict=True):
            weight, size = self.lines.weight(self.deviation, group)
            change, own = turned[..., group] / size, slopes
            if 2 * len(group) < per:
                # the derivatives themselves are fewer than the columns they are made of
                own = self._derivatives(slopes, change[..., 0])
                change = np.tile(np.eye(2)[:, :, None], (count, 1, 1, 1))
            own = own.weighted(weight)
            columns = own.count // count
            shared = basis.products(own) / norm[:, None]
            squares = own.squares()
            products = np.tril(squares) + np.tril(squares, -1).T - shared.T @ _solved(factor, shared)
            products = products.reshape(count, columns, count, columns)
            normal += np.einsum("aipo,apbq,bkqo->aibk", change, products, change, optimize=True).reshape(normal.shape)
            onto = own.onto(self.residual[:, group]).reshape(count, columns, len(group))
            descent += np.einsum("aipo,apo->ai", change, onto).ravel()
        damped = 2 * np.arange(count) + 1
        normal[damped, damped] += 1 / self.usual[:, 1] ** 2
        descent[damped] -= self.surprise / self.usual[:, 1]
        return normal, descent

    def _derivatives(self, slopes: RecordColumns, change: NDArray[np.float64]) -> RecordColumns:
        """Two columns of each pole: those of its `slopes`, in the proportions of (poles, 2, columns of a pole)."""
        count, blocks = len(self.poles), []
        for number, block in enumerate(slopes.blocks):
            of_pole = self.lines.of_record(number)
            size = len(of_pole)
            made = np.empty((len(block), 2 * count), order="F")
            for i in range(count):
                made[:, 2 * i : 2 * i + 2] = block[:, size * i : size * (i + 1)] @ change[i][:, of_pole].T
            blocks.append(made)
        places = (np.arange(2 * count),) * len(blocks)
        return replace(slopes, count=2 * count, places=places, blocks=tuple(blocks))

    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the logarithms of frequency and damping ratio of all poles, in turn."""
        normal, _ = self.curvature()
        excess = self.cost / max(2 * self.lines.values - self.coefficients.size - len(normal), 1)
        return np.asarray(np.linalg.pinv(normal) * max(1.0, excess))

    def explained(self, forced: bool = False) -> NDArray[np.float64]:
        """(poles,) what each pole explains (chi-square), or its `forced` response alone, all else fitted again."""
        per, found = self.lines.per_pole, np.zeros(len(self.poles))
        for group, factor, norm in zip(self.lines.groups, self.factors, self.norms, strict=True):
            inverse = _solved(factor, np.eye(len(norm)))
            scaled = self.coefficients[:, group] * norm[:, None] / self.lines.weight(self.deviation, group)[1]
            for i in range(len(self.poles)):
                own = slice(per * i, per * i + (2 * self.lines.inputs if forced else per))
                found[i] += float(np.sum(scaled[own] * np.linalg.solve(inverse[own, own], scaled[own])))
        return found

    def gains(self, candidates: NDArray[np.complex128]) -> NDArray[np.float64]:
        """(candidates,) what each further pole would explain (chi-square), not refined."""
        per, found = self.lines.per_pole, np.zeros(len(candidates))
        for start in range(0, len(candidates), AT_A_TIME):
            columns = self.lines.columns(candidates[start : start + AT_A_TIME])
            count = columns.count // per
            for group, basis, factor, norm in zip(
                self.lines.groups, self.weighted, self.factors, self.norms, strict=True
            ):
                own = columns.weighted(self.lines.weight(self.deviation, group)[0])
                shared = (basis.products(own) / norm[:, None]).T.reshape(count, per, -1)
                products = np.zeros((count, per, per))
                for places, block in zip(own.places, own.blocks, strict=True):
                    mine = block.T.reshape(count, block.shape[1] // count, -1)
                    of_pole = places[: mine.shape[1]]
                    products[:, of_pole[:, None], of_pole] += mine @ mine.transpose(0, 2, 1)
                scale = np.sqrt(np.maximum(np.diagonal(products, axis1=1, axis2=2), np.finfo(float).tiny))
                taken = _solved(factor, shared.reshape(count * per, -1).T).T.reshape(shared.shape)
                apart = (products - shared @ taken.transpose(0, 2, 1)) / (scale[:, :, None] * scale[:, None])
                apart[:, range(per), range(per)] += 1e-9
                of_own = own.onto(self.residual[:, group]).reshape(count, per, -1) / scale[:, :, None]
                explained = np.sum(of_own * np.linalg.solve(apart, of_own), axis=(1, 2))
                found[start : start + count] += explained
        return found


def _solved(factor: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """The solution of the normal equations with this lower Cholesky factor."""
    return np.asarray(linalg.cho_solve((factor, True), right, check_finite=False))


def refined(
    lines: Lines,
    poles: NDArray[np.complex128],
    steps: int = 12,
    settled: float = 1e-3,
    usual: NDArray[np.float64] | None = None,
) -> LineFit:
    """The fit after Levenberg-Marquardt steps from these poles.

    Parameters
    ----------
    lines, poles
    steps
        Most steps.
    settled
        A step that lowers the cost by less ends them.
    usual
        As of `LineFit`.
    """
    fit, damping = LineFit.at(lines, poles, usual), 1e-3
    if not len(poles):
        return fit
    low, high = np.log(0.3 * lines.omega.min()), np.log(lines.omega.max())
    for _ in range(steps):
        (normal, descent), now = fit.curvature(), parameters_of(fit.poles)
        curvature = np.diag(normal) + 1e-9
        limits = np.column_stack([np.maximum(0.02, 3 * np.exp(now[:, 1])), np.full(len(now), 1.5)])
        gain = 0.0
        for _ in range(TRIES):
            step = np.linalg.solve(normal + np.diag(damping * curvature + 1e-12), descent).reshape(-1, 2)
            later = now + np.clip(step, -limits, limits)
            later[:, 0] = np.clip(later[:, 0], low, high)
            later[:, 1] = np.clip(later[:, 1], np.log(LEAST_DAMPING), np.log(MOST_DAMPING))
            new = LineFit.at(lines, poles_of(later), usual)
            if new.cost < fit.cost:
                gain, fit, damping = fit.cost - new.cost, new, max(damping / 8, 1e-9)
                break
            damping = 8 * max(damping, 1e-6)
        if gain < settled * max(1.0, 1e-6 * fit.misfit):
            break
    return fit
