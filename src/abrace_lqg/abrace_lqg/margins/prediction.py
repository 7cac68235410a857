"""What a loop will do: rms of every response and of the commands while the ground shakes at random.

The ground acceleration is noise with a flat spectrum in a band; the response's power is the integral of |H|^2 over that
band, with H of the sampled loop, for which the ground moves linearly between samples. Nothing saturates here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_lqg.loop import LOWEST, closed_loop, resolving, sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel


@dataclass(frozen=True)
class Excitation:
    """Banded white noise of the ground acceleration.

    Parameters
    ----------
    rms
        [m/s^2].
    band
        Lowest and highest frequency [Hz].

    Raises
    ------
    AbraceError
        If there is no such noise.
    """

    rms: float = 0.25
    band: tuple[float, float] = (0.3, 10.0)

    def __post_init__(self) -> None:
        low, high = self.band
        if not (0 < self.rms < np.inf and 0 <= low < high < np.inf):
            raise AbraceError(
                f"excitation of {self.rms} m/s^2 from {low} to {high} Hz: expected more than 0, and a band that rises"
            )

    def __str__(self) -> str:
        return f"ground acceleration of {self.rms:g} m/s^2 rms, flat from {self.band[0]:g} to {self.band[1]:g} Hz"


def excited(model: LinearModel, excitation: Excitation) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Amplitudes of the outputs over the band.

    Parameters
    ----------
    model
        Discrete and stable; its only input is the ground acceleration.
    excitation
        How the ground shakes.

    Returns
    -------
    omega, amplitudes
        (frequencies,) [rad/s] and (frequencies, outputs): products of two outputs' amplitudes, one conjugated, add up
        to their covariance.

    Raises
    ------
    AbraceError
        If the model has other inputs, is not stable, or is sampled too slowly for the band.
    """
    poles = np.asarray(np.linalg.eigvals(model.a), dtype=np.complex128)
    if model.inputs != (signals.GROUND,) or not model.sample_period or np.abs(poles).max(initial=0.0) >= 1:
        raise AbraceError(
            f"prediction: model with inputs {', '.join(model.inputs)} and sample period {model.sample_period} s, "
            f"expected a stable discrete one with input {signals.GROUND}"
        )
    low, high = (2 * np.pi * frequency for frequency in excitation.band)
    highest = np.pi / model.sample_period
    if high > highest * (1 + 1e-9):
        raise AbraceError(
            f"prediction: band up to {excitation.band[1]} Hz, expected at most {highest / (2 * np.pi):g} Hz"
        )
    omega = resolving(poles, model.sample_period, (max(low, LOWEST), min(high, highest)))
    steps = np.diff(omega)
    share = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]]) / 2 / (high - low)
    response = model.frequency_response(omega)[:, :, 0]
    return omega, response * (excitation.rms * np.sqrt(share))[:, None]


def predicted_rms(model: LinearModel, controller: LinearModel | None, excitation: Excitation) -> dict[str, float]:
    """Rms of each output, and of each command, by name [SI units].

    Parameters
    ----------
    model
        From ground acceleration and commands; continuous, or discrete at the controller's sample period.
    controller
        Eq. (13); None: zero command, with a discrete model.
    excitation
        How the ground shakes.
    """
    loop = model.select(inputs=[signals.GROUND]) if controller is None else closed_loop(model, controller)
    _, amplitudes = excited(loop, excitation)
    rms = np.sqrt(np.sum(np.abs(amplitudes) ** 2, axis=0))
    found = dict(zip(loop.outputs, rms.tolist(), strict=True))
    return {name: 0.0 for name in model.inputs if name != signals.GROUND} | found


def controlled_and_not(
    model: LinearModel, controller: LinearModel, excitation: Excitation
) -> dict[str, tuple[float, float]]:
    """Rms of each output and command by name, with zero command and controlled [SI units].

    `model` and `controller` are as in `closed_loop`, `excitation` as in `predicted_rms`.
    """
    plant = sampled(model, controller.sample_period)
    without, controlled = predicted_rms(plant, None, excitation), predicted_rms(plant, controller, excitation)
    return {name: (without[name], controlled[name]) for name in (*plant.outputs, *controller.outputs)}
