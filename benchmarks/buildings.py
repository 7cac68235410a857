# SPDX-License-Identifier: Apache-2.0
"""More than one brace group, from tests to a controller and what it does: in the part `buildings` of `make verify`.

Five storeys with two unequal groups and ten with four: all groups tested at once with noise, orders and delays from
the data, a controller for which no weights were known, and El Centro at 0.1 g without and with control. And the paper's
rig: how far the model's transfer functions are from the rig's own.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from laboratory import Laboratory

from abrace.report.table import Table
from abrace_core.figures.saving import save_figure
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import load_controller
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import pole_table, save_model
from abrace_core.model.response import peak_rms
from abrace_core.model.simulation import simulate
from abrace_lqg.proof.limits import DesignOptions
from abrace_lqg.proof.proven_design import design_to_file
from abrace_lqg.weights import load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig
from abrace_sysid.figures import identification as figures
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import Identification, identify
from abrace_sysid.validation import compare
from abrace_sysid.validity.judgement import judge

if TYPE_CHECKING:
    from abrace_core.model.controller_file import Controller
    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig

SECONDS = 300.0
RESULTS = Path("results/buildings")
COMMAND_RMS = {"five_storey": 3500.0, "ten_storey": 10000.0}
"""N for each brace."""
HIGHEST = {"five_storey": 25.0, "ten_storey": 25.0}
"""Hz up to which the table is shaken: beyond the building's highest mode."""
RESPONSES = "xa"
"""First letters of displacements (strokes are no responses) and accelerations."""


def rig_of(name: str) -> Rig:
    """A rig of the package."""
    return load_rig(find_file(name, "abrace_plant", "config", ".yaml", "rig"))


def noise_tests(rig: Rig, seconds: float, command: float, highest: float, seed: int = 1) -> tuple[Run, Run]:
    """A test of the table and one of all commands at once, each with sensors' noise of its own."""
    first, second = Laboratory(rig, 2 * seed), Laboratory(rig, 2 * seed + 1)
    ground = Laboratory._noise(seconds, highest, 0.25, 1000 + seed)
    forces = [Laboratory._noise(seconds, 30.0, command, 2000 + 10 * seed + i) for i in range(rig.groups)]
    at_rest = np.zeros((len(ground), rig.groups))
    return (
        first.open_loop("bags/table", ground, at_rest),
        second.open_loop("bags/command", 0 * ground, np.column_stack(forces)),
    )


def earthquake(rig: Rig) -> np.ndarray:
    """El Centro at 0.1 g, 100 s."""
    treatment = Treatment(peak_acceleration=0.1 * STANDARD_GRAVITY, duration=100.0)
    return prepare(read_record("el_centro"), rig.sample_rate, treatment)


def chain(name: str) -> dict[str, Any]:
    """From two tests of a rig to a controller and what it does under El Centro, with the CPU seconds of each step."""
    rig, seconds = rig_of(name), {}
    folder = Path(tempfile.mkdtemp())
    tests = noise_tests(rig, SECONDS, COMMAND_RMS[name], HIGHEST[name])

    def timed(step: str, begin: float) -> float:
        seconds[step] = time.process_time() - begin
        return time.process_time()

    begin = time.process_time()
    options = IdentificationOptions(table_band=(0.3, HIGHEST[name]))
    found = identify(*tests, options)
    begin = timed("identify, with the reduction", begin)
    validity = judge(found).validity
    begin = timed("judge", begin)
    save_model(found.model, folder / "model.json", found.covariance)
    for model, content in (("reduced", found.reduced), ("superposed", found.superposed)):
        save_model(content, folder / f"{model}.json")
    proof, controller, _ = design_to_file(
        [str(folder / f"{model}.json") for model in ("reduced", "model", "superposed")],
        folder / "half.yaml",
        weights=load_weights(find_file("half", "abrace_lqg", "config", ".yaml", "weights")),
        weights_name="half",
        options=DesignOptions(sample_period=1 / rig.sample_rate, force_limit=tuple(rig.capacity.tolist())),
    )
    begin = timed("design and proof", begin)
    ground, laboratory = earthquake(rig), Laboratory(rig, 11)
    controller = load_controller(folder / "half.yaml")
    free = laboratory.open_loop("bags/uncontrolled", ground, np.zeros((len(ground), rig.groups)))
    controlled = laboratory.closed_loop("bags/controlled", ground, controller.law, controller.correction)
    begin = time.process_time()
    report = _compared(found, free, controlled, controller, rig)
    shown = [output for output in found.model.outputs if output in (f"x{rig.floors}", "a1")]
    for data in found.commands:
        drawn = figures.transfer_functions(data.responses[0], shown, found.model)
        save_figure(drawn, RESULTS / name / f"figure_5_command_{data.input}.svg")
    timed("comparison and figures", begin)
    for path in folder.glob("half*"):
        shutil.copy(path, RESULTS / name)
    shutil.rmtree(folder)
    frequency, damping = pole_errors(found, rig)
    return {
        "frequency_error": frequency,
        "damping_error": damping,
        **report,
        "states": {"model": found.model.order, "reduced": found.reduced.order},
        "delays_ms": [round(1e3 * delay, 4) for delay in found.model.input_delay],
        "margins": proof.summary(),
        "validity": validity.verdict.words,
        "warnings": list(found.warnings),
        "step_seconds": seconds,
        "seconds": sum(seconds.values()),
    }


def _compared(found: Identification, free: Run, controlled: Run, controller: Controller, rig: Rig) -> dict[str, Any]:
    """Prediction of zero command and of the loop, and reductions as measured and as predicted."""
    law, limit, correction = controller.law, controller.force_limit, controller.correction
    without = compare(free, found.model, None, limit)
    loop = compare(controlled, found.model, law, limit, correction)
    simulated = {"without": without.simulated_peak_rms(), "with": loop.simulated_peak_rms()}
    measured = {"without": peak_rms(free), "with": peak_rms(controlled)}
    rows = [name for name in rig.model.outputs if name[0] in RESPONSES and name[1:].isdigit()]
    reductions = {
        kind: {name: 1 - rms["with"][name].rms / rms["without"][name].rms for name in rows}
        for kind, rms in (("measured", measured), ("predicted", simulated))
    }
    # the rig's own motion, before its sensors: their noise hides a small force, and is no error of the model
    plant = rig.discrete_model()
    moved = simulate(plant, np.column_stack([earthquake(rig), np.zeros((len(free.outputs), rig.groups))]))
    left = without.simulated[:, : len(free.names)] - moved
    error = np.sqrt(np.mean(left**2, axis=0) / np.mean(moved**2, axis=0))
    of_loop = loop.noise_free_error()
    return {
        "prediction_error": float(error.max()),
        "prediction_errors": dict(zip(free.names, error.tolist(), strict=True)),
        "prediction_errors_as_measured": without.noise_free_error(),
        "closed_loop_errors": of_loop,
        "reduction_error": max(abs(reductions["measured"][n] - reductions["predicted"][n]) for n in rows),
        "reductions": reductions,
        "peak_commands": {name: measured["with"][name].peak for name in controlled.command_names},
    }


def pole_errors(found: Identification, rig: Rig) -> tuple[float, float]:
    """Worst relative errors of frequency and damping of the rig's own pairs."""
    own = np.array(pole_table(rig.model.poles))
    pairs = np.array([(pair.frequency, pair.damping) for pair in found.poles.common_pairs])
    nearest = np.abs(pairs[:, :1] / own[:, 0] - 1).argmin(axis=0)
    frequency, damping = np.abs(pairs[nearest] / own - 1).max(axis=0)
    return float(frequency), float(damping)


def transfer_errors(seconds: float = 600.0, seed: int = 1) -> dict[str, dict[str, float]]:
    """By input and output of the paper's rig: rms over the band of the model's difference, over that of the rig's."""
    rig = rig_of("ncree_three_storey")
    table, command = noise_tests(rig, seconds, 1800.0, 10.0, seed)
    model = identify(table, command).model
    errors: dict[str, dict[str, float]] = {}
    for name, highest in (("w", 10.0), ("U", 30.0)):
        omega = 2 * np.pi * np.linspace(0.3, highest, 3000)
        own, found = (
            discretize(one.select(table.names, [name]), 1 / rig.sample_rate).frequency_response(omega)[:, :, 0]
            for one in (rig.model, model)
        )
        error = np.sqrt(np.mean(np.abs(found - own) ** 2, axis=0) / np.mean(np.abs(own) ** 2, axis=0))
        errors[name] = dict(zip(table.names, error.tolist(), strict=True))
    return errors


def verify_buildings() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and tables."""
    five, ten, transfer = chain("five_storey"), chain("ten_storey"), transfer_errors()
    worst = max(error for of_input in transfer.values() for error in of_input.values())
    values = {"five_storeys": five, "ten_storeys": ten, "transfer_error": worst, "transfer_errors": transfer}
    claims = [
        Claim("five storeys, two groups: worst pole, frequency", five["frequency_error"], 0.0005, "the rig"),
        Claim("five storeys, two groups: worst pole, damping", five["damping_error"], 0.01, "the rig"),
        Claim("five storeys: El Centro, worst channel", five["prediction_error"], 0.01, "the rig"),
        Claim("five storeys: reductions within those predicted", five["reduction_error"], 0.02, "as measured"),
        Claim("ten storeys, four groups: CPU s of the chain", ten["seconds"], 60.0, "one thread"),
        Claim("NCREE, linear: transfer functions in band, worst", worst, 0.0005, "the rig"),
    ]
    return values, claims, [_table(five, ten), _transfer_table(transfer)]


def _table(five: dict[str, Any], ten: dict[str, Any]) -> Table:
    def mean(found: dict[str, Any], kind: str, letter: str) -> float:
        return float(np.mean([value for name, value in found["reductions"][kind].items() if name[0] == letter]))

    rows = [
        ("worst pole: frequency %", *(f"{100 * one['frequency_error']:.4f}" for one in (five, ten))),
        ("worst pole: damping %", *(f"{100 * one['damping_error']:.3f}" for one in (five, ten))),
        ("states: model, reduced", *("{model}, {reduced}".format(**one["states"]) for one in (five, ten))),
        ("El Centro, zero command: worst channel %", *(f"{100 * one['prediction_error']:.2f}" for one in (five, ten))),
        ("closed loop: worst %", *(f"{100 * max(one['closed_loop_errors'].values()):.2f}" for one in (five, ten))),
        ("displacements: rms -%", *(f"{100 * mean(one, 'measured', 'x'):.1f}" for one in (five, ten))),
        ("accelerations: rms -%", *(f"{100 * mean(one, 'measured', 'a'):.1f}" for one in (five, ten))),
        ("reductions: worst difference, %", *(f"{100 * one['reduction_error']:.2f}" for one in (five, ten))),
        *(
            (f"CPU s: {step}", *(f"{one['step_seconds'][step]:.1f}" for one in (five, ten)))
            for step in five["step_seconds"]
        ),
    ]
    notes = tuple(f"{name}: {one['margins']}" for name, one in (("five", five), ("ten", ten)))
    header = ("", "five storeys, two groups", "ten storeys, four groups")
    return Table("Several brace groups, 300 s of each test, weights of `half`", header, tuple(rows), notes)


def _transfer_table(transfer: dict[str, dict[str, float]]) -> Table:
    names = list(transfer["w"])
    rows = tuple((f"from {name}", *(f"{100 * row[one]:.3f}" for one in names)) for name, row in transfer.items())
    return Table("The paper's rig: transfer functions in band, rms error, %, 600 s each", ("", *names), rows)


def main() -> int:
    """The section alone."""
    values, claims, tables = verify_buildings()
    print(values)
    for claim in claims:
        print(claim, claim.holds)
    print("\n\n".join(table.text() for table in tables))
    return 0 if all(claim.holds for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
