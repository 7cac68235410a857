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

from abrace_core import signals
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
    lag
        Time by which the stroke's sensor is later than the floors' sensors [s].
    """

    group: int
    stroke: str
    clearance: float
    deviation: float
    share: float
    lag: float


@dataclass(frozen=True)
class _Floor:
    """The fitted equation of one floor: coefficients of displacements, forces and signs, with standard deviations."""

    stiffness: NDArray[np.float64]
    force: NDArray[np.float64]
    force_deviation: NDArray[np.float64]
    sign: NDArray[np.float64]
    sign_deviation: NDArray[np.float64]


@dataclass(frozen=True)
class _Balance:
    """The fitted equations of the floors in one test, by number, and the floors' displacements, lowest first."""

    motion: Motion
    band: tuple[float, float]
    displacements: Sequence[NDArray[np.complex128]]
    floors: dict[int, _Floor]

    @classmethod
    def of(cls, motion: Motion, band: tuple[float, float]) -> _Balance | None:
        """Fit the floors' equations in a test; None if a floor has neither a displacement nor an acceleration."""
        numbers = range(1, motion.floors + 1)
        displacements = [one for number in numbers if (one := motion.displacement(number)) is not None]
        if len(displacements) < motion.floors:
            return None
        forces = [motion.spectra[name] for name in signals.numbered("f", motion.groups) if name in motion.spectra]
        drifts = [displacements[0], *(one - below for below, one in pairwise(displacements))]
        rates = [motion.series(1j * motion.omega * drift, (band[0], FASTEST * band[1])) for drift in drifts]
        signs = [motion.spectrum(np.sign(rate)) for rate in rates]
        accelerations = {number: motion.spectra.get(f"a{number}") for number in numbers}
        floors = {
            number: _equation(motion, acceleration, displacements, forces, signs, band)
            for number, acceleration in accelerations.items()
            if acceleration is not None
        }
        return cls(motion, band, displacements, floors)

    @property
    def surest(self) -> float:
        """Greatest brace force coefficient of all floors, in standard deviations; 0 without load cells."""
        return max(
            (float(np.max(np.abs(one.force) / one.force_deviation, initial=0)) for one in self.floors.values()),
            default=0.0,
        )


def storey_frictions(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> list[tuple[str, StoreyFriction]]:
    """The friction of every storey in every test, with the test's name; tests that lack sensors are left out.

    Parameters
    ----------
    tests
        Each test with the band [Hz] in which its floors' equations are fitted.
    """
    balances = [balance for motion, band in tests if (balance := _Balance.of(motion, band)) is not None]
    # in some tests the braces' forces are below their noise: use the masses of the test that determines them best
    masses = _masses(max(balances, key=lambda balance: balance.surest)) if balances else {}
    return [
        (balance.motion.source, _friction(balance, storey, masses)) for balance in balances for storey in balance.floors
    ]


def floor_masses(tests: Sequence[tuple[Motion, tuple[float, float]]]) -> dict[int, float]:
    """Masses [kg] of floors by number, from the test that determines them best; empty without load cells.

    Parameters
    ----------
    tests
        As in `storey_frictions`.
    """
    balances = [balance for motion, band in tests if (balance := _Balance.of(motion, band)) is not None]
    return _masses(max(balances, key=lambda balance: balance.surest)) if balances else {}


def _equation(
    motion: Motion,
    acceleration: NDArray[np.complex128],
    displacements: Sequence[NDArray[np.complex128]],
    forces: Sequence[NDArray[np.complex128]],
    signs: Sequence[NDArray[np.complex128]],
    band: tuple[float, float],
) -> _Floor:
    lines = motion.within(band)
    omega = motion.omega[lines]
    linear = [one[lines] for one in (*displacements, *forces)]
    columns = [*linear, *(1j * omega * one for one in linear), *(-(omega**2) * one[lines] for one in forces)]
    columns += [one[lines] for one in signs]
    # leave out forces that are zero throughout
    moving = [k for k, column in enumerate(columns) if np.any(column)]
    stacked = np.column_stack([*(columns[k] for k in moving), leakage(omega)])
    coefficients, deviations = np.zeros(len(columns)), np.full(len(columns), np.inf)
    values = regression(acceleration[lines], stacked)
    coefficients[moving], deviations[moving] = (one[: len(moving)] for one in values)
    end, count = len(displacements), len(forces)
    return _Floor(
        -coefficients[:end],
        coefficients[end : end + count],
        deviations[end : end + count],
        coefficients[-len(signs) :],
        deviations[-len(signs) :],
    )


def _masses(balance: _Balance) -> dict[int, float]:
    """Masses [kg] of floors by number: first of the floor on which a brace acts most, then of its neighbours."""
    motion, floors = balance.motion, balance.floors
    if any(len(one.force) < motion.groups for one in floors.values()):
        return {}
    masses: dict[int, float] = {}
    for group, count in enumerate(motion.braces):
        cosine = _cosine(balance, group)
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


def _cosine(balance: _Balance, group: int) -> float | None:
    """The cosine of a group's braces: their stroke over the drift that they span."""
    motion = balance.motion
    stroke = motion.spectra.get(signals.numbered("xf", motion.groups)[group])
    if stroke is None:
        return None
    lines = motion.within(balance.band)
    columns = np.column_stack([*(one[lines] for one in balance.displacements), leakage(motion.omega[lines])])
    return float(np.abs(regression(stroke[lines], columns)[0][: motion.floors]).max())


def _friction(balance: _Balance, storey: int, masses: dict[int, float]) -> StoreyFriction:
    motion, own, below = balance.motion, balance.floors[storey], balance.floors.get(storey - 1)
    acceleration, deviation = float(-own.sign[storey - 1]), float(own.sign_deviation[storey - 1])
    opposite = float("nan")
    if below is not None:
        opposite = float(below.sign[storey - 1] / below.sign_deviation[storey - 1])
    mass = masses.get(storey, float("nan"))
    # equivalent viscous damping of a storey, c = sqrt(2 / pi) F / rms of the drift's rate, over twice sqrt(k m)
    above = [floor for floor in range(storey, motion.floors + 1) if floor in balance.floors]
    shear = sum(
        (masses[floor] / mass if floor in masses and storey in masses else 1.0)
        * motion.series(motion.spectra[f"a{floor}"], balance.band)
        for floor in above
    )
    damping = np.sqrt(2 / np.pi) * acceleration / (2 * float(np.std(shear)))
    return StoreyFriction(storey, acceleration, deviation, opposite, mass * acceleration, float(damping))


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
        own = motion.spectra[force]
        side = motion.spectrum(np.sign(motion.series(own, (0.0, FASTEST_FORCE * band[1]))))
        linear = [one[lines] for one in (*displacements, own)]
        columns = [side[lines], *linear, *(1j * omega * one for one in linear)]
        coefficients, deviations = regression(
            motion.spectra[stroke][lines], np.column_stack([*columns, leakage(omega)])
        )
        size = float(np.std(motion.series(motion.spectra[stroke], band)))
        clearance, deviation = 2 * float(coefficients[0]), 2 * float(deviations[0])
        own_floor = 1 + int(np.argmax(np.abs(coefficients[1 : 1 + len(displacements)])))
        lag = -float(coefficients[own_floor + len(linear)] / coefficients[own_floor])
        found.append(Backlash(group, stroke, clearance, deviation, clearance / 2 / size, lag))
    return tuple(found)
