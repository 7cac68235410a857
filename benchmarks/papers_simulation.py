# SPDX-License-Identifier: Apache-2.0
"""The paper's own simulation, the second half of its Table 1: how much of it two unlike tests explain.

The paper simulates its controlled test by Eqs. (6) and (7), a table model and a command model side by side. A1 and A2,
as printed, are of two buildings that differ a little. Here two rigs are made whose building has the printed poles of
A1 and of A2; the table part comes from the one, the command part from the other, and both together run El Centro at
0.1 g for 100 s under the same LQG3. Beside it runs the standing rig itself, one consistent model.

`make verify PARTS=lqg` calls `papers_simulation`; what was found is in docs/measured.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import least_squares

from abrace_core.files.installed import find_file
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel, pole_table
from abrace_core.model.response import (
    TABLE_1_EXPERIMENT,
    TABLE_1_SIMULATION,
    PeakRms,
    in_paper_units,
    mean_relative_error,
    peak_rms_of,
)
from abrace_core.model.simulation import simulate_closed_loop
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig import published
from abrace_plant.rig.building import Building
from abrace_plant.rig.file import load_rig
from abrace_sysid.models.realization import realize
from abrace_sysid.paper import superpose
from abrace_sysid.spectra.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

Pairs = tuple[tuple[float, float], ...]
"""Frequency [rad/s] and damping ratio of the building's modes."""

FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 1e-6, 1e-4
"""Relative; the paper prints four or five digits of a frequency and three of a damping."""
CHANGE = 0.1
"""Relative change of one of a rig's parameters that counts as much as the tolerances: as good as none."""
TABLE_BAND, COMMAND_BAND = (0.3, 10.0), (0.3, 30.0)
"""Hz, of the paper's tests."""
SPACING = 0.01
"""Hz between the lines of an exact transfer function."""


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
        found = pole_table(changed(logarithms).model.poles)[: rig.floors]
        errors = np.log(np.array(found) / np.array(asked)) / (FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
        return np.concatenate([errors.ravel(), logarithms / CHANGE])

    return changed(least_squares(missed, np.zeros(9), x_scale=0.01).x)


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
        upper = rig.model.poles
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
