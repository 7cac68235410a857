"""The node `validate`: a bag against its simulation by a model, and against the same test without control."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from abrace_bags import read_run
from abrace_core.controller_file import load_controller
from abrace_core.drawing import save_figure
from abrace_core.files import write_text
from abrace_core.linear_model import load_model
from abrace_core.node import AbraceNode, Parameter, run
from abrace_core.response import PeakRms, clipped_sentences, in_paper_units, peak_rms
from abrace_sysid.figures import validation as figures
from abrace_sysid.validation import Comparison, compare
from abrace_sysid.validity.prediction import predicted

PARAMETERS = [
    Parameter("bag", "", "bag of the test to compare", required=True),
    Parameter("model", "", "model file (JSON) to simulate with", required=True),
    Parameter("other_models", [], "further model files to simulate with, compared in the same way", element=str),
    Parameter("controller", "", "controller file of the test; empty: the recorded command drives the model"),
    Parameter("uncontrolled", "", "bag of the same test without control; empty: none"),
    Parameter("output", "", "folder for comparison.json and figures", required=True),
]

ZOOM = 20.0
"""Seconds shown enlarged: the strong part of El Centro."""


class Validate(AbraceNode):
    """Compares one test and ends."""

    def __init__(self) -> None:
        super().__init__("validate", PARAMETERS)

    def work(self) -> None:
        """Read, simulate, compare, write, draw."""
        given = self.parameters
        print("reading the bags", flush=True)
        test, model = read_run(given.bag), load_model(given.model)
        uncontrolled = read_run(given.uncontrolled) if given.uncontrolled else None
        for recorded in [test] + ([uncontrolled] if uncontrolled else []):
            for warning in recorded.facts.get("warnings", []):
                self.get_logger().warning(warning)
            for sentence in clipped_sentences(recorded.clipped_samples):
                self.get_logger().warning(f"{recorded.source}: {sentence}")
        law, limit, correction = None, np.full(test.groups, np.inf), None
        if given.controller:
            controller = load_controller(given.controller)
            law, limit, correction = controller.law, controller.force_limit, controller.correction
        clipped = {"measured": test.clipped_samples}
        if uncontrolled:
            clipped["uncontrolled"] = uncontrolled.clipped_samples
        print("simulating", flush=True)
        comparison = compare(test, model, law, limit, correction)
        agreement, judged = _agreement(comparison), predicted(comparison)
        others = {
            Path(path).stem: compare(test, load_model(path), law, limit, correction) for path in given.other_models
        }
        content = {
            "test": {
                "record": test.facts.get("record", ""),
                "peak_acceleration": float(test.facts.get("peak_acceleration", 0.0)),
                "controller": test.facts.get("controller", ""),
            },
            "measured": _table(comparison.measured_peak_rms()),
            "simulated": _table(comparison.simulated_peak_rms()),
            "uncontrolled": _table(peak_rms(uncontrolled)) if uncontrolled else None,
            "clipped": clipped,
            "simulated_vs_measured": agreement,
            "peak_rms_error": comparison.peak_rms_error(),
            "validity": judged.content,
            "other_models": {
                name: {"simulated_vs_measured": _agreement(other), "peak_rms_error": other.peak_rms_error()}
                for name, other in others.items()
            },
        }
        output = Path(given.output)
        write_text(output / "comparison.json", json.dumps(content, indent=1))
        top = test.floors
        begin, end = comparison.time[0], comparison.time[-1]
        drawing = figures.time_histories(comparison, [f"x{top}", "a1"], (begin, min(begin + ZOOM, end)))
        save_figure(drawing, output / "figure_6_time_histories.png")
        if uncontrolled:
            drawing = figures.control_effect(uncontrolled, test, [f"x{top}", f"a{top}"])
            save_figure(drawing, output / "uncontrolled_and_controlled.png")
        for label, one in ((Path(given.model).stem, comparison), *others.items()):
            print(f"{label}: error of peaks and rms {one.peak_rms_error():.4f}")
            print("channel  correlation  rms error / rms  without sensor noise")
            for name, row in _agreement(one).items():
                error, noise_free = row["normalised_rms_error"], row["noise_free_error"]
                print(f"{name:8} {row['correlation']:11.4f}  {error:15.4f}  {noise_free:20.4f}")
        print(f"wrote {output}")
        print(f"validity: {judged.verdict.words}: {judged.meaning}")


def _agreement(comparison: Comparison) -> dict[str, dict[str, float]]:
    error, noise_free = comparison.normalised_rms_error(), comparison.noise_free_error()
    return {
        name: {"correlation": value, "normalised_rms_error": error[name], "noise_free_error": noise_free[name]}
        for name, value in comparison.correlation().items()
    }


def _table(rows: dict[str, PeakRms]) -> dict[str, dict[str, float]]:
    return {name: row._asdict() for name, row in in_paper_units(rows).items()}


def main() -> int:
    """Entry point."""
    return run(Validate)
