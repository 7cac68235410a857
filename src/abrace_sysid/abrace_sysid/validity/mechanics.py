"""Friction of storeys and backlash of braces, from the equations that every floor and every brace obeys.

No model is needed. The acceleration of a floor, read as it is, follows from what the sensors read of the forces on it:

    a_i = - sum over j of (k_ij x_j + c_ij x_j') + sum of the braces' b f_g - (F_i s_i - F_(i+1) s_(i+1)) / m_i,

with the sign s_i of storey i's drift velocity. Stiffness, damping and the braces' share are fitted with the friction in
one linear regression over the lines below the band's end. Of a normally distributed motion what its sign adds to the
motion is uncorrelated with whatever linear dynamics the equation has left out (Bussgang 1952): a linear rig shows none.
Likewise a stroke follows from the floors' displacements but for the clearance of the pins, which the rod crosses when
the force changes sign. Newtons come from the load cells: a brace's force, its cosine (stroke over drift) and its share
in a floor's acceleration give that floor's mass, the symmetry of the stiffness those of the others.
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
"""Highest frequency, as a share of the band's end, of the drifts whose sign is taken."""

FASTEST_FORCE = 3.0
"""Likewise of the forces."""

LEAST_T = 10.0
"""Deviations that the brace's force must be away from zero in a floor's equation to give its mass."""


@dataclass(frozen=True)
class StoreyFriction:
    """Friction of one storey.

    Parameters
    ----------
    storey
        1 the lowest.
    acceleration, deviation
        Force over the mass of the floor above, positive where it opposes the drift, and its standard deviation [m/s^2].
    opposite
        The same from the equation of the floor below, in its deviations; positive where it agrees. NaN of storey 1.
    force
        [N]; NaN where no load cell gives the masses.
    damping
        What it adds to the damping ratio at the test's amplitude: that of a storey whose every cycle loses as much.
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
    group
        1 the first.
    clearance, deviation
        From side to side, and its standard deviation [m].
    share
        Half of it over the stroke's rms.
    """

    group: int
    clearance: float
    deviation: float
    share: float


@dataclass(frozen=True)
class _Floor:
    """The equation of one floor: coefficients of displacements, forces and signs, with deviations."""

    stiffness: NDArray[np.float64]
    force: NDArray[np.float64]
    force_deviation: NDArray[np.float64]
    sign: NDArray[np.float64]
    sign_deviation: NDArray[np.float64]


def storey_frictions(motion: Motion, band: tuple[float, float]) -> tuple[StoreyFriction, ...]:
    """The friction of every storey; none where the sensors are too few.

    Parameters
    ----------
    motion
        A test.
    band
        [Hz] in which the floors' equations are fitted.
    """
    floors = range(1, motion.floors + 1)
    found = [motion.displacement(floor) for floor in floors]
    displacements = [one for one in found if one is not None]
    forces = [motion.spectra[name] for name in signals.numbered("f", motion.groups) if name in motion.spectra]
    if len(displacements) < motion.floors:
        return ()
    drifts = [displacements[0], *(one - below for below, one in pairwise(displacements))]
    rates = [motion.series(1j * motion.omega * drift, (band[0], FASTEST * band[1])) for drift in drifts]
    signs = [motion.spectrum(np.sign(rate)) for rate in rates]
    equations = {
        floor: _equation(motion, motion.spectra[f"a{floor}"], displacements, forces, signs, band)
        for floor in floors
        if f"a{floor}" in motion.spectra
    }
    masses = _masses(motion, equations, displacements, band) if len(forces) == motion.groups else {}
    return tuple(_friction(motion, storey, equations, masses, band) for storey in floors if storey in equations)


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
    # drive and rest: an equation without a force that is zero throughout
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


def _masses(
    motion: Motion,
    equations: dict[int, _Floor],
    displacements: Sequence[NDArray[np.complex128]],
    band: tuple[float, float],
) -> dict[int, float]:
    """Masses [kg] of floors by number: of those that a brace acts on, then of their neighbours."""
    masses: dict[int, float] = {}
    for group, count in enumerate(motion.braces):
        cosine = _cosine(motion, group, displacements, band)
        for floor, equation in equations.items():
            share, deviation = abs(equation.force[group]), equation.force_deviation[group]
            if cosine and share > LEAST_T * deviation:
                # a floor has mass; what local modes make of a far brace's force is smaller than the force
                mass = count * cosine / share
                masses[floor] = min(mass, masses.get(floor, np.inf))
    if not masses:
        return {}
    first = min(masses, key=lambda floor: masses[floor])
    known = {first: masses[first]}
    for floor in [*range(first + 1, motion.floors + 1), *range(first - 1, 0, -1)]:
        from_floor = floor - 1 if floor > first else floor + 1
        if from_floor in known and floor in equations:
            ratio = equations[from_floor].stiffness[floor - 1] / equations[floor].stiffness[from_floor - 1]
            if 0.1 < ratio < 10:
                known[floor] = known[from_floor] * ratio
    return known


def _cosine(
    motion: Motion, group: int, displacements: Sequence[NDArray[np.complex128]], band: tuple[float, float]
) -> float | None:
    """Of a group's braces: their stroke over the drift that they span."""
    stroke = motion.spectra.get(signals.numbered("xf", motion.groups)[group])
    if stroke is None:
        return None
    lines = motion.within(band)
    columns = np.column_stack([*(one[lines] for one in displacements), leakage(motion.omega[lines])])
    shares = regression(stroke[lines], columns)[0][: len(displacements)]
    return float(np.abs(shares).max())


def _friction(
    motion: Motion,
    storey: int,
    equations: dict[int, _Floor],
    masses: dict[int, float],
    band: tuple[float, float],
) -> StoreyFriction:
    own, below = equations[storey], equations.get(storey - 1)
    acceleration, deviation = float(-own.sign[storey - 1]), float(own.sign_deviation[storey - 1])
    opposite = float("nan")
    if below is not None:
        opposite = float(below.sign[storey - 1] / below.sign_deviation[storey - 1])
    mass = masses.get(storey, float("nan"))
    # equivalent viscous damping of a storey, c = sqrt(2 / pi) F / rms of the drift's rate, over twice sqrt(k m)
    above = [floor for floor in range(storey, motion.floors + 1) if f"a{floor}" in motion.spectra]
    relative = [masses[floor] / mass if floor in masses and storey in masses else 1.0 for floor in above]
    shear = sum(
        share * motion.series(motion.spectra[f"a{floor}"], band) for share, floor in zip(relative, above, strict=True)
    )
    damping = np.sqrt(2 / np.pi) * acceleration / (2 * float(np.std(shear)))
    return StoreyFriction(storey, acceleration, deviation, opposite, mass * acceleration, float(damping))


def backlashes(motion: Motion, band: tuple[float, float]) -> tuple[Backlash, ...]:
    """The clearance of each brace group's pins, of those whose stroke and load cells answer.

    Parameters
    ----------
    motion
        A test.
    band
        [Hz] in which the strokes' equations are fitted.
    """
    displacements = [one for floor in range(1, motion.floors + 1) if (one := motion.displacement(floor)) is not None]
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
        found.append(Backlash(group, clearance, deviation, clearance / 2 / size))
    return tuple(found)
