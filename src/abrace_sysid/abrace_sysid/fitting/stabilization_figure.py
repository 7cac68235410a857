"""The stabilisation diagram drawn: orders over frequency, above the response that the poles belong to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED

if TYPE_CHECKING:
    from abrace_sysid.fitting.stabilization import Stabilization


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
    figure.legend(*axis.get_legend_handles_labels(), loc="outside upper center", ncols=len(kinds), fontsize="small")
    return figure
