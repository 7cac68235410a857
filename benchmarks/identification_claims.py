# SPDX-License-Identifier: Apache-2.0
"""Claims about identification, and the tables that compare it with other methods and models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import identification_accuracy as accuracy
import numpy as np
from claims import Claim

from abrace.report.table import Table
from abrace_core.model.modes import nearest_mode
from abrace_plant.rig import published

if TYPE_CHECKING:
    from abrace_sysid.fitting.pole_estimate import PoleInterval


def verify_identification() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Identification of the simulated rig, and the tables that compare it with other methods and models."""
    trials, prediction = accuracy.measure()
    true = accuracy.true_pairs(accuracy.the_rig())
    values = accuracy.evaluate(trials, prediction, true)
    claims = []
    for case, (_, _, *asked) in accuracy.CASES.items():
        for quantity, limit in zip(("frequency", "damping"), asked, strict=True):
            key, peer = f"{quantity}_error", values["n4sid"][case]
            stated = "N4SID refuses" if peer[key] is None else f"N4SID {peer[key]:.2g}"
            name = f"{case.replace('_', ' ')} s: {quantity}" if case[-1].isdigit() else f"{case}: {quantity}"
            claims.append(Claim(f"{name}, worst of {accuracy.SEEDS} seeds", values[case][key], limit, stated))
    name = "true poles within their 95 % intervals"
    claims += [
        Claim(name, values["coverage"], 0.85, "theory: 0.95", least=True),
        Claim(name, values["coverage"], 0.99, "theory: 0.95"),
    ]
    for test, title, channels, most in (
        ("zero_command", "El Centro, zero command: every channel", prediction["consistent"]["zero_command"], 0.02),
        (
            "closed_loop",
            "El Centro, LQG3: every channel but a1",
            set(prediction["consistent"]["closed_loop"]) - {"a1"},
            0.03,
        ),
        ("closed_loop", "El Centro, LQG3: a1", {"a1"}, 0.05),
    ):
        ours, theirs = (max(prediction[name][test][c] for c in channels) for name in ("consistent", "states_24"))
        claims.append(Claim(title, ours, most, f"24 states {theirs:.2g}"))
    ours, theirs = (prediction[name]["peak_rms_error"] for name in ("consistent", "states_24"))
    claims.append(Claim("El Centro: peaks and rms, mean", ours, 0.015, f"24 states {theirs:.2g}"))
    (shown,) = (trial for trial in trials if (trial.length, trial.seed) == accuracy.SHOWN)
    return values, claims, [error_table(values), pole_comparison(shown, true), prediction_table(prediction)]


def error_table(values: dict[str, Any]) -> Table:
    """Worst errors of our method, N4SID and the paper's, on the same tests."""

    def cell(found: dict[str, Any]) -> str:
        if "failed" in found:
            return f"refused, {found['failed_seeds']} of {accuracy.SEEDS}"
        return f"{100 * found['frequency_error']:.2g} / {100 * found['damping_error']:.2g}"

    methods = (values, values["n4sid"], values["paper_method"])
    rows = tuple(
        (case, f"{100 * asked[0]:g} / {100 * asked[1]:g}", *(cell(found[case]) for found in methods))
        for case, (_, _, *asked) in accuracy.CASES.items()
    )
    title = f"Poles: worst error of frequency / damping, %, over {accuracy.SEEDS} seeds"
    return Table(title, ("test", "asked", "abrace", "N4SID", "paper's method"), rows)


def pole_comparison(trial: accuracy.Trial, true: dict[str, accuracy.Pairs]) -> Table:
    """Each pole of A1 and of A2 as the rig has it, as each method finds it, and as the paper prints its own."""

    def number(pair: tuple[float, float]) -> str:
        return f"{pair[0]:.4f} / {100 * pair[1]:.3f}"

    def with_interval(pair: PoleInterval) -> str:
        frequency, damping = (np.ptp(interval) / 2 for interval in (pair.frequency_interval, pair.damping_interval))
        return f"{pair.frequency:.5f} ± {frequency:.5f} / {100 * pair.damping:.4f} ± {100 * damping:.4f}"

    def nearest(found: accuracy.Pairs | str, own: tuple[float, float]) -> str:
        if isinstance(found, str):
            return "refused"
        nearest = nearest_mode([pair[0] for pair in found], own[0])
        return "none near" if nearest is None else number(found[nearest])

    rows, notes = [], []
    for matrix, test in (("A1", "table"), ("A2", "command")):
        printed = [(abs(pole), -pole.real / abs(pole)) for pole in published.PAPER_POLES[test]]
        for own, ours in zip(true[test], trial.ours[test], strict=True):
            others = [nearest(trial.peers[method][test], own) for method in accuracy.PEERS]
            rows.append((matrix, number(own), with_interval(ours), *others, nearest(printed, own)))
        refusals = ((method, trial.peers[method][test]) for method in accuracy.PEERS)
        notes += [f"{matrix}, {method}: {refusal}" for method, refusal in refusals if isinstance(refusal, str)]
    titles = {
        "paper": "paper's method",
        "n4sid": "N4SID",
        "vector_fitting": "vector fitting",
    }
    header = ("", "rig", "abrace, 95 %", *(titles[method] for method in accuracy.PEERS), "paper's own rig")
    return Table("Poles by several methods: rad/s / damping in %, tests of 600 s", header, tuple(rows), tuple(notes))


def prediction_table(prediction: dict[str, Any]) -> Table:
    """Simulated against measured by the three models."""
    tests, models = ("zero_command", "closed_loop"), ("consistent", "states_24", "states_8")
    header = ("", *(f"{test}: {model}".replace("_", " ") for test in tests for model in models))
    rows = [
        (channel, *(f"{100 * prediction[model][test][channel]:.2f}" for test in tests for model in models))
        for channel in prediction["consistent"]["zero_command"]
    ]
    errors = ", ".join(f"{model} {100 * prediction[model]['peak_rms_error']:.2f}".replace("_", " ") for model in models)
    note = f"Mean error of peaks and rms over both tests, %: {errors}"
    return Table("El Centro at 0.1 g, simulated against measured: rms error, %", header, tuple(rows), (note,))
