"""The sampled loop of a model and a controller: its poles, and how far it is from instability.

The loop is that of the graph: the command computed from sample k is in force from sample k+1 to k+2, held. It is broken
at the plant's input U, and its frequency response is that of the discrete models, exact at every frequency below half
the sampling rate, with the computational delay of one sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, pole_table
from abrace_core.simulation import discretize

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

LOWEST = 1e-4
"""Where the search for crossings begins [rad/s]."""

REAL = 1e-2
"""Radians within which L counts as real at the ends of the search, where it meets the real axis without crossing it."""

BISECTIONS = 40

GONE = 1e-4
"""|z| of a pole that dies out within one sample, as those of a delay do: no oscillation."""


@dataclass(frozen=True)
class Margins:
    """How far a loop is from instability, broken at its command.

    Parameters
    ----------
    gain
        Least change of gain, up or down, that reaches the edge [dB]; infinite if none does.
    phase
        Least change of phase, either way, that does [degrees].
    delay
        Least additional delay that does [s].
    sensitivity_peak
        Greatest |1 / (1 + L)|: one over the Nyquist curve's distance from -1.
    """

    gain: float
    phase: float
    delay: float
    sensitivity_peak: float

    def __str__(self) -> str:
        return (
            f"gain margin {self.gain:.1f} dB, phase margin {self.phase:.1f} deg, "
            f"delay margin {1e3 * self.delay:.1f} ms, sensitivity peak {self.sensitivity_peak:.2f}"
        )


def sampled(model: LinearModel, sample_period: float) -> LinearModel:
    """The `model` at `sample_period` [s]: commands held, ground motion linear in between; a discrete one as it is."""
    if not model.sample_period:
        return discretize(model, sample_period, {signals.GROUND: "first"})
    if abs(model.sample_period - sample_period) > 1e-9 * sample_period:
        raise AbraceError(f"model sampled every {model.sample_period} s, expected every {sample_period} s")
    return model


def closed_loop(model: LinearModel, controller: LinearModel) -> LinearModel:
    """The discrete loop from the remaining inputs (the ground acceleration) to the outputs and the commands.

    Parameters
    ----------
    model
        Continuous, or discrete at the controller's sample period.
    controller
        Discrete, from some of the model's outputs to some of its inputs (Eq. 13).

    Returns
    -------
    LinearModel
        States: the model's, the commands in force, the controller's. A command at sample k is the one in force from
        there to the next.
    """
    plant = sampled(model, controller.sample_period)
    outside = tuple(name for name in plant.inputs if name not in controller.outputs)
    driven = plant.select(inputs=outside)
    commanded = plant.select(inputs=controller.outputs)
    y_driven, y_commanded = driven.select(controller.inputs), commanded.select(controller.inputs)
    n, m, states = plant.order, len(controller.outputs), controller.order
    a = np.block(
        [
            [plant.a, commanded.b, np.zeros((n, states))],
            [controller.d @ y_commanded.c, controller.d @ y_commanded.d, controller.c],
            [controller.b @ y_commanded.c, controller.b @ y_commanded.d, controller.a],
        ]
    )
    b = np.vstack([driven.b, controller.d @ y_driven.d, controller.b @ y_driven.d])
    c = np.block([[plant.c, commanded.d, np.zeros((len(plant.c), states))], [np.eye(m, n + m + states, n)]])
    d = np.vstack([driven.d, np.zeros((m, len(outside)))])
    return LinearModel(a, b, c, d, outside, plant.outputs + controller.outputs, controller.sample_period)


def closed_loop_poles(model: LinearModel, controller: LinearModel) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of the loop's oscillating poles, slowest first, as in `closed_loop`."""
    return _oscillations(closed_loop(model, controller))


def is_stable(model: LinearModel, controller: LinearModel) -> bool:
    """Whether the loop is stable; arguments as in `closed_loop`."""
    return bool(np.abs(np.linalg.eigvals(closed_loop(model, controller).a)).max() < 1)


def loop_response(model: LinearModel, controller: LinearModel, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """L of the loop broken at its single command, negative feedback: 1 + L = 0 at the edge of stability.

    Parameters
    ----------
    model, controller
        As in `closed_loop`, with one command.
    omega
        (frequencies,) [rad/s].

    Returns
    -------
    NDArray
        (frequencies,) complex.
    """
    if len(controller.outputs) != 1:
        raise AbraceError(f"margins of a loop with commands {', '.join(controller.outputs)}: expected one command")
    plant = sampled(model, controller.sample_period).select(controller.inputs, controller.outputs)
    delay = np.exp(-1j * omega * controller.sample_period)
    forward, back = plant.frequency_response(omega), controller.frequency_response(omega)
    return -(back @ forward)[:, 0, 0] * delay


def margins(model: LinearModel, controller: LinearModel) -> Margins:
    """Gain, phase and delay margin and sensitivity peak of a stable loop with one command.

    Parameters
    ----------
    model, controller
        As in `closed_loop`.

    Raises
    ------
    AbraceError
        If the loop is not stable, or has several commands.
    """
    if not is_stable(model, controller):
        raise AbraceError("margins: the closed loop is not stable")
    plant = sampled(model, controller.sample_period).select(controller.inputs, controller.outputs)
    omega = _frequencies(plant, controller)
    loop = loop_response(plant, controller, omega)

    def crossings(measure: Callable[[NDArray[np.complex128]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Frequencies where a measure of L goes through zero."""
        values = measure(loop)
        changes = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        low, high, side = omega[changes], omega[changes + 1], np.sign(values[changes])
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            before = np.sign(measure(loop_response(plant, controller, middle))) == side
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return low

    at_phase = np.append(loop_response(plant, controller, crossings(np.imag)), loop[[0, -1]])
    at_phase = at_phase[np.abs(np.angle(-at_phase)) < REAL]
    gains = np.abs(20 * np.log10(np.abs(at_phase)))
    at_gain = crossings(lambda response: np.log(np.abs(response)))
    angles = np.mod(np.angle(-loop_response(plant, controller, at_gain)), 2 * np.pi)
    return Margins(
        gain=float(gains.min(initial=np.inf)),
        phase=float(np.degrees(np.minimum(angles, 2 * np.pi - angles)).min(initial=180.0)),
        delay=float((angles / at_gain).min(initial=np.inf)),
        sensitivity_peak=float(np.abs(1 / (1 + loop)).max()),
    )


def _oscillations(model: LinearModel) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of a discrete model's complex poles, slowest first."""
    z = np.asarray(np.linalg.eigvals(model.a), dtype=np.complex128)
    z = z[(z.imag != 0) & (np.abs(z) > GONE)]
    return pole_table(np.log(z) / model.sample_period)


def _frequencies(plant: LinearModel, controller: LinearModel) -> NDArray[np.float64]:
    """Frequencies up to half the sampling rate that miss no crossing: dense where a pole or its damping asks for it."""
    highest = np.pi / controller.sample_period
    parts = [np.geomspace(LOWEST, highest, 3000)]
    spread = np.sinh(np.linspace(-5, 5, 101))
    for model in (plant, controller):
        parts += [frequency * (1 + damping * spread) for frequency, damping in _oscillations(model)]
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= LOWEST) & (omega <= highest)]
