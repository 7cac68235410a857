# SPDX-License-Identifier: Apache-2.0
"""Predicted rms of responses and commands under a random disturbance, of a rig the ground motion.

It is noise with a flat spectrum in a band; the response's power is the integral of |H|^2 over that band, with H the
transfer function of the sampled loop, for which a ground acceleration is linear between samples; with a controller that
answers every n-th sample it is the mean over the n samples. The prediction is linear: commands do not saturate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.linear_model import takes_models
from abrace_core.model.si_units import in_si_units
from abrace_lqg.analysis.named_values import Named
from abrace_lqg.loop import LOWEST_FREQUENCY, at_rate, closed_loop, eigenvalues, frequency_grid

if TYPE_CHECKING:
    from abrace_core.model.linear_model import LinearModel


@dataclass(frozen=True)
class Excitation:
    """Disturbance: white noise within a band.

    Parameters
    ----------
    rms
        [unit].
    band
        Lowest and highest frequency [Hz].
    input
        Name of the input that disturbs, by default the ground acceleration.
    unit
        SI unit of it.

    Raises
    ------
    AbraceError
        If the rms or the band is not positive and finite.
    """

    rms: float = 0.25
    band: Annotated[tuple[float, float], Named("lowest_hz", "highest_hz")] = (0.3, 10.0)
    input: str = signals.GROUND
    unit: str = signals.unit(signals.GROUND)

    def __post_init__(self) -> None:
        low, high = self.band
        if not (0 < self.rms < np.inf and 0 <= low < high < np.inf):
            raise AbraceError(
                f"excitation of {self.rms} {self.unit} from {low} to {high} Hz: expected more than 0, and a band that "
                "rises"
            )

    def __str__(self) -> str:
        what = "ground acceleration" if self.input == signals.GROUND else self.input
        return f"{what} of {self.rms:g} {self.unit} rms, flat from {self.band[0]:g} to {self.band[1]:g} Hz"


@takes_models
def predicted_rms(model: LinearModel, controller: LinearModel | None, excitation: Excitation) -> dict[str, float]:
    """Rms of each output, and of each command, by name [SI units].

    Parameters
    ----------
    model
        From disturbance and commands; continuous, or discrete at the controller's sample period or a whole part of it.
    controller
        Eq. (13); None: zero command, with a discrete model.
    excitation
        The disturbance.

    Raises
    ------
    AbraceError
        If the loop has other inputs, is not stable, or is sampled too slowly for the band.
    """
    model = in_si_units(model)
    loop = model.select(inputs=[excitation.input]) if controller is None else closed_loop(model, controller)
    commands = () if controller is None else controller.outputs
    poles, free = eigenvalues(loop.a), [name for name in model.inputs if name not in commands]
    if (controller and free != [excitation.input]) or not loop.sample_period or np.abs(poles).max(initial=0.0) >= 1:
        raise AbraceError(
            f"prediction: model with inputs {', '.join(free)} and sample period {loop.sample_period} s, "
            f"expected a stable discrete one with input {excitation.input}"
        )
    low, high = (2 * np.pi * frequency for frequency in excitation.band)
    highest = np.pi / loop.sample_period
    if high > highest * (1 + 1e-9):
        raise AbraceError(
            f"prediction: band up to {excitation.band[1]} Hz, expected at most {highest / (2 * np.pi):g} Hz"
        )
    omega = frequency_grid(poles, loop.sample_period, (max(low, LOWEST_FREQUENCY), min(high, highest)))
    steps = np.diff(omega)
    share = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]]) / 2 / (high - low)
    held, count = len(loop.inputs), len(model.outputs)
    step = np.exp(1j * np.outer(omega, np.arange(held)) * loop.sample_period / held)
    response = np.einsum("fpi,fi->fp", loop.frequency_response(omega), step)
    power = share @ np.abs(response) ** 2
    power = np.concatenate([power[: held * count].reshape(held, count).mean(axis=0), power[held * count :]])
    rms, names = excitation.rms * np.sqrt(power), (*model.outputs, *commands)
    if not np.isfinite(rms).all():
        raise AbraceError(f"prediction: rms of {names[np.argmin(np.isfinite(rms))]} is not finite")
    found = dict(zip(names, rms.tolist(), strict=True))
    return {name: 0.0 for name in model.inputs if name != excitation.input} | found


@takes_models
def rms_without_and_with_control(
    model: LinearModel, controller: LinearModel, excitation: Excitation
) -> dict[str, tuple[float, float]]:
    """Rms of each output and command by name, with zero command and controlled [SI units].

    `model` and `controller` are as in `closed_loop`, `excitation` as in `predicted_rms`.
    """
    plant = at_rate(model, controller)
    without, controlled = predicted_rms(plant, None, excitation), predicted_rms(plant, controller, excitation)
    return {name: (without[name], controlled[name]) for name in (*plant.outputs, *controller.outputs)}
