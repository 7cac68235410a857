# SPDX-License-Identifier: Apache-2.0
"""The frequency lines of tests, linearised at given modes: basis, derivatives (slopes), channels, and a QR factor.

The lines are used once, in an orthogonal factorisation of [basis, slopes, channels]. All further computations use the
triangular factor, whose size does not depend on the length of the test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from abrace_core import AbraceError
from abrace_sysid.fitting.curve_fit import stacked, triangular_factor
from abrace_sysid.fitting.modes import across
from abrace_sysid.fitting.observation import ENDS
from abrace_sysid.fitting.pole_basis import combined, sides_of, whole_samples
from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.modes import Modes
    from abrace_sysid.fitting.observation import Observation

ROUNDING = 1e-12
"""Shares of a unit vector that are due to rounding."""


@dataclass(frozen=True)
class Slope:
    """The derivative of a test's response with respect to one parameter: columns times coefficients times a factor.

    `columns` are indices into the test's [basis, slopes]; `parameter` is the index of the parameter, real or complex.
    """

    columns: slice
    coefficient: slice
    parameter: slice
    factor: complex = 1.0


@dataclass(frozen=True)
class CondensedLines:
    """One test: its basis, slopes and channels at every line, real parts above imaginary parts, and their QR factor.

    `observation` is the test; `columns` are the indices of the basis among all coefficients; `basis`, `slopes` (which
    begin with the basis) and `measured` have 2 * lines rows; `small` is the triangular factor of [slopes, measured].
    """

    observation: Observation
    columns: NDArray[np.int64]
    kinds: tuple[Slope, ...]
    basis: NDArray[np.float64]
    slopes: NDArray[np.float64]
    measured: NDArray[np.float64]
    small: NDArray[np.float64]

    @property
    def parts(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The basis, basis and slopes, and channels, condensed."""
        first, second = self.basis.shape[1], self.slopes.shape[1]
        return self.small[:, :first], self.small[:, :second], self.small[:, second:]

    def derivatives(self, coefficients: NDArray[np.float64], parameters: int) -> sparse.csr_matrix:
        """(parameters, slopes) matrix from the slopes to the derivatives of a channel with these `coefficients`."""
        columns, rows, places, factors = self._entries
        values = factors[:, 0] * coefficients[places[:, 0]] + factors[:, 1] * coefficients[places[:, 1]]
        # as csr_matrix wants them: entries row by row, and where each row begins
        begins = np.searchsorted(rows, np.arange(parameters + 1))
        return sparse.csr_matrix((values, columns, begins), shape=(parameters, self.slopes.shape[1]))

    @cached_property
    def _entries(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Entries of `derivatives` by parameter: slope, parameter, indices of two coefficients, and their factors."""
        columns, rows, places, factors = [], [], [], []
        for kind in self.kinds:
            first, last = kind.coefficient.start, kind.coefficient.stop - 1
            for number, row in enumerate(range(kind.parameter.start, kind.parameter.stop)):
                # a complex number c weighs the two columns of a pair by its parts; of its derivatives the other is i c
                turned = kind.factor * 1j**number
                second = turned * 1j if last > first else 0j
                parts = ((turned.real, second.real), (turned.imag, second.imag))
                for column, part in zip(range(kind.columns.start, kind.columns.stop), parts, strict=False):
                    columns.append(column)
                    rows.append(row)
                    places.append((first, last))
                    factors.append(part)
        order = np.argsort(rows, kind="stable")
        return np.array(columns)[order], np.array(rows)[order], np.array(places)[order], np.array(factors)[order]


def condensed(observations: Sequence[Observation], inputs: Sequence[str], modes: Modes) -> tuple[CondensedLines, ...]:
    """Each test's lines, linearised at given modes, with their triangular factor.

    The coefficients of a channel are those of all modes, then the direct terms of each group of tests with the same
    inputs and modes, then each test's transient.

    Parameters
    ----------
    observations

    Raises
    ------
    AbraceError
        If a test has fewer lines than unknowns.
    """
    places = columns_of(modes.poles)
    direct, end = direct_terms(observations, inputs, modes)
    tests = []
    for observation in observations:
        shown = observation.shown(modes.poles)
        first = direct[observation.inputs, shown]
        basis, slopes, columns, kinds, alike = _lines_of(observation, inputs, modes, shown, places, end, first)
        end = max(end, 1 + max(columns))
        unknowns = len(columns) + modes.size
        if 2 * len(observation.z) <= unknowns:
            raise AbraceError(
                f"{observation.source}: {len(observation.z)} frequency lines, expected more than {unknowns // 2}"
            )
        lines = np.array([*basis, *slopes, *observation.measured.T], dtype=np.complex128) / observation.noise_level
        whole = stacked(lines.T)
        small = triangular_factor(whole, alike)
        changes, measured = np.split(whole, [len(basis) + len(slopes)], axis=1)
        own = np.array(columns)
        tests.append(CondensedLines(observation, own, kinds, changes[:, : len(basis)], changes, measured, small))
    return tuple(tests)


def direct_terms(
    observations: Sequence[Observation], inputs: Sequence[str], modes: Modes
) -> tuple[dict[tuple[tuple[str, ...], tuple[int, ...]], int], int]:
    """For each group of tests with the same inputs and modes, the index of its direct terms; and the index after them.

    Parameters
    ----------
    observations, inputs, modes
        As for `condensed`.
    """
    end = columns_of(modes.poles)[-1].stop
    found: dict[tuple[tuple[str, ...], tuple[int, ...]], int] = {}
    for observation in observations:
        group = observation.inputs, observation.shown(modes.poles)
        if group not in found:
            found[group] = end
            end += sum(modes.direct[inputs.index(name)] for name in observation.inputs)
    return found, end


def _lines_of(
    observation: Observation,
    inputs: Sequence[str],
    modes: Modes,
    shown: Sequence[int],
    places: Sequence[slice],
    transient_at: int,
    direct_at: int,
) -> tuple[list[NDArray[np.complex128]], list[NDArray[np.complex128]], list[int], tuple[Slope, ...], list[int]]:
    """The basis (modes, transients, direct terms), the slopes of every parameter, and the coefficients' indices.

    The indices of slopes begin after those of the basis. Last, the indices of the columns of slow real poles, which are
    nearly the same for several servos.
    """
    z = observation.z
    named = [inputs.index(name) for name in observation.inputs]
    at = {(mode, direction): columns for mode, direction, columns in modes.parameters()}
    delays = modes.delay_columns()
    basis: list[NDArray[np.complex128]] = []
    slopes: list[NDArray[np.complex128]] = []
    columns: list[int] = []
    of_basis: list[Slope] = []
    of_slopes: list[Slope] = []
    alike: list[list[int]] = [[], []]  # among the basis, and among the slopes

    def add_columns(new: list[NDArray[np.complex128]]) -> slice:
        slopes.extend(new)
        return slice(len(slopes) - len(new), len(slopes))

    def add_slope(new: list[NDArray[np.complex128]], coefficient: slice, parameter: slice) -> None:
        of_slopes.append(Slope(add_columns(new), coefficient, parameter))

    # a transient that is over within a sample is the same at all lines, whatever its pole; and fixed poles have none
    at_once = -modes.poles.real * observation.samplings[0].sample_period > 1
    slow = ~at_once & ~modes.fixed
    later: list[tuple[int, slice, complex]] = []  # of delayed inputs themselves: which, coefficients and factor
    for mode in shown:
        pole, place = modes.poles[mode], places[mode]
        sides = sides_of(pole)
        before = len(basis), len(slopes)
        # a fixed pole stands for others: it has no history
        whole = replace(observation, from_rest=False) if modes.fixed[mode] else observation
        responses, changes = [], []  # of each side (the pole, its conjugate): (lines, inputs)
        for side in sides:
            pairs = [whole.state(side, number, modes.delays[i]) for number, i in enumerate(named)]
            responses.append(np.column_stack([pair[0] for pair in pairs]))
            changes.append(np.column_stack([pair[1] for pair in pairs]))
        drive = modes.drive[mode]
        own = slice(len(basis), len(basis) + len(sides))
        basis += combined(responses, drive[named])
        columns += range(place.start, place.stop)
        add_slope(combined(changes, drive[named]), place, at[mode, None])
        # the states that this test's inputs can make: orthogonal combinations of the inputs, the first is the drive's
        axes = [(own, drive[named], of_basis)] if drive[named].any() else []
        for vector in across(drive[named], modes.driven[mode, named], pole.imag > 0).T:
            axes.append((add_columns(combined(responses, vector)), vector, of_slopes))

        # changes of the state, as those of inputs in these proportions, by their parameters
        moves = [(vector[named], at[mode, i]) for i, vector in enumerate(modes.directions[mode].T)]
        for number, i in enumerate(named):
            if i in delays and drive[i]:
                # -(p x + u)
                moves.append((-pole * drive[i] * np.eye(len(named))[number], slice(delays[i], delays[i] + 1)))
                later.append((i, place, -drive[i]))
        for vector, parameter in moves:
            for where, axis, found in axes:
                share = np.vdot(axis, vector) / np.vdot(axis, axis).real
                if abs(share) > ROUNDING:
                    found.append(Slope(where, place, parameter, complex(share)))
        if observation.transient and slow[mode]:
            leaks = [observation.samplings[0].transient(side, z) for side in sides]
            basis += combined([leak[0][:, None] for leak in leaks], np.ones(1))
            size = place.stop - place.start
            columns += range(transient_at, transient_at + size)
            transient = slice(transient_at, transient_at + size)
            add_slope(combined([leak[1][:, None] for leak in leaks], np.ones(1)), transient, at[mode, None])
            transient_at += size
        if len(sides) == 1 and slow[mode]:
            alike[0] += range(before[0], len(basis))
            alike[1] += range(before[1], len(slopes))
    over = observation.transient and bool(at_once[list(shown)].any())
    free = ENDS if observation.free_ends else ENDS[: int(over)]
    basis += [z ** -float(sample) for sample in free]
    columns += range(transient_at, transient_at + len(free))
    for number, i in enumerate(named):
        if modes.direct[i]:
            basis.append(observation.excitation[:, number])
            columns.append(direct_at)
            direct_at += 1
        elif i in delays:
            own = slice(len(slopes), len(slopes) + 1)
            samples = 1 + whole_samples(modes.delays[i], observation.samplings[number].sample_period)
            slopes.append(observation.excitation[:, number] * z ** -float(samples))
            moved = slice(delays[i], delays[i] + 1)
            of_slopes += [Slope(own, place, moved, factor) for who, place, factor in later if who == i]
    behind = [
        replace(one, columns=slice(one.columns.start + len(basis), one.columns.stop + len(basis))) for one in of_slopes
    ]
    return basis, slopes, columns, (*of_basis, *behind), [*alike[0], *(len(basis) + i for i in alike[1])]
