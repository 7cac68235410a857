# SPDX-License-Identifier: Apache-2.0
"""The node `validate`: compares a recorded test with its simulation, with the same test without control, or both.

abrace run abrace_sysid validate --ros-args -p test:=bags/first -p model:=model/model.json -p output:=check
abrace run abrace_sysid validate --ros-args -p test:=second.csv -p model:=structure/model.json -p output:=check
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from abrace_bags import read_run
from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json
from abrace_core.model import signals
from abrace_core.model.controller_file import load_controller
from abrace_core.model.linear_model import LinearModel, load_model
from abrace_core.model.response import PeakRms, clipped_sentences, in_paper_units, paper_unit, peak_rms, unit_system
from abrace_core.model.run import Run
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, parameters_of
from abrace_node.process import run
from abrace_sysid.figures import validation as figures
from abrace_sysid.recorded.test import is_table
from abrace_sysid.validation import Comparison, ValidateOptions, compare, predicted, read_test

PARAMETERS = [
    Parameter("test", "", "bag of the test to compare; for a model of data also a file with columns", required=True),
    Parameter("model", "", "model file (JSON) to simulate with; empty: only against the test without control"),
    Parameter("other_models", [], "further model files to simulate with, compared in the same way", element=str),
    Parameter("controller", "", "controller file of the test; empty: the recorded command drives the model"),
    Parameter("uncontrolled", "", "bag of the same test without control; empty: none"),
    *parameters_of(ValidateOptions),
    Parameter("output", "", "folder for comparison.json and figures", required=True),
]

BEFORE, ZOOM = 5.0, 20.0
"""The enlarged part of the figure begins BEFORE seconds ahead of the ground motion's peak and lasts ZOOM seconds."""


class ValidateNode(AbraceNode):
    """Compares one test, then ends."""

    def __init__(self) -> None:
        super().__init__("validate", PARAMETERS)

    def work(self) -> None:
        """Read, simulate, compare, write, draw."""
        given = self.parameters
        models = {Path(path).stem: load_model(path) for path in (given.model, *given.other_models) if given.model}
        print("reading the tests", flush=True)
        test = None if is_table(given.test) else self.read(given.test)
        uncontrolled = self.read(given.uncontrolled) if given.uncontrolled else None
        if not given.model and not (test and uncontrolled):
            raise AbraceError("parameter model: empty, expected a model file (JSON), or a bag for uncontrolled")
        if uncontrolled and not test:
            raise AbraceError(f"parameter uncontrolled: {given.uncontrolled}, expected none where test is no bag")
        facts = test.facts if test else {"record": given.test, "controller": Path(given.controller).stem}
        output, units = Path(given.output), unit_system(facts.get("rig", ""))
        content: dict[str, Any] = {
            "test": {
                "record": facts.get("record", ""),
                "peak_acceleration": float(facts.get("peak_acceleration", 0.0)),
                "controller": facts.get("controller", ""),
                "rig": facts.get("rig", ""),
            },
            "measured": _table(peak_rms(test)) if test else None,
            "simulated": None,
            "uncontrolled": _table(peak_rms(uncontrolled)) if uncontrolled else None,
            "clipped": ({"measured": test.clipped_samples} if test else {})
            | ({"uncontrolled": uncontrolled.clipped_samples} if uncontrolled else {}),
        }
        judged = None
        if given.model:
            print("simulating", flush=True)
            first, *others = comparisons = self.simulate(test or given.test, models)
            shown = comparisons[first]
            judged = predicted(shown)
            content |= _simulated(shown) | {
                "simulated": _table(shown.simulated_peak_rms()),
                "validity": judged.content,
                "other_models": {name: _simulated(comparisons[name]) for name in others},
            }
            if not test:
                content |= {"measured": _table(shown.measured_peak_rms()), "units": dict(shown.units)}
        write_json(output / "comparison.json", content)
        if given.model:
            telling = signals.most_telling(shown.names)
            with_table = test and signals.GROUND in test.all_names
            motion = (
                test.ground_acceleration if test and with_table else shown.measured[:, shown.names.index(telling[0])]
            )
            begin = max(shown.time[0], shown.time[np.argmax(np.abs(motion))] - BEFORE)
            zoom = (begin, min(begin + ZOOM, shown.time[-1]))
            drawing = figures.time_histories(shown, telling, zoom, units, _tested(facts))
            save_figure(drawing, output / "figure_6_time_histories.svg")
            _print(comparisons)
        if test and uncontrolled:
            floors = [name for name in test.names if name[1:].isdigit()]
            tops = [name for letter in "xa" for name in [one for one in floors if one[0] == letter][-1:]]
            drawing = figures.control_effect(uncontrolled, test, tops, units, _tested(facts))
            save_figure(drawing, output / "uncontrolled_and_controlled.svg")
        print(f"wrote {output}")
        if judged:
            print(f"validity: {judged.verdict.words}: {judged.meaning}")

    def read(self, bag: str) -> Run:
        """Read the run of a bag, and log its warnings."""
        recorded = read_run(bag)
        for warning in recorded.facts.get("warnings", []):
            self.get_logger().warning(warning)
        for sentence in clipped_sentences(recorded.clipped_samples):
            self.get_logger().warning(f"{recorded.source}: {sentence}")
        return recorded

    def simulate(self, test: Run | str, models: dict[str, LinearModel]) -> dict[str, Comparison]:
        """Simulate the test, a bag's or a file's, by each model, in closed loop if a controller is given."""
        law: tuple[Any, Any, Any] = (None, None, None)
        if self.parameters.controller:
            controller = load_controller(self.parameters.controller)
            law = controller.law, controller.force_limit, controller.correction
        options = ValidateOptions.of_values(self.parameters)
        return {name: compare(read_test(test, model, options), model, *law) for name, model in models.items()}


def _tested(facts: dict[str, Any]) -> str:
    """Record and controller of a test with these `facts`, as text."""
    peak = float(facts.get("peak_acceleration", 0.0)) * paper_unit(signals.GROUND)[0]
    record = f"{facts.get('record', '') or 'no motion'}{f' at {peak:.3g} g' if peak else ''}"
    return f"{record}, {facts.get('controller', '') or 'zero command'}"


def _simulated(comparison: Comparison) -> dict[str, Any]:
    agreement = {name: asdict(one) for name, one in comparison.agreement().items()}
    return {"simulated_vs_measured": agreement, "peak_rms_error": comparison.peak_rms_error()}


def _print(comparisons: dict[str, Comparison]) -> None:
    for label, one in comparisons.items():
        error_of_all = one.peak_rms_error()
        print(f"{label}: error of peaks and rms {'unknown' if error_of_all is None else f'{error_of_all:.4f}'}")
        width = max(8, *map(len, one.names))
        print(f"{'channel':{width}} correlation  rms error / rms  without sensor noise")
        for name, row in one.agreement().items():
            errors = f"{row.normalised_rms_error:15.4f}  {row.noise_free_error:20.4f}"
            print(f"{name:{width}} {row.correlation:11.4f}  {errors}")


def _table(rows: dict[str, PeakRms]) -> dict[str, dict[str, float]]:
    """Peaks and rms in cm, g and kgf; of quantities that are no rig's in their SI unit."""
    return {name: (rows if signals.unit(name) == "-" else in_paper_units(rows))[name]._asdict() for name in rows}


def main() -> int:
    """Entry point."""
    return run(ValidateNode)
