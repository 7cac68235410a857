# SPDX-License-Identifier: Apache-2.0
"""The paper's own method, beside maximum likelihood, on the demo's two tests: the part `paper_method` of `make verify`.

Two tests of 240 s of the simulated rig; El Centro at 0.1 g under an LQG3 designed with each method's own eight states.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from claims import Claim
from identification_accuracy import the_rig, true_pairs, two_tests, worst_errors
from laboratory import Laboratory

from abrace.report.table import Table
from abrace_core.files.installed import find_file
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig import published
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import identify
from abrace_sysid.validation import compare

if TYPE_CHECKING:
    from abrace_sysid.identification import Identification

SECONDS = 240.0
METHODS = ("paper", "maximum_likelihood")
MODELS = {"24": "superposed", "8": "reduced"}
"""Models by their number of states."""


def poles_found(found: Identification) -> dict[str, Any]:
    """Worst errors of each test's poles; `damping_of_three`: of the building's three modes alone."""
    true = true_pairs(the_rig())
    values: dict[str, Any] = {}
    for test, pairs in (("table", found.poles.table_pairs), ("command", found.poles.command_pairs)):
        own = [(pair.frequency, pair.damping) for pair in pairs]
        frequency, damping = worst_errors(own, true[test])
        values[test] = {
            "frequency_error": frequency,
            "damping_error": damping,
            "damping_of_three": worst_errors(own, true["table"])[1],
            "stable": all(pair.damping > 0 for pair in pairs),
        }
    return values


def predicted(found: Identification) -> dict[str, dict[str, float]]:
    """Errors of the test under LQG3: of Table 1's cells, mean, and of the time histories, the worst channel."""
    rig = the_rig()
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    law = design(found.reduced, weights, 1 / rig.sample_rate).controller
    treatment = Treatment(peak_acceleration=0.1 * STANDARD_GRAVITY, duration=100.0)
    ground = prepare(read_record("el_centro"), rig.sample_rate, treatment)
    test = Laboratory(rig, 99).closed_loop("bags/controlled", ground, law)
    values: dict[str, dict[str, float]] = {"table1_error": {}, "prediction_error": {}}
    for states, name in MODELS.items():
        compared = compare(test, getattr(found, name), law, rig.capacity)
        cells = compared.peak_rms_error()
        assert cells is not None, "every channel moves"
        values["table1_error"][states] = cells
        values["prediction_error"][states] = max(compared.noise_free_error().values())
    return values


def verify_paper_method() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Poles, Table 1 and prediction by the paper's method and by maximum likelihood."""
    runs = two_tests(the_rig(), SECONDS, 0)
    by_method = {}
    for method in METHODS:
        options = IdentificationOptions.model_validate({"method": method, "servo_lag": published.BENCH_LAG})
        found = identify(runs["table"], runs["command"], options)
        by_method[method] = {**poles_found(found), **predicted(found)}
    values = {**by_method["paper"], "maximum_likelihood": by_method["maximum_likelihood"]}
    claims = []
    for test in ("table", "command"):
        one = values[test]
        claims += [
            Claim(f"the paper's method, {test}: frequency", one["frequency_error"], 0.002, ""),
            Claim(f"the paper's method, {test}: damping of the building", one["damping_of_three"], 0.1, ""),
            Claim(f"the paper's method, {test}: stable", float(one["stable"]), 1.0, "", least=True),
        ]
    return values, claims, [method_table(by_method)]


def method_table(by_method: dict[str, Any]) -> Table:
    """Both methods side by side."""
    rows = []
    for test in ("table", "command"):
        for key, title in (("frequency_error", "frequency"), ("damping_error", "damping")):
            rows.append((f"{test}: worst {title}", *(f"{100 * by_method[each][test][key]:.2g}" for each in METHODS)))
    for key, title in (("table1_error", "Table 1, mean"), ("prediction_error", "time histories, worst channel")):
        for states in MODELS:
            rows.append(
                (f"{states} states: {title}", *(f"{100 * by_method[each][key][states]:.2g}" for each in METHODS))
            )
    header = ("error, %", *(method.replace("_", " ") for method in METHODS))
    return Table(f"The paper's method on two tests of {SECONDS:g} s", header, tuple(rows))
