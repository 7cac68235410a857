# SPDX-License-Identifier: Apache-2.0
"""Figures of a controller's proof: the loop with its margins, the poles, and the predicted rms.

Each function returns a matplotlib Figure; `abrace_core.drawing` has the colours and saves it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, captioned, legend_above, plain_ticks
from abrace_core.linear_model import takes_models
from abrace_core.response import shown_unit
from abrace_lqg.loop import Loop

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.proof.checks import ModelProof, Proof

LOWEST_SHOWN = 0.1
"""Lower end of the frequency axes [Hz]; the upper end is half the sampling rate."""

KINDS = (("x", "displacement, stroke"), ("a", "acceleration"), ("fU", "force, command"))
"""First letters of the quantities that share a unit, and the names of these quantities."""

EVERY = 4
"""Of the frequencies, at which the models drawn from others are shown."""

LEAST_SHOWN = 0.1
"""Damping ratio [%] at which poles with less damping are drawn."""

LINE_STYLES = ("-", "--", ":", "-.")
"""Of the signals, or of the models, in turn."""


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
        Of the controller.
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


def pole_figure(proof: Proof) -> Figure:
    """Frequency and damping ratio of every model's pole pairs without and with control, and of all closed-loop poles.

    `proof` is the controller's. Pairs that the design model lacks, the unmodelled local modes, are marked.
    """
    columns = min(2, len(proof.models))
    rows = -(-len(proof.models) // columns)
    figure = Figure(figsize=(5.2 * columns, 4.2 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axis, each in zip(axes.flat, proof.models, strict=False):
        _poles(axis, each)
        axis.set_title(f"{each.name}, {each.order} states" + ("" if each.stable else ": NOT STABLE"))
    shown = [pole[0] for each in proof.models for pole in each.poles if pole[0] > 0]
    shown += [mode.frequency for each in proof.models for mode in each.modes]
    plain_ticks(axes[0, 0].xaxis, min(shown) / 1.3, max(shown) * 1.3)
    plain_ticks(axes[0, 0].yaxis, LEAST_SHOWN, 100)
    for axis in axes.flat[len(proof.models) :]:
        axis.set_visible(False)
    legend_above(figure, axes[0, 0], 4)
    caption = "Poles of each model with zero command and, arrows, in the closed loop."
    return captioned(figure, caption)


def prediction_figure(proof: Proof) -> Figure:
    """Rms of every quantity, with zero command and controlled.

    `proof` is the controller's. Drawn is the first check model with which the loop is stable, or without one the design
    model.
    """
    stable = [each for each in proof.models if each.stable]
    shown = stable[1] if len(stable) > 1 else stable[0]
    groups = [
        ([name for name in shown.prediction if name[0] in letters], kind)
        for letters, kind in KINDS
        if any(name[0] in letters for name in shown.prediction)
    ]
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    widths = [len(names) for names, _ in groups]
    for axis, (names, kind) in zip(
        figure.subplots(1, len(groups), squeeze=False, width_ratios=widths)[0], groups, strict=True
    ):
        position, factor = np.arange(len(names)), shown_unit(names[0], "SI")[0]
        without, controlled = np.array([shown.prediction[name] for name in names]).T * factor
        axis.bar(position - 0.2, without, 0.4, color=REFERENCE, label="zero command")
        bars = axis.bar(position + 0.2, controlled, 0.4, color=SIMULATED, label="controlled")
        changes = [
            f"{b / a - 1:+.0%}" if a and name[0] in "xa" else ""
            for name, a, b in zip(names, without, controlled, strict=True)
        ]
        axis.bar_label(bars, changes, fontsize=8, padding=2)
        axis.set_xticks(position, names)
        axis.set_ylabel(f"{kind}, rms [{shown_unit(names[0], 'SI')[1]}]")
        axis.grid(axis="y", alpha=0.3)
    figure.axes[0].legend(loc="upper left")
    heading = f"Rms predicted with {shown.name}, {shown.order} states, for a {proof.excitation}"
    return captioned(figure, f"{heading}, with zero command and controlled.")


def _critical_point(axis: Axes, proof: Proof) -> None:
    """Draw the critical point and the margins into a Nichols chart, and label it."""
    margins = proof.margins
    gain = min(margins.gain, 40.0)
    style: dict[str, Any] = {"color": MEASURED, "lw": 2.5, "alpha": 0.6}
    axis.plot([-180, -180], [-gain, gain], label="margins", **style)
    axis.plot([-180 - margins.phase, -180 + margins.phase], [0, 0], **style)
    axis.plot(-180, 0, marker="+", color="k", ms=12, mew=2)
    axis.set_xlim(-360, 0)
    axis.set_xticks(np.arange(-360, 1, 45))
    axis.set_ylim(-50, None)
    axis.set_xlabel("phase of the loop at the command [deg]")
    axis.set_ylabel("gain of the loop at the command [dB]")
    axis.set_title(f"{margins}".replace(", delay", ",\ndelay"), fontsize=10)
    axis.grid(alpha=0.25)
    axis.legend(loc="upper center")


def _poles(axis: Axes, each: ModelProof) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    for mode in each.modes:
        if mode.controlled_frequency:
            axis.annotate(
                "",
                (mode.controlled_frequency, max(100 * mode.controlled_damping, LEAST_SHOWN)),
                (mode.frequency, max(100 * mode.damping, LEAST_SHOWN)),
                arrowprops={"arrowstyle": "->", "color": REFERENCE, "lw": 0.8},
            )
    known = [mode for mode in each.modes if mode.modelled]
    unknown = [mode for mode in each.modes if not mode.modelled]
    for modes, marker, label in ((known, "o", "zero command"), (unknown, "D", "zero command, not in the design model")):
        points = np.array([(mode.frequency, 100 * mode.damping) for mode in modes]).reshape(-1, 2)
        axis.plot(
            *points.T, marker=marker, ms=9, mfc="none", mec=REFERENCE if marker == "o" else "k", ls="none", label=label
        )
    points = np.array(each.poles).reshape(-1, 2) * [1, 100]
    axis.plot(*points.T, marker="x", ms=8, mew=1.6, color=SIMULATED, ls="none", label="closed loop")
    if (lost := points[points[:, 1] <= 0]).size:
        axis.plot(
            lost[:, 0], np.full(len(lost), LEAST_SHOWN), "v", color=SIMULATED, ms=9, ls="none", label="not stable"
        )
    axis.set_ylim(LEAST_SHOWN / 1.3, 130)
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("damping ratio [%]")
    axis.grid(which="both", alpha=0.25)


def _decibels(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.asarray(20 * np.log10(np.maximum(np.abs(response), 1e-10)))


def _with_gaps(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (frequencies,) [degrees] with NaN where they jump by more than half a turn, so that no line is drawn."""
    jumps = np.abs(np.diff(angle, append=angle[-1:])) > 180
    return np.where(jumps, np.nan, angle)
