# SPDX-License-Identifier: Apache-2.0
"""A benchmark on a rig: its linear model under recorded earthquakes.

Responses of a controller are those of the rig's linear model, exact, with the timing and the saturation of the graph.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.discretization import discretize
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_plant.records.files import read_record
from abrace_plant.records.options import BAND_LIMIT, Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig
from abrace_studies.benchmark.criteria import Layout, Responses, criteria, peaks
from abrace_studies.benchmark.definition import check_case_names, record_path

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.benchmark.definition import RigCase, RigDefinition


class RigBenchmark:
    """A benchmark of a rig as its file defines it.

    Raises
    ------
    AbraceError
        If the rig file is missing or wrong, or two cases have one name.
    """

    def __init__(self, definition: RigDefinition) -> None:
        check_case_names(definition)
        self.definition = definition
        self._uncontrolled: dict[str, dict[str, float]] = {}
        self.rig = load_rig(find_file(definition.rig, "abrace_plant", "config", ".yaml", "rig"))
        braces = self.rig.braces
        self.layout = Layout(
            self.rig.building.masses,
            self.rig.storey_heights,
            tuple(group.floor for group in braces),
            tuple(group.count for group in braces),
            tuple(group.cosine for group in braces),
        )

    @cached_property
    def model(self) -> LinearModel:
        """The rig's continuous model, velocities `v1` ... of the floors relative to the table among its outputs."""
        model, floors = self.rig.model, self.rig.floors
        rates = np.zeros((floors, model.order))
        first = floors + len(self.rig.local_modes)
        rates[:, first : first + floors] = np.eye(floors)
        return replace(
            model,
            c=np.vstack([model.c, rates]),
            d=np.vstack([model.d, np.zeros((floors, len(model.inputs)))]),
            outputs=(*model.outputs, *(f"v{i + 1}" for i in range(floors))),
        )

    @cached_property
    def plant(self) -> LinearModel:
        """The exact discrete model at the rig's rate."""
        return discretize(self.model, 1 / self.rig.sample_rate)

    @property
    def design_model(self) -> LinearModel:
        """What controllers are designed on: the rig's own model."""
        return self.rig.model

    def ground(self, case: RigCase) -> NDArray[np.float64]:
        """(samples,) acceleration of the table in a `case` [m/s^2], treated as the node `ground_motion` does it."""
        treatment = Treatment(
            peak_acceleration=case.peak_acceleration, duration=self.definition.duration, band_limit=BAND_LIMIT
        )
        return prepare(read_record(record_path(case.record)), self.rig.sample_rate, treatment)

    def _responses(self, outputs: NDArray[np.float64]) -> Responses:
        named = dict(zip(self.plant.outputs, outputs.T, strict=True))
        floors, groups = range(1, self.rig.floors + 1), self.rig.model.outputs[2 * self.rig.floors + self.rig.groups :]
        x, v, a = (np.column_stack([named[f"{kind}{i}"] for i in floors]) for kind in "xva")
        force = np.column_stack([named[name] for name in groups])
        return Responses(self.plant.sample_period, x, v, a, force)

    def without_control(self, case: RigCase) -> Responses:
        """A run of a `case` with zero command: the braces have the forces that their servos leave."""
        inputs = np.zeros((len(ground := self.ground(case)), len(self.plant.inputs)))
        inputs[:, 0] = ground
        return self._responses(simulate(self.plant, inputs))

    def evaluate(self, controller: Controller) -> dict[str, dict[str, float]]:
        """Criteria with a `controller`, by the name of each case."""
        found = {}
        for case in self.definition.cases:
            outputs, _ = simulate_closed_loop(
                self.plant, controller.law, self.ground(case), controller.force_limit, controller.correction
            )
            if not np.isfinite(outputs).all():
                raise AbraceError(f"benchmark {self.definition.name}: {case.name}: the loop is not stable")
            responses = self._responses(outputs)
            law = controller.law
            found[case.name] = criteria(responses, self.layout, self.uncontrolled(case), len(law.inputs), law.order)
        return found

    def uncontrolled(self, case: RigCase) -> Mapping[str, float]:
        """What a `case`'s criteria are divided by: a run with zero command."""
        if case.name not in self._uncontrolled:
            self._uncontrolled[case.name] = peaks(self.without_control(case), self.layout)
        return self._uncontrolled[case.name]
