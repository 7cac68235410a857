# SPDX-License-Identifier: Apache-2.0
"""The nodes that command the braces and the table in a test, or serve as its rig: programs and parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from abrace.campaign.laboratory import program_of
from abrace.campaign.tasks import OwnController
from abrace.processes.group import find_executable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from abrace.campaign.laboratory import Laboratory
    from abrace.campaign.tasks import RigTest


SIGNALS = ("excitation", "ground_motion")
"""Nodes whose signals begin when the campaign says so."""
STOP_HEARTBEAT = 1.0
"""Seconds within which every stop button must repeat: there has to be one. Of an emulator it is the campaign."""
START, LOCKSTEP_START = 5.0, 0.6
"""Seconds of a run in real time, and in lockstep, within which its signals begin: they are recorded whole."""


@dataclass(frozen=True)
class NodeStart:
    """A node to start: its name in the graph, its command, parameters, and files that these override."""

    name: str
    program: Sequence[str | Path]
    parameters: dict[str, Any]
    files: tuple[Path, ...] = ()


def abrace_node(package: str, executable: str, parameters: dict[str, Any], *files: Path, name: str = "") -> NodeStart:
    """An `executable` of a `package` with its `parameters` and `files`; `name`: the executable's by default."""
    return NodeStart(name or executable, [find_executable(package, executable)], parameters, files)


def drivers(test: RigTest, laboratory: Laboratory, controller_file: Callable[[str], Path]) -> dict[str, NodeStart]:
    """The nodes that command braces and table of a `test` in its `laboratory`, by the topic that each publishes.

    `controller_file` gives the file of a controller that the test names.
    """
    rig, controller = laboratory.rig, test.controller
    rates = {"rate_limit": test.rate_limit or max(rig.rate_limit.tolist(), default=0.0)}
    limits = {"force_limit": list(test.force_limit or rig.capacity.tolist()), **rates}
    length = {"duration": test.duration}
    found: dict[str, NodeStart] = {}
    if test.excitation:
        given = {**test.excitation.parameters, **length, "sample_rate": rig.sample_rate, **limits}
        found["brace_command"] = abrace_node("abrace_sysid", "excitation", given)
    elif isinstance(controller, OwnController):
        given = {"sample_rate": rig.sample_rate, **limits, **controller.parameters}
        found["brace_command"] = NodeStart("controller", program_of(controller), given)
    elif controller:
        given = {"rig_period": 1 / rig.sample_rate, **(limits if test.force_limit else rates)}
        found["brace_command"] = abrace_node("abrace_lqg", "controller", given, controller_file(controller))
    if test.ground_motion:
        given = {**test.ground_motion.parameters, "rig": str(laboratory.rig_file), **length}
        found["ground_motion"] = abrace_node("abrace_plant", "ground_motion", given)
    return found


def seconds_of_run(test: RigTest, lockstep: bool) -> float:
    """Seconds of a `test`'s run, in `lockstep` or by the clock: its signals, and the time before they begin."""
    signals = test.excitation is not None or test.ground_motion is not None
    return test.duration + signals * (LOCKSTEP_START if lockstep else START)


def rig_node(test: RigTest, laboratory: Laboratory, seed: int, wait_for: Sequence[str]) -> NodeStart:
    """The rig of a `test` in its `laboratory`: its node is always called `plant`.

    `seed`: of simulated sensor noise; `wait_for`: topics whose answers lockstep waits for, empty: real time.
    """
    setup = laboratory.setup
    length = seconds_of_run(test, bool(wait_for))
    given: dict[str, Any] = {"rig": str(laboratory.rig_file), "duration": length, "autostart": False}
    if wait_for:
        given |= {"lockstep": True, "wait_for": list(wait_for)}
    if setup.node is not None:
        return NodeStart("plant", program_of(setup.node), given | setup.node.parameters)
    if laboratory.device_file is not None:
        given |= {"device": str(laboratory.device_file), "stop_heartbeat": STOP_HEARTBEAT}
        return abrace_node("abrace_plant", "sensor_bridge", given, name="plant")
    faults = {key: list(value) for key in ("disconnected_braces", "sensor_faults") if (value := getattr(test, key))}
    return abrace_node("abrace_plant", "plant", given | {"seed": seed, **faults})
