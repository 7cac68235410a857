# SPDX-License-Identifier: Apache-2.0
"""The figure of a controller's proof: the loop with its margins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED, captioned, plain_ticks
from abrace_core.model.linear_model import takes_models
from abrace_lqg.loop import Loop

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.proof.checks import Proof

LOWEST_SHOWN = 0.1
"""Lower end of the frequency axes [Hz]; the upper end is half the sampling rate."""

EVERY = 4
"""Models drawn from others are shown at one frequency in so many."""

LINE_STYLES = ("-", "--", ":", "-.")
"""Line styles of the signals, or of the models, in turn."""


@takes_models
def loop_figure(
    proof: Proof,
    models: Mapping[str, LinearModel],
    controller: LinearModel,
    ensembles: Mapping[str, Sequence[LinearModel]] | None = None,
) -> Figure:
    """Nichols chart and gain of the loop broken at each command, and the sensitivity at every signal.

    Parameters
    ----------
    proof
        Proof of the controller.
    models
        By name, as they were given to `prove`: the design model in colour, the check models grey.
    controller
        Discrete.
    ensembles
        Models drawn from the covariance of some of them: thin lines.
    """
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    axes: dict[str, Axes] = figure.subplot_mosaic([["nichols", "gain"], ["nichols", "sensitivity"]])
    nichols, gain, sensitivity = axes["nichols"], axes["gain"], axes["sensitivity"]
    for number, (name, model) in reversed(list(enumerate(models.items()))):
        loop = Loop(model, controller)
        omega = loop.frequencies()
        omega = omega[omega >= 2 * np.pi * LOWEST_SHOWN]
        coarse = omega[::EVERY]
        for command in proof.commands:
            response = loop.transfer_function(command, omega)
            label = f"{command}, {name}" if len(proof.commands) > 1 else name
            style: dict[str, Any] = {"color": SIMULATED, "lw": 1.4}
            if number:
                style = {"color": REFERENCE, "lw": 1.0, "ls": LINE_STYLES[number % len(LINE_STYLES)]}
            for drawn in (ensembles or {}).get(name, ()):
                other = Loop(drawn, controller).transfer_function(command, coarse)
                thin = {"color": style["color"], "lw": 0.3, "alpha": 0.4}
                nichols.plot(_with_gaps(np.degrees(np.angle(-other)) - 180), _decibels(other), **thin)
                gain.semilogx(coarse / (2 * np.pi), _decibels(other), **thin)
            # the critical point, -180 degrees, in the middle
            nichols.plot(_with_gaps(np.degrees(np.angle(-response)) - 180), _decibels(response), label=label, **style)
            gain.semilogx(omega / (2 * np.pi), _decibels(response), **style)
        if number == 0:
            size = 20 * np.log10(np.abs(1 - loop.complementary_sensitivity(omega)))
            for column, signal in enumerate(loop.signals):
                colour = SIMULATED if signal in proof.commands else MEASURED
                style = {"color": colour, "ls": LINE_STYLES[column % len(LINE_STYLES)]}
                sensitivity.semilogx(omega / (2 * np.pi), size[:, column], label=signal, lw=1.2, **style)
    _critical_point(nichols, proof)
    low, high = gain.get_ylim()
    gain.set_ylim(max(low, -60), high)
    gain.set_ylabel("loop at the command [dB]")
    sensitivity.set_ylabel("sensitivity, loop broken at one signal [dB]")
    sensitivity.set_xlabel("frequency [Hz]")
    sensitivity.legend(loc="best", ncols=3)
    for axis in (gain, sensitivity):
        plain_ticks(axis.xaxis, *axis.get_xlim())
        axis.axhline(0, color="k", lw=0.7)
        axis.grid(alpha=0.25)
    caption = (
        "The loop broken at each command, as a Nichols chart with the margins and over frequency, and the sensitivity "
        "of the loop broken at one signal; the design model in colour, the models it was checked with grey."
    )
    return captioned(figure, caption)


def _critical_point(axis: Axes, proof: Proof) -> None:
    """Draw the critical point and the margins into a Nichols chart, and label it."""
    margins = proof.margins
    gain = min(margins.gain_db, 40.0)
    style: dict[str, Any] = {"color": MEASURED, "lw": 2.5, "alpha": 0.6}
    axis.plot([-180, -180], [-gain, gain], label="margins", **style)
    axis.plot([-180 - margins.phase_deg, -180 + margins.phase_deg], [0, 0], **style)
    axis.plot(-180, 0, marker="+", color="k", ms=12, mew=2)
    axis.set_xlim(-360, 0)
    axis.set_xticks(np.arange(-360, 1, 45))
    axis.set_ylim(-50, None)
    axis.set_xlabel("phase of the loop at the command [deg]")
    axis.set_ylabel("gain of the loop at the command [dB]")
    axis.set_title(f"{margins}".replace(", delay", ",\ndelay"), fontsize=10)
    axis.grid(alpha=0.25)
    axis.legend(loc="upper center")


def _decibels(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.asarray(20 * np.log10(np.maximum(np.abs(response), 1e-10)))


def _with_gaps(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (frequencies,) [degrees] with NaN where they jump by more than half a turn, so that no line is drawn."""
    jumps = np.abs(np.diff(angle, append=angle[-1:])) > 180
    return np.where(jumps, np.nan, angle)
