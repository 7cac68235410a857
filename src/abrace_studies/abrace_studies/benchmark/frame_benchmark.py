# SPDX-License-Identifier: Apache-2.0
"""A benchmark on a building of plane frames: its model, its runs with and without control, and what they give."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.discretization import discretize
from abrace_core.model.simulation import simulate
from abrace_lqg.design import tustin
from abrace_plant.records.files import read_record
from abrace_studies.benchmark.criteria import Layout, Responses, criteria, peaks
from abrace_studies.benchmark.definition import check_case_names, record_path
from abrace_studies.benchmark.sampled_loop import Converter, run_loops
from abrace_studies.frames.file import load_frame
from abrace_studies.frames.model import building_model
from abrace_sysid.models.reduction import Scales, balanced_truncation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.benchmark.definition import Case, Definition


class FrameBenchmark:
    """A benchmark of frames as its file defines it.

    Raises
    ------
    AbraceError
        If the frame file is missing or wrong, the devices do not fit it, or two cases have one name.
    """

    def __init__(self, definition: Definition) -> None:
        check_case_names(definition)
        self.definition = definition
        self._uncontrolled: dict[str, Mapping[str, float]] = {}
        self.building = load_frame(find_file(definition.frame, "abrace_studies", "frames", ".yaml", "frame"))
        devices, levels = definition.devices.per_storey, len(self.building.levels)
        if len(devices) != levels:
            raise AbraceError(
                f"benchmark {definition.name}: devices.per_storey: {len(devices)} numbers, "
                f"expected one for each of {levels} storeys"
            )
        storeys = tuple(storey for storey, count in enumerate(devices, 1) if count)
        self.layout = Layout(
            self.building.masses,
            self.building.heights,
            storeys,
            tuple(devices[storey - 1] for storey in storeys),
            (1.0,) * len(storeys),
        )

    @cached_property
    def model(self) -> LinearModel:
        """The continuous model with every mode that ground and devices excite (`building_model`)."""
        return building_model(self.building, self.definition.devices.per_storey)

    @cached_property
    def plant(self) -> LinearModel:
        """The exact discrete model: commands held, the ground's acceleration on straight lines."""
        return discretize(self.model, self.definition.sample_period)

    @cached_property
    def newmark(self) -> LinearModel:
        """The discrete model of Newmark's constant mean acceleration (1/4, 1/2), which is Tustin's transformation."""
        return tustin(self.model, self.definition.sample_period)

    @cached_property
    def design_model(self) -> LinearModel:
        """The model that controllers are designed on: balanced between ground and accelerations, and truncated."""
        named = [name for name in self.model.outputs if name[0] in "xa"]
        model = self.model.select(named)
        scales = Scales(
            np.array([1.0, *[0.0] * (len(model.inputs) - 1)]),
            np.array([1.0 if name[0] == "a" else np.inf for name in named]),
        )
        return balanced_truncation(model, self.definition.design_states, scales).model

    def ground(self, case: Case) -> NDArray[np.float64]:
        """(samples,) acceleration of the ground in a `case` [m/s^2]: straight between samples, then zero."""
        record = read_record(record_path(case.record))
        period, duration = self.definition.sample_period, self.definition.duration
        time = np.arange(round(duration / period) + 1) * period
        return case.intensity * np.interp(time, record.time, record.acceleration, right=0.0)

    def responses(self, outputs: NDArray[np.float64], force: NDArray[np.float64]) -> Responses:
        """What the model's `outputs` (samples, outputs) are, with one device's `force` (samples, commands)."""
        levels = len(self.building.levels)
        x, v, a, c = np.split(outputs, [levels, 2 * levels, 3 * levels], axis=1)
        return Responses(self.definition.sample_period, x, v, a, force, c if c.shape[1] else None)

    def without_control(self, case: Case, model: LinearModel | None = None) -> Responses:
        """A run of a `case` without control, of the exact discrete model or of another `model` (`newmark`)."""
        model = (model or self.plant).select(inputs=self.model.inputs[:1])
        outputs = simulate(model, self.ground(case)[:, None])
        return self.responses(outputs, np.zeros((len(outputs), len(self.layout.storeys))))

    def uncontrolled(self, case: Case) -> Mapping[str, float]:
        """Reference values of a `case`'s criteria: from its file, else from a run of our own."""
        if case.name not in self._uncontrolled:
            self._uncontrolled[case.name] = case.uncontrolled or peaks(self.without_control(case), self.layout)
        return self._uncontrolled[case.name]

    def evaluate(self, controller: Controller) -> dict[str, dict[str, float]]:
        """Criteria with a `controller`, whose commands are the forces of one device, by case.

        Raises
        ------
        AbraceError
            If controller and building do not fit each other, or a record is missing.
        """
        cases, sensors, devices = self.definition.cases, self.definition.sensors, self.definition.devices
        states, inputs = run_loops(
            self.plant,
            controller,
            np.column_stack([self.ground(case) for case in cases]),
            Converter(sensors.range, sensors.bits),
            Converter(devices.capacity, sensors.bits),
        )
        found = {}
        for case, state, given in zip(cases, states, inputs, strict=True):
            if not np.isfinite(state).all():
                raise AbraceError(f"benchmark {self.definition.name}: {case.name}: the loop is not stable")
            responses = self.responses(state @ self.plant.c.T + given @ self.plant.d.T, given[:, 1:])
            law = controller.law
            found[case.name] = criteria(responses, self.layout, self.uncontrolled(case), len(law.inputs), law.order)
        return found
