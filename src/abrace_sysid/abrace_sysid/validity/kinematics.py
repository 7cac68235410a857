# SPDX-License-Identifier: Apache-2.0
"""Detection of sensors that contradict each other: swapped, in a wrong unit, with a wrong sign, or late.

No model is needed. Absolute acceleration minus the table's is the second derivative of a floor's displacement:

    a_i - w = x_i'',

a brace's stroke is the drift that it spans times its cosine, but for the clearance of its pins, and its force follows
its command. In the first mode all floors move in phase, the higher ones further. If this does not hold, possible faults
are tried one after the other: channels swapped, in another unit, or reversed. The finding is the fault whose correction
makes the channels agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.model import signals
from abrace_sysid.validity.mechanics import side_of_clearance
from abrace_sysid.validity.regression import leakage, regression

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.validity.motion import Motion

CONTRADICTION = 0.02
"""A cause is searched if more than this share of a channel's power, noise subtracted, contradicts the others.

With transducers of different bandwidths it is 0.0004; impacts of loose pins, which accelerometers measure, give 0.006.
"""

IMPROVEMENT = 0.5
"""A change is accepted if it removes more than this share of all contradictions."""

LOOSE = 0.2
"""This share of a stroke's power need not follow from the floors' displacements and the side on which the rod rests in
the pins' clearance; a clearance as large as the rms stroke causes 0.06."""

COSINES = (0.2, 1.1)
"""Possible ratios of stroke to drift."""

AS_WELL = 0.05
"""Two drifts explain a stroke equally well if their shares of its power differ by less than this."""

SERVO = (0.4, 1.6)
"""Possible ratios of a brace's force to its command."""

UNKNOWN_UNIT = 0.001
"""Penalty, as a contradiction, for a factor that belongs to no usual unit, so that usual units are preferred."""

EXCITED = 100.0
"""The lag of the table's accelerometer is determined if its signal power exceeds its noise power by this factor."""

MOST = 3
"""Greatest number of faults searched in one test."""

ONE_SHAPE = 0.99
"""Floors move in one mode at the strongest line if one real shape explains this share of their motion around it."""

DISTINCT = 0.03
"""Two floors whose amplitudes differ by less than this share cannot be told apart by their heights."""

ABOVE_NOISE = 20.0
"""Sensors are compared if the power of what they read exceeds that of their noise by this factor."""

CERTAIN = 3.0
"""A lag counts from this many standard deviations on, below and above the middle of the motion's power."""

LEAST_LINES = 4
"""A side with fewer lines than this times the unknowns says nothing of a lag."""


HEIGHTS = "heights of "


@dataclass(frozen=True)
class Change:
    """A fault of channels, which can be corrected.

    Parameters
    ----------
    kind
        "swapped", "unit" or "reversed".
    channels
        The two channels that are swapped, or the one that is wrong.
    factor
        Factor by which the readings are too large; 1 for swapped channels.
    unit
        The unit that explains the factor; empty if no usual unit does.
    """

    kind: str
    channels: tuple[str, ...]
    factor: float = 1.0
    unit: str = ""

    def applied(self, motion: Motion) -> Motion:
        """The test `motion` with this fault corrected."""
        spectra, noise = motion.spectra, motion.noise
        if self.kind == "swapped":
            one, other = self.channels
            return motion.with_channels(
                {one: spectra[other], other: spectra[one]}, {one: noise[other], other: noise[one]}
            )
        (name,) = self.channels
        return motion.with_channels({name: spectra[name] / self.factor}, {name: noise[name] / abs(self.factor)})


@dataclass(frozen=True)
class Kinematics:
    """The agreement of the sensors of one test.

    Parameters
    ----------
    contradictions
        Share of each channel's power that contradicts the others, 0 to 1.
    changes
        The faults whose correction makes the channels agree.
    left
        The contradictions that remain after correction.
    lags
        Seconds by which each accelerometer, of a floor or of the table, is later than the displacement sensors.
    """

    contradictions: Mapping[str, float]
    changes: tuple[Change, ...]
    left: Mapping[str, float]
    lags: Mapping[str, float]


def kinematics(motion: Motion, band: tuple[float, float]) -> Kinematics:
    """Compare the sensors of one test.

    Parameters
    ----------
    motion
    band
        [Hz] of the building's modes.
    """
    lines = motion.within(band)
    hidden = _hidden(motion, lines)
    found = contradictions(motion, lines, hidden)
    changes: list[Change] = []
    current, left = motion, found
    while max(_compared(motion, left).values(), default=0.0) > CONTRADICTION and len(changes) < MOST:
        trials = [(change, change.applied(current)) for change in _candidates(current, lines)]
        costs = [
            sum(contradictions(trial, lines, hidden).values()) + _doubt(change, current, lines)
            for change, trial in trials
        ]
        best = int(np.argmin(costs)) if costs else 0
        if not costs or costs[best] > (1 - IMPROVEMENT) * sum(left.values()):
            break
        changes.append(trials[best][0])
        current = trials[best][1]
        left = contradictions(current, lines, hidden)
    return Kinematics(_compared(motion, found), tuple(changes), _compared(motion, left), _lags(current, lines))


def _compared(motion: Motion, found: Mapping[str, float]) -> dict[str, float]:
    """The contradictions between sensors; those of heights only where no floor has two sensors."""
    pairs = any(
        f"x{floor}" in motion.spectra and f"a{floor}" in motion.spectra for floor in range(1, motion.floors + 1)
    )
    return {name: value for name, value in found.items() if not (pairs and name.startswith(HEIGHTS))}


def contradictions(motion: Motion, lines: NDArray[np.int64], hidden: Collection[str] = ()) -> dict[str, float]:
    """Share of each channel's power that contradicts the others, 0 to 1; 1 if its sign or size is impossible.

    Parameters
    ----------
    motion
        A test.
    lines
        Numbers of the lines used.
    hidden
        Contradictions that are left out.
    """
    found = dict([*_of_floors(motion, lines), *_of_heights(motion, lines), *_of_braces(motion, lines)])
    return {name: value for name, value in found.items() if name not in hidden}


def comparable(motion: Motion) -> bool:
    """Whether the test of a `motion` has sensors that can contradict each other."""
    floors = [(f"x{floor}" in motion.spectra, f"a{floor}" in motion.spectra) for floor in range(1, motion.floors + 1)]
    pairs = signals.GROUND in motion.spectra and any(all(both) for both in floors)
    heights = max(sum(one) for one in zip(*floors, strict=True)) > 1
    braces = [name for letter in ("xf", "f") for name in signals.numbered(letter, motion.groups)]
    return pairs or heights or any(name in motion.spectra for name in braces)


def _hidden(motion: Motion, lines: NDArray[np.int64]) -> list[str]:
    """What cannot be compared in a test as recorded: floors and strokes that hardly move more than their noise."""
    still = []
    for floor in range(1, motion.floors + 1):
        both = _relative(motion, floor, lines)
        if both is not None:
            one, other, weight = both
            size = np.sum(np.abs(weight * one) ** 2) + np.sum(np.abs(weight * other) ** 2)
            still += [_pair(floor)] if size < ABOVE_NOISE * len(lines) else []
    floors = [motion.noise[f"x{floor}"] for floor in range(1, motion.floors + 1) if f"x{floor}" in motion.spectra]
    strokes = [name for name in signals.numbered("xf", motion.groups) if name in motion.spectra and floors]
    power = {name: float(np.mean(np.abs(motion.spectra[name][lines]) ** 2)) for name in strokes}
    return still + [
        name for name in strokes if power[name] < ABOVE_NOISE * (motion.noise[name] ** 2 + 2 * min(floors) ** 2)
    ]


def _relative(
    motion: Motion, floor: int, lines: NDArray[np.int64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.float64]] | None:
    """The spectra of a - w and x'' of a floor, and the weights of the lines."""
    x, a, w = (motion.spectra.get(name) for name in (f"x{floor}", f"a{floor}", signals.GROUND))
    if x is None or a is None or w is None:
        return None
    square = motion.omega[lines] ** 2
    noise = (
        motion.noise[f"a{floor}"] ** 2 + motion.noise[signals.GROUND] ** 2 + (square * motion.noise[f"x{floor}"]) ** 2
    )
    return a[lines] - w[lines], -square * x[lines], 1 / np.sqrt(noise)


def _pair(floor: int) -> str:
    return f"a{floor}, x{floor}"


def _of_floors(motion: Motion, lines: NDArray[np.int64]) -> Iterator[tuple[str, float]]:
    for floor in range(1, motion.floors + 1):
        both = _relative(motion, floor, lines)
        if both is not None:
            one, other, weight = both
            size = np.sum(np.abs(weight * one) ** 2) + np.sum(np.abs(weight * other) ** 2)
            # a record that ends in motion is no period of it: its second derivative has more than -w^2 x
            ends, _ = np.linalg.qr(weight[:, None] * leakage(motion.omega[lines])[:, ::2])
            apart = weight * (one - other)
            apart = apart - ends @ (ends.conj().T @ apart)
            # the weights make the expected noise power of each line 1
            different = np.sum(np.abs(apart) ** 2) - len(lines)
            yield _pair(floor), float(np.clip(different / size, 0, 1))


def _of_heights(motion: Motion, lines: NDArray[np.int64]) -> Iterator[tuple[str, float]]:
    """The shares of displacements and of accelerations that do not grow with height, if one mode moves all floors."""
    for letter in "xa":
        names = [f"{letter}{floor}" for floor in range(1, motion.floors + 1) if f"{letter}{floor}" in motion.spectra]
        w = motion.spectra.get(signals.GROUND)
        if len(names) < 2 or (letter == "a" and w is None):
            continue
        motions = np.column_stack([motion.spectra[name][lines] for name in names])
        if letter == "a" and w is not None:
            motions = (motions - w[lines, None]) / motion.omega[lines, None] ** 2
        normal = motions / np.linalg.norm(motions, axis=0)
        peak = int(np.argmax(np.sum(np.abs(normal) ** 2, axis=1)))
        about = motions[max(0, peak - 3) : peak + 4]
        sizes = np.linalg.norm(about, axis=0)
        share = np.linalg.svd(np.vstack([about.real, about.imag]), compute_uv=False) ** 2
        steps = np.diff(sizes) / np.maximum(sizes[1:], sizes[:-1])
        if share[0] > ONE_SHAPE * share.sum() and np.abs(steps).min() > DISTINCT:
            yield f"{HEIGHTS}{letter}", 0.5 * float(np.count_nonzero(steps < 0)) / (len(names) - 1)


def _of_braces(motion: Motion, lines: NDArray[np.int64]) -> Iterator[tuple[str, float]]:
    floors = [f"x{floor}" for floor in range(1, motion.floors + 1) if f"x{floor}" in motion.spectra]
    omega = motion.omega[lines]
    commands = signals.command_names(motion.groups)
    driven = [name for group, name in enumerate(commands, 1) if motion.driven(group)]
    for group in range(motion.groups):
        stroke, force = (signals.numbered(letter, motion.groups)[group] for letter in ("xf", "f"))
        if stroke in motion.spectra and len(floors) == motion.floors:
            by = [motion.spectra[name][lines] for name in floors]
            sides = []
            if force in motion.spectra:
                sides = [side_of_clearance(motion, force, omega[-1] / (2 * np.pi))[lines]]
            found = _explained_by_drifts(motion.spectra[stroke][lines], by, sides, omega)
            least = max(1 - LOOSE, max(share for share, _ in found) - AS_WELL)
            possible = any(share > least and COSINES[0] < cosine < COSINES[1] for share, cosine in found)
            yield stroke, 0.0 if possible else 1.0
        if force in motion.spectra and commands[group] in driven:
            own = [motion.spectra[name][lines] for name in driven]
            gain = _explained(motion.spectra[force][lines], own, omega)[1][driven.index(commands[group])]
            yield force, 0.0 if SERVO[0] < gain < SERVO[1] else 1.0


def _explained(
    spectrum: NDArray[np.complex128], by: Sequence[NDArray[np.complex128]], omega: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Share of a spectrum's power that a real linear combination of others explains, and the coefficients."""
    columns = np.column_stack([*by, *(1j * omega * one for one in by), leakage(omega)])
    both, values = np.vstack([columns.real, columns.imag]), np.concatenate([spectrum.real, spectrum.imag])
    scale = np.linalg.norm(both, axis=0)
    found = np.linalg.lstsq(both / scale, values, rcond=None)[0]
    left = values - (both / scale) @ found
    return 1 - float(left @ left / (values @ values)), (found / scale)[: len(by)]


def _explained_by_drifts(
    stroke: NDArray[np.complex128],
    floors: Sequence[NDArray[np.complex128]],
    sides: Sequence[NDArray[np.complex128]],
    omega: NDArray[np.float64],
) -> list[tuple[float, float]]:
    """The share of a stroke's power that each drift explains, with the `sides` of the clearance; the stroke over it.

    Drifts are those between every two floors, and between the ground and each floor. (A free combination of all floors
    says nothing: of a tall building they move so much alike that their sensors' noise decides it.)
    """
    moving = [*floors, *(1j * omega * one for one in floors)]
    columns = np.column_stack([*moving, *sides, *(1j * omega * one for one in sides), leakage(omega)])
    both, values = np.vstack([columns.real, columns.imag]), np.concatenate([stroke.real, stroke.imag])
    product, right, power = both.T @ both, both.T @ values, float(values @ values)
    count, others = len(floors), both.shape[1] - 2 * len(floors)
    found = []
    for lower, upper in combinations(range(-1, count), 2):
        drift = np.zeros((len(product), 2 + others))
        drift[[upper, count + upper], [0, 1]] = 1.0
        if lower >= 0:
            drift[[lower, count + lower], [0, 1]] = -1.0
        drift[2 * count :, 2:] = np.eye(others)
        normal, of_stroke = drift.T @ product @ drift, drift.T @ right
        scale = np.sqrt(np.diag(normal))
        if not scale.all():
            continue
        fitted = np.linalg.lstsq(normal / np.outer(scale, scale), of_stroke / scale, rcond=None)[0] / scale
        found.append((float(fitted @ of_stroke) / power, float(fitted[0])))
    return found


def _candidates(motion: Motion, lines: NDArray[np.int64]) -> Iterator[Change]:
    """Every two channels swapped, and every channel in another unit or reversed."""
    channels = [name for name in motion.spectra if name in motion.noise]
    yield from (Change("swapped", both) for both in combinations(channels, 2))
    for name in channels:
        kind = "a" if name == signals.GROUND else name[0]
        yield Change("reversed", (name,), -1.0)
        for sign in (1.0, -1.0):
            yield from (
                Change("unit", (name,), sign * factor, unit) for unit, factor in signals.OTHER_UNITS[kind].items()
            )
        factor = _factor(motion, name, lines)
        if factor is not None and abs(factor) > 1e-9:
            yield Change("unit", (name,), factor)


def _doubt(change: Change, motion: Motion, lines: NDArray[np.int64]) -> float:
    """Penalty of a change of unit: the unit is not a usual one, or differs from the measured factor."""
    if change.kind != "unit":
        return 0.0
    measured = _factor(motion, change.channels[0], lines)
    away = abs(float(np.log(abs(change.factor / measured)))) if measured else 0.0
    return UNKNOWN_UNIT * (away if change.unit else 1.0)


def _factor(motion: Motion, name: str, lines: NDArray[np.int64]) -> float | None:
    """The factor by which a floor's sensor reads too much, from the floor's other sensor."""
    if name[0] not in "xa" or name.startswith("xf"):
        return None
    both = _relative(motion, int(name[1:]), lines)
    if both is None:
        return None
    relative, second, weight = both
    if name[0] == "x":
        one, other = second, relative
    else:
        one, other = relative + motion.spectra[signals.GROUND][lines], second + motion.spectra[signals.GROUND][lines]
    one, other = one * weight, other * weight
    return float(np.real(np.vdot(other, one)) / np.real(np.vdot(other, other)))


def _lags(motion: Motion, lines: NDArray[np.int64]) -> dict[str, float]:
    """Lags by channel: to first order a late reading is (1 - i w lag) times the true one."""
    found: dict[str, float] = {}
    ground: list[float] = []
    omega = motion.omega[lines]
    for floor in range(1, motion.floors + 1):
        both = _relative(motion, floor, lines)
        if both is not None:
            relative, second, _ = both
            w = motion.spectra[signals.GROUND][lines]
            columns = [-1j * omega * (relative + w)]
            if np.mean(np.abs(w) ** 2) > EXCITED * motion.noise[signals.GROUND] ** 2:
                columns.append(1j * omega * w)
            all_columns, difference = np.column_stack([*columns, leakage(omega)]), relative - second
            lags = regression(difference, all_columns)[0][: len(columns)]
            # a lag delays the motion on both sides of the middle of its power; what is wrong at one resonance does not
            power = np.cumsum(np.abs(relative + w) ** 2)
            middle = int(np.searchsorted(power, power[-1] / 2))
            for side in (slice(0, middle), slice(middle, None)):
                if len(omega[side]) <= LEAST_LINES * all_columns.shape[1]:
                    continue
                part, deviations = regression(difference[side], all_columns[side])
                certain = part[: len(columns)] * np.sign(lags) > CERTAIN * deviations[: len(columns)]
                lags = np.where(certain, lags, 0.0)
            found[f"a{floor}"] = float(lags[0])
            ground += [float(lag) for lag in lags[1:]]
    if ground:
        found[signals.GROUND] = float(np.median(ground))
    return found
