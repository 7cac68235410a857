# SPDX-License-Identifier: Apache-2.0
"""Figures of poles: differences between sets of pole pairs, and confidence intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED, captioned, legend_above
from abrace_core.model.linear_model import pole_table
from abrace_core.model.modes import match_modes
from abrace_sysid.fitting.pole_estimate import NORMAL_95, TESTS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleInterval

STYLES: tuple[dict[str, Any], ...] = (
    {"marker": "o", "color": MEASURED},
    {"marker": "s", "color": SIMULATED},
    {"marker": "D", "color": "k", "ms": 5},
)
REFERENCES: tuple[dict[str, Any], ...] = (
    {"marker": "o", "color": REFERENCE, "mfc": "none"},
    {"marker": "s", "color": REFERENCE, "mfc": "none"},
)
SPREAD = 0.6
"""Share of a row's height over which the markers of the sets are spread, so that they do not overlap."""


def pole_chart(poles: Mapping[str, NDArray[np.complex128]], reference: Mapping[str, NDArray[np.complex128]]) -> Figure:
    """Differences of frequency and damping ratio of each oscillating pole from a reference set, a row for each mode.

    Parameters
    ----------
    poles
        Identified sets by name [rad/s].
    reference
        Reference sets by name (for example the rig's, the paper's) [rad/s]. Differences are taken from the first, or,
        without references, from the first identified set.
    """
    drawn = [(name, values, REFERENCES[i % 2]) for i, (name, values) in enumerate(reference.items())]
    drawn += [(name, values, STYLES[i % 3]) for i, (name, values) in enumerate(poles.items())]
    sets = [(name, [(w, z, 0.0, 0.0) for w, z in pole_table(values)], style) for name, values, style in drawn]
    text = "Identified poles: frequency and damping ratio of each mode, relative to those of the " + sets[0][0]
    return captioned(_rows(sets, sets[0][0], sets[0][1]), f"{text}.")


def confidence(sets: Mapping[str, Sequence[PoleInterval]]) -> Figure:
    """95 % intervals of frequency and damping ratio of each pair about the last set's estimate, a row for each mode.

    Parameters
    ----------
    sets
        Pole pairs of each test, by a key of `TESTS` or another name, lowest frequency first; differences are taken
        from the last set.
    """
    drawn = [
        (
            TESTS.get(name, name),
            [(pair.frequency, pair.damping, pair.frequency_deviation, pair.damping_deviation) for pair in pairs],
            STYLES[i % 3],
        )
        for i, (name, pairs) in enumerate(sets.items())
    ]
    text = "95 % intervals of frequency and damping ratio of each mode, relative to the estimate from"
    return captioned(_rows(drawn, drawn[-1][0], drawn[-1][1]), f"{text} {drawn[-1][0]}.")


Pair = tuple[float, float, float, float]
"""Frequency [rad/s] and damping ratio, and their standard deviations."""


def _rows(sets: Sequence[tuple[str, Sequence[Pair], dict[str, Any]]], zero: str, centres: Sequence[Pair]) -> Figure:
    """Differences of the pairs of all sets from the `centres` (the set named `zero`), a row for each centre."""
    figure = Figure(figsize=(9.0, 1.4 + 0.55 * len(centres)), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, quantity, title in zip(axes, (0, 1), ("frequency", "damping ratio"), strict=True):
        found = [_differences(centres, pairs, quantity) for _, pairs, _ in sets]
        largest = np.nanmax([[0.0, *(np.abs(x) + error for x, error in rows)] for rows in found])
        factor, unit = (100.0, "%") if largest > 5e-4 else (1e6, "ppm")
        for number, ((name, _, style), rows) in enumerate(zip(sets, found, strict=True)):
            x, error = factor * np.array(rows).reshape(-1, 2).T
            y = np.arange(len(centres)) + SPREAD * ((number + 0.5) / len(sets) - 0.5)
            given = {"ls": "none", "ms": 6, **style, "label": name}
            if np.nansum(error) > 0:
                axis.errorbar(x, y, xerr=error, capsize=2.5, lw=1.0, **given)
            else:
                axis.plot(x, y, **given)
        axis.axvline(0.0, color="k", lw=0.6)
        axis.set_xlabel(f"{title} minus that of {zero} [{unit}]")
        axis.grid(axis="x", alpha=0.3)
        axis.margins(x=0.08)
    axes[0].set_yticks(range(len(centres)), [f"{w:.4g} rad/s\n{100 * z:.3g} %" for w, z, _, _ in centres])
    axes[0].set_ylim(len(centres) - 0.5, -0.5)
    for axis in axes:
        for border in np.arange(len(centres) - 1) + 0.5:
            axis.axhline(border, color="#dddddd", lw=0.6)
    legend_above(figure, axes[0], min(4, len(sets)))
    return figure


def _differences(centres: Sequence[Pair], pairs: Sequence[Pair], quantity: int) -> list[tuple[float, float]]:
    """Relative difference of the pair of the same mode as each centre, and half its 95 % interval; NaN if none is."""
    same = dict(match_modes([centre[0] for centre in centres], [pair[0] for pair in pairs]))
    found = []
    for i, centre in enumerate(centres):
        size, pair = centre[quantity], pairs[same[i]] if i in same else None
        found.append(
            (np.nan, 0.0) if pair is None else (pair[quantity] / size - 1, NORMAL_95 * pair[quantity + 2] / abs(size))
        )
    return found
