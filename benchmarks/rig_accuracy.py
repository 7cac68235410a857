# SPDX-License-Identifier: Apache-2.0
"""The paper's rig against the numbers that the paper prints, and its limited motion against finer substeps."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import identification_accuracy as accuracy
import numpy as np
from claims import Claim

from abrace_plant.rig import published
from abrace_plant.rig.characteristics import characterize
from abrace_plant.rig.motion import RigMotion

if TYPE_CHECKING:
    from abrace_plant.rig.model import Rig


def worst(found: Any, asked: Any, column: int) -> float:
    """Greatest relative error among pairs of (frequency, damping ratio)."""
    ours, theirs = np.array(found)[:, column], np.array(asked)[:, column]
    return float(np.abs(ours / theirs - 1).max())


def limited_motion(rig: Rig) -> tuple[float, float]:
    """Error at the rig's own substeps, of the peak, and order of convergence, for an actuator at its capacity."""
    group = rig.braces[0]
    weak = replace(rig, braces=(replace(group, actuator=replace(group.actuator, capacity=8000.0)),))
    time = np.arange(1500) / rig.sample_rate
    ground = 3.0 * np.sin(7.3 * time) + np.sin(23.0 * time)

    def motion(refinement: int) -> np.ndarray:
        stepped = RigMotion(weak, refinement)
        return np.array([stepped.outputs(acceleration, np.zeros(1)) for acceleration in ground])

    exact = motion(512)
    refinements = [1, 2, 4, 8, 16]
    peak = np.abs(exact).max(axis=0)
    errors = [float(np.sqrt(np.mean(((motion(r) - exact) / peak) ** 2))) for r in refinements]
    return errors[0], float(-np.polyfit(np.log(refinements), np.log(errors), 1)[0])


def verify_rig() -> tuple[dict[str, Any], list[Claim]]:
    """The paper's rig, measured as the paper measured its building."""
    rig = accuracy.the_rig()
    found = characterize(rig)
    (brace,) = found.braces
    error, order = limited_motion(rig)
    antiresonances = found.antiresonance_error()
    shape = np.abs(np.array(found.shape[:2]) - published.SHAPE[:2])
    values = {
        "bare": found.bare,
        "zero_command": found.zero_command,
        "extra": found.extra,
        "bench_gain_error": brace.bench_gain_error,
        "bench_lag_ms": 1e3 * brace.bench_lag,
        "antiresonance_error": antiresonances,
        "shape": found.shape[:2],
        "stroke_ratio": brace.stroke_ratio,
        "limited_motion_error": error,
        "limited_motion_order": order,
    }
    claims = [
        Claim("bare frame: frequencies, worst of 3", worst(found.bare, published.BARE, 0), 0.001, "paper"),
        Claim("bare frame: damping, worst of 3", worst(found.bare, published.BARE, 1), 0.10, "paper"),
        Claim(
            "zero command: frequencies, worst of 3",
            worst(found.zero_command, published.ZERO_COMMAND, 0),
            0.001,
            "paper",
        ),
        Claim("zero command: damping, worst of 3", worst(found.zero_command, published.ZERO_COMMAND, 1), 0.05, "paper"),
        Claim("further pairs of A2: frequencies", worst(found.extra, published.EXTRA, 0), 0.001, "paper, A2"),
        Claim("further pairs of A2: damping", worst(found.extra, published.EXTRA, 1), 0.001, "paper, A2"),
        Claim("bench: gain from 1, 0 to 30 Hz", brace.bench_gain_error, 0.01, "paper, Fig. 2"),
        Claim("bench: lag from 0.8 ms", abs(brace.bench_lag / published.BENCH_LAG - 1), 0.01, "paper, Fig. 2"),
        Claim("f/U: antiresonances, worst of 3", max(antiresonances), 0.01, "paper, Fig. 3"),
        Claim("first mode: shape, greatest difference", float(shape.max()), 0.05, "paper, Table 1"),
        Claim("first mode: xf/x1", abs(brace.stroke_ratio / published.STROKE_RATIO - 1), 0.01, "paper, Table 1"),
        Claim("limited motion: error at the rig's substeps", error, 1e-4, "512 times finer"),
        Claim("limited motion: order of convergence", order, 1.7, "theory: 2", least=True),
    ]
    return values, claims
