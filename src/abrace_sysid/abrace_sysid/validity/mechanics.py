# SPDX-License-Identifier: Apache-2.0
"""Estimation of storey friction and brace backlash from the equations of motion of floors and braces.

No model is needed. The measured absolute acceleration of a floor follows from the forces on it:

    a_i = - sum over j of (k_ij x_j + c_ij x_j') + sum of the braces' b f_g - (F_i s_i - F_(i+1) s_(i+1)) / m_i,

with the sign s_i of storey i's drift velocity. Stiffness, damping, the braces' coefficients b and the friction F are
fitted in one linear regression over the lines below the band's end. For normally distributed motion the part of its
sign that is not proportional to the motion is uncorrelated with any linear dynamics that the equation omits (Bussgang
1952). So a linear rig shows no friction.

Likewise a stroke follows from the floors' displacements, except for the clearance of the pins, which the rod crosses
when the force changes sign. The load cells give friction in newtons: a brace's force, its cosine (stroke over drift)
and its coefficient in a floor's equation give that floor's mass; the symmetry of the stiffness gives the other masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.model import signals
from abrace_sysid.validity.regression import leakage, regression

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.validity.motion import Motion

FASTEST = 1.5
"""Cut-off frequency of the drifts whose sign is used, as a multiple of the band's end."""

FASTEST_FORCE = 3.0
"""Cut-off frequency of the forces whose sign is used, as a multiple of the band's end."""

LEAST_T = 10.0
"""A floor's equation gives its mass if the brace force's coefficient exceeds this many standard deviations."""


@dataclass(frozen=True)
class StoreyFriction:
    """Friction of one storey.

    Parameters
    ----------
    storey
        Number of the storey, 1 is the lowest.
    acceleration, deviation
        Friction force over the mass of the floor above, positive if it opposes the drift velocity, and its standard
        deviation [m/s^2].
    opposite
        The same from the equation of the floor below, in standard deviations; positive if it agrees. NaN for storey 1.
    force
        Friction force [N]; NaN if no load cell gives the masses.
    damping
        Equivalent viscous damping ratio of the storey (same energy loss in a cycle) at the test's amplitude.
    """

    storey: int
    acceleration: float
    deviation: float
    opposite: float
    force: float
    damping: float


@dataclass(frozen=True)
class Backlash:
    """Clearance of a brace group's pins.

    Parameters
    ----------
    group, stroke
        Number of the brace group, from 1, and the name of its stroke.
    clearance, deviation
        Total clearance, from side to side, and its standard deviation [m].
    share
        Half the clearance over the stroke's rms.
    lag, lag_deviation
        Time by which the stroke's sensor is later than the floors' sensors, and its standard deviation [s].
    """

    group: int
    stroke: str
    clearance: float
    deviation: float
    share: float
    lag: float
    lag_deviation: float


@dataclass(frozen=True)
class _Floor:
    """The fitted equation of one floor: coefficients of displacements, forces and signs, with standard deviations."""

    stiffness: NDArray[np.float64]
    force: NDArray[np.float64]
    force_deviation: NDArray[np.float64]
    sign: NDArray[np.float64]
    sign_deviation: NDArray[np.float64]


@dataclass(frozen=True)
class _Test:
    """A test, the band [Hz] in which the equations hold, and the spectra in them, storeys and groups lowest first."""

    motion: Motion
    band: tuple[float, float]
    displacements: Sequence[NDArray[np.complex128]]
    forces: Sequence[NDArray[np.complex128]]
    signs: Sequence[NDArray[np.complex128]]

    @classmethod
    def of(cls, motion: Motion, band: tuple[float, float]) -> _Test | None:
        """None if a floor has neither a displacement nor an acceleration."""
        numbers = range(1, motion.floors + 1)
        displacements = [one for number in numbers if (one := motion.displacement(number)) is not None]
        if len(displacements) < motion.floors:
            return None
        forces = [motion.spectra[name] for name in signals.numbered("f", motion.groups) if name in motion.spectra]
        drifts = [displacements[0], *(one - below for below, one in pairwise(displacements))]
        rates = [motion.series(1j * motion.omega * drift, (band[0], FASTEST * band[1])) for drift in drifts]
        signs = [motion.spectrum(np.sign(rate)) for rate in rates]
        return cls(motion, band, displacements, forces, signs)

    @property
    def lines(self) -> NDArray[np.int64]:
        """Numbers of the lines within the band."""
        return self.motion.within(self.band)

    @property
    def omega(self) -> NDArray[np.float64]:
        """Frequencies of these lines [rad/s]."""
        return self.motion.omega[self.lines]

    def columns(self) -> NDArray[np.complex128]:
        """(lines, regressors) of a floor's equation."""
        lines, omega = self.lines, self.omega
        linear = [one[lines] for one in (*self.displacements, *self.forces)]
        columns = [*linear, *(1j * omega * one for one in linear), *(-(omega**2) * one[lines] for one in self.forces)]
        return np.column_stack([*columns, *(one[lines] for one in self.signs)])


def storey_frictions(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> list[tuple[str, StoreyFriction]]:
    """The friction of every storey in every test, with the test's name; tests that lack sensors are left out.

    Parameters
    ----------
    tests
        Each test with the band [Hz] in which its floors' equations are fitted.
    """
    masses = floor_masses(tests)
    found = []
    for motion, band in tests:
        if test := _Test.of(motion, band):
            floors = _floors([test])
            found += [(motion.source, _friction(test, floors, storey, masses)) for storey in floors]
    return found


def floor_masses(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> dict[int, float]:
    """Masses [kg] of floors by number, from all tests with load cells together; empty without any.

    Parameters
    ----------
    tests
        As in `storey_frictions`.
    """
    each = [_Test.of(motion, band) for motion, band in tests]
    usable = [test for test in each if test is not None and len(test.forces) == test.motion.groups]
    return _masses(usable, _floors(usable)) if usable else {}


def _floors(tests: Sequence[_Test]) -> dict[int, _Floor]:
    """The equations of the floors with an accelerometer in `tests`, by number."""
    return {
        number: _equation(tests, f"a{number}")
        for number in range(1, tests[0].motion.floors + 1)
        if all(f"a{number}" in test.motion.spectra for test in tests)
    }


def _equation(tests: Sequence[_Test], acceleration: str) -> _Floor:
    measured = np.concatenate([test.motion.spectra[acceleration][test.lines] for test in tests])
    columns = np.vstack([test.columns() for test in tests])
    # leave out forces that are zero throughout
    moving = np.flatnonzero(np.any(columns, axis=0))
    ends = linalg.block_diag(*(leakage(test.omega) for test in tests))
    values = regression(measured, np.hstack([columns[:, moving], ends]))
    coefficients, deviations = np.zeros(columns.shape[1]), np.full(columns.shape[1], np.inf)
    coefficients[moving], deviations[moving] = (one[: len(moving)] for one in values)
    end, count, storeys = len(tests[0].displacements), len(tests[0].forces), len(tests[0].signs)
    return _Floor(
        -coefficients[:end],
        coefficients[end : end + count],
        deviations[end : end + count],
        coefficients[-storeys:],
        deviations[-storeys:],
    )


def _masses(tests: Sequence[_Test], floors: dict[int, _Floor]) -> dict[int, float]:
    """Masses [kg] of floors by number: first of the floor on which a brace acts most, then of its neighbours."""
    motion = tests[0].motion
    masses: dict[int, float] = {}
    for group, count in enumerate(motion.braces):
        cosine = _cosine(tests, group)
        for number, floor in floors.items():
            share, deviation = abs(floor.force[group]), floor.force_deviation[group]
            if cosine and share > LEAST_T * deviation:
                # coefficients of a distant brace, due to local modes, are smaller and would give a greater mass
                masses[number] = min(count * cosine / share, masses.get(number, np.inf))
    if not masses:
        return {}
    first = min(masses, key=lambda number: masses[number])
    known = {first: masses[first]}
    for number in [*range(first + 1, motion.floors + 1), *range(first - 1, 0, -1)]:
        neighbour = number - 1 if number > first else number + 1
        if neighbour in known and number in floors:
            ratio = floors[neighbour].stiffness[number - 1] / floors[number].stiffness[neighbour - 1]
            if 0.1 < ratio < 10:
                known[number] = known[neighbour] * ratio
    return known


def _cosine(tests: Sequence[_Test], group: int) -> float | None:
    """The cosine of a group's braces: their stroke over the drift that they span."""
    name = signals.numbered("xf", tests[0].motion.groups)[group]
    tests = [test for test in tests if name in test.motion.spectra]
    if not tests:
        return None
    stroke = np.concatenate([test.motion.spectra[name][test.lines] for test in tests])
    columns = np.vstack([np.column_stack([one[test.lines] for one in test.displacements]) for test in tests])
    ends = linalg.block_diag(*(leakage(test.omega) for test in tests))
    return float(np.abs(regression(stroke, np.hstack([columns, ends]))[0][: columns.shape[1]]).max())


def _friction(test: _Test, floors: dict[int, _Floor], storey: int, masses: dict[int, float]) -> StoreyFriction:
    motion, own, below = test.motion, floors[storey], floors.get(storey - 1)
    acceleration, deviation = float(-own.sign[storey - 1]), float(own.sign_deviation[storey - 1])
    opposite = float("nan")
    if below is not None:
        opposite = float(below.sign[storey - 1] / below.sign_deviation[storey - 1])
    mass = masses.get(storey, float("nan"))
    # equivalent viscous damping of a storey, c = sqrt(2 / pi) F / rms of the drift's rate, over twice sqrt(k m)
    above = [floor for floor in range(storey, motion.floors + 1) if floor in floors]
    shear = sum(
        (masses[floor] / mass if floor in masses and storey in masses else 1.0)
        * motion.series(motion.spectra[f"a{floor}"], test.band)
        for floor in above
    )
    damping = np.sqrt(2 / np.pi) * acceleration / (2 * float(np.std(shear)))
    return StoreyFriction(storey, acceleration, deviation, opposite, mass * acceleration, float(damping))


def side_of_clearance(motion: Motion, force: str, highest: float) -> NDArray[np.complex128]:
    """(lines,) spectrum of the side on which a rod rests in its clearance, 1 or -1: the sign of its force.

    Parameters
    ----------
    motion
        A test.
    force
        Name of the brace's force.
    highest
        End of the band [Hz] in which the stroke's equation is fitted.
    """
    return motion.spectrum(np.sign(motion.series(motion.spectra[force], (0.0, FASTEST_FORCE * highest))))


def backlashes(motion: Motion, band: tuple[float, float]) -> tuple[Backlash, ...]:
    """The clearance of the pins of each brace group whose stroke and load cells respond.

    Parameters
    ----------
    motion
        A test.
    band
        Band [Hz] in which the strokes' equations are fitted.
    """
    # use the displacement sensor alone: a combination with a late accelerometer would be late too
    each = [motion.spectra.get(f"x{floor}", motion.displacement(floor)) for floor in range(1, motion.floors + 1)]
    displacements = [one for one in each if one is not None]
    lines = motion.within(band)
    omega = motion.omega[lines]
    found = []
    names = zip(signals.numbered("xf", motion.groups), signals.numbered("f", motion.groups), strict=True)
    for group, (stroke, force) in enumerate(names, 1):
        if stroke not in motion.spectra or force not in motion.spectra or not displacements:
            continue
        linear = [one[lines] for one in (*displacements, motion.spectra[force])]
        columns = [side_of_clearance(motion, force, band[1])[lines], *linear, *(1j * omega * one for one in linear)]
        coefficients, deviations = regression(
            motion.spectra[stroke][lines], np.column_stack([*columns, leakage(omega)])
        )
        size = float(np.std(motion.series(motion.spectra[stroke], band)))
        clearance, deviation = 2 * float(coefficients[0]), 2 * float(deviations[0])
        # late by one time is the drift that the brace spans; floors that move alike share no lag among themselves
        drift = np.column_stack([one[lines] for one in displacements]) @ coefficients[1 : 1 + len(displacements)]
        spanned = [columns[0], drift, motion.spectra[force][lines]]
        late, deviations = regression(
            motion.spectra[stroke][lines],
            np.column_stack([*spanned, 1j * omega * drift, 1j * omega * spanned[2], leakage(omega)]),
        )
        lag, uncertain = -float(late[3] / late[1]), float(deviations[3] / abs(late[1]))
        found.append(Backlash(group, stroke, clearance, deviation, clearance / 2 / size, lag, uncertain))
    return tuple(found)
