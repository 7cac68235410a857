# SPDX-License-Identifier: Apache-2.0
"""The quantities that interlocks watch, sample by sample: one linear system from readings, command and table.

Most quantities are readings or differences of readings. Four need filters, which are made in continuous time and
discretised by the bilinear transformation:

velocity                   of a floor relative to the table: its displacement's derivative, smoothed by a Butterworth
                           low-pass of second order at `VELOCITY_CUTOFF`
force error                |U_lag - f|: the command in force, after the actuator's `command_delay` and through
                           1 / (lag s + 1), held between samples, less the force in the load cell
implausible acceleration   an accelerometer against its neighbours, the displacement of its floor and the table's
                           accelerometer: F(s) (a - w) - s^2 F(s) x, which is zero for x'' = a - w
oscillation                rms over `OSCILLATION_TIME` of the force that is faster than the building: after a
                           Butterworth high-pass of second order at `FASTER` times its highest frequency. A loop that
                           is unstable with a local mode ends in a limit cycle that hardly moves the building

F is a band-pass around the building's first frequency (`BAND` times it; a high-pass and a low-pass of second order): it
excludes an accelerometer's drift at low frequencies, and at high frequencies the local modes, which only accelerometers
measure, and the noise of the displacement, which two derivatives amplify with the square of the frequency. It needs no
model of the building, so that any motion of the building, also beyond its elastic range, is plausible; a sensor that is
dead, reversed, swapped with another or wrongly calibrated is not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import linalg

from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_plant.rig.limits import frequencies
from abrace_plant.rig.sensors import KINDS, Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

VELOCITY_CUTOFF = 20.0
"""[Hz], or a fifth of the sample rate where that is less."""
BAND = (0.4, 2.5)
"""Of F: its high-pass and low-pass, times the first frequency."""
FASTER = 1.3
OSCILLATION_TIME = 0.25
"""[s]."""
SETTLING = 5.0
"""Time constants of the high-pass after which the implausibility of an acceleration counts: it may start in motion."""

Matrices = tuple["NDArray[np.float64]", "NDArray[np.float64]", "NDArray[np.float64]", "NDArray[np.float64]"]
UNFILTERED: Matrices = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))


class Quantity(NamedTuple):
    """One number that an interlock watches: the key of its interlock, the channel, and its name in messages."""

    interlock: str
    channel: str
    name: str


class Detectors(NamedTuple):
    """The quantities of a rig, [next states; quantities] = step [states; inputs].

    Of an oscillation the quantity is the force above the building's modes, its rms is left to take.
    Inputs are the readings (channels,), the commands in force until them (groups,), the table's displacement and its
    velocity.
    """

    quantities: tuple[Quantity, ...]
    step: NDArray[np.float64]
    """(states + quantities, states + inputs)."""
    at_rest: NDArray[np.float64]
    """(states, inputs): the states after inputs that have always been the same."""
    settling: int
    """Samples after a start for which the implausibility of accelerations does not count; one or more."""
    noise: dict[str, float]
    """Standard deviation of the noisiest quantity of each interlock, from the sensors' noise alone."""


def detectors(rig: Rig) -> Detectors:
    """The detectors of a rig; a disconnected brace group has none, nor has what is not measured."""
    n, m, period = rig.floors, rig.groups, 1 / rig.sample_rate
    channels = rig.channel_names
    inputs = len(channels) + m + 2
    unit = np.eye(inputs)
    measured = dict(zip(channels, unit, strict=False))
    x, a = ({i: measured[name] for i in range(n) if (name := f"{letter}{i + 1}") in measured} for letter in ("x", "a"))
    x_of = {0: np.zeros(inputs), **{i + 1: row for i, row in x.items()}}  # by the floor's number, 0 the table
    command = unit[len(channels) :]
    rows: list[tuple[Quantity, Matrices, NDArray[np.float64]]] = []

    def watch(quantity: Quantity, factors: NDArray[np.float64], filtered: Matrices = UNFILTERED) -> None:
        """Add the output of a discrete filter whose inputs are sums of inputs, by their `factors`."""
        rows.append((quantity, filtered, np.atleast_2d(factors)))

    for i in x:
        if i in x_of:
            watch(Quantity("drift", f"x{i + 1}", f"interstorey drift of storey {i + 1}"), x[i] - x_of[i])
    for i in x:
        watch(Quantity("displacement", f"x{i + 1}", f"displacement x{i + 1}"), x[i])
    cutoff = 2 * np.pi * min(VELOCITY_CUTOFF, rig.sample_rate / 5)
    derivative = _bilinear(_second_order(cutoff, (0.0, cutoff**2, 0.0)), period)
    for i in x:
        watch(Quantity("velocity", f"x{i + 1}", f"velocity of floor {i + 1}"), x[i], derivative)
    connected = [j for j in range(m) if rig.braces[j].connected]
    strokes = {j: name for j in connected if (name := signals.numbered("xf", m)[j]) in measured}
    groups = np.repeat(np.arange(m), rig.braces_in_group).tolist()
    cells = [
        (name, measured[name], j)
        for name, j in zip(signals.load_cell_names(rig.braces_in_group), groups, strict=True)
        if name in measured and j in connected
    ]
    for name in strokes.values():
        watch(Quantity("stroke", name, f"stroke {name}"), measured[name])
    for i in a:
        watch(Quantity("acceleration", f"a{i + 1}", f"acceleration a{i + 1}"), a[i])
    for name, force, j in cells:
        watch(Quantity("force", name, f"force {name}"), force)
        error = Quantity("force_error", name, f"force {name} against its command")
        actuator = rig.braces[j].actuator
        lagging = _lag(actuator.lag, actuator.command_delay, period)
        watch(error, np.vstack([command[j], force]), lagging)
    modes = frequencies(rig)
    faster = _bilinear(_second_order(FASTER * modes[-1], (1.0, 0.0, 0.0)), period)
    for name, force, _ in cells:
        text = f"oscillation of force {name}, rms above {FASTER * modes[-1] / (2 * np.pi):.3g} Hz"
        watch(Quantity("oscillation", name, text), force, faster)
    watch(Quantity("table_displacement", "table", "place where the table would stop"), unit[-2])
    watch(Quantity("table_velocity", "table", "velocity of the table"), unit[-1])

    slow, fast = (factor * modes[0] for factor in BAND)
    residual = _bilinear(_residual(slow, fast), period)
    for i in [i for i in a if i in x and signals.GROUND in measured]:
        name = f"a{i + 1} against x{i + 1} and {signals.GROUND}"
        factors = np.array([a[i] - measured[signals.GROUND], x[i]])
        watch(Quantity("implausible_acceleration", f"a{i + 1}", name), factors, residual)
    for j, stroke in strokes.items():
        floor = rig.braces[j].floor
        if floor in x_of and floor - 1 in x_of:
            expected = rig.braces[j].cosine * (x_of[floor] - x_of[floor - 1])
            name = f"stroke {stroke} against its floor's displacement"
            watch(Quantity("implausible_stroke", stroke, name), measured[stroke] - expected)
    sensors = rig.channel_sensors
    for k, channel in enumerate(channels):
        jump = _second_difference(1 / sensors[k].range)
        watch(Quantity("noisy", channel, f"jumps of {channel}"), unit[k], jump)
    one, two = (linalg.block_diag(*[matrices[k] for _, matrices, _ in rows]) for k in (0, 2))
    entering, direct = (np.vstack([matrices[k] @ factors for _, matrices, factors in rows]) for k in (1, 3))
    at_rest = np.linalg.solve(np.eye(len(one)) - one, entering)
    step: NDArray[np.float64] = np.ascontiguousarray(np.block([[one, entering], [two, direct]]))
    # of the readings, steps of the converter included; command and table have none
    noises = [np.hypot(sensor.noise, sensor.step / np.sqrt(12)) for sensor in sensors]
    deviations = np.array([*noises, *[0.0] * (m + 2)])
    covariance = linalg.solve_discrete_lyapunov(one, (entering * deviations) @ (entering * deviations).T)
    variances = np.einsum("ij,jk,ik->i", two, covariance, two) + np.sum((direct * deviations) ** 2, axis=1)
    noise: dict[str, float] = {}
    for (quantity, _, _), variance in zip(rows, variances, strict=True):
        noise[quantity.interlock] = max(noise.get(quantity.interlock, 0.0), float(np.sqrt(variance)))
    quantities, settling = tuple(quantity for quantity, _, _ in rows), int(np.ceil(SETTLING / slow / period))
    return Detectors(quantities, step, np.asarray(at_rest, dtype=np.float64), settling, noise)


def not_watched(rig: Rig) -> dict[str, tuple[str, ...]]:
    """By interlock, the channels of a `rig` that it would watch if every channel were measured, and does not."""
    if not rig.not_measured:
        return {}
    any_sensor = Sensor(1.0, 0.0, 16)
    kinds: dict[str, Any] = {kind: getattr(rig.sensors, kind) or any_sensor for kind in KINDS}
    complete = replace(rig, sensors=replace(rig.sensors, **kinds, without=frozenset()))
    watched = {one[:2] for one in detectors(rig).quantities}
    found: dict[str, tuple[str, ...]] = {}
    for interlock, channel, _ in detectors(complete).quantities:
        if (interlock, channel) not in watched and interlock != "noisy":
            found[interlock] = (*found.get(interlock, ()), channel)
    return found


def missing_sensors(rig: Rig) -> str:
    """What is not measured of a `rig`, and therefore not watched, in a sentence; empty: all is measured."""
    if not rig.not_measured:
        return ""
    watched = {one.interlock for one in detectors(rig).quantities}
    without = [
        f"{interlock} of {', '.join(channels)}" if interlock in watched else interlock
        for interlock, channels in not_watched(rig).items()
    ]
    sentence = f"not measured: {', '.join(rig.not_measured)}"
    sentence += f"; interlocks that do not watch: {', '.join(without)}" if without else ""
    if cells := cells_missing(rig):
        sentence += f"; no load cell {', '.join(cells)}: rest cannot be measured there"
    return sentence


def cells_missing(rig: Rig) -> list[str]:
    """Load cells of a `rig` that are not there."""
    return [name for name in signals.load_cell_names(rig.braces_in_group) if name in rig.not_measured]


def _second_order(frequency: float, *numerators: Sequence[float]) -> Matrices:
    """(n2 s^2 + n1 s + n0) / (s^2 + sqrt(2) w s + w^2), one input for each numerator (n2, n1, n0); observable form."""
    damping, stiffness = np.sqrt(2) * frequency, frequency**2
    n2, n1, n0 = np.array(numerators).T
    a = np.array([[-damping, 1.0], [-stiffness, 0.0]])
    return a, np.array([n1 - damping * n2, n0 - stiffness * n2]), np.array([[1.0, 0.0]]), n2[None]


def _residual(slow: float, fast: float) -> Matrices:
    """From (a - w, x) to F (a - w) - s^2 F x: the low-pass of the difference, then the high-pass."""
    a1, b1, c1, d1 = _second_order(fast, (0.0, 0.0, fast**2), (-(fast**2), 0.0, 0.0))
    a2, b2, c2, d2 = _second_order(slow, (1.0, 0.0, 0.0))
    a = np.block([[a1, np.zeros((2, 2))], [b2 @ c1, a2]])
    return a, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def _bilinear(matrices: Matrices, period: float) -> Matrices:
    a, b, c, d = matrices
    half = period / 2 * a
    inverse = np.linalg.inv(np.eye(len(a)) - half)
    return inverse @ (np.eye(len(a)) + half), period * inverse @ b, c @ inverse, d + period / 2 * c @ inverse @ b


def _lag(lag: float, delay: float, period: float) -> Matrices:
    """From (command in force until a sample, force at it) to the command after delay and lag, less the force."""
    one = np.ones((1, 1))
    servo = LinearModel(-one / lag, one / lag, one, 0 * one, ("U",), ("f",), input_delay=(delay,))
    model = discretize(servo, period)
    # the command that ends at a sample has acted on the state by then
    b = np.hstack([model.b, np.zeros((model.order, 1))])
    return model.a, b, model.c @ model.a, np.hstack([model.c @ model.b, -one])


def _second_difference(factor: float) -> Matrices:
    """factor (r(k) - 2 r(k-1) + r(k-2)): small for a smooth motion, 2.4 times the rms for white noise."""
    a, b = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    return a, b, factor * np.array([[-2.0, 1.0]]), np.array([[factor]])
