# SPDX-License-Identifier: Apache-2.0
"""The paper's own simulation, the second half of its Table 1: how much of it two unlike tests explain.

The paper simulates its controlled test by Eqs. (6) and (7), a table model and a command model side by side. A1 and A2,
as printed, are of two buildings that differ a little. Here two rigs are made whose building has the printed poles of
A1 and of A2; the table part comes from the one, the command part from the other, and both together run El Centro at
0.1 g for 100 s under the same LQG3. Beside it runs the standing rig itself, one consistent model.

    python benchmarks/papers_simulation.py

prints the tables of docs/papers_simulation.md and draws its figures. `make verify` calls `papers_simulation`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from laboratory import Laboratory
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from abrace.report.table import Table
from abrace_core import signals
from abrace_core.discretization import discretize
from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED, legend_above, save_figure
from abrace_core.linear_model import LinearModel, pole_table
from abrace_core.node import find_file
from abrace_core.response import (
    TABLE_1_EXPERIMENT,
    TABLE_1_SIMULATION,
    PeakRms,
    in_paper_units,
    mean_relative_error,
    peak_rms_of,
)
from abrace_core.simulation import simulate, simulate_closed_loop
from abrace_lqg.design import design
from abrace_lqg.loop import closed_loop
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.intensity import STANDARD_GRAVITY
from abrace_plant.records.treatment import Treatment, prepare
from abrace_plant.rig import published
from abrace_plant.rig.building import Building
from abrace_plant.rig.file import load_rig
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import identify
from abrace_sysid.models.realization import realize, superpose
from abrace_sysid.spectra.estimation import TransferFunctionOptions
from abrace_sysid.spectra.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig
    from abrace_sysid.spectra.estimation import Method

Pairs = tuple[tuple[float, float], ...]
"""Frequency [rad/s] and damping ratio of the building's modes."""

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 1e-6, 1e-4
"""Relative; the paper prints four or five digits of a frequency and three of a damping."""
CHANGE = 0.1
"""Relative change of one of a rig's parameters that counts as much as the tolerances: as good as none."""
TABLE_BAND, COMMAND_BAND = (0.3, 10.0), (0.3, 30.0)
"""Hz, of the paper's tests."""
SPACING = 0.01
"""Hz between the lines of an exact transfer function."""
DETUNING = np.linspace(-0.04, 0.04, 17)
"""Relative difference of the first frequency, command part against table part, of the sweep."""
SEEDS = 8
OTHERS, DECADES, NEAR = 100, 0.6, 0.055
"""Other controllers: how many are tried, how far their weights stray from LQG3's either way (in log10), and the
distance from the paper's experiment, on the standing rig, up to which one might have been the paper's LQG3 as well."""


def printed(test: str) -> Pairs:
    """The building's pairs among the printed eigenvalues of A1 (`test` "table") or A2 ("command")."""
    return tuple((abs(pole), -pole.real / abs(pole)) for pole in published.PAPER_POLES[test][:3])


def rig_with(rig: Rig, asked: Pairs) -> Rig:
    """The rig nearest to `rig` whose building's poles, with zero command, are those `asked`.

    Nine parameters may move: frequencies and damping ratios of the bare frame's modes, the stiffeners, the servo's
    velocity feedback and its integral rate. Of all that meet the six numbers, the least relative change is taken.
    """
    building, group = rig.building, rig.braces[0]
    frequencies, shapes = building.modes()
    shares = building.masses[:, None] * shapes

    def changed(logarithms: NDArray[np.float64]) -> Rig:
        ratios = np.exp(logarithms)
        omega, damping = frequencies * ratios[:3], building.damping_ratios * ratios[3:6]
        frame = Building(building.masses, (shares * omega**2) @ shares.T, (shares * (2 * damping * omega)) @ shares.T)
        actuator = replace(
            group.actuator,
            velocity_feedback=group.actuator.velocity_feedback * ratios[7],
            integral_rate=group.actuator.integral_rate * ratios[8],
        )
        stiffeners = group.stiffener_stiffness * ratios[6]
        return replace(rig, building=frame, braces=(replace(group, stiffener_stiffness=stiffeners, actuator=actuator),))

    def missed(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
        found = pole_table(changed(logarithms).model.poles())[: rig.floors]
        errors = np.log(np.array(found) / np.array(asked)) / (FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
        return np.concatenate([errors.ravel(), logarithms / CHANGE])

    return changed(least_squares(missed, np.zeros(9), x_scale=0.01).x)


def exact_superposition(table: Rig, command: Rig) -> LinearModel:
    """z = z1 + z2, z1 the exact response of one rig to the table and z2 that of another to the command."""
    parts = [table.model.select(None, [signals.GROUND]), command.model.select(None, command.model.inputs[1:])]
    return superpose(parts, table.model.inputs, table.model.outputs)


def superposition(table: Rig, command: Rig) -> LinearModel:
    """Eqs. (3) to (7), 24 states: as `exact_superposition`, but in the paper's orders.

    Numerators are fitted to the exact transfer functions, in the paper's bands, over the rigs' own poles; the servo's
    lag stays a delay. What six or twelve states cannot hold (the servo's slow pole, in A3 the local modes) is left out.
    """
    ground, brace = table.model.inputs
    outputs = table.model.outputs
    accelerations = [name for name in outputs if name.startswith("a")]
    others = [name for name in outputs if name not in accelerations]

    def part(rig: Rig, name: str, band: tuple[float, float], wanted: Sequence[str], pairs: int) -> LinearModel:
        omega = 2 * np.pi * np.arange(*band, SPACING)
        response = rig.discrete_model().select(wanted, [name]).frequency_response(omega)[:, :, 0]
        no_error = np.zeros(response.shape)
        exact = FrequencyResponse(name, tuple(wanted), omega, response, no_error, 1 / rig.sample_rate, "exact")
        upper = rig.model.poles()
        upper = upper[upper.imag > 0][:pairs]
        lag = published.BENCH_LAG if name == brace else 0.0
        return realize(exact, np.column_stack([upper, upper.conj()]).ravel(), lag)

    parts = [
        part(table, ground, TABLE_BAND, outputs, 3),
        part(command, brace, COMMAND_BAND, accelerations, 6),
        part(command, brace, COMMAND_BAND, others, 3),
    ]
    return superpose(parts, (ground, brace), outputs)


@dataclass(frozen=True)
class Test:
    """El Centro at 0.1 g for 100 s under one controller, on whatever model.

    Parameters
    ----------
    controller
        Discrete law, Eq. (13).
    rig, table, command
        The standing rig, and those with the poles of A1 and of A2.
    ground
        (samples,) acceleration of the table [m/s^2].
    """

    __test__ = False  # to pytest this is no test

    controller: LinearModel
    rig: Rig
    table: Rig
    command: Rig
    ground: NDArray[np.float64]

    @classmethod
    def under(cls, controller: LinearModel) -> Test:
        """The test with a `controller`."""
        rig = load_rig(find_file(published.RIG, "abrace_plant", "config", ".yaml", "rig"))
        treatment = Treatment(peak_acceleration=0.1 * STANDARD_GRAVITY, duration=100.0)
        ground = prepare(read_record("el_centro"), rig.sample_rate, treatment)
        return cls(controller, rig, rig_with(rig, printed("table")), rig_with(rig, printed("command")), ground)

    def run(self, model: LinearModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Outputs and commands of a continuous model, as `simulate_closed_loop` gives them."""
        sampled = discretize(model, 1 / self.rig.sample_rate)
        return simulate_closed_loop(sampled, self.controller, self.ground, self.rig.capacity)

    def parts(self, model: LinearModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same outputs as the sum of what the table and what the command cause, each (samples, outputs)."""
        _, command = self.run(model)
        sampled = discretize(model, 1 / self.rig.sample_rate)
        in_force = np.append(command[1:, 0], command[-1, 0])
        still = np.zeros(len(self.ground))
        shaken, pushed = np.column_stack([self.ground, still]), np.column_stack([still, in_force])
        return simulate(sampled, shaken), simulate(sampled, pushed)

    def table_1(self, model: LinearModel) -> dict[str, PeakRms]:
        """Peak and rms in the rows and units of Table 1."""
        return in_paper_units(peak_rms_of((*model.outputs, *model.inputs[1:]), np.hstack(self.run(model))))

    def error(self, model: LinearModel) -> float:
        """Mean over the 18 cells of the relative distance from the paper's simulation."""
        return mean_relative_error(self.table_1(model), TABLE_1_SIMULATION)


def papers_simulation(controller: LinearModel) -> dict[str, Any]:
    """What the superposition of A1's rig and A2's gives under a controller, and the paper's simulation.

    Returns
    -------
    dict
        `error`, `consistent_error`: mean relative distance, over 18 cells, of the superposed and of the consistent
        model from the paper's simulation; `experiment_error`, `consistent_experiment_error`: from its experiment;
        `cells`: by row, peak and rms [cm, g, kgf] of the paper's simulation and experiment and of both models.
    """
    test = Test.under(controller)
    tables = {
        "paper": TABLE_1_SIMULATION,
        "superposed": test.table_1(superposition(test.table, test.command)),
        "consistent": test.table_1(test.rig.model),
        "experiment": TABLE_1_EXPERIMENT,
    }
    return {
        "error": mean_relative_error(tables["superposed"], TABLE_1_SIMULATION),
        "consistent_error": mean_relative_error(tables["consistent"], TABLE_1_SIMULATION),
        "experiment_error": mean_relative_error(tables["superposed"], TABLE_1_EXPERIMENT),
        "consistent_experiment_error": mean_relative_error(tables["consistent"], TABLE_1_EXPERIMENT),
        "cells": {row: {name: list(table[row]) for name, table in tables.items()} for row in TABLE_1_SIMULATION},
    }


def with_command_poles(model: LinearModel, pairs: Pairs) -> LinearModel:
    """A model of `superposition` whose command parts, A2 and A3, have other building poles and the same residues."""
    a = model.a.copy()
    for start in (6, 18):  # of A2 and A3; each pair is a block of two states
        for i, (frequency, damping) in enumerate(pairs):
            re, im = -damping * frequency, frequency * np.sqrt(1 - damping**2)
            block = slice(start + 2 * i, start + 2 * i + 2)
            a[block, block] = [[re, im], [-im, re]]
    return replace(model, a=a)


def detuned(model: LinearModel, share: float) -> LinearModel:
    """A model of `superposition` with the command parts' first frequency so much above A1's, all else A2's."""
    (_, damping), *others = printed("command")
    return with_command_poles(model, ((printed("table")[0][0] * (1 + share), damping), *others))


def causes(test: Test) -> dict[str, float]:
    """Distance from the paper's simulation, one difference at a time."""
    one_day, two_days = superposition(test.table, test.table), superposition(test.table, test.command)
    table, command = printed("table"), printed("command")
    found = {
        "consistent: standing rig": test.error(test.rig.model),
        "consistent: A1's rig": test.error(test.table.model),
        "consistent: A2's rig": test.error(test.command.model),
        "superposed, exact: A1's and A2's rig": test.error(exact_superposition(test.table, test.command)),
        "24 states: A1's rig for both": test.error(one_day),
    }
    for mode in range(3):
        for i, quantity in enumerate(("frequency", "damping")):
            pairs = [list(pair) for pair in table]
            pairs[mode][i] = command[mode][i]
            moved = with_command_poles(one_day, tuple((frequency, damping) for frequency, damping in pairs))
            found[f"24 states: A1's rig, command part with A2's {quantity} {mode + 1}"] = test.error(moved)
    found["24 states: A1's rig, command part with A2's six numbers"] = test.error(with_command_poles(one_day, command))
    found["24 states: A1's and A2's rig"] = test.error(two_days)
    found["24 states: A2's and A1's rig, exchanged"] = test.error(superposition(test.command, test.table))
    for milliseconds in (-0.8, 2.0):
        delay = two_days.input_delay[1] + milliseconds / 1e3
        later = replace(two_days, input_delay=(0.0, max(delay, 0.0)))
        found[f"24 states: A1's and A2's rig, command {milliseconds:+.1f} ms"] = test.error(later)
    return found


def estimated(test: Test, table: Rig, command: Rig, method: Method) -> list[float]:
    """Distances of the superposed models of SEEDS pairs of simulated tests of 300 s, a rig for each test."""
    options = IdentificationOptions(
        fit="sk",
        command_order=12,
        servo_lag=published.BENCH_LAG,
        transfer_function=TransferFunctionOptions(method=method),
    )
    errors = []
    for seed in range(SEEDS):
        noise = Laboratory(table, seed).table_test(300), Laboratory(command, seed).command_test(300)
        errors.append(test.error(identify(*noise, options).superposed))
    return errors


def other_controllers(test: Test) -> NDArray[np.float64]:
    """(controllers, 2) distances, consistent and superposed, under others that meet the paper's experiment as well.

    They are designed on the standing rig; the weights of displacements, accelerations and noise stray at random.
    """
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    superposed = superposition(test.table, test.command)
    distances = []
    for ratios in 10 ** np.random.default_rng(0).uniform(-DECADES, DECADES, (OTHERS, 3)):
        content = weights.model_dump()
        content["weights"]["displacement"] *= ratios[0]
        content["weights"]["acceleration"] *= ratios[1]
        content["noise_to_excitation"] *= ratios[2]
        designed = design(test.rig.model, Weights.model_validate(content), 1 / test.rig.sample_rate)
        other = replace(test, controller=designed.controller)
        if mean_relative_error(other.table_1(test.rig.model), TABLE_1_EXPERIMENT) <= NEAR:
            distances.append([other.error(test.rig.model), other.error(superposed)])
    return np.array(distances)


def lqg3() -> LinearModel:
    """LQG3 as a test day gives it: designed on the model identified from two tests of the standing rig of 300 s."""
    rig = load_rig(find_file(published.RIG, "abrace_plant", "config", ".yaml", "rig"))
    laboratory = Laboratory(rig)
    found = identify(laboratory.table_test(300), laboratory.command_test(300))
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    return design(found.reduced, weights, 1 / rig.sample_rate).controller


def cells_table(found: dict[str, Any]) -> Table:
    """Table 1 and our models."""
    names = ("experiment", "paper", "superposed", "consistent")
    header = ("", *(f"{name} {number}" for number in ("peak", "rms") for name in names))
    rows = tuple(
        (row, *(f"{cell[name][i]:.4g}" for i in range(2) for name in names)) for row, cell in found["cells"].items()
    )
    notes = tuple(f"{key}: {value:.4f}" for key, value in found.items() if key != "cells")
    return Table("El Centro at 0.1 g, LQG3 [cm, g, kgf]", header, rows, notes)


def causes_table(errors: dict[str, float]) -> Table:
    """What each difference does."""
    rows = tuple((name, f"{error:.3f}") for name, error in errors.items())
    return Table("Mean relative distance from the paper's simulation", ("models", "distance"), rows)


def cells_figure(cells: dict[str, Any]) -> Figure:
    """The 18 cells of Table 1 over those of the paper's experiment."""
    figure = Figure(figsize=(10.0, 5.6), layout="constrained")
    bars = {
        "the paper's simulation": ("paper", REFERENCE),
        "superposed, A1's and A2's rig": ("superposed", SIMULATED),
        "consistent": ("consistent", MEASURED),
    }
    for i, (axis, number) in enumerate(zip(figure.subplots(2, 1, sharex=True), ("peak", "rms"), strict=True)):
        for j, (label, (name, colour)) in enumerate(bars.items()):
            ratios = [cell[name][i] / cell["experiment"][i] for cell in cells.values()]
            axis.bar(np.arange(len(ratios)) + 0.27 * (j - 1), ratios, 0.25, color=colour, label=label)
        axis.axhline(1.0, color="black", lw=0.8)
        axis.set_ylabel(f"{number} / experiment's [-]")
        axis.set_ylim(0.7, 1.4)
        axis.set_xticks(range(len(cells)), list(cells))
        axis.grid(alpha=0.3, axis="y")
    legend_above(figure, axis, len(bars))
    return figure


def parts_figure(test: Test, model: LinearModel) -> Figure:
    """x3 of the table part and of the command part, and, on a scale of its own, of their sum."""
    column, factor = model.outputs.index("x3"), 100.0
    shaken, pushed = (factor * part[:, column] for part in test.parts(model))
    consistent = factor * test.run(test.rig.model)[0][:, column]
    time = np.arange(len(shaken)) / test.rig.sample_rate
    figure = Figure(figsize=(10.0, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(time, shaken, color=REFERENCE, lw=0.9, label="table part")
    above.plot(time, pushed, color=MEASURED, lw=0.9, label="command part")
    above.plot(time, shaken + pushed, color=SIMULATED, lw=0.9, label="sum")
    below.plot(time, consistent, color=MEASURED, lw=0.9, label="consistent")
    below.plot(time, shaken + pushed, color=SIMULATED, lw=0.9, label="superposed, A1's and A2's rig")
    for axis in (above, below):
        axis.set_ylabel("x3 [cm]")
        axis.set_xlim(0.0, 60.0)
        axis.legend(loc="upper right", ncols=3)
        axis.grid(alpha=0.3)
    below.set_xlabel("time [s]")
    return figure


def mode_1_figure(test: Test, models: dict[str, LinearModel], errors: Sequence[float]) -> Figure:
    """From w to x3 in closed loop near the first mode, and the distance from the paper over the sweep of DETUNING."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    hertz = np.linspace(0.8, 1.6, 600)
    for (label, model), colour in zip(models.items(), (MEASURED, SIMULATED, "#b8860b"), strict=True):
        response = closed_loop(model, test.controller).select(["x3"]).frequency_response(2 * np.pi * hertz)
        left.plot(hertz, 100 * np.abs(response[:, 0, 0]), color=colour, lw=1.2, label=label)
    left.set_xlabel("frequency [Hz]")
    left.set_ylabel("x3 / w in closed loop [cm per m/s²]")
    left.legend(fontsize="small")
    right.plot(100 * DETUNING, errors, color=SIMULATED, marker="o", ms=3, lw=1.2)
    as_printed = 100 * (printed("command")[0][0] / printed("table")[0][0] - 1)
    right.axvline(as_printed, color=REFERENCE, ls="--", label=f"as printed, {as_printed:.2f} %")
    right.axhline(test.error(test.rig.model), color=MEASURED, lw=1.0, label="consistent")
    right.set_xlabel("first frequency, command part over table part [%]")
    right.set_ylabel("mean distance from the paper's simulation [-]")
    right.set_ylim(0.0, None)
    right.legend(fontsize="small")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    return figure


def main() -> None:
    """Measure, print, draw."""
    test = Test.under(lqg3())
    found = papers_simulation(test.controller)
    print(cells_table(found).text())
    others = {row: TABLE_1_SIMULATION[row] for row in TABLE_1_SIMULATION if row != "xf"}
    ours = {row: PeakRms(*cell["superposed"]) for row, cell in found["cells"].items()}
    print(f"superposed, without the row of xf: {mean_relative_error(ours, others):.4f}", end="\n\n")
    two_days = superposition(test.table, test.command)
    sweep = {f"24 states: first frequencies {share:+.1%}": test.error(detuned(two_days, share)) for share in DETUNING}
    print(causes_table({**causes(test), **sweep}).text(), end="\n\n")
    tests: tuple[tuple[Rig, Method], ...] = (
        (test.table, "welch"),
        (test.command, "welch"),
        (test.command, "local_rational"),
    )
    for command, method in tests:
        errors = estimated(test, test.table, command, method)
        rigs = "A1's rig for both" if command is test.table else "A1's and A2's rig"
        spread = f"{min(errors):.3f} to {max(errors):.3f}, median {np.median(errors):.3f}"
        print(f"{rigs}, identified from tests of 300 s, {method}, {SEEDS} seeds: {spread}")
    consistent, superposed = other_controllers(test).T
    print(
        f"{len(consistent)} other controllers: consistent {consistent.min():.3f} to {consistent.max():.3f}, superposed "
        f"{superposed.min():.3f} to {superposed.max():.3f}, difference {(superposed - consistent).min():+.3f} to "
        f"{(superposed - consistent).max():+.3f}"
    )
    sizes = [np.std(values, axis=0) for values in (*test.parts(two_days), test.run(two_days)[0])]
    for name, shaken, pushed, together in zip(two_days.outputs, *sizes, strict=True):
        print(
            f"{name}: rms of the table part {shaken / together:.2f} times the sum's, of the command part "
            f"{pushed / together:.2f}"
        )
    shown = {
        "consistent": test.rig.model,
        "A1's and A2's rig": two_days,
        "first frequencies +2 %": detuned(two_days, 0.02),
    }
    for name, figure in (
        ("cells", cells_figure(found["cells"])),
        ("parts", parts_figure(test, two_days)),
        ("mode_1", mode_1_figure(test, shown, list(sweep.values()))),
    ):
        save_figure(figure, FIGURES / f"papers_simulation_{name}.png")


if __name__ == "__main__":
    main()
