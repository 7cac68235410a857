# SPDX-License-Identifier: Apache-2.0
"""The sampled loop of a model and a controller: closed, as one model, or broken at one signal, over frequency.

The timing is that of the rig: the command computed from sample k is in force from sample k+1 to k+2, held. A controller
whose sample period is n of a discrete model's answers every n-th sample, its command in force from sample k+1 to k+n+1:
what follows is then of the lifted model, from one of the controller's samples to the next, and its poles are those of
the monodromy matrix.

The loop is broken at one signal, a command at the plant's input U or a measured quantity, while the others stay closed.
Its transfer function is that of the discrete models, exact at every frequency below half the sampling rate, with the
computational delay of one sample. With S = 1/(1 + L) the diagonal entry of the sensitivity that belongs to that signal
and T = 1 - S the complementary sensitivity, L = T/(1 - T) (Skogestad and Postlethwaite 2005, ch. 2).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize, holds_of
from abrace_core.model.lifting import divisor, lifted
from abrace_core.model.linear_model import LinearModel, pole_table, takes_models
from abrace_core.model.si_units import in_si_units

if TYPE_CHECKING:
    from numpy.typing import NDArray

LOWEST_FREQUENCY = 1e-4
"""Where frequency grids begin [rad/s]."""

NEGLIGIBLE_POLE = 1e-4
"""|z| of a pole that decays within one sample, as those of a delay do: it is not counted as an oscillation."""


@takes_models
def sampled(model: LinearModel, sample_period: float) -> LinearModel:
    """The `model` in SI units at `sample_period` [s]: commands held, ground motion linear in between.

    A discrete one has to be of this sample period.
    """
    model = in_si_units(model)
    if not model.sample_period:
        return discretize(model, sample_period, holds_of(model))
    if abs(model.sample_period - sample_period) > 1e-9 * sample_period:
        raise AbraceError(f"model sampled every {model.sample_period} s, expected every {sample_period} s")
    return model


@takes_models
def at_rate(model: LinearModel, controller: LinearModel) -> LinearModel:
    """The `model` in SI units: continuous, `sampled` as the `controller`; discrete, of its own sample period.

    That of the controller is the same or a whole multiple.
    """
    if not model.sample_period:
        return sampled(model, controller.sample_period)
    divisor(controller.sample_period, model.sample_period)
    return in_si_units(model)


@takes_models
def seen_by(plant: LinearModel, controller: LinearModel) -> LinearModel:
    """A discrete `plant` from one sample of the `controller` to the next (`lifted`), its commands the last inputs."""
    external = tuple(name for name in plant.inputs if name not in controller.outputs)
    samples = divisor(controller.sample_period, plant.sample_period)
    return lifted(plant.select(inputs=(*external, *controller.outputs)), len(controller.outputs), samples)


@takes_models
def closed_loop(model: LinearModel, controller: LinearModel) -> LinearModel:
    """The discrete loop from the remaining inputs (of a rig the ground acceleration) to the outputs and the commands.

    Parameters
    ----------
    model
        Continuous, or discrete at the controller's sample period or a whole part of it; its signals are converted to SI
        units.
    controller
        Discrete, from some of the model's outputs to some of its inputs (Eq. 13); likewise.

    Returns
    -------
    LinearModel
        States: the model's, the controller's, the commands in force. The command at sample k is the one in force from
        that sample to the next. With a slower controller each other input and each output come once for each sample, as
        `lifted` has them.
    """
    import control

    controller = in_si_units(controller)
    period, commands = controller.sample_period, len(controller.outputs)
    plant = seen_by(at_rate(model, controller), controller)
    external = plant.inputs[: len(plant.inputs) - commands]
    measured = plant.select(controller.inputs)
    in_force = np.eye(commands, len(plant.inputs), len(external))
    none, eye = np.zeros((commands, commands)), np.eye(commands)
    # to the outputs and the commands in force, and to what is measured, which goes back through a sample's delay
    c = np.vstack([plant.c, np.zeros((commands, plant.order)), measured.c])
    upper = control.ss(plant.a, plant.b, c, np.vstack([plant.d, in_force, measured.d]), period)
    whole = upper.lft(control.series(controller.to_control(), control.ss(none, eye, eye, none, period)))
    return LinearModel(whole.A, whole.B, whole.C, whole.D, external, plant.outputs + controller.outputs, period)


@takes_models
def open_loop(model: LinearModel, controller: LinearModel, broken_at: str) -> LinearModel:
    """The discrete loop broken at one signal, the others closed, as a model: L of `Loop.transfer_function`.

    For python-control's Bode, Nyquist and Nichols plots: `open_loop(model, controller, "U").to_control()`. A row or a
    column of the closed loop's matrices is cut, which has no states to name again as `interconnect` has.

    Parameters
    ----------
    model, controller
        As in `closed_loop`.
    broken_at
        A command or a measured quantity: its name is that of the input, and of the output, which is turned in sign so
        that the loop is on the edge of stability where L = -1.
    """
    plant, controller = at_rate(model, controller), in_si_units(controller)
    signals = (*controller.outputs, *controller.inputs)
    if broken_at not in signals:
        raise AbraceError(f"loop broken at {broken_at!r}: expected one of {', '.join(signals)}")
    whole = closed_loop(plant, controller)
    a, b = whole.a.copy(), np.zeros((whole.order, 1))
    if broken_at in controller.outputs:
        # the controller's command is the output, the command in force one sample later the input
        row = plant.order + controller.order + controller.outputs.index(broken_at)
        returned = a[row].copy()
        a[row], b[row] = 0.0, 1.0
    else:
        returned = whole.c[whole.outputs.index(broken_at)]
        column = controller.inputs.index(broken_at)
        b[plant.order :, 0] = np.concatenate([controller.b[:, column], controller.d[:, column]])
        a -= b @ returned[None]
    return LinearModel(a, b, -returned[None], np.zeros((1, 1)), (broken_at,), (broken_at,), whole.sample_period)


@takes_models
def closed_loop_poles(model: LinearModel, controller: LinearModel) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of the oscillating poles, slowest first; arguments as in `closed_loop`."""
    return _oscillations(eigenvalues(closed_loop(model, controller).a), controller.sample_period)


@takes_models
def is_stable(model: LinearModel, controller: LinearModel) -> bool:
    """Whether the closed loop is stable; arguments as in `closed_loop`."""
    return bool(np.abs(eigenvalues(closed_loop(model, controller).a)).max() < 1)


class Loop:
    """Transfer functions of the loop of a model and a controller, prepared for evaluation at many frequencies.

    Parameters
    ----------
    model, controller
        As in `closed_loop`.

    Attributes
    ----------
    signals
        Names of the signals at which it can be broken: the commands, then the measured quantities.
    is_stable
        Whether the closed loop is stable.
    """

    @takes_models
    def __init__(self, model: LinearModel, controller: LinearModel) -> None:
        whole, controller = seen_by(at_rate(model, controller), controller), in_si_units(controller)
        self._plant, self._controller = whole.select(controller.inputs, controller.outputs), controller
        self.sample_period = controller.sample_period
        self.signals = (*controller.outputs, *controller.inputs)
        closed_poles = eigenvalues(closed_loop(whole, controller).a)
        self.is_stable = bool(np.abs(closed_poles).max() < 1)
        self._poles = np.concatenate([eigenvalues(whole.a), eigenvalues(controller.a), closed_poles])

    def components(self, omega: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Responses of plant and controller at `omega` [rad/s].

        That of the plant (frequencies, measured, commands) includes the delay of one sample; that of the controller is
        (frequencies, commands, measured).
        """
        z = np.exp(1j * omega * self.sample_period)[:, None, None]
        plant, controller = self._plant.frequency_response(omega) / z, self._controller.frequency_response(omega)
        finite = np.isfinite(plant).all(axis=(1, 2)) & np.isfinite(controller).all(axis=(1, 2))
        if not finite.all():
            raise AbraceError(
                f"loop: no finite response at {omega[~finite][0]:.6g} rad/s, expected one of plant and law"
            )
        return plant, controller

    def complementary_sensitivity(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """T of the loop broken at each of `signals`, the others closed: (frequencies, signals) at `omega` [rad/s]."""
        plant, controller = self.components(omega)
        # T = L (1 + L)^-1 with L = -K G at the commands and -G K at the sensors, where G (1 - K G)^-1 K is the same T
        if controller.shape[1] == 1:
            through = controller / (1 - controller @ plant)
        else:
            difference = np.eye(controller.shape[1]) - controller @ plant
            through = np.asarray(np.linalg.solve(difference, controller), dtype=np.complex128)
        at_commands = -np.einsum("fmp,fpm->fm", through, plant)
        at_sensors = -np.einsum("fpm,fmp->fp", plant, through)
        return np.hstack([at_commands, at_sensors])

    def transfer_function(self, signal: str, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """L (frequencies,) of the loop broken at `signal`, at `omega` [rad/s]; 1 + L = 0 at the edge of stability."""
        complementary = self.complementary_sensitivity(omega)[:, self.index(signal)]
        return complementary / (1 - complementary)

    def index(self, signal: str) -> int:
        """Position of `signal` among `signals`; an AbraceError if it is not one of them."""
        if signal not in self.signals:
            raise AbraceError(f"loop broken at {signal!r}: expected one of {', '.join(self.signals)}")
        return self.signals.index(signal)

    def frequencies(self) -> NDArray[np.float64]:
        """Frequencies [rad/s] up to half the sampling rate, dense enough that no crossing is missed."""
        return frequency_grid(self._poles, self.sample_period, (LOWEST_FREQUENCY, np.pi / self.sample_period))


def frequency_grid(
    poles: NDArray[np.complex128], sample_period: float, span: tuple[float, float]
) -> NDArray[np.float64]:
    """Frequencies [rad/s], evenly spaced on a logarithmic scale and denser around each oscillating pole.

    Parameters
    ----------
    poles
        (poles,) in the z plane; the less damped one is, the closer are the frequencies around it.
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


def eigenvalues(matrix: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Eigenvalues (n,) of a real `matrix` (n, n): the poles in the z plane of a discrete model."""
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)


def _oscillations(z: NDArray[np.complex128], sample_period: float) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of the complex ones among poles in the z plane, slowest first."""
    z = z[(np.abs(z.imag) > 1e-12 * np.abs(z)) & (np.abs(z) > NEGLIGIBLE_POLE)]
    return pole_table(np.asarray(np.log(z) / sample_period, dtype=np.complex128))
