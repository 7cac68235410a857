# SPDX-License-Identifier: Apache-2.0
"""Figures of an identification: transfer functions as in Figs. 3 to 5, poles, and the errors of its models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from abrace_core import signals
from abrace_core.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned, legend_above, plain_ticks
from abrace_core.linear_model import takes_models
from abrace_sysid.figures.symbols import RIG, symbol
from abrace_sysid.spectra.frequency_response import sampled_response

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.fitting.stabilization import Stabilization
    from abrace_sysid.models.reduction import OrderErrors
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

MOST_NAMED = 5
"""Up to this number of channels each has its own curve."""
WORDS = {"x": "displacements", "xf": "strokes", "a": "accelerations", "f": "forces"}
"""Kinds of a rig's channels."""
COLOURS = (MEASURED, SIMULATED, "#2a7f62", "#d08c1d")
FAINT = "#c3cbd8"
"""Colour of measured lines that are not distinct from noise."""
SEEN, NEIGHBOURS = 2.0, 15
"""A line is distinct from noise if the amplitude over NEIGHBOURS lines is at least SEEN times the standard deviation.

The phase of other lines is not drawn.
"""


@takes_models
def transfer_functions(
    measured: FrequencyResponse,
    channels: Sequence[str],
    fitted: LinearModel,
    units: Mapping[str, str] | None = None,
) -> Figure:
    """Amplitude and phase of some channels, measured and fitted, with noise and distortion: Figs. 3, 4 and 5.

    Parameters
    ----------
    measured
        Transfer functions of the sampled rig.
    channels
        Outputs to show, one column each.
    fitted
        Continuous model; its curve includes sampling, hold and delay, like the measured one.
    units
        Units of measured data, by name; None: those of a rig's signals.
    """
    figure = Figure(figsize=(4.8 * len(channels), 5.6), layout="constrained")
    axes = figure.subplots(2, len(channels), sharex=True, squeeze=False)
    frequency = measured.omega / (2 * np.pi)
    several = measured.select(channels)
    curves = sampled_response(fitted.select(channels), measured)
    dots: dict[str, Any] = {"marker": ".", "ms": 2.5, "ls": "none", "rasterized": True}
    for j, name in enumerate(channels):
        (amplitude, phase), points, curve = axes[:, j], several.response[:, j], curves[:, j]
        size, seen = np.abs(points), _seen(points, several.sigma[:, j])
        if not seen.all():
            noise = {**dots, "color": FAINT, "label": "measured, noise"}
            amplitude.semilogy(frequency[~seen], size[~seen], **noise)
        amplitude.semilogy(frequency[seen], size[seen], color=MEASURED, label="measured", **dots)
        amplitude.semilogy(frequency, np.abs(curve), color=SIMULATED, lw=1.2, label="fitted")
        phase.plot(frequency[seen], _phase(points)[seen], color=MEASURED, **dots)
        phase.plot(frequency, _phase(curve), color=SIMULATED, lw=1.2)
        error = np.sqrt(uniform_filter1d(np.abs(curve - points) ** 2, max(1, len(frequency) // 100)))
        amplitude.semilogy(frequency, error, color=ERROR, lw=0.8, label="fitted minus measured, rms")
        lowest = _levels(amplitude, frequency, measured.select([name]))
        amplitude.set_ylim(min(size.min(), np.quantile(error, 0.05), lowest) / 2, size.max() * 2)
        amplitude.set_title(f"{symbol(name)} / {symbol(measured.input)}")
        amplitude.set_ylabel(f"amplitude [{_ratio_unit(name, measured.input, units)}]")
        phase.set_ylabel("phase angle [deg]")
        phase.set_yticks(np.arange(-180, 181, 90))
        phase.set_ylim(-190, 190)
        phase.set_xlabel("frequency [Hz]")
        phase.set_xlim(0, frequency[-1])
    longest = max(axes[0], key=lambda axis: len(axis.get_legend_handles_labels()[1]))
    legend_above(figure, longest, 3 if len(channels) == 1 else 5)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    named = ", ".join(channels)
    caption = f"Transfer functions from {measured.input} to {named}: measured ({measured.method}) and fitted."
    return captioned(figure, caption + " Lines within twice their standard deviation are faint and without phase.")


def _seen(points: NDArray[np.complex128], sigma: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which lines (lines,) are distinct from noise with standard deviation `sigma` (see SEEN)."""
    return np.asarray(
        uniform_filter1d(np.abs(points) ** 2, NEIGHBOURS) > uniform_filter1d((SEEN * sigma) ** 2, NEIGHBOURS)
    )


def _levels(axis: Axes, frequency: NDArray[np.float64], one: FrequencyResponse) -> float:
    """Draw the standard deviation of one channel's response, and its distortion if known; return the least value.

    Each curve is smoothed: the rms over a hundredth of the lines.
    """
    levels = {"standard deviation" if one.distortion is None else "noise": one.sigma}
    if one.distortion is not None:
        levels |= {"odd distortion": one.distortion.odd, "even distortion": one.distortion.even}
    lowest = np.inf
    for (label, level), style in zip(levels.items(), ("-", "--", ":"), strict=False):
        smooth = np.sqrt(uniform_filter1d(level[:, 0] ** 2, max(1, len(frequency) // 100)))
        if np.isfinite(smooth).all() and smooth.any():
            axis.semilogy(frequency, smooth, color=REFERENCE, lw=1.0, ls=style, label=label)
            lowest = min(lowest, float(np.quantile(smooth[smooth > 0], 0.05)))
    return lowest


def hankel_singular_values(values: NDArray[np.float64], kept: int) -> Figure:
    """Hankel singular values (states,), greatest first; the first `kept` are those of the reduced model."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axis = figure.subplots()
    shown = np.maximum(values, 1e-8 * values[0])
    number = np.arange(1, len(values) + 1)
    axis.bar(number[:kept], shown[:kept], color=SIMULATED, label=f"kept ({kept})")
    axis.bar(number[kept:], shown[kept:], color=REFERENCE, label=f"truncated ({len(values) - kept})")
    axis.set_yscale("log")
    axis.set_ylim(shown.min() / 2, shown.max() * 2)
    axis.set_xticks(number[:: max(1, len(number) // 12)])
    axis.set_xlabel("state of the balanced model")
    axis.set_ylabel("Hankel singular value [-]")
    axis.grid(axis="y", alpha=0.3)
    axis.legend(loc="best")
    return captioned(figure, "Hankel singular values of the whole model, and the states that the reduced model keeps.")


def reduction_errors(errors: OrderErrors, kept: int, inputs: Sequence[str] = (signals.GROUND, "U")) -> Figure:
    """Errors of reduced models over their order, for each input: the worst and the median of all channels.

    Parameters
    ----------
    errors
        Errors of all orders. Orders without a stable reduced model are left out; errors below 1e-6 are not drawn.
    kept
        Number of states of the reduced model.
    inputs
        Names of the model's inputs; by default those of a rig with one brace group.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis = figure.subplots()
    shown = np.isfinite(errors.achieved).all(axis=(1, 2))
    orders, percent = errors.orders[shown], 100 * np.maximum(errors.achieved[shown], 1e-6)
    for j, (name, colour) in enumerate(zip(inputs, COLOURS * 5, strict=False)):
        worst, median = percent[:, :, j].max(axis=1), np.median(percent[:, :, j], axis=1)
        axis.semilogy(orders, worst, "o-", color=colour, ms=4, lw=1.4, label=f"from {symbol(name)}: worst channel")
        axis.semilogy(orders, median, "o--", color=colour, ms=3, lw=0.9, label=f"from {symbol(name)}: median")
    axis.axvline(kept, color=REFERENCE, ls=":", label=f"kept: {kept} states")
    plain_ticks(axis.yaxis, *axis.get_ylim())
    axis.set_xlabel("states of the reduced model")
    axis.set_ylabel("rms error of a channel's response [%]")
    axis.grid(alpha=0.3)
    axis.legend(loc="best", fontsize="small")
    caption = "Error of the reduced model's responses over its number of states: worst and median of all outputs."
    return captioned(figure, caption)


@takes_models
def residuals(measured: Sequence[FrequencyResponse], fitted: LinearModel) -> Figure:
    """Residuals of a model in measured transfer functions, relative to the response and to the standard deviation.

    Each transfer function has a column. Curves are smoothed: the rms over a fortieth of the lines.

    Parameters
    ----------
    measured
        Transfer functions.
    fitted
        Continuous model.
    """
    figure = Figure(figsize=(5.4 * len(measured), 5.8), layout="constrained")
    axes = figure.subplots(2, len(measured), sharex="col", squeeze=False)
    for j, response in enumerate(measured):
        frequency = response.omega / (2 * np.pi)
        left_over = np.abs(sampled_response(fitted.select(response.outputs), response) - response.response)
        size = np.sqrt(np.mean(np.abs(response.response) ** 2, axis=0))
        neighbours = max(1, len(frequency) // 40)
        for axis, relative in zip(axes[:, j], (left_over / size, left_over / response.sigma), strict=True):
            smooth = np.sqrt(uniform_filter1d(relative**2, neighbours, axis=0))
            for (label, columns), colour in zip(_kinds(response.outputs).items(), COLOURS * 3, strict=False):
                axis.semilogy(frequency, smooth[:, columns].max(axis=1), lw=1.0, color=colour, label=label)
        axes[0, j].set_title(f"from {symbol(response.input)}")
        axes[1, j].axhline(1.0, color="k", lw=0.8, ls=":")
        low, high = axes[1, j].get_ylim()
        axes[1, j].set_ylim(min(low, 0.4), max(high, 2.5))
        for axis in axes[:, j]:
            plain_ticks(axis.yaxis, *axis.get_ylim())
        axes[1, j].set_xlabel("frequency [Hz]")
        axes[1, j].set_xlim(0, frequency[-1])
    axes[0, 0].set_ylabel("residual over rms response [-]")
    axes[1, 0].set_ylabel("over standard deviation [-]")
    legend_above(figure, axes[0, 0], 5)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    caption = (
        "Residual of the model in the measured transfer functions, the largest of each kind of channels: relative to "
        "the rms response, and to the standard deviation, where noise gives 1. Rms over a fortieth of the band."
    )
    return captioned(figure, caption)


def _kinds(names: Sequence[str]) -> dict[str, list[int]]:
    """Indices of the channels that share a curve: few channels have one each, else one for each kind."""
    if len(names) <= MOST_NAMED:
        return {symbol(name): [i] for i, name in enumerate(names)}
    kinds = {
        letter: [i for i, name in enumerate(names) if RIG.match(name) and _kind(name) == letter] for letter in WORDS
    }
    found = {WORDS[letter]: columns for letter, columns in kinds.items() if columns}
    other = sorted(set(range(len(names))) - {i for columns in found.values() for i in columns})
    return found | ({"others": other} if other else {})


def _kind(name: str) -> str:
    return "xf" if name.startswith("xf") else name[0]


def stabilization_diagram(found: Stabilization, reference: list[float] | None = None) -> Figure:
    """Poles at rising order, and in the background the mean amplitude of all channels.

    Parameters
    ----------
    found
        Poles of all orders.
    reference
        Frequencies to mark [rad/s], such as those of a fit.
    """
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axis = figure.subplots()
    behind = axis.twinx()
    amplitude = np.abs(found.measured.response)
    size = np.sqrt(np.mean(amplitude**2, axis=0))
    mean = np.exp(np.mean(np.log(np.maximum(amplitude / np.where(size > 0, size, 1.0), 1e-12)), axis=1))
    behind.semilogy(found.measured.omega / (2 * np.pi), mean, color=REFERENCE, lw=0.8, alpha=0.7)
    behind.set_ylabel("mean amplitude of the channels [-]")
    axis.set_zorder(behind.get_zorder() + 1)
    axis.patch.set_visible(False)
    for frequency in reference or ():
        axis.axvline(frequency / (2 * np.pi), color="k", lw=0.6, ls=":")
    kinds: tuple[tuple[str, dict[str, Any]], ...] = (
        ("new", {"marker": ".", "color": REFERENCE, "ms": 4}),
        ("same frequency", {"marker": "+", "color": MEASURED, "ms": 6}),
        ("and damping", {"marker": "x", "color": MEASURED, "ms": 6}),
        ("and mode shape", {"marker": "o", "color": SIMULATED, "ms": 6, "mfc": "none"}),
    )
    for level, (label, style) in enumerate(kinds):
        x, y = [], []
        for poles in found.orders:
            reached = np.where(poles.same, 3, np.where(poles.same_damping, 2, np.where(poles.same_frequency, 1, 0)))
            chosen = poles.frequency[reached == level] / (2 * np.pi)
            x += list(chosen)
            y += [poles.order] * len(chosen)
        axis.plot(x, y, ls="none", label=label, **style)
    axis.set_xlim(0, found.measured.omega[-1] / (2 * np.pi))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("number of poles")
    axis.set_yticks([poles.order for poles in found.orders][:: max(1, len(found.orders) // 10)])
    legend_above(figure, axis, len(kinds))
    text = "Poles of rising order and their agreement with those of the previous order; grey: mean amplitude"
    return captioned(figure, f"{text} from {found.measured.input}; dotted: the modes found.")


def _phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """[deg] within -180 to 180, with gaps where it wraps so that no line is drawn across."""
    phase = np.degrees(np.angle(response))
    phase[1:][np.abs(np.diff(phase)) > 270] = np.nan
    return phase


def _ratio_unit(output: str, input_name: str, units: Mapping[str, str] | None) -> str:
    """The unit of a transfer function."""
    given = (signals.unit(name) if units is None else units.get(name, "-") for name in (output, input_name))
    above, below = (unit.replace("^2", "²") for unit in given)
    return f"{above} / ({below})" if "/" in below else f"{above} / {below}"
