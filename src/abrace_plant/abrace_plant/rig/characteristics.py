# SPDX-License-Identifier: Apache-2.0
"""A rig measured as the paper measured its building: frequencies, damping, bench test, f/U in the building, first mode.

Everything is computed from the rig's linear model, which the simulated rig follows exactly within its limits.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import minimize_scalar

from abrace_core.model import signals
from abrace_core.model.linear_model import pole_table
from abrace_plant.rig import published

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.actuator import Actuator
    from abrace_plant.rig.model import Rig

LINES = 4000
"""Lines of a frequency response in which minima are searched."""

Pairs = tuple[tuple[float, float], ...]
"""(frequency [rad/s], damping ratio) of pole pairs, slowest first."""


@dataclass(frozen=True)
class BraceCharacteristics:
    """One brace group's actuator, on the bench and in the building.

    Parameters
    ----------
    bench_gain_error
        Greatest departure of |f/U| from 1 with the rod blocked, from 0 to 30 Hz.
    bench_lag
        Delay [s] whose phase is nearest to that of f/U on the bench, in least squares from 0 to 30 Hz.
    antiresonances
        (floors,) frequencies [rad/s] of the minima of |f/U| in the building nearest to the building's frequencies;
        nan where there is none.
    stroke_ratio
        Stroke over displacement of the group's floor in the first mode.
    """

    bench_gain_error: float
    bench_lag: float
    antiresonances: tuple[float, ...]
    stroke_ratio: float


@dataclass(frozen=True)
class Characteristics:
    """Frequencies, damping, first mode and braces of a rig.

    Parameters
    ----------
    bare
        Pole pairs of the frame alone.
    zero_command
        Pole pairs of the building with braces and zero command, as many as floors.
    extra
        The rig's further pole pairs, which come from local modes (and, in other rigs, from servos).
    shape
        (floors,) the first mode with zero command, 1 at the top.
    braces
        One entry a brace group.
    """

    bare: Pairs
    zero_command: Pairs
    extra: Pairs
    shape: tuple[float, ...]
    braces: tuple[BraceCharacteristics, ...]

    def antiresonance_error(self, group: int = 0) -> list[float]:
        """(floors,) relative distance of a `group`'s antiresonances from the building's frequencies."""
        pairs = zip(self.braces[group].antiresonances, self.zero_command, strict=True)
        return [abs(minimum / frequency - 1) for minimum, (frequency, _) in pairs]


def bench_response(actuator: Actuator, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """f/U of an `actuator` with its rod blocked (Fig. 2) at `omega` (lines,) [rad/s], its command delay included."""
    response = actuator.bench_model().frequency_response(omega)[:, 0, 0]
    return np.asarray(response * np.exp(-1j * omega * actuator.command_delay))


def force_response(rig: Rig, group: int, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """f/U of a brace `group` (the first is 0) of a `rig` in the building (Fig. 3) at `omega` (lines,) [rad/s]."""
    forces, commands = signals.numbered("f", rig.groups), signals.command_names(rig.groups)
    return rig.model.select([forces[group]], [commands[group]]).frequency_response(omega)[:, 0, 0]


def characterize(rig: Rig) -> Characteristics:
    """Measure a `rig`."""
    everything = pole_table(rig.model.poles)
    zero_command = []
    for frequency, _ in pole_table(replace(rig, local_modes=()).model.poles)[: rig.floors]:
        nearest = min(everything, key=lambda pair: abs(np.log(pair[0] / frequency)))
        everything.remove(nearest)
        zero_command.append(nearest)
    values, vectors = np.linalg.eig(rig.model.a)
    first = vectors[:, np.argmin(np.abs(np.abs(values) - zero_command[0][0]) + 1e9 * (values.imag <= 0))]
    outputs = rig.model.c @ first
    floors, strokes = outputs[: rig.floors], outputs[rig.floors : rig.floors + rig.groups]
    braces = []
    for number, group in enumerate(rig.braces):
        gain_error, lag = _bench(group.actuator)
        braces.append(
            BraceCharacteristics(
                gain_error,
                lag,
                tuple(_antiresonance(rig, number, frequency) for frequency, _ in zero_command),
                float(abs(strokes[number] / floors[group.floor - 1])),
            )
        )
    return Characteristics(
        bare=tuple(pole_table(rig.bare_frame().model.poles)),
        zero_command=tuple(zero_command),
        extra=tuple(everything),
        shape=tuple((floors / floors[-1]).real.tolist()),
        braces=tuple(braces),
    )


def rows(found: Characteristics, rig: Rig) -> list[tuple[str, str, float, float | None]]:
    """Rows (quantity, unit, found, published) of a table; published is None where the paper's rig is another one.

    Parameters
    ----------
    found
        The characteristics.
    rig
        Whose they are.
    """
    is_papers = rig.name == published.RIG
    table: list[tuple[str, str, float, float | None]] = []

    def add(quantity: str, unit: str, value: float, paper: float) -> None:
        table.append((quantity, unit, value, paper if is_papers else None))

    for title, ours, theirs in (
        ("bare frame", found.bare, published.BARE),
        ("zero command", found.zero_command, published.ZERO_COMMAND),
        ("further pair", found.extra, published.EXTRA),
    ):
        for number, (pair, printed) in enumerate(zip(ours, theirs if is_papers else ours, strict=True), 1):
            add(f"{title} {number}: frequency", "rad/s", pair[0], printed[0])
            add(f"{title} {number}: damping", "%", 100 * pair[1], 100 * printed[1])
    for group, brace in enumerate(found.braces, 1):
        name = f"group {group}, " if len(found.braces) > 1 else ""
        add(f"{name}bench: greatest gain", "-", 1 + brace.bench_gain_error, 1.0)
        add(f"{name}bench: lag", "ms", 1e3 * brace.bench_lag, 1e3 * published.BENCH_LAG)
        of_building = published.ZERO_COMMAND if is_papers else found.zero_command
        for number, (minimum, (frequency, _)) in enumerate(zip(brace.antiresonances, of_building, strict=True), 1):
            add(f"{name}f/U: antiresonance {number}", "rad/s", minimum, frequency)
        add(f"{name}first mode: stroke/displacement", "-", brace.stroke_ratio, published.STROKE_RATIO)
    shape = published.SHAPE if is_papers else found.shape
    for number, (ours_at, theirs_at) in enumerate(zip(found.shape[:-1], shape[:-1], strict=True), 1):
        add(f"first mode: x{number}/x{len(found.shape)}", "-", ours_at, theirs_at)
    return table


def as_json(found: Characteristics, rig: Rig) -> dict[str, Any]:
    """The content of characteristics.json: SI units, None where there is none.

    The paper's rig has the comparison.

    Parameters
    ----------
    found
        The characteristics.
    rig
        Whose they are.
    """
    content: dict[str, Any] = {"rig": rig.name, **asdict(found)}
    for brace in content["braces"]:
        brace["antiresonances"] = [value if np.isfinite(value) else None for value in brace["antiresonances"]]
    if rig.name == published.RIG:
        content["comparison"] = [
            {"quantity": quantity, "unit": unit, "found": ours, "paper": paper}
            for quantity, unit, ours, paper in rows(found, rig)
        ]
    return content


def _bench(actuator: Actuator) -> tuple[float, float]:
    """Greatest gain error and lag [s] up to the bench's band."""
    omega = 2 * np.pi * np.linspace(0.0, published.BENCH_BAND, LINES + 1)[1:]
    response = bench_response(actuator, omega)
    phase = np.unwrap(np.angle(response))
    return float(np.abs(np.abs(response) - 1).max()), float(-(omega @ phase) / (omega @ omega))


def _antiresonance(rig: Rig, group: int, frequency: float) -> float:
    """Frequency [rad/s] of the minimum of |f/U| next to a frequency of the building, within a fifth of it."""
    omega = np.linspace(0.8 * frequency, 1.2 * frequency, LINES)
    gain = np.abs(force_response(rig, group, omega))
    lowest = np.flatnonzero((gain[1:-1] < gain[:-2]) & (gain[1:-1] <= gain[2:])) + 1
    if not len(lowest):
        return float("nan")
    at = lowest[np.argmin(np.abs(omega[lowest] - frequency))]
    found = minimize_scalar(
        lambda value: float(np.abs(force_response(rig, group, np.array([value])))[0]),
        bounds=(omega[at - 1], omega[at + 1]),
        method="bounded",
        options={"xatol": 1e-9 * frequency},
    )
    return float(found.x)
