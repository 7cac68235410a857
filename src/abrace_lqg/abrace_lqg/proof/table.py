# SPDX-License-Identifier: Apache-2.0
"""The proof of a controller as lines of text: printed by `design`, and comments in the controller file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.signals import unit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace_lqg.analysis.margins import Margins
    from abrace_lqg.analysis.mode_damping import ModeEffect
    from abrace_lqg.proof.checks import EnsembleProof, ModelProof, Proof


def table_lines(proof: Proof) -> list[str]:
    """The lines of a `proof`, one model after the other."""
    return [line for each in proof.models for line in _model(each, proof)]


def _model(one: ModelProof, proof: Proof) -> Iterator[str]:
    role = "designed with" if one is proof.models[0] else "checked with"
    yield f"{role} {one.name}, {one.order} states: the closed loop is {'stable' if one.stable else 'NOT STABLE'}"
    if one.margins:
        yield "  loop broken at   gain [dB]  phase [deg]  delay [ms]  sensitivity peak"
        for name, margins in one.margins.items():
            yield f"  {name:<14}{_margins(margins)}"
        yield f"  {one.disk}"
    if one.ensemble is not None:
        yield from _ensemble(one.ensemble)
    yield "  closed-loop poles [rad/s] (damping ratio):"
    for i in range(0, len(one.poles), 6):
        yield "   " + "".join(f" {frequency:10.2f} ({damping:.3f})" for frequency, damping in one.poles[i : i + 6])
    yield "  mode [rad/s]   damping ratio   controlled [rad/s]   damping ratio   share kept"
    for mode in one.modes:
        yield f"  {_mode(mode)}"
    if one.prediction:
        yield f"  rms for a {proof.excitation}:"
        yield "  quantity      zero command    controlled   change"
        for name, (without, controlled) in one.prediction.items():
            change = f"{controlled / without - 1:+8.0%}" if without else "        "
            yield f"  {name + ' [' + unit(name) + ']':<12}{without:14.4g}{controlled:14.4g} {change}".rstrip()
    for lost in one.lost:
        yield f"  samples: {lost}"


def _ensemble(drawn: EnsembleProof) -> Iterator[str]:
    yield f"  the least of {drawn}: the closed loop is {'NOT STABLE' if drawn.unstable else 'stable'} with" + (
        f" {drawn.unstable} of them" if drawn.unstable else " all of them"
    )
    for name, margins in drawn.margins.items():
        yield f"  {name:<14}{_margins(margins)}"
    if drawn.margins:
        kept = f"; damping kept {drawn.damping_kept:.2f} by the mode at {drawn.at:.1f} rad/s" if drawn.at else ""
        yield f"  disk margin {drawn.disk_margin:.2f}{kept}"


def _margins(margins: Margins) -> str:
    delay = f"{1e3 * margins.delay:.1f}" if np.isfinite(margins.delay) else "any"
    gain = f"{margins.gain:.1f}" if np.isfinite(margins.gain) else "any"
    return f"{gain:>12}{margins.phase:13.1f}{delay:>12}{margins.sensitivity_peak:18.2f}"


def _mode(mode: ModeEffect) -> str:
    known = "" if mode.modelled else "   not in the design model"
    return (
        f"{mode.frequency:12.2f}{mode.damping:16.4f}{mode.controlled_frequency:21.2f}"
        f"{mode.controlled_damping:16.4f}{mode.damping_kept:13.2f}{known}"
    )
