"""The sampled loop of a model and a controller: in the time domain as one model, and over frequency, broken anywhere.

The loop is that of the graph: the command computed from sample k is in force from sample k+1 to k+2, held. It is broken
at one signal, a command on its way to the plant's input U or a sensor, while the others stay closed; its frequency
response is that of the discrete models, exact at every frequency below half the sampling rate, with the computational
delay of one sample. With S = 1/(1 + L) the diagonal entry of the sensitivity that belongs to that signal and T = 1 - S
the complementary one, L = T/(1 - T) (Skogestad and Postlethwaite 2005, Multivariable Feedback Control, chapter 2).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, pole_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

LOWEST = 1e-4
"""Where frequencies begin [rad/s]."""

DISTINCT = 1e10
"""Condition of the eigenvectors up to which a model is evaluated as a sum over its poles."""

GONE = 1e-4
"""|z| of a pole that dies out within one sample, as those of a delay do: no oscillation."""


def sampled(model: LinearModel, sample_period: float) -> LinearModel:
    """The `model` at `sample_period` [s]: commands held, ground motion linear in between; a discrete one as it is."""
    if not model.sample_period:
        return discretize(model, sample_period)
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
    poles = np.asarray(np.linalg.eigvals(closed_loop(model, controller).a), dtype=np.complex128)
    return _oscillations(poles, controller.sample_period)


def is_stable(model: LinearModel, controller: LinearModel) -> bool:
    """Whether the loop is stable; arguments as in `closed_loop`."""
    return bool(np.abs(np.linalg.eigvals(closed_loop(model, controller).a)).max() < 1)


class Loop:
    """The loop of a model and a controller, made ready to be evaluated at many frequencies.

    Parameters
    ----------
    model, controller
        As in `closed_loop`.

    Attributes
    ----------
    signals
        Where it can be broken: the commands, then the measured quantities.
    is_stable
        Whether it is stable when closed.
    """

    def __init__(self, model: LinearModel, controller: LinearModel) -> None:
        whole = sampled(model, controller.sample_period)
        plant = whole.select(controller.inputs, controller.outputs)
        self.sample_period = controller.sample_period
        self.signals = (*controller.outputs, *controller.inputs)
        (open_poles, self._forward), (own_poles, self._back) = _evaluator(plant), _evaluator(controller)
        closed_poles = np.asarray(np.linalg.eigvals(closed_loop(whole, controller).a), dtype=np.complex128)
        self.is_stable = bool(np.abs(closed_poles).max() < 1)
        self._poles = np.concatenate([open_poles, own_poles, closed_poles])

    def paths(self, omega: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The plant with the delay of one sample (frequencies, measured, commands), and the controller, at `omega`."""
        z = np.exp(1j * omega * self.sample_period)
        return self._forward(z) / z[:, None, None], self._back(z)

    def complementary(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """T of the loop broken at each of `signals`, the others closed: (frequencies, signals) at `omega` [rad/s]."""
        forward, back = self.paths(omega)
        # T = L (1 + L)^-1 with L = -K G at the commands and -G K at the sensors, where G (1 - K G)^-1 K is the same T
        if back.shape[1] == 1:
            through = back / (1 - back @ forward)
        else:
            through = np.asarray(np.linalg.solve(np.eye(back.shape[1]) - back @ forward, back), dtype=np.complex128)
        at_commands = -np.einsum("fmp,fpm->fm", through, forward)
        at_sensors = -np.einsum("fpm,fmp->fp", forward, through)
        return np.hstack([at_commands, at_sensors])

    def at(self, signal: str, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """L (frequencies,) of the loop broken at `signal`, at `omega` [rad/s], negative feedback."""
        if signal not in self.signals:
            raise AbraceError(f"loop broken at {signal!r}: expected one of {', '.join(self.signals)}")
        complementary = self.complementary(omega)[:, self.signals.index(signal)]
        return complementary / (1 - complementary)

    def frequencies(self) -> NDArray[np.float64]:
        """Frequencies [rad/s] up to half the sampling rate that miss no crossing."""
        return resolving(self._poles, self.sample_period, (LOWEST, np.pi / self.sample_period))


def loop_response(
    model: LinearModel, controller: LinearModel, omega: NDArray[np.float64], signal: str = ""
) -> NDArray[np.complex128]:
    """L of the loop broken at one signal, negative feedback: 1 + L = 0 at the edge of stability.

    Parameters
    ----------
    model, controller
        As in `closed_loop`.
    omega
        (frequencies,) [rad/s].
    signal
        A command or a measured quantity; the first command if none is named.

    Returns
    -------
    NDArray
        (frequencies,) complex.
    """
    return Loop(model, controller).at(signal or controller.outputs[0], omega)


def resolving(poles: NDArray[np.complex128], sample_period: float, span: tuple[float, float]) -> NDArray[np.float64]:
    """Frequencies [rad/s] that show all that a loop does: dense where a pole or its damping asks for it.

    Parameters
    ----------
    poles
        (poles,) in the z plane; the oscillating ones have to be resolved.
    sample_period
        [s].
    span
        Lowest and highest frequency, more than zero [rad/s]; both are among the result.
    """
    found = np.array(_oscillations(poles, sample_period)).reshape(-1, 2)
    spread = np.sinh(np.linspace(-4.5, 4.5, 37))
    around = found[:, [0]] * (1 + found[:, [1]] * spread)
    omega = np.unique(np.concatenate([np.geomspace(*span, 1200), around.ravel()]))
    return omega[(omega >= span[0]) & (omega <= span[1])]


def _evaluator(
    model: LinearModel,
) -> tuple[NDArray[np.complex128], Callable[[NDArray[np.complex128]], NDArray[np.complex128]]]:
    """The model's poles, and its response (points, outputs, inputs) as a function of z (points,), a sum over them."""
    shape = model.d.shape
    poles, vectors = np.linalg.eig(model.a)
    poles = np.asarray(poles, dtype=np.complex128)
    if np.linalg.cond(vectors) < DISTINCT:
        left = np.linalg.solve(vectors, model.b.astype(np.complex128))
        residues = ((model.c @ vectors).T[:, :, None] * left[:, None, :]).reshape(model.order, -1)
        return poles, lambda z: (1 / (z[:, None] - poles) @ residues).reshape(len(z), *shape) + model.d
    return poles, lambda z: model.frequency_response(np.angle(z) / model.sample_period)


def _oscillations(z: NDArray[np.complex128], sample_period: float) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of the complex ones among poles in the z plane, slowest first."""
    z = z[(np.abs(z.imag) > 1e-12 * np.abs(z)) & (np.abs(z) > GONE)]
    return pole_table(np.asarray(np.log(z) / sample_period, dtype=np.complex128))
