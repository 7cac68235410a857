# SPDX-License-Identifier: Apache-2.0
"""Delays of single channels: the time shift with which known modes explain an output, or the outputs, best.

The modes' shapes are complex and free, and follow a delay at each resonance. Between and beside the resonances they
cannot: a delay there multiplies the tails of all modes and the direct terms by exp(-i w t). So the likelihood over the
shift of one output has a maximum at its delay, whatever the output measures. With several inputs, one of them can act
late against the first: then the shift is that of its column.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize

from abrace_sysid.fitting.curve_fit import stacked
from abrace_sysid.fitting.observation import names_of
from abrace_sysid.fitting.pole_basis import forced, transients
from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation

MOST_SAMPLES, GRID = 8, 0.25
"""Greatest delay that is searched, and the steps of the search, in samples."""

MODEL_ERROR, OF_INPUT = 0.02, 0.15
"""Standard deviation [samples] that the tails of modes above the band, and the ends of a record, add: of an output; of
an input, of which each output's shapes can take up the most."""

CERTAIN = 5.0
"""A delay is claimed from so many standard deviations on."""

EXPLAINS = 0.7
"""Greatest share that a delay leaves. Where the model errs otherwise (clipped, nonlinear) it leaves 0.89 and more."""

AS_LIKELY = 8.0
"""Shifts whose -log likelihood is greater by less (four standard deviations) may be right as well."""

SETTLED = 0.02
"""Samples; a smaller change ends the iterations."""

ITERATIONS = 8
"""Most Gauss-Newton steps to the maximum near that of the search."""

LINES, FEW_LINES = 4000, 1000
"""Approximate number of a record's lines that are used: for outputs, and for inputs, where all is computed anew."""

PIECES = 16
"""Parts of the band whose scores are taken as independent, for the standard deviation."""


class Delay(NamedTuple):
    """A delay [s] of an output, positive if it is late, or of an input's action, with its standard deviation.

    `left` is the share that remains, with it, of the power that the modes alone do not explain; `apart` how far [s] the
    delays are from it that explain as much: in some records shapes of modes and a delay can hardly be told apart.
    """

    seconds: float
    deviation: float
    left: float
    apart: float = 0.0

    @property
    def is_certain(self) -> bool:
        """Whether it is far beyond its uncertainty, and explains what the modes do not."""
        return abs(self.seconds) > CERTAIN * self.deviation and self.left < EXPLAINS

    def words(self, sample_period: float) -> str:
        """As "3.00 ± 0.02 samples (15 ms) late", in samples of `sample_period` [s]."""
        samples = abs(self.seconds) / sample_period
        spread = max(NORMAL_95 * self.deviation, self.apart) / sample_period
        side = "late" if self.seconds > 0 else "early"
        return f"{samples:.2f} ± {spread:.2f} samples ({1e3 * abs(self.seconds):.3g} ms) {side}"


def output_delays(observations: Sequence[Observation], poles: NDArray[np.complex128]) -> tuple[Delay, ...]:
    """The delay of each output (`names_of`) against the inputs.

    Parameters
    ----------
    observations
        Records of one structure, with noise.
    poles
        Of the modes, and of the pairs that represent modes above the band [rad/s].
    """
    records = [one.thinned(LINES) for one in observations]
    period = records[0].samplings[0].sample_period
    bases = [_basis(one, poles) for one in records]

    def left_over(record: int, lines: NDArray[np.complex128]) -> NDArray[np.float64]:
        q, values = bases[record], stacked(lines / records[record].noise_level[:, None])
        return np.asarray(values - q @ (q.T @ values))

    grid = np.arange(-MOST_SAMPLES, MOST_SAMPLES + GRID, GRID) * period
    found = []
    for name in names_of(records)[1]:
        having = [(i, one, one.outputs.index(name)) for i, one in enumerate(records) if name in one.outputs]
        cost, lines = np.zeros(len(grid)), sum(len(one.z) for _, one, _ in having)
        for i, one, channel in having:
            turned = one.measured[:, [channel]] * np.exp(1j * np.outer(one.omega, grid))
            power = np.sum(left_over(i, turned) ** 2, axis=0)
            cost += len(one.z) * np.log(np.maximum(power, np.finfo(float).tiny))
        seconds = float(grid[np.argmin(cost)])
        for _ in range(ITERATIONS):
            curvature, scores, least = 0.0, [], 0.0
            for i, one, channel in having:
                turned = one.measured[:, [channel]] * np.exp(1j * one.omega * seconds)[:, None]
                rest = left_over(i, turned)
                slope = left_over(i, 1j * one.omega[:, None] * turned)
                power = max(float(np.mean(rest**2)), np.finfo(float).tiny)
                curvature += float(np.sum(slope**2)) / power
                least += len(one.z) * np.log(power * 2 * len(one.z))
                of_lines = (slope * rest).reshape(2, -1).sum(axis=0) / power
                scores += [float(part.sum()) for part in np.array_split(of_lines, PIECES)]
            if not curvature > 0:
                break
            step = sum(scores) / curvature
            seconds -= float(np.clip(step, -GRID * period, GRID * period))
        random = float(np.sqrt(np.sum(np.square(scores)))) / curvature if curvature > 0 else np.inf
        left = float(np.exp((least - cost[len(grid) // 2]) / lines))
        deviation, apart = float(np.hypot(random, MODEL_ERROR * period)), _apart(seconds, grid, cost)
        found.append(Delay(seconds, deviation, left, apart))
    return tuple(found)


def input_delays(observations: Sequence[Observation], poles: NDArray[np.complex128]) -> tuple[Delay, ...]:
    """By how much each input after the first acts later than the first, on all outputs.

    Parameters
    ----------
    observations, poles
        As for `output_delays`.
    """
    records = [one.thinned(FEW_LINES) for one in observations]
    period = records[0].samplings[0].sample_period
    lines = sum(one.measured.size for one in records)

    def cost(seconds: float, number: int) -> float:
        """-log likelihood of all outputs, each with its own noise."""
        found = 0.0
        for one in records:
            excitation = one.excitation.copy()
            excitation[:, number] *= np.exp(-1j * one.omega * seconds)
            q = _basis(replace(one, excitation=excitation), poles)
            values = stacked(one.measured / one.noise_level[:, None])
            power = np.sum((values - q @ (q.T @ values)) ** 2, axis=0)
            found += len(one.z) * float(np.sum(np.log(np.maximum(power, np.finfo(float).tiny))))
        return found

    found = []
    for number in range(1, len(records[0].inputs)):
        grid = np.arange(-MOST_SAMPLES, MOST_SAMPLES + 2 * GRID, 2 * GRID) * period
        costs = [cost(seconds, number) for seconds in grid]
        first, step = grid[int(np.argmin(costs))], 2 * GRID * period
        around = first - step, first + step
        near = optimize.minimize_scalar(
            cost, bounds=around, args=(number,), method="bounded", options={"xatol": 0.002 * period}
        )
        before, after = (cost(near.x + side * 0.1 * period, number) for side in (-1, 1))
        curvature = (before + after - 2 * near.fun) / (0.1 * period) ** 2
        random = 1 / np.sqrt(curvature) if curvature > 0 else np.inf
        left = float(np.exp((near.fun - costs[len(grid) // 2]) / lines))
        deviation, apart = float(np.hypot(random, OF_INPUT * period)), _apart(near.x, grid, np.array(costs))
        found.append(Delay(float(near.x), deviation, left, apart))
    return tuple(found)


def _apart(seconds: float, grid: NDArray[np.float64], cost: NDArray[np.float64]) -> float:
    """How far [s] the shifts of a `grid` are from a delay that are about as likely; `cost`: -log likelihood of each."""
    alike = grid[cost < cost.min() + AS_LIKELY]
    return max(0.0, float(np.abs(alike - seconds).max() - (grid[1] - grid[0])))


def _basis(one: Observation, poles: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(2 lines, columns) orthogonal: what these poles, the inputs and a record's ends can make."""
    columns: list[NDArray[np.complex128]] = [*forced(poles, one.z, one.samplings, one.excitation), *one.excitation.T]
    columns += transients(poles, one.z, one.samplings[0])
    # the shift is circular: samples that leave at one end of the record come in at the other
    columns += [one.z ** float(sample) for sample in range(-MOST_SAMPLES, MOST_SAMPLES + 1)]
    basis = stacked(np.column_stack(columns).astype(np.complex128) / one.noise_level[:, None])
    return np.asarray(np.linalg.qr(basis / np.linalg.norm(basis, axis=0))[0])
