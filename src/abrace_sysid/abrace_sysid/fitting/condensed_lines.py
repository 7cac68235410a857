"""The lines of tests near some modes: basis, slopes and channels, and their triangular factor.

The lines are used once, in an orthogonal factorisation of the three side by side; everything after that is done with
the triangular factor, whose size does not depend on the length of the test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.pole_basis import sides_of
from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.modes import Modes
    from abrace_sysid.fitting.observation import Observation


@dataclass(frozen=True)
class Slope:
    """One complex parameter's slope in a test: which coefficients multiply it, and which parameters they move."""

    coefficient: slice
    parameter: slice


@dataclass(frozen=True)
class CondensedLines:
    """One test: its basis, slopes and channels at every line, stacked real above imaginary, and condensed.

    `observation` is the test; `columns` are the places of the basis among all coefficients; `basis`, `slopes`,
    `measured` have 2 lines rows, and `small` is the triangular factor of the three side by side.
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
        """Basis, slopes and channels condensed."""
        first, second = self.basis.shape[1], self.basis.shape[1] + self.slopes.shape[1]
        return self.small[:, :first], self.small[:, first:second], self.small[:, second:]

    def combination(self, coefficients: NDArray[np.float64], parameters: int) -> NDArray[np.float64]:
        """(slopes, parameters) that make of the slopes the derivatives of a channel with these `coefficients`."""
        combined = np.zeros((self.slopes.shape[1], parameters))
        row = 0
        for kind in self.kinds:
            first, parameter = coefficients[kind.coefficient], kind.parameter.start
            combined[row : row + len(first), parameter] = first
            if len(first) == 2:
                # x1 and x2 have the derivatives s1 and s2 with the real part, and s2 and -s1 with the imaginary one
                combined[row : row + 2, parameter + 1] = -first[1], first[0]
            row += len(first)
        return combined


def condensed(observations: Sequence[Observation], inputs: Sequence[str], modes: Modes) -> tuple[CondensedLines, ...]:
    """Each test's lines near some modes, with their triangular factor.

    The coefficients of a channel are those of all modes, then direct terms of each group of tests with the same inputs
    and modes, then each test's transient.

    Parameters
    ----------
    observations
        The tests.
    inputs
        Names of all inputs.
    modes
        Near which.

    Raises
    ------
    AbraceError
        If a test has fewer lines than unknowns.
    """
    places = columns_of(modes.poles)
    direct = direct_terms(observations, modes.poles)
    end = max(first + len(names) for (names, _), first in direct.items())
    tests = []
    for observation in observations:
        shown = observation.shown(modes.poles)
        first = direct[observation.inputs, shown]
        basis, slopes, columns, kinds = _lines_of(observation, inputs, modes, shown, places, end)
        columns += range(first, first + len(observation.inputs))
        basis += list(observation.excitation.T)
        end = max(end, 1 + max(columns))
        unknowns = len(columns) + modes.parameters()[-1][2].stop
        if 2 * len(observation.z) <= unknowns:
            raise AbraceError(
                f"{observation.source}: {len(observation.z)} frequency lines, expected more than {unknowns // 2}"
            )
        weight = 1 / observation.noise_level[:, None]
        states, changes = (stacked(np.column_stack(part) * weight) for part in (basis, slopes))
        measured = stacked(observation.measured * weight)
        whole = np.hstack([states, changes, measured])
        scale = np.linalg.norm(whole, axis=0)
        scale[scale == 0] = 1.0
        small = np.linalg.qr(whole / scale, mode="r") * scale
        tests.append(CondensedLines(observation, np.array(columns), tuple(kinds), states, changes, measured, small))
    return tuple(tests)


def direct_terms(
    observations: Sequence[Observation], poles: NDArray[np.complex128]
) -> dict[tuple[tuple[str, ...], tuple[int, ...]], int]:
    """Of each group of `observations` with the same inputs and modes, of `poles`, where its direct terms are."""
    end = columns_of(poles)[-1].stop
    found: dict[tuple[tuple[str, ...], tuple[int, ...]], int] = {}
    for observation in observations:
        group = observation.inputs, observation.shown(poles)
        if group not in found:
            found[group] = end
            end += len(observation.inputs)
    return found


def _lines_of(
    observation: Observation,
    inputs: Sequence[str],
    modes: Modes,
    shown: Sequence[int],
    places: Sequence[slice],
    transient_at: int,
) -> tuple[list[NDArray[np.complex128]], list[NDArray[np.complex128]], list[int], list[Slope]]:
    """Basis of the modes and of their transients, slopes with every parameter, and where the coefficients are."""
    z = observation.z
    named = [inputs.index(name) for name in observation.inputs]
    at = {(mode, direction): columns for mode, direction, columns in modes.parameters()}
    basis: list[NDArray[np.complex128]] = []
    slopes: list[NDArray[np.complex128]] = []
    columns: list[int] = []
    kinds: list[Slope] = []
    # a transient that is over within a sample is the same at all lines, whatever its pole; and fixed poles have none
    at_once = -modes.poles.real * observation.samplings[0].sample_period > 1
    slow = ~at_once & ~modes.fixed
    for mode in shown:
        pole, place = modes.poles[mode], places[mode]
        sides = sides_of(pole)
        responses, changes = [], []  # of each side (the pole, its conjugate): (lines, inputs)
        for side in sides:
            pairs = [
                [drive * part for part in sampling.response(side, z)]
                for sampling, drive in zip(observation.samplings, observation.excitation.T, strict=True)
            ]
            responses.append(np.column_stack([pair[0] for pair in pairs]))
            changes.append(np.column_stack([pair[1] for pair in pairs]))
        basis += combined(responses, modes.drive[mode, named])
        columns += range(place.start, place.stop)
        slopes += combined(changes, modes.drive[mode, named])
        kinds.append(Slope(place, at[mode, None]))
        for direction, vector in enumerate(modes.directions(mode).T):
            slopes += combined(responses, vector[named])
            kinds.append(Slope(place, at[mode, direction]))
        if observation.transient and slow[mode]:
            leaks = [observation.samplings[0].transient(side, z) for side in sides]
            basis += combined([leak[0][:, None] for leak in leaks], np.ones(1))
            slopes += combined([leak[1][:, None] for leak in leaks], np.ones(1))
            size = place.stop - place.start
            columns += range(transient_at, transient_at + size)
            kinds.append(Slope(slice(transient_at, transient_at + size), at[mode, None]))
            transient_at += size
    if observation.transient and at_once[list(shown)].any():
        basis.append(np.ones(len(z), dtype=np.complex128))
        columns.append(transient_at)
    return basis, slopes, columns, kinds


def combined(sides: Sequence[NDArray[np.complex128]], vector: NDArray[Any]) -> list[NDArray[np.complex128]]:
    """Responses to the inputs (lines, inputs) of both `sides` of a pair, weighed by a `vector`, in two combinations.

    Of a real pole there is one side, and one combination.
    """
    if len(sides) == 1:
        return [sides[0] @ vector]
    above, below = sides[0] @ vector, sides[1] @ vector.conj()
    return [(above + below) / 2, (above - below) * 0.5j]


def stacked(lines: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Complex `lines` as real numbers: the real parts above the imaginary ones."""
    return np.vstack([lines.real, lines.imag])
