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

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg

from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_plant.rig.limits import frequencies

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
    """The detectors of a rig; a disconnected brace group has none."""
    n, m, period = rig.floors, rig.groups, 1 / rig.sample_rate
    channels = rig.channel_names
    inputs = len(channels) + m + 2
    unit = np.eye(inputs)
    x, stroke, a, force = (unit[first:] for first in (0, n, n + m, 2 * n + m))
    ground, command = unit[len(channels) - 1], unit[len(channels) :]
    rows: list[tuple[Quantity, Matrices, NDArray[np.float64]]] = []

    def watch(quantity: Quantity, factors: NDArray[np.float64], filtered: Matrices = UNFILTERED) -> None:
        """Add the output of a discrete filter whose inputs are sums of inputs, by their `factors`."""
        rows.append((quantity, filtered, np.atleast_2d(factors)))

    for i in range(n):
        below = x[i - 1] if i else np.zeros(inputs)
        watch(Quantity("drift", f"x{i + 1}", f"interstorey drift of storey {i + 1}"), x[i] - below)
    for i in range(n):
        watch(Quantity("displacement", f"x{i + 1}", f"displacement x{i + 1}"), x[i])
    cutoff = 2 * np.pi * min(VELOCITY_CUTOFF, rig.sample_rate / 5)
    derivative = _bilinear(_second_order(cutoff, (0.0, cutoff**2, 0.0)), period)
    for i in range(n):
        watch(Quantity("velocity", f"x{i + 1}", f"velocity of floor {i + 1}"), x[i], derivative)
    connected = [j for j in range(m) if rig.braces[j].connected]
    strokes = channels[n : n + m]
    groups = np.repeat(np.arange(m), rig.braces_in_group).tolist()
    cells = [(channels[2 * n + m + k], force[k], j) for k, j in enumerate(groups) if rig.braces[j].connected]
    for j in connected:
        watch(Quantity("stroke", strokes[j], f"stroke {strokes[j]}"), stroke[j])
    for i in range(n):
        watch(Quantity("acceleration", f"a{i + 1}", f"acceleration a{i + 1}"), a[i])
    for name, measured, j in cells:
        watch(Quantity("force", name, f"force {name}"), measured)
        error = Quantity("force_error", name, f"force {name} against its command")
        actuator = rig.braces[j].actuator
        lagging = _lag(actuator.lag, actuator.command_delay, period)
        watch(error, np.vstack([command[j], measured]), lagging)
    modes = frequencies(rig)
    faster = _bilinear(_second_order(FASTER * modes[-1], (1.0, 0.0, 0.0)), period)
    for name, measured, _ in cells:
        text = f"oscillation of force {name}, rms above {FASTER * modes[-1] / (2 * np.pi):.3g} Hz"
        watch(Quantity("oscillation", name, text), measured, faster)
    watch(Quantity("table_displacement", "table", "place where the table would stop"), unit[-2])
    watch(Quantity("table_velocity", "table", "velocity of the table"), unit[-1])

    slow, fast = (factor * modes[0] for factor in BAND)
    residual = _bilinear(_residual(slow, fast), period)
    for i in range(n):
        name = f"a{i + 1} against x{i + 1} and {signals.GROUND}"
        watch(Quantity("implausible_acceleration", f"a{i + 1}", name), np.array([a[i] - ground, x[i]]), residual)
    for j in connected:
        group = rig.braces[j]
        expected = group.cosine * group.direction(n) @ x[:n]
        name = f"stroke {strokes[j]} against its floor's displacement"
        watch(Quantity("implausible_stroke", strokes[j], name), stroke[j] - expected)
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
