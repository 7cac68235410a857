# SPDX-License-Identifier: Apache-2.0
"""Responses over force: abrace's own controller with other weights of its commands, and the sample controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from abrace.benchmark.comparison import Evaluation
from abrace.benchmark.criteria import OF_RESPONSE
from abrace.benchmark.figures import COLOURS
from abrace.benchmark.laws import designed, margins_of
from abrace_core.drawing import REFERENCE, captioned, legend_above
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from abrace.benchmark.frame_benchmark import FrameBenchmark

FACTORS = 10.0 ** np.array([1.6, 1.2, 0.8, 0.4, 0.0, -0.4, -0.8])
"""On the weights of all commands."""


def trade_off(benchmark: FrameBenchmark) -> list[Evaluation]:
    """abrace's own controller on a `benchmark` with each of FACTORS, by increasing force; unstable ones left out."""
    found = []
    for factor in FACTORS:
        try:
            law = designed(benchmark, benchmark.definition.weights, float(factor))
            evaluated = benchmark.evaluate(law)
        except AbraceError:  # no controller, or not a stable one
            continue
        if margins := margins_of(benchmark, law):
            found.append(Evaluation.of(f"commands x {factor:.3g}", evaluated, benchmark.layout, margins))
    return sorted(found, key=lambda one: one.worst()["J11"])


def trade_off_figure(benchmark: FrameBenchmark, tried: list[Evaluation], sample: Evaluation) -> Figure:
    """Worst J1 to J6, gain margin and disk margin over the greatest force of one device.

    Parameters
    ----------
    benchmark
        Its weight makes a force of J11.
    tried
        As from `trade_off`.
    sample
        Drawn as crosses; where its loop is not stable it has no margins, and no crosses of them.
    """
    kilonewtons = benchmark.layout.weight / 1e3
    force = [one.worst()["J11"] * kilonewtons for one in tried]
    at = sample.worst()["J11"] * kilonewtons
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    response, gain, disk = figure.subplots(1, 3)
    for name, colour in zip(OF_RESPONSE, COLOURS, strict=True):
        response.plot(force, [one.worst()[name] for one in tried], "o-", color=colour, markersize=3, label=name)
        response.plot(at, sample.worst()[name], "x", color=colour)
    response.set_ylabel("greatest ratio of the cases")
    for axis, name, label in ((gain, "gain_margin_db", "gain margin (dB)"), (disk, "disk_margin", "disk margin")):
        axis.plot(force, [one.margins[name] for one in tried], "o-", color=COLOURS[0], markersize=3)
        if name in sample.margins:
            axis.plot(at, sample.margins[name], "x", color=REFERENCE)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
    for axis in (response, gain, disk):
        axis.set_xlabel("greatest force of a device (kN)")
        axis.grid(alpha=0.3)
    legend_above(figure, response, len(OF_RESPONSE))
    title = f"{benchmark.definition.name}: abrace's controller with other weights of its commands"
    return captioned(figure, f"{title}; the crosses are the sample controller.")
