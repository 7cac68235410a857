# SPDX-License-Identifier: Apache-2.0
"""Figures of signals: time histories of a test or record, and the frequency response of a model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

KINDS = {
    "xf": "stroke",
    "x": "displacement",
    "a": "acceleration",
    "w": "ground acceleration",
    "f": "force",
    "U": "command",
}
"""Of a rig's signals, by the beginning of their names."""


def time_histories(
    time: NDArray[np.float64], signals: Mapping[str, tuple[NDArray[np.float64], str]], title: str
) -> Figure:
    """Signals over time, an axis for each kind.

    Parameters
    ----------
    time
        (samples,) [s].
    signals
        By name: (samples,), and the unit.
    title
        What they are of.
    """
    kinds: dict[tuple[str, str], list[str]] = {}
    for name, (_, unit) in signals.items():
        kind = next((kind for start, kind in KINDS.items() if name.startswith(start)), name)
        kinds.setdefault((kind, unit), []).append(name)
    figure = Figure(figsize=(10.0, 1.2 + 1.8 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    for axis, ((kind, unit), names) in zip(axes, kinds.items(), strict=True):
        for name in names:
            axis.plot(time, signals[name][0], lw=0.8, label=name)
        axis.set_ylabel(f"{kind}\n[{unit.replace('^2', '²')}]")
        axis.grid(alpha=0.3)
        axis.margins(x=0)
        if len(names) > 1:
            axis.legend(loc="upper right", ncols=len(names), fontsize="small")
    axes[0].set_title(title, loc="left", fontsize="medium")
    axes[-1].set_xlabel("time [s]")
    return figure


def gains(
    frequency: NDArray[np.float64], response: NDArray[np.complex128], outputs: Sequence[str], inputs: Sequence[str]
) -> Figure:
    """The gain of a frequency response, a column for each input.

    Parameters
    ----------
    frequency
        (frequencies,) [Hz].
    response
        (frequencies, outputs, inputs).
    outputs, inputs
        Names.
    """
    figure = Figure(figsize=(1.0 + 5.0 * len(inputs), 4.4), layout="constrained")
    axes = figure.subplots(1, len(inputs), squeeze=False)[0]
    for j, (axis, driven_by) in enumerate(zip(axes, inputs, strict=True)):
        for i, name in enumerate(outputs):
            axis.loglog(frequency, np.abs(response[:, i, j]), lw=1.0, label=name)
        axis.set_title(f"from {driven_by}", loc="left", fontsize="medium")
        axis.set_xlabel("frequency [Hz]")
        axis.grid(which="both", alpha=0.3)
    axes[0].set_ylabel("gain [SI units]")
    axes[0].legend(loc="best", fontsize="small")
    return figure
