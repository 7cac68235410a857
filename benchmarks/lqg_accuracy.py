# SPDX-License-Identifier: Apache-2.0
"""The five controllers as they run: designed on the identified model, recorded on the lockstep graph, and simulated.

The campaign is `five_controllers.yaml`: tests, model, LQG1 to LQG5, each under El Centro at 0.1 g and
under noise of another seed; a record that is given, such as Kobe, is added. Everything is read from what the campaign
wrote: nothing here designs or simulates a second time.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from fitted_weights import fit_table, other_rigs
from isolation import isolated
from papers_simulation import papers_simulation

from abrace.campaign.course import run_campaign
from abrace.report.results import read_results
from abrace.report.table import Table
from abrace.report.writer import make_report
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import load_controller
from abrace_core.model.response import TABLE_1_EXPERIMENT

if TYPE_CHECKING:
    from collections.abc import Iterable

    from abrace.report.results import ComparedTest, Results

CONTROLLERS = ("lqg1", "lqg2", "lqg3", "lqg4", "lqg5")
MOTIONS = ("el_centro", "noise", "record")
RESPONSES = ("x1", "x2", "x3", "a1", "a2", "a3")
KEPT = Path("results/five_controllers")
"""Where the campaign's report and figures stay."""


def verify_lqg(record: Path | None) -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and a table of the controllers."""
    values = evaluate(run(record))
    lqg3 = load_controller(KEPT / "lqg3/lqg3.yaml")
    values["papers_simulation"] = papers_simulation(lqg3.law)
    values["not_fitted"] = other_rigs(lqg3)
    controllers = values["controllers"]
    strongest = controllers["lqg3"]
    claims = [
        Claim("LQG3, Table 1, 18 cells fitted to: mean", values["table1_error"], 0.045, "paper's simulation 0.136"),
        Claim("LQG3, Table 1, 18 cells fitted to: worst", values["table1_worst"], 0.12, "paper's simulation 0.32"),
        Claim("LQG3: gain margin, dB", strongest["gain_margin_db"], 8, "-", least=True),
        Claim("LQG3: phase margin, degrees", strongest["phase_margin_deg"], 45, "-", least=True),
        Claim("LQG3: delay margin, ms", strongest["delay_margin_ms"], 15, "-", least=True),
        Claim("LQG3: least damping kept by an unmodelled pair", strongest["local_damping_kept"], 0.85, "-", least=True),
        Claim("f/U, rms", values["force_to_command_rms"], 1.03, "paper 1.05", least=True),
        Claim("f/U, rms", values["force_to_command_rms"], 1.09, "paper 1.05"),
    ]
    for name, found in controllers.items():
        peer = f"24 states {found['peak_rms_error_24_states']:.2g}"
        claims += [
            Claim(f"{name}: least correlation, every channel", found["worst_correlation"], 0.998, "-", least=True),
            Claim(f"{name}: peaks and rms, mean", found["peak_rms_error"], 0.015, peer),
            Claim(f"{name}: peaks and rms, worst", found["worst_peak_rms_error"], 0.05, "-"),
            Claim(f"{name}: delay margin, ms", found["delay_margin_ms"], 4, "-", least=True),
        ]
    tables = [_table(controllers), fit_table(values["table1_error"], strongest, values["not_fitted"])]
    return values, claims, [*tables, _finding(values["papers_simulation"])]


def _finding(found: dict[str, Any]) -> Table:
    """How near the paper's model comes to the paper's own simulation; nothing is asked of it."""
    titles = {"": "A1 and A2 superposed, 24 states", "consistent_": "consistent model"}
    rows = tuple(
        (title, *(f"{found[f'{model}{key}']:.3f}" for key in ("error", "experiment_error")))
        for model, title in titles.items()
    )
    header = ("a finding, no claim: mean of 18 cells", "from the paper's simulation", "from its experiment")
    return Table("The paper's simulation (docs/measured.md)", header, rows)


def _table(controllers: dict[str, Any]) -> Table:
    """Margins, strength and reductions of the five."""
    header = ("", "gain dB", "phase deg", "delay ms", "peak command kgf", *(f"{row} rms -%" for row in RESPONSES))
    rows = tuple(
        (
            name,
            f"{found['gain_margin_db']:.1f}",
            f"{found['phase_margin_deg']:.0f}",
            f"{found['delay_margin_ms']:.1f}",
            f"{found['peak_command']:.0f}",
            *(f"{100 * found['reductions']['el_centro']['rms'][row]:.1f}" for row in RESPONSES),
        )
        for name, found in controllers.items()
    )
    return Table("The five controllers, El Centro at 0.1 g, as measured", header, rows)


def campaign_text(record: Path | None) -> str:
    """The campaign's YAML, with the tests of another record at 0.1 g added."""
    text = find_file("five_controllers", "abrace", "campaigns", ".yaml", "campaign").read_text(encoding="utf-8")
    if record is None:
        return text
    motion = f"ground_motion: {{record: {json.dumps(str(record.resolve()))}, peak_acceleration: 0.980665}}"
    steps = [f"  - {{name: record, test: {{duration: 50.0, {motion}}}}}"]
    for name in CONTROLLERS:
        check = f"{{test: record_{name}, uncontrolled: record, model: model, controller: {name}}}"
        steps += [
            f"  - {{name: record_{name}, test: {{duration: 50.0, {motion}, controller: {name}}}}}",
            f"  - {{name: record_{name}_check, validate: {check}}}",
        ]
    return text + "\n".join(steps) + "\n"


def run(record: Path | None) -> Results:
    """Run the campaign in a folder of its own, keep its report, return what it found."""
    with isolated() as here:
        campaign = Path("five_controllers.yaml")
        campaign.write_text(campaign_text(record), encoding="utf-8")
        results = run_campaign(campaign).results
        make_report(results)
        found = read_results(results)
        shutil.rmtree(here / KEPT, ignore_errors=True)
        shutil.copytree(results, here / KEPT)
    return found


def evaluate(found: Results) -> dict[str, Any]:
    """What was found, as verify.json has it."""
    main = found.comparisons["el_centro_lqg3_check"]
    cells = [
        abs(getattr(main.measured[name], key) / getattr(row, key) - 1)
        for name, row in TABLE_1_EXPERIMENT.items()
        for key in ("peak", "rms")
    ]
    return {
        "table1_error": float(np.mean(cells)),
        "table1_worst": float(np.max(cells)),
        "force_to_command_rms": _worst([main.measured["f"].rms]) / _worst([main.measured["U"].rms]),
        "controllers": {name: _controller(found, name) for name in CONTROLLERS},
    }


def _worst_peak_rms_error(comparison: ComparedTest) -> float | None:
    """Greatest relative error of a simulated peak or rms value in a `comparison`, of the channels that move.

    None: some are not known.
    """
    simulated = comparison.simulated or {}
    pairs = [
        (getattr(simulated[name], key), getattr(comparison.measured[name], key))
        for name in comparison.simulated_vs_measured
        for key in ("peak", "rms")
    ]
    if not pairs or any(value is None for pair in pairs for value in pair):
        return None
    return max(abs(found / measured - 1) for found, measured in pairs)


def _worst(values: Iterable[float | None]) -> float:
    """The greatest; NaN if one of them is not known."""
    return float(np.max(np.array(list(values), dtype=np.float64)))


def _controller(found: Results, name: str) -> dict[str, Any]:
    tests = {
        motion: found.comparisons[step] for motion in MOTIONS if (step := f"{motion}_{name}_check") in found.comparisons
    }
    proof = json.loads((KEPT / name / f"{name}_proof.json").read_text(encoding="utf-8"))
    margins = proof["margins"]
    return {
        "worst_correlation": min(_least_correlation(test) for test in tests.values()),
        "peak_rms_error": _worst(test.peak_rms_error for test in tests.values()),
        "peak_rms_errors": {motion: test.peak_rms_error for motion, test in tests.items()},
        "worst_peak_rms_error": _worst(_worst_peak_rms_error(test) for test in tests.values()),
        "peak_rms_error_24_states": _worst(test.other_models["superposed"].peak_rms_error for test in tests.values()),
        "gain_margin_db": margins["gain_db"],
        "phase_margin_deg": margins["phase_deg"],
        "delay_margin_ms": 1e3 * margins["delay_s"],
        "local_damping_kept": proof["least_damping_kept"],
        "reduction": _reduction(tests["el_centro"]),
        "reductions": {
            motion: {key: {row: _less(test, row, key) for row in RESPONSES} for key in ("peak", "rms")}
            for motion, test in tests.items()
        },
        "peak_command": tests["el_centro"].measured["U"].peak,
    }


def _least_correlation(test: ComparedTest) -> float:
    return min(row.correlation for row in test.simulated_vs_measured.values())


def _less(test: ComparedTest, row: str, key: str) -> float:
    assert test.uncontrolled is not None
    return 1 - float(getattr(test.measured[row], key) / getattr(test.uncontrolled[row], key))


def _reduction(test: ComparedTest) -> float:
    """By how much the controller lowers the rms values of displacements and accelerations, mean of all floors."""
    return float(np.mean([_less(test, row, "rms") for row in RESPONSES]))
