# SPDX-License-Identifier: Apache-2.0
"""How `plot`, `bode`, `step` and `compare` draw; registered when a name of `abrace` is used."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import several
from abrace_core import AbraceError
from abrace_core.figures.chart import Chart, Panel, beside, gains, time_histories, with_unit
from abrace_core.model.linear_model import LinearModel, pole_table
from abrace_core.model.plotted import draws
from abrace_core.model.run import Run
from abrace_plant.records.record import Record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import AnyTest


@draws(Run)
def _of_run(run: Run, channels: Sequence[str] = ()) -> Figure:
    names = several(channels) or run.all_names
    columns = zip(names, run.channels(names).T, strict=True)
    return time_histories(run.time, {name: (column, run.unit(name)) for name, column in columns}, run.source).figure()


@draws(Record)
def _of_record(record: Record) -> Figure:
    return time_histories(record.time, {"acceleration": (record.acceleration, "m/s^2")}, record.name).figure()


@draws(LinearModel)
def _of_model(model: LinearModel, *given: Any) -> Figure:
    frequency, response, shown = _response(model, *given)
    return gains(frequency, response, shown.outputs, shown.inputs, _units(shown)).figure()


@draws(LinearModel, "bode")
def _bode(model: LinearModel, *given: Any) -> Figure:
    frequency, response, shown = _response(model, *given)
    chart, units = gains(frequency, response, shown.outputs, shown.inputs, _units(shown)), _units(shown)
    names = [with_unit(name, units) for name in shown.outputs]
    angles = np.degrees(np.unwrap(np.angle(response), axis=0))
    phases = tuple(
        Panel(
            beside(frequency, dict(zip(names, angles[:, :, j].T, strict=True))),
            "",
            "frequency [Hz]",
            "phase [deg]",
            "x",
        )
        for j in range(len(shown.inputs))
    )
    return Chart(
        (tuple(replace(each, x_label="") for each in chart.rows[0]), phases), (chart.size[0], 2 * chart.size[1])
    ).figure()


@draws(LinearModel, "step")
def _step(model: LinearModel, outputs: Sequence[str] | None, inputs: Sequence[str] | None, duration: float) -> Figure:
    import control

    shown = model.select(outputs, inputs)
    found = control.step_response(shown.to_control(), duration or None, squeeze=False)
    units = _units(shown)
    names = [with_unit(name, units) for name in shown.outputs]
    panels = tuple(
        Panel(
            beside(found.time, dict(zip(names, found.outputs[:, j], strict=True))),
            f"from {with_unit(name, units)}",
            "time [s]",
            "step response" if units else "step response [SI units]",
        )
        for j, name in enumerate(shown.inputs)
    )
    return Chart((panels,), (1.0 + 5.0 * len(panels), 4.4)).figure()


@draws(LinearModel, "compare")
def _compare(model: LinearModel, test: AnyTest, channels: Sequence[str]) -> Figure:
    from abrace.interactive.validation import validate

    return validate(test, model).plot(channels)


def _units(model: LinearModel) -> dict[str, str]:
    """The units of all signals of a `model` that states some; empty: it is in SI units."""
    known = {name: model.unit(name) for name in (*model.inputs, *model.outputs)}
    return {name: unit for name, unit in known.items() if unit != "-"} if model.units else {}


def _response(
    model: LinearModel, outputs: Sequence[str] | None, inputs: Sequence[str] | None, band: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.complex128], LinearModel]:
    """Frequencies [Hz] over the `band`, the response there, and the model with the chosen signals."""
    shown = model.select(outputs, inputs)
    pairs = [frequency / (2 * np.pi) for frequency, _ in pole_table(model.poles)]
    low, high = band or (min(pairs, default=1.0) / 3, 3 * max(pairs, default=10.0))
    if not 0 < low < high < np.inf:
        raise AbraceError(f"band {low:g} to {high:g} Hz, expected two frequencies above 0 that rise")
    if model.sample_period:
        high = min(high, 0.5 / model.sample_period)
    frequency = np.geomspace(low, high, 2000)
    return frequency, shown.frequency_response(2 * np.pi * frequency), shown
