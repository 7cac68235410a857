# SPDX-License-Identifier: Apache-2.0
"""Tests simulated: of a rig as the nodes make them, or of a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, law_of, model_of, rig_or_none, takes, told_of, warn
from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.controller_file import Controller
from abrace_core.model.discretization import discretize, holds_of
from abrace_core.model.linear_model import name_and_unit_of
from abrace_core.model.noise import banded_noise
from abrace_core.model.own_law import GuardedLaw
from abrace_core.model.roles import with_roles
from abrace_core.model.run import Run
from abrace_core.model.si_units import in_si_units
from abrace_core.model.simulation import simulate as simulate_model
from abrace_core.model.simulation import simulate_closed_loop
from abrace_core.model.table_signals import table_noise
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_lqg.active_controller import ActiveController
from abrace_plant.live.simulated_run import simulated_run
from abrace_plant.records.asked import keyword
from abrace_plant.records.files import read_record
from abrace_plant.records.options import PlayedOptions, SimulateOptions, Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion
from abrace_plant.records.treatment import prepare

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from abrace.interactive.given import AnyController, AnyModel
    from abrace_core.model.linear_model import LinearModel
    from abrace_core.model.own_law import Force, Law, LawSample
    from abrace_plant.rig.model import Rig

WHITE_NOISE = "white_noise"
TABLE_NOISE: dict[str, Any] = {"band": (0.1, 10.0), "rms": 0.25}
"""[Hz] and [m/s^2], as the node `ground_motion` has them."""
COMMAND_BAND = (0.0, 30.0)
"""[Hz], as the node `excitation` has it."""
COMMAND_SHARE = 0.07
"""Rms of a white noise command over the capacity: that of the paper's test, 1.8 of 24.5 kN."""
RAMP = 0.5
"""Seconds in which the nodes that command fade a force in."""
ROUNDING = 1e-9


@takes(SimulateOptions)
def simulate(
    structure: AnyModel,
    record: Record | Run | ArrayLike | Path | str | None = None,
    *,
    controller: AnyController | Law | Callable[[LawSample], Force] | None = None,
    command: ArrayLike | str | None = None,
    **options: Any,
) -> Run:
    """Simulate a test, from rest.

    A rig is simulated as the node `plant` does it in lockstep: limits, interlocks, sensors and their noise, friction
    where it has some. A model is linear and without noise; its commands are limited to the controller's. What it
    has in other units is converted to SI units. Its inputs and outputs may have any names.

    Parameters
    ----------
    structure
        A rig (its name, its file), or a model (its file, an identification, a StateSpace of python-control).
    record
        The motion of the table: a known name, a file, a Record, a Run whose table is played again, (samples,) [m/s^2]
        at the sample rate, "white_noise" (0.1 to 10 Hz, 0.25 m/s^2); None: at rest. Of a model of other names:
        (samples,) of what disturbs, in its SI unit; if it is an acceleration also as above.
    controller
        A controller, its file, a design, a discrete StateSpace of python-control from measured quantities to commands
        (its forces limited to the capacity); of a rig also a law of one's own (`abrace_core.model.own_law`), or a
        function from its `LawSample` to forces [N].
    command
        Instead of a controller: (samples,) or (samples, commands) [N] of one brace, or "white_noise" (to 30 Hz,
        7 % of the capacity, which a model has from its tests); None: zero.
    **options
        As `SimulateOptions` has them.

    Returns
    -------
    Run
        As from a bag. A rig that was stopped by a fault (`run.stopped`) is a Python warning with the cause, a clipped
        sensor one with its samples. Channels that a model of a rig does not have are not in the run; a
        model of other names, or of measured data, has its own.

    Raises
    ------
    AbraceError
        If record, controller and structure do not fit each other, or the record is more than the rig's table has.
    """
    if controller is not None and command is not None:
        raise AbraceError("simulate: controller and command, expected one of them")
    if isinstance(controller, type):
        raise AbraceError(f"simulate: controller {controller.__name__} is a class, expected {controller.__name__}(...)")
    checked = SimulateOptions.of(options)
    rig, law = rig_or_none(structure), law_of(controller)
    if rig is not None:
        fixed = 1 / rig.sample_rate
    else:
        model = model_of(structure)
        fixed = model.sample_period
    capacity = rig.capacity if rig is not None else np.array(model.provenance.get("force_limit", []))
    if rig is None:
        acting = () if controller is None or law else controller_of(controller, capacity).law.outputs
        model = _with_roles(model, acting, checked.disturbance, record is None)
    elif checked.disturbance:
        raise AbraceError(f"simulate: disturbance {checked.disturbance!r} of a rig, which is moved by its table")
    period = _period(fixed, checked.sample_period) or _sample_period(model, None if law else controller, capacity)
    ground, name = _ground(record, 1 / period, checked)
    if rig is None and ground is not None:
        _require_acceleration(record, model)
    groups = rig.groups if rig is not None else len(model.inputs) - 1
    forces = _commands(command, 1 / period, checked.duration, groups, checked.seed, COMMAND_SHARE * capacity)
    if ground is None and forces is None:
        raise AbraceError("simulate: neither record nor command, expected at least one")
    samples = max(len(each) for each in (ground, forces) if each is not None)
    ground, forces = _padded(ground, (samples,)), _padded(forces, (samples, groups))
    if rig is None:
        if law is not None:
            raise AbraceError("simulate: a law of your own and a model, expected a rig")
        given = None if controller is None else controller_of(controller, capacity)
        run = _of_model(model, ground, forces, given, period, name)
    else:
        if ground.any():
            check_motion(ground, rig.sample_rate, rig.table, name, RECORD_REMEDIES)
        force, case = (lambda k, *_: forces[k].tolist()), f"{rig.name}/{name}"
        if controller is not None:
            force, called = _answer(rig, controller_of(controller, capacity) if law is None else law)
            case = f"{case}/{called}"
        run = simulated_run(rig, ground, force, checked.seed, case)
    warn(told_of(run) if rig is not None else run.facts.get("warnings", []))
    return run


def _period(fixed: float, given: float) -> float:
    """The sample period that a rig or a sampled model has (`fixed`, 0: none), or that is given; 0: neither [s]."""
    if given and fixed and abs(given / fixed - 1) > ROUNDING:
        raise AbraceError(f"simulate: sample_period {given!r}, expected {fixed:g} s")
    return fixed or given


def _sample_period(model: LinearModel, controller: Any, capacity: NDArray[np.float64]) -> float:
    """The sample period of the controller, or of the tests that the model was identified from [s]."""
    if controller is not None:
        return controller_of(controller, capacity).rig_period
    found = model.provenance.get("sample_period")
    if not found:
        raise AbraceError("simulate: the sample period of this model is not known, expected sample_period in s")
    return float(found)


def _ground(record: Any, rate: float, asked: SimulateOptions) -> tuple[NDArray[np.float64] | None, str]:
    """The motion of the table (samples,) [m/s^2], and its name."""
    if record is None:
        return None, "command"
    treated = set(PlayedOptions.model_fields)
    of_file = {"unit", "record_sample_period", "channel"} & asked.model_fields_set
    if of_file and not (isinstance(record, (str, Path)) and record != WHITE_NOISE):
        raise AbraceError(f"simulate: {', '.join(sorted(of_file))} of {type(record).__name__}, expected of a file")
    if isinstance(record, str) and record == WHITE_NOISE:
        if asked.model_fields_set & treated:
            raise AbraceError(f"simulate: a treatment of {WHITE_NOISE!r}, expected only duration and seed")
        return table_noise(round(asked.duration * rate), rate, **TABLE_NOISE, seed=asked.seed + 1), WHITE_NOISE
    treatment = Treatment(**asked.model_dump(include={*treated, "duration"}))
    if not isinstance(record, (Record, str, Path)) and "band_limit" not in asked.model_fields_set:
        treatment = treatment.model_copy(
            update={"band_limit": 0.0}
        )  # it was played before, or is as the table is to move
    if isinstance(record, Run):
        motion = Record(record.source, record.sample_period, record.ground_acceleration)
    elif isinstance(record, Record):
        motion = record
    elif isinstance(record, (str, Path)):
        motion = read_record(
            record, asked.unit or None, asked.record_sample_period or None, asked.channel or None, _way
        )
    else:
        motion = Record("motion", 1 / rate, _numbers(record, "record"))
    return prepare(motion, rate, treatment), motion.name


def _way(name: str, value: str) -> str:
    """How an argument of `simulate` is given: it calls the sample period of a record otherwise."""
    return keyword("record_sample_period" if name == "sample_period" else name, value)


def _numbers(given: Any, what: str) -> NDArray[np.float64]:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise AbraceError(f"simulate: {what} {given!r:.60}: expected numbers ({error})") from error


def _commands(
    command: ArrayLike | str | None,
    rate: float,
    duration: float,
    groups: int,
    seed: int,
    rms: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """(samples, groups) [N]; `rms` (groups,) [N] of white noise, empty if it is not known."""
    if command is None:
        return None
    if isinstance(command, str):
        if command != WHITE_NOISE:
            raise AbraceError(f"simulate: command {command!r}, expected an array or {WHITE_NOISE!r}")
        if len(rms) != groups:
            raise AbraceError(
                f"simulate: command {WHITE_NOISE!r} to a model without force_limit, expected an array in N"
            )
        samples = round(duration * rate)
        each = [banded_noise(samples, rate, COMMAND_BAND, float(rms[j]), seed + 2 + j) for j in range(groups)]
        return np.column_stack(each)
    forces = _numbers(command, "command")
    forces = forces[:, None] if forces.ndim == 1 else forces
    if forces.ndim != 2 or forces.shape[1] != groups or not len(forces):
        raise AbraceError(f"simulate: command of shape {forces.shape}, expected (samples, {groups})")
    if not np.isfinite(forces).all():
        raise AbraceError("simulate: a command that is not finite, expected forces in N")
    samples = round(duration * rate) or len(forces)
    return _padded(forces[:samples], (samples, groups))


def _padded(values: NDArray[np.float64] | None, shape: tuple[int, ...]) -> NDArray[np.float64]:
    padded = np.zeros(shape)
    if values is not None:
        padded[: len(values)] = values
    return padded


def _answer(rig: Rig, given: Controller | Law) -> tuple[Callable[[int, list[float], list[float]], list[float]], str]:
    """The controller as its node runs it: forces fade in, and pass the limits; and its name."""
    period, floors, groups = 1 / rig.sample_rate, rig.floors, rig.groups
    if not isinstance(given, Controller):
        limit, law = rig.capacity, GuardedLaw(given, period, RAMP)
        law.begin(floors, groups)
        active = None
    else:
        if missing := [
            name for name in given.law.inputs if name in rig.model.outputs and name not in rig.recorded_names
        ]:
            raise AbraceError(
                f"controller {given.name}: measures {', '.join(missing)}, expected some of what rig {rig.name} "
                f"measures, {', '.join(rig.recorded_names)}"
            )
        limit, active = given.force_limit, ActiveController(given, RAMP, period)
        active.reset(signals.response_names(floors, groups), signals.command_names(groups), np.zeros(groups))
    guard = CommandGuard(limit, rig.rate_limit.tolist(), period, RAMP_TIME)

    def force(number: int, z: list[float], applied: list[float]) -> list[float]:
        if active is None:
            guard.follow(law.force(number, z, applied, 0))
        else:
            active.require_finite(number, z)
            guard.follow(active.force(z, 0).tolist())
            active.advance(guard.value)
        return guard.value

    return force, given.name if isinstance(given, Controller) else type(given).__name__


def _is_of_rig(model: LinearModel) -> bool:
    """Whether all signals of a `model` have the names of a rig's, and it was not identified from columns of data."""
    inputs, outputs = ({name_and_unit_of(name)[0] for name in names} for names in (model.inputs, model.outputs))
    known = {signals.GROUND, *signals.command_names(len(inputs) - 1)} if inputs else {""}
    return inputs == known and all(signals.is_recorded(name) for name in outputs) and "data" not in model.provenance


def _with_roles(model: LinearModel, commands: Sequence[str], disturbance: str, at_rest: bool) -> LinearModel:
    """The model in SI units from the disturbance and the commands; at rest any input may be the first."""
    if _is_of_rig(model) and not disturbance:
        groups = signals.command_names(len(model.inputs) - 1)
        model = with_roles(model, groups)
    else:
        nothing = model.inputs[0] if at_rest and not commands and signals.GROUND not in model.inputs else ""
        model = with_roles(model, commands or (model.inputs if nothing else ()), disturbance or nothing)
    return in_si_units(model)


def _require_acceleration(record: Any, model: LinearModel) -> None:
    """Refuse that a motion of the ground drives an input that is known to be something else."""
    name = model.inputs[0]
    unit = model.unit(name)
    if isinstance(record, (Record, Run, str, Path)) and unit not in ("-", signals.unit(signals.GROUND)):
        raise AbraceError(f"simulate: record of an acceleration for {name} [{unit}], expected (samples,) in {unit}")


def _of_model(
    model: LinearModel,
    ground: NDArray[np.float64],
    forces: NDArray[np.float64],
    given: Controller | None,
    period: float,
    name: str,
) -> Run:
    groups = len(model.inputs) - 1
    sampled = model if model.sample_period else discretize(model, period, holds_of(model))
    if given is None:
        outputs = simulate_model(sampled, np.column_stack([ground, forces]))
        command = np.vstack([np.zeros((1, groups)), forces[:-1]])
    else:
        outputs, command = simulate_closed_loop(sampled, given.law, ground, given.force_limit, given.correction)
    sequence = np.arange(len(ground), dtype=np.uint64)
    source = f"model/{name}"
    facts: dict[str, Any] = {"sample_period": repr(period), "rig": str(model.provenance.get("rig", ""))}
    if not _is_of_rig(model):
        named = (*model.outputs, *model.inputs)
        return Run(
            source, period, sequence, 0, groups, outputs, ground, command, facts, signals=named, units=model.units
        )
    floors = max((int(each[1:]) for each in model.outputs if each[0] in "xa" and each[1:].isdigit()), default=0)
    names = signals.response_names(floors, groups)
    outputs = outputs[:, [model.outputs.index(each) for each in names if each in model.outputs]]
    without = tuple(each for each in names if each not in model.outputs)
    return Run(source, period, sequence, floors, groups, outputs, ground, command, facts, without=without)
