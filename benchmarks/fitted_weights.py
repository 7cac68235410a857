# SPDX-License-Identifier: Apache-2.0
"""What LQG3's weights were fitted to, and what they do where nothing was fitted: in the part `lqg` of `make verify`.

`benchmarks/fit_weights.py` found five numbers (the weights of displacements and of three accelerations,
and the noise) such that El Centro at 0.1 g meets the 18 cells of Table 1's experiment. So the distance from these cells
is that of a fit. Everything else is a test of the weights: other motions on the same rig, and El Centro on rigs that no
search saw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from papers_simulation import printed, rig_with

from abrace.report.table import Table
from abrace_core.files.installed import find_file
from abrace_core.model.response import TABLE_1_EXPERIMENT, in_paper_units, mean_relative_error, peak_rms_of
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_lqg.analysis.disk_margin import disk_margin
from abrace_lqg.analysis.margins import margins
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig import published
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel
    from abrace_plant.rig.model import Rig

OTHER_RIGS = ("single_storey", "five_storey")
"""Rig files; the weights go over as they stand, all accelerations measured, none weighed more than another."""

QUANTITIES = {"displacement": "x", "acceleration": "a"}
"""What a reduction is the mean of: all floors' displacements, or accelerations; by their names' first letter."""


def rig_file(name: str) -> Rig:
    """A rig of the package."""
    return load_rig(find_file(name, "abrace_plant", "config", ".yaml", "rig"))


def other_rigs(lqg3: Controller) -> dict[str, Any]:
    """What LQG3 does under El Centro at 0.1 g on rigs that its weights were not fitted to, simulated.

    The controller as it was designed meets the paper's rig with the poles of A1 and of A2; of OTHER_RIGS each gets a
    controller of its own, designed on the rig's model.
    """
    standing = rig_file(published.RIG)
    found = {
        f"{name}'s rig": _measure(rig_with(standing, printed(test)), lqg3.law, lqg3.correction)
        for name, test in (("A1", "table"), ("A2", "command"))
    }
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    for name in OTHER_RIGS:
        rig = rig_file(name)
        measured = [output for output in rig.model.outputs if output.startswith("a")]
        moved = weights.model_copy(update={"measured": measured, "relative": {}})
        designed = design(rig.model, moved, 1 / rig.sample_rate)
        found[name] = _measure(rig, designed.controller, designed.correction)
    return found


def _measure(rig: Rig, law: LinearModel, correction: NDArray[np.float64]) -> dict[str, Any]:
    """Margins, reductions and, of a rig with Table 1's rows, the distance from Table 1's experiment."""
    treatment = Treatment(peak_acceleration=0.1 * STANDARD_GRAVITY, duration=100.0)
    ground, plant = prepare(read_record("el_centro"), rig.sample_rate, treatment), rig.discrete_model()
    controlled, command = simulate_closed_loop(plant, law, ground, rig.capacity, correction)
    free = simulate(plant, np.column_stack([ground, np.zeros((len(ground), len(law.outputs)))]))
    with_control, without = (
        peak_rms_of((*plant.outputs, *law.outputs), np.hstack([outputs, command])) for outputs in (controlled, free)
    )
    found = margins(plant, law)
    table = in_paper_units(with_control)
    whole = table.keys() >= TABLE_1_EXPERIMENT.keys()
    floors = {name: 1 - with_control[name].rms / without[name].rms for name in plant.outputs if name[1:].isdigit()}
    return {
        "table1_error": mean_relative_error(table, TABLE_1_EXPERIMENT) if whole else None,
        "reduction": _means(floors),
        "gain_margin_db": found.gain_db,
        "phase_margin_deg": found.phase_deg,
        "disk_margin": disk_margin(plant, law).alpha,
    }


def _means(reductions: dict[str, float]) -> dict[str, float]:
    """Of all floors' displacements, and of their accelerations."""
    return {
        kind: float(np.mean([value for name, value in reductions.items() if name.startswith(letter)]))
        for kind, letter in QUANTITIES.items()
    }


def fit_table(table1_error: float, strongest: dict[str, Any], others: dict[str, Any]) -> Table:
    """What was fitted first, then what was not.

    Parameters
    ----------
    table1_error
        Of LQG3 as measured.
    strongest
        LQG3's values in verify.json: margins, and by motion what was measured.
    others
        Of `other_rigs`.
    """
    lines = []
    for motion, reductions in strongest["reductions"].items():
        fitted = motion == "el_centro"
        found = strongest | {"reduction": _means(reductions["rms"]), "table1_error": table1_error if fitted else None}
        prediction = f"{100 * strongest['peak_rms_errors'][motion]:.2f}"
        lines.append((f"{motion}, as measured", "18 cells" if fitted else "no", found, prediction))
    lines += [(f"el_centro, {name}", "no", found, "-") for name, found in others.items()]
    rows = tuple(
        (
            title.replace("_", " "),
            fitted,
            "-" if found["table1_error"] is None else f"{found['table1_error']:.3f}",
            *(f"{100 * found['reduction'][kind]:.1f}" for kind in QUANTITIES),
            prediction,
            f"{found['gain_margin_db']:.1f}",
            f"{found['phase_margin_deg']:.0f}",
        )
        for title, fitted, found, prediction in lines
    )
    reductions = (f"{kind}s: rms -%" for kind in QUANTITIES)
    header = ("", "fitted", "from Table 1", *reductions, "prediction: mean error %", "gain dB", "phase deg")
    note = "LQG3's five weights were fitted to Table 1's 18 cells: the first row's error is that of a fit, and no other"
    return Table("LQG3 where its weights were fitted, and where not", header, rows, (note,))
