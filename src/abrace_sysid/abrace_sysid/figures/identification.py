"""Figures of an identification: transfer functions as in Figs. 3 to 5, poles, and the errors of its models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.ndimage import uniform_filter1d

from abrace_core import signals
from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, legend_above
from abrace_core.linear_model import pole_table, takes_models
from abrace_sysid.figures.symbols import symbol
from abrace_sysid.spectra.frequency_response import sampled_response

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.fitting.stabilization import Stabilization
    from abrace_sysid.models.reduction import OrderErrors
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

MOST_NAMED = 16
"""Channels up to which a legend names each of them."""


@takes_models
def transfer_functions(
    measured: FrequencyResponse,
    channels: Sequence[str],
    fitted: LinearModel,
    units: Mapping[str, str] | None = None,
) -> Figure:
    """Amplitude and phase of some channels, measured and fitted: Figs. 3, 4 and 5; beside them noise and distortion.

    Parameters
    ----------
    measured
        Of the sampled rig.
    channels
        Outputs to show, one column each.
    fitted
        Continuous model; its curve is drawn as sampled, with hold and delay, as the measured one is.
    units
        Of measured data, by name; None: those of a rig's signals.
    """
    figure = Figure(figsize=(4.8 * len(channels), 5.6), layout="constrained")
    axes = figure.subplots(2, len(channels), sharex=True, squeeze=False)
    frequency = measured.omega / (2 * np.pi)
    points = measured.select(channels).response
    curves: tuple[tuple[NDArray[np.complex128], str, dict[str, Any]], ...] = (
        (points, "measured", {"color": MEASURED, "marker": ".", "ms": 2.5, "ls": "none"}),
        (sampled_response(fitted.select(channels), measured), "fitted", {"color": SIMULATED, "lw": 1.2}),
    )
    for j, name in enumerate(channels):
        amplitude, phase = axes[:, j]
        for response, label, style in curves:
            amplitude.semilogy(frequency, np.abs(response[:, j]), label=label, **style)
            phase.plot(frequency, _phase(response[:, j]), **style)
        size = np.abs(points[:, j])
        lowest = _levels(amplitude, frequency, measured.select([name]))
        amplitude.set_ylim(min(size.min(), lowest) / 2, size.max() * 2)
        amplitude.set_title(f"{symbol(name)} / {symbol(measured.input)}")
        amplitude.set_ylabel(f"amplitude [{_ratio_unit(name, measured.input, units)}]")
        phase.set_ylabel("phase angle [deg]")
        phase.set_yticks(np.arange(-180, 181, 90))
        phase.set_ylim(-190, 190)
        phase.set_xlabel("frequency [Hz]")
        phase.set_xlim(0, frequency[-1])
    axes[0, 0].legend(loc="best", markerscale=4)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    return figure


def _levels(axis: Axes, frequency: NDArray[np.float64], one: FrequencyResponse) -> float:
    """Draw the standard deviation of one channel's response, and its distortion if that is known; the least of them.

    Single lines scatter too much to be read: each curve is the rms over the neighbouring hundredth.
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


def pole_chart(poles: Mapping[str, NDArray[np.complex128]], reference: Mapping[str, NDArray[np.complex128]]) -> Figure:
    """Frequency and damping ratio of each oscillating pole.

    Parameters
    ----------
    poles
        Identified sets by name, drawn as crosses and the like.
    reference
        Sets to compare with by name (the paper's, the rig's own), drawn as open rings. [rad/s]
    """
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axis = figure.subplots()
    for i, (label, values) in enumerate(reference.items()):
        style = {"marker": "osD^"[i % 4], "ms": 10, "mfc": "none", "mec": (REFERENCE, "k")[i % 2], "ls": "none"}
        axis.loglog(*_frequency_and_percent(values), label=label, **style)
    for i, (label, values) in enumerate(poles.items()):
        style = {"marker": "x+1*"[i % 4], "ms": 9, "mew": 1.6, "color": (SIMULATED, MEASURED)[i % 2], "ls": "none"}
        axis.loglog(*_frequency_and_percent(values), label=label, **style)
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("damping ratio [%]")
    axis.grid(which="both", alpha=0.3)
    axis.legend(loc="best")
    return figure


def hankel_singular_values(values: NDArray[np.float64], kept: int) -> Figure:
    """Hankel singular values (states,), greatest first, and the `kept` first that a reduced model has."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axis = figure.subplots()
    shown = np.maximum(values, 1e-8 * values[0])
    number = np.arange(1, len(values) + 1)
    axis.bar(number[:kept], shown[:kept], color=SIMULATED, label=f"kept ({kept})")
    axis.bar(number[kept:], shown[kept:], color=REFERENCE, label="cut")
    axis.set_yscale("log")
    axis.set_ylim(shown.min() / 2, shown.max() * 2)
    axis.set_xticks(number[:: max(1, len(number) // 12)])
    axis.set_xlabel("state of the balanced model")
    axis.set_ylabel("Hankel singular value [-]")
    axis.grid(axis="y", alpha=0.3)
    axis.legend(loc="best")
    return figure


def reduction_errors(errors: OrderErrors, kept: int, inputs: Sequence[str] = (signals.GROUND, "U")) -> Figure:
    """Errors of the reduced model by its order: every channel's for each input, and the order `kept`.

    Parameters
    ----------
    errors
        Of all orders; those below a millionth, where only rounding is left, are not shown.
    kept
        States of the reduced model.
    inputs
        Names of the model's inputs; by default those of a rig with one brace group.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis = figure.subplots()
    for j, (name, colour) in enumerate(zip(inputs, (MEASURED, SIMULATED) * 9, strict=False)):
        axis.semilogy(errors.orders, 100 * errors.achieved[:, :, j], color=colour, lw=0.9)
        axis.plot([], [], color=colour, label=f"from {symbol(name)}, each channel")
    axis.set_ylim(bottom=max(axis.get_ylim()[0], 1e-4))
    axis.axvline(kept, color=REFERENCE, ls="--", label=f"kept ({kept})")
    axis.set_xlabel("states of the reduced model")
    axis.set_ylabel("rms error of a channel's response [%]")
    axis.grid(which="both", alpha=0.3)
    axis.legend(loc="best")
    return figure


@takes_models
def residuals(measured: Sequence[FrequencyResponse], fitted: LinearModel) -> Figure:
    """Residuals of a model against measured transfer functions, and over their standard deviations: a column each.

    Each curve is the rms over the neighbouring hundredth of the lines: single ones scatter too much to be read.

    Parameters
    ----------
    measured
        Transfer functions.
    fitted
        Continuous model.
    """
    figure = Figure(figsize=(5.4 * len(measured), 6.4), layout="constrained")
    axes = figure.subplots(2, len(measured), sharex="col", squeeze=False)
    for j, response in enumerate(measured):
        frequency = response.omega / (2 * np.pi)
        left_over = np.abs(sampled_response(fitted.select(response.outputs), response) - response.response)
        size = np.sqrt(np.mean(np.abs(response.response) ** 2, axis=0))
        neighbours = max(1, len(frequency) // 100)
        for axis, relative in zip(axes[:, j], (left_over / size, left_over / response.sigma), strict=True):
            smooth = np.sqrt(uniform_filter1d(relative**2, neighbours, axis=0))
            for name, column in zip(response.outputs, smooth.T, strict=True):
                axis.semilogy(frequency, column, lw=1.0, label=symbol(name))
        axes[0, j].set_title(f"from {symbol(response.input)}")
        axes[1, j].axhline(1.0, color=REFERENCE, lw=0.8)
        axes[1, j].set_xlabel("frequency [Hz]")
    axes[0, 0].set_ylabel("residual over rms response [-]")
    axes[1, 0].set_ylabel("residual over standard deviation [-]")
    if max(len(response.outputs) for response in measured) <= MOST_NAMED:
        legend_above(figure, axes[0, 0], 8)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    return figure


def confidence(sets: Mapping[str, Sequence[PoleInterval]]) -> Figure:
    """95 % confidence ellipses of frequency and damping of each pair, one axis each, about the last set's estimate.

    Frequency and damping ratio of a lightly damped pair are nearly uncorrelated: the ellipses' axes are the intervals.

    Parameters
    ----------
    sets
        Pairs by the test that they are from, slowest first; those of the last are the reference.
    """
    *_, reference = sets.values()
    columns = min(3, len(reference))
    figure = Figure(figsize=(4.2 * columns, 3.6 * -(-len(reference) // columns)), layout="constrained")
    axes = figure.subplots(-(-len(reference) // columns), columns, squeeze=False)
    radius = np.sqrt(-2 * np.log(0.05))
    for axis, (i, centre) in zip(axes.flat, enumerate(reference), strict=False):
        for (label, pairs), colour in zip(sets.items(), (MEASURED, SIMULATED, "k") * 3, strict=False):
            if i >= len(pairs):
                continue
            pair = pairs[i]
            x, y = 1e6 * (pair.frequency / centre.frequency - 1), 1e6 * (pair.damping / centre.damping - 1)
            width = 2e6 * radius * pair.frequency_deviation / centre.frequency
            height = 2e6 * radius * pair.damping_deviation / centre.damping
            axis.plot(x, y, ".", color=colour, label=label)
            axis.add_patch(Ellipse((x, y), width, height, fill=False, color=colour))
        axis.autoscale_view()
        axis.set_title(f"{centre.frequency:.3f} rad/s, {100 * centre.damping:.3f} %")
        axis.set_xlabel("frequency [1e-6 of it]")
        axis.set_ylabel("damping ratio [1e-6 of it]")
        axis.locator_params(nbins=5)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(reference) :]:
        axis.set_axis_off()
    legend_above(figure, axes[0, 0], len(sets))
    return figure


def stabilization_diagram(found: Stabilization, reference: list[float] | None = None) -> Figure:
    """Poles of rising order; behind them the mean amplitude of all channels.

    Parameters
    ----------
    found
        What to draw.
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
    return figure


def _phase(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """[deg] within -180 to 180, with gaps where it wraps so that no line is drawn across."""
    phase = np.degrees(np.angle(response))
    phase[1:][np.abs(np.diff(phase)) > 270] = np.nan
    return phase


def _frequency_and_percent(poles: NDArray[np.complex128]) -> tuple[list[float], list[float]]:
    pairs = pole_table(poles)
    return [frequency for frequency, _ in pairs], [100 * ratio for _, ratio in pairs]


def _ratio_unit(output: str, input_name: str, units: Mapping[str, str] | None) -> str:
    """The unit of a transfer function."""
    given = (signals.unit(name) if units is None else units.get(name, "-") for name in (output, input_name))
    above, below = (unit.replace("^2", "²") for unit in given)
    return f"{above} / ({below})" if "/" in below else f"{above} / {below}"
