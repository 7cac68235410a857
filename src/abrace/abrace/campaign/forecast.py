# SPDX-License-Identifier: Apache-2.0
"""Predicted peaks of tests against the limits of sensors, interlocks, table and braces, by the rig file's linear model.

A test with a controller is predicted in closed loop: with the controller's file, or, if the campaign has yet to
identify the model, with a design on the rig's own model. A user's node cannot be simulated: its test is predicted with
zero command.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import cycle, pairwise
from typing import TYPE_CHECKING

import numpy as np

from abrace.campaign.names import CONTROLLER_FILE, MODEL_FILE, is_path
from abrace.campaign.tasks import Design, OwnController
from abrace.report.result import worse_than_none
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.controller_file import load_controller
from abrace_core.model.linear_model import load_model
from abrace_core.model.response import PeakRms
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_core.model.verdict import judged
from abrace_core.safety.table_guard import TableGuard
from abrace_lqg.design import design
from abrace_lqg.proof.checks import prove, require
from abrace_lqg.proof.limits import of_rig, rig_period_of
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import load_weights
from abrace_plant.records.table_motion import table_demands
from abrace_plant.rig.detectors import detectors
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.limits import group_limits, limit_table
from abrace_plant.rig.sensors import Measurement, OverRange, parse_fault

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from abrace.campaign.check import CheckedCampaign
    from abrace.campaign.laboratory import Laboratory
    from abrace.campaign.tasks import RigTest
    from abrace_core.model.linear_model import LinearModel
    from abrace_core.safety.table_stop import Table
    from abrace_plant.rig.model import Interlock, Rig

    Law = tuple[LinearModel, NDArray[np.float64]]

UNITS = {"table": "", "drift": "m", "displacement": "m", "acceleration": "m/s^2", "stroke": "m", "force": "N"}
"""Units of the predicted quantities; the table's quantity is the one nearest to its limit, with its own unit."""
COMMAND = "command"


@dataclass(frozen=True)
class Peak:
    """The greatest value of one kind of quantity, of the signal `name`, and its limit.

    `of`: "sensor range", "interlock", "table" or "force limit".
    """

    name: str
    value: float
    limit: float
    unit: str
    of: str

    @property
    def share(self) -> float:
        """The value as a share of the limit."""
        return self.value / self.limit


@dataclass(frozen=True)
class Forecast:
    """The predicted peaks of a test by kind, those of UNITS and "command"; a note on what the prediction leaves out.

    `problems`: the interlock that stops the rig, a controller that makes the motion worse.
    """

    peaks: dict[str, Peak]
    note: str = ""
    problems: tuple[str, ...] = ()

    def cares(self) -> Iterator[str]:
        """The problems, and the peaks beyond their limits."""
        yield from self.problems
        for kind, peak in self.peaks.items():
            if kind == COMMAND and not peak.share < 1:
                yield f"command {peak.name} reaches its limit of {peak.limit:.4g} N ({peak.of})"
            elif judged(peak.share, 1.0):
                yield (
                    f"{kind} {peak.name} {peak.value:.3g} {peak.unit} as predicted, more than {peak.limit:.3g} "
                    f"{peak.unit} ({peak.of})"
                )


@dataclass(frozen=True)
class _Designed:
    """A tried design: its law, whether its model exists already, and why the design is refused."""

    law: Law | None
    known: bool
    refusal: str


class _Prepared:
    """A rig with some braces disconnected, its discrete model, and the limits of its signals."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.model = rig.discrete_model()
        noise = detectors(rig).noise
        interlocks = limit_table(rig, noise)
        self.limits = {
            kind: [_limit(kind, rig, interlocks.get(kind))] for kind in UNITS if kind not in ("table", "force")
        }
        force = interlocks.get("force")
        values = group_limits(rig, force, noise.get("force", 0.0)).tolist() if force else []
        of_groups = [replace(force, value=value) for value in values] if force else [None]
        self.limits["force"] = [_limit("force", rig, one) for one in of_groups]
        """By kind: the limit of each of its signals, or one that holds for all."""


class Forecaster:
    """Predicts the tests of a campaign."""

    def __init__(self, checked: CheckedCampaign) -> None:
        self._checked = checked
        self._prepared: dict[tuple[int, tuple[int, ...]], _Prepared] = {}
        self._designed = {
            name: self._design(task) for name, task in checked.campaign.tasks.items() if isinstance(task, Design)
        }
        self._forecasts = {name: self._forecast(test) for name, test in checked.campaign.tests.items()}

    def refusals(self) -> list[str]:
        """Designs that are refused on a model that exists already: a line each."""
        refused = {name: one.refusal for name, one in self._designed.items() if one.known and one.refusal}
        return [f"step {name}: {refusal}" for name, refusal in refused.items()]

    def cares(self) -> list[str]:
        """Predicted problems that are no reason to refuse the campaign: a line for each, with its step."""
        found = [
            f"step {name}: {one.refusal}, as predicted with the model of the rig file"
            for name, one in self._designed.items()
            if one.refusal and not one.known
        ]
        for name, forecast in self._forecasts.items():
            found += [f"step {name}: {care}" for care in forecast.cares()]
        return found

    def of(self, test: str) -> Forecast:
        """The forecast of the `test` of this name."""
        return self._forecasts[test]

    def _forecast(self, test: RigTest) -> Forecast:
        laboratory = self._checked.laboratories.of(test)
        prepared, signals = self._prepare(laboratory, test.disconnected_braces), self._checked.signals
        rig, model = prepared.rig, prepared.model
        samples = round(test.duration * rig.sample_rate)
        ground, commands = np.zeros(samples), np.zeros((samples, rig.groups))
        if test.ground_motion is not None:
            motion = signals.motion(test.ground_motion, test.duration, laboratory)[:samples]
            ground[: len(motion)] = motion
        limits = np.array(test.force_limit or rig.capacity)
        if test.excitation is not None:
            asked = signals.excitation(test.excitation, test.duration, laboratory)[:samples]
            commands[: len(asked)] = np.clip(asked, -limits, limits)
        note, law = "", None
        if isinstance(test.controller, OwnController):
            note = "with zero command: a node of your own is not simulated"
        elif test.controller is not None:
            law, note = self._law(test.controller, laboratory)
        outputs, problems = simulate(model, np.column_stack([ground, commands])), []
        commands = np.vstack([np.zeros((1, rig.groups)), commands[:-1]])  # in force until each sample
        if law is not None:
            without = _floors(outputs, rig)
            outputs, commands = simulate_closed_loop(model, law[0], ground, limits, law[1])
            if worse := worse_than_none(without, _floors(outputs, rig)):
                problems.append(f"{test.controller_name} makes the motion worse than no control, as predicted: {worse}")
        if stop := _stop(rig, ground, outputs, commands, test.sensor_faults):
            problems.insert(0, stop)
        found = _table_peak(ground, rig) if test.ground_motion is not None else {}
        found |= _response_peaks(dict(zip(model.outputs, outputs.T, strict=True)), rig.floors, prepared.limits)
        if np.any(commands):
            group = int(np.argmax(np.abs(commands).max(axis=0) / limits))
            greatest = float(np.abs(commands[:, group]).max())
            name = model.inputs[1 + group]
            found[COMMAND] = Peak(name, greatest, float(limits[group]), "N", "force limit")
        return Forecast(found, note, tuple(problems))

    def _prepare(self, laboratory: Laboratory, disconnected: tuple[int, ...]) -> _Prepared:
        key = id(laboratory), disconnected
        if key not in self._prepared:
            self._prepared[key] = _Prepared(laboratory.rig.disconnect(disconnected))
        return self._prepared[key]

    def _law(self, controller: str, laboratory: Laboratory) -> tuple[Law | None, str]:
        """A controller's law and correction, and a note on the prediction with it."""
        if controller.endswith(CONTROLLER_FILE):
            read = load_controller(controller)
            return (read.law, read.correction), ""
        designed = self._designed[controller]
        if designed.law is None:
            return None, "with zero command: no controller can be designed on the rig's own model"
        if designed.law[0].outputs != laboratory.rig.model.inputs[1:]:
            return None, f"with zero command: {controller} is for another rig"
        return designed.law, "" if designed.known else f"{controller} as designed on the rig's own model"

    def _design(self, task: Design) -> _Designed:
        """A design on its model if that exists already, otherwise on the rig's own."""
        rig = self._checked.laboratories.behind(task)[0].rig
        known, law, refusal = is_path(task.model), None, ""
        file = task.model if task.model.endswith(MODEL_FILE) else f"{task.model}/reduced{MODEL_FILE}"
        try:
            model = task.for_control(load_model(file) if known else rig.measured_model)
            options = of_rig(task, rig.sample_rate, rig.capacity).of_model(model)
            excitation = options.excitation(model)
            weights = load_weights(find_file(task.weights, "abrace_lqg", "config", ".yaml", "weights"))
            period, rig_period = options.sample_period, rig_period_of(model, options.sample_period)
            weights = scaled_weights(model, weights, period, options.force_limit, excitation, rig_period)
            designed = design(model, weights, period, rig_period)
            law = designed.controller, designed.correction
            require(prove(designed, {"the model": model}, excitation, options.limits), options.accept)
        except AbraceError as error:
            refusal = str(error)
        return _Designed(law, known, refusal)


def _floors(outputs: NDArray[np.float64], rig: Rig) -> dict[str, PeakRms]:
    """Peak and rms of each floor's displacement."""
    floors = outputs[:, : rig.floors]
    peaks, rms = np.abs(floors).max(axis=0).tolist(), np.sqrt((floors**2).mean(axis=0)).tolist()
    return {f"x{i}": PeakRms(*both) for i, both in enumerate(zip(peaks, rms, strict=True), 1)}


def _stop(
    rig: Rig,
    ground: NDArray[np.float64],
    outputs: NDArray[np.float64],
    commands: NDArray[np.float64],
    faults: Sequence[str],
) -> str:
    """When the rig is stopped and by which interlock, its sensors and their `faults` included; empty: it is not."""
    period, sensors, names = 1 / rig.sample_rate, rig.channel_sensors, rig.channel_names
    measurement, over_range = Measurement(sensors, 1, period), OverRange(sensors)
    measurement.faults = tuple(parse_fault(text, names, period) for text in faults)
    readings = measurement.record(rig.readings_of(outputs, ground))
    clipped = (readings > over_range.highest) | (readings < over_range.lowest)
    places = _places(rig.table, period, ground.tobytes())
    found = Interlocks(rig).first_trip(np.column_stack([readings, commands, places]), clipped)
    return f"the rig stops after {found[0] * period:.2f} s, as predicted: {found[1]}" if found else ""


@lru_cache(maxsize=16)
def _places(table: Table, period: float, ground: bytes) -> NDArray[np.float64]:
    """(samples, 2) where a table with this motion could stop at the earliest, and its velocity."""
    guard, found = TableGuard(table, period), []
    for acceleration in np.frombuffer(ground).tolist():
        guard.follow([acceleration])
        found.append((guard.turning_point, guard.state.velocity))
    return np.array(found)


def _table_peak(ground: NDArray[np.float64], rig: Rig) -> dict[str, Peak]:
    """The table's quantity that is nearest to its limit."""
    demands = table_demands(ground, rig.sample_rate, rig.table)[:-1]
    worst = max(demands, key=lambda demand: demand.value / demand.limit)
    return {"table": Peak(worst.name, worst.value, worst.limit, worst.unit, "table")}


def _response_peaks(
    outputs: dict[str, NDArray[np.float64]], count: int, limits: dict[str, list[tuple[float, str]]]
) -> dict[str, Peak]:
    """The peak of each kind of response that is nearest to its limit; `count`: the number of floors."""
    greatest = {name: float(np.abs(values).max()) for name, values in outputs.items()}
    floors = [np.zeros(1), *(outputs[f"x{i + 1}"] for i in range(count))]
    drifts = {f"of storey {i}": float(np.abs(b - a).max()) for i, (a, b) in enumerate(pairwise(floors), 1)}
    of_kind = {
        "drift": drifts,
        "displacement": {name: value for name, value in greatest.items() if name[0] == "x" and name[1] != "f"},
        "acceleration": {name: value for name, value in greatest.items() if name[0] == "a"},
        "stroke": {name: value for name, value in greatest.items() if name.startswith("xf")},
        "force": {name: value for name, value in greatest.items() if name[0] == "f"},
    }
    found = {}
    for kind, values in of_kind.items():
        if values:
            peaks = [
                Peak(name, value, limit, UNITS[kind], of)
                for (name, value), (limit, of) in zip(values.items(), cycle(limits[kind]), strict=False)
            ]
            found[kind] = max(peaks, key=lambda peak: peak.share)
    return found


def _limit(kind: str, rig: Rig, interlock: Interlock | None) -> tuple[float, str]:
    """The least of a sensor's range and the interlock, if that stops the rig, and which of the two it is."""
    limits = [(interlock.value, "interlock")] if interlock and interlock.action == "stop" else []
    if sensor := getattr(rig.sensors, kind, None):
        limits.append((sensor.range, "sensor range"))
    return min(limits, default=(np.inf, "no limit"))
