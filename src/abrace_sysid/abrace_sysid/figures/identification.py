# SPDX-License-Identifier: Apache-2.0
"""Figures of an identification: transfer functions as in Figs. 3 to 5, poles, and the errors of its models."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from abrace_core.figures.chart import POINTS, Chart, Curve, Panel
from abrace_core.figures.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, captioned
from abrace_core.model import signals
from abrace_core.model.linear_model import takes_models
from abrace_sysid.figures.poles import confidence
from abrace_sysid.spectra.frequency_response import sampled_response

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.models.reduction import Reduction
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


RIG = re.compile(r"(w|U\d*|xf?\d*|a\d+|f\d*)$")
"""Names of a rig's signals."""
QUADRANTS = (-180.0, -90.0, 0.0, 90.0, 180.0)
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
    fitted: LinearModel | None = None,
    units: Mapping[str, str] | None = None,
) -> Chart:
    """Amplitude and phase of some channels, measured and fitted, with the noise: Figs. 3, 4 and 5.

    Parameters
    ----------
    measured
        Transfer functions of the sampled rig.
    channels
        Outputs to show, one column each.
    fitted
        Continuous model; its curve includes sampling, hold and delay, like the measured one. None: no curve.
    units
        Units of measured data, by name; None: those of a rig's signals.
    """
    frequency = measured.omega / (2 * np.pi)
    curves = [None] * len(channels) if fitted is None else sampled_response(fitted.select(channels), measured).T
    columns = [
        _column(frequency, measured.select([name]), curve, _ratio_unit(name, measured.input, units))
        for name, curve in zip(channels, curves, strict=True)
    ]
    caption = (
        f"Transfer functions from {measured.input} to {', '.join(channels)}: measured ({measured.method})"
        f"{'' if fitted is None else ' and fitted'}. "
        "Lines within twice their standard deviation are faint and without phase."
    )
    return Chart(tuple(zip(*columns, strict=True)), (max(6.4, 4.8 * len(channels)), 5.6), caption)


def _column(
    frequency: NDArray[np.float64], one: FrequencyResponse, fitted: NDArray[np.complex128] | None, unit: str
) -> tuple[Panel, Panel]:
    """Amplitude and phase of one channel over `frequency` [Hz]."""
    points = one.response[:, 0]
    size, seen = np.abs(points), _seen(points, one.sigma[:, 0])
    level = _rms(one.sigma[:, 0], len(frequency) // 100)
    levels = [Curve(frequency, level, "standard deviation", REFERENCE)] if level.any() else []
    curves, phases = [], []
    if fitted is not None:
        error = _rms(np.abs(fitted - points), len(frequency) // 100)
        curves = [
            Curve(frequency, error, "fitted minus measured, rms", ERROR),
            Curve(frequency, np.abs(fitted), "fitted", SIMULATED, 1.2),
        ]
        phases = [Curve(frequency, _phase(fitted), "", SIMULATED, 1.2)]
    below = [one.y[one.y > 0] for one in (*levels, *curves[:1])]
    lowest = min([size.min(), *(np.quantile(values, 0.05) for values in below)])
    amplitude = (
        Curve(frequency[~seen], size[~seen], "" if seen.all() else "measured, noise", FAINT, style=POINTS),
        Curve(frequency[seen], size[seen], "measured", MEASURED, style=POINTS),
        *levels,
        *curves,
    )
    phase = (Curve(frequency[seen], _phase(points)[seen], "", MEASURED, style=POINTS), *phases)
    band, title = (0.0, float(frequency[-1])), f"{one.outputs[0]} / {one.input}"
    return (
        Panel(amplitude, title, "", f"amplitude [{unit}]", "y", band, (lowest / 2, size.max() * 2)),
        Panel(phase, "", "frequency [Hz]", "phase angle [deg]", "", band, (-190.0, 190.0), y_ticks=QUADRANTS),
    )


def _seen(points: NDArray[np.complex128], sigma: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which lines (lines,) are distinct from noise with standard deviation `sigma` (see SEEN)."""
    return np.asarray(
        uniform_filter1d(np.abs(points) ** 2, NEIGHBOURS) > uniform_filter1d((SEEN * sigma) ** 2, NEIGHBOURS)
    )


def _rms(values: NDArray[np.float64], lines: int) -> NDArray[np.float64]:
    """The rms of `values` (lines, ...) over so many neighbouring `lines`."""
    return np.asarray(np.sqrt(uniform_filter1d(values**2, max(1, lines), axis=0)))


def hankel_singular_values(reduction: Reduction) -> Figure:
    """Hankel singular values of a `reduction`, greatest first; the first ones are those of the reduced model."""
    values, kept = reduction.hankel_singular_values, reduction.model.order
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


SHOWN_OUTPUTS = 3
"""Number of outputs whose transfer functions are drawn."""


def figures_of_data(found: DataIdentification) -> dict[str, Figure | Chart]:
    """The figures of `found` by name: transfer functions from each input, and intervals of the modes."""
    shown = found.model.outputs[:SHOWN_OUTPUTS]
    drawn: dict[str, Figure | Chart] = {
        f"transfer_functions_{response.input.replace('/', '_')}": transfer_functions(
            response, shown, found.model, found.model.units
        )
        for response in found.responses
    }
    drawn["confidence"] = confidence({"data": found.pairs})
    return drawn
