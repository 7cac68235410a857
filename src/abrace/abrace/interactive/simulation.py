# SPDX-License-Identifier: Apache-2.0
"""Tests simulated: of a rig as the nodes make them, or of a model."""

from __future__ import annotations

from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, model_of, rig_of, warn
from abrace_core import signals
from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.noise import banded_noise
from abrace_core.own_law import GuardedLaw
from abrace_core.run import Run
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_core.simulation import simulate as simulate_model
from abrace_core.simulation import simulate_closed_loop
from abrace_core.table_signals import table_noise
from abrace_lqg.active_controller import ActiveController
from abrace_plant.live.simulated_run import simulated_run
from abrace_plant.records.files import read_record
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion
from abrace_plant.records.treatment import BAND_LIMIT, Treatment, prepare
from abrace_plant.rig.model import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from abrace.interactive.given import AnyController, AnyModel, AnyRun
    from abrace_core.linear_model import LinearModel
    from abrace_core.own_law import Law

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


def simulate(
    structure: AnyModel,
    record: Record | AnyRun | ArrayLike | None = None,
    *,
    controller: AnyController | Law | None = None,
    command: ArrayLike | str | None = None,
    peak_acceleration: float = 0.0,
    duration: float = 0.0,
    seed: int = 0,
    sample_period: float | None = None,
    **treatment: Any,
) -> Run:
    """Simulate a test, from rest.

    A rig is simulated as the node `plant` does it in lockstep: limits, interlocks, sensors and their noise, friction
    where it has some. A model is linear and without noise; its commands are limited to the controller's.

    Parameters
    ----------
    structure
        A rig (its name, its file), or a model (its file, an identification, a StateSpace of python-control).
    record
        The motion of the table: a known name, a file, a Record, a Run whose table is played again, (samples,) [m/s^2]
        at the sample rate, "white_noise" (0.1 to 10 Hz, 0.25 m/s^2); None: at rest.
    controller
        A controller, its file, a design; of a rig also a law of one's own (`abrace_core.own_law`).
    command
        Instead of a controller: (samples,) or (samples, groups) [N] of one brace, or "white_noise" (to 30 Hz,
        7 % of the capacity, which a model has from its tests); None: zero.
    peak_acceleration
        [m/s^2] to which the record is scaled; 0: as recorded.
    duration
        [s] to which record and command are padded or cut, or of the noise; 0: all of them.
    seed
        Of the sensors, from 0 on; white noise has the next ones, as the nodes have it by default.
    sample_period
        [s] of a simulated model; None: that of the controller, or of the tests that the model was identified from.
    treatment
        Of the record, as `Treatment` has it: `baseline`, `time_scale`, `taper`, `low_cut`, `band_limit`.

    Returns
    -------
    Run
        As from a bag. A rig that was stopped by a fault is a Python warning, with the cause.

    Raises
    ------
    AbraceError
        If record, controller and structure do not fit each other, or the record is more than the rig's table has.
    """
    if controller is not None and command is not None:
        raise AbraceError("simulate: controller and command, expected one of them")
    if isinstance(controller, type):
        raise AbraceError(f"simulate: controller {controller.__name__} is a class, expected {controller.__name__}(...)")
    rig = _rig_or_none(structure)
    if rig is not None:
        fixed = 1 / rig.sample_rate
    else:
        model = model_of(structure)
        fixed = model.sample_period
    period = _period(fixed, sample_period) or _sample_period(model, controller)
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise AbraceError(f"simulate: seed {seed!r}, expected a whole number from 0 on")
    fields = {**treatment, "peak_acceleration": peak_acceleration, "duration": duration}
    if isinstance(record, (Record, str, Path)) and record != WHITE_NOISE:
        fields = {"band_limit": BAND_LIMIT, **fields}
    asked = _treatment(fields)
    ground, name = _ground(record, 1 / period, asked, seed)
    groups = rig.groups if rig is not None else len(model.inputs) - 1
    capacity = rig.capacity if rig is not None else np.array(model.provenance.get("force_limit", []))
    forces = _commands(command, 1 / period, duration, groups, seed, COMMAND_SHARE * capacity)
    if ground is None and forces is None:
        raise AbraceError("simulate: neither record nor command, expected at least one")
    samples = max(len(each) for each in (ground, forces) if each is not None)
    ground, forces = _padded(ground, (samples,)), _padded(forces, (samples, groups))
    if rig is None:
        return _of_model(model, ground, forces, controller, period, name)
    if ground.any():
        check_motion(ground, rig.sample_rate, rig.table, name, RECORD_REMEDIES)
    force = _answer(rig, controller) if controller is not None else lambda k, _: forces[k].tolist()
    run = simulated_run(rig, ground, force, seed, f"{rig.name}/{name}")
    warn(run.facts.get("warnings", []))
    return run


def _rig_or_none(structure: Any) -> Rig | None:
    if isinstance(structure, Rig):
        return structure
    is_name = isinstance(structure, (str, Path)) and not Path(structure).is_dir() and Path(structure).suffix != ".json"
    return rig_of(structure) if is_name else None


def _period(fixed: float, given: float | None) -> float:
    """The sample period that a rig or a sampled model has (`fixed`, 0: none), or that is given; 0: neither [s]."""
    if given is None:
        return fixed
    if not isinstance(given, Real) or not 0 < given < np.inf or (fixed and abs(given / fixed - 1) > ROUNDING):
        raise AbraceError(f"simulate: sample_period {given!r}, expected {f'{fixed:g}' if fixed else 'more than 0'} s")
    return float(given)


def _sample_period(model: LinearModel, controller: Any) -> float:
    """The sample period of the controller, or of the tests that the model was identified from [s]."""
    if controller is not None and not hasattr(controller, "begin"):
        return controller_of(controller).law.sample_period
    found = model.provenance.get("sample_period")
    if not found:
        raise AbraceError("simulate: the sample period of this model is not known, expected sample_period in s")
    return float(found)


def _treatment(fields: dict[str, Any]) -> Treatment:
    known = Treatment.__dataclass_fields__
    if unknown := [name for name in fields if name not in known]:
        expected = f"expected a treatment of the record: {', '.join(known)}"
        raise AbraceError(f"simulate: {', '.join(unknown)}: unknown, {expected}")
    return Treatment(**fields)


def _ground(record: Any, rate: float, asked: Treatment, seed: int) -> tuple[NDArray[np.float64] | None, str]:
    """The motion of the table (samples,) [m/s^2], and its name."""
    if record is None:
        return None, "command"
    if isinstance(record, str) and record == WHITE_NOISE:
        if asked != Treatment(duration=asked.duration):
            raise AbraceError(f"simulate: a treatment of {WHITE_NOISE!r}, expected only duration and seed")
        return table_noise(round(asked.duration * rate), rate, **TABLE_NOISE, seed=seed + 1), WHITE_NOISE
    if isinstance(record, Run):
        motion = Record(record.source, record.sample_period, record.ground_acceleration)
    elif isinstance(record, Record):
        motion = record
    elif isinstance(record, (str, Path)):
        motion = read_record(record)
    else:
        motion = Record("motion", 1 / rate, _numbers(record, "record"))
    return prepare(motion, rate, asked), motion.name


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


def _answer(rig: Rig, controller: Any) -> Callable[[int, list[float]], list[float]]:
    """The controller as its node runs it: forces fade in, and pass the limits."""
    period, floors, groups = 1 / rig.sample_rate, rig.floors, rig.groups
    if hasattr(controller, "begin"):
        limit, law = rig.capacity, GuardedLaw(controller, period, RAMP)
        law.begin(floors, groups)
        active = None
    else:
        given = controller_of(controller)
        if abs(given.law.sample_period / period - 1) > ROUNDING:
            raise AbraceError(
                f"controller {given.name}: every {given.law.sample_period:g} s, expected the rig's {period:g} s"
            )
        limit, active = given.force_limit, ActiveController(given, RAMP)
        active.reset(signals.response_names(floors, groups), signals.command_names(groups), np.zeros(groups))
    guard = CommandGuard(limit, rig.rate_limit.tolist(), period, RAMP_TIME)

    def force(number: int, z: list[float]) -> list[float]:
        wanted = active.force(z, 0).tolist() if active is not None else law.force(number, z, 0)
        guard.follow(wanted)
        if active is not None:
            active.advance(guard.value)
        return guard.value

    return force


def _of_model(
    model: LinearModel,
    ground: NDArray[np.float64],
    forces: NDArray[np.float64],
    controller: Any,
    period: float,
    name: str,
) -> Run:
    groups = len(model.inputs) - 1
    floors = sum(output[0] == "x" and output[1:].isdigit() for output in model.outputs)
    wanted = model.select(signals.response_names(floors, groups), (signals.GROUND, *signals.command_names(groups)))
    sampled = wanted if wanted.sample_period else discretize(wanted, period)
    if controller is None:
        outputs = simulate_model(sampled, np.column_stack([ground, forces]))
        command = np.vstack([np.zeros((1, groups)), forces[:-1]])
    elif hasattr(controller, "begin"):
        raise AbraceError("simulate: a law of your own and a model, expected a rig")
    else:
        given = controller_of(controller)
        outputs, command = simulate_closed_loop(sampled, given.law, ground, given.force_limit, given.correction)
    sequence = np.arange(len(ground), dtype=np.uint64)
    facts = {"sample_period": repr(period), "rig": str(model.provenance.get("rig", ""))}
    return Run(f"model/{name}", period, sequence, floors, groups, outputs, ground, command, facts)
