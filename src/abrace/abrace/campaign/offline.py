"""What the steps between the tests ask of rig and tests, checked before the first one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace.campaign.file import BandedNoise, Design, Identify, RigTest
from abrace_core.errors import AbraceError
from abrace_core.node import find_file
from abrace_lqg.weights import load_weights
from abrace_sysid.recordings import LEAST_SECONDS

if TYPE_CHECKING:
    from abrace.campaign.file import Campaign
    from abrace_plant.rig.model import Rig


def check_offline_steps(campaign: Campaign, rig: Rig) -> None:
    """Refuse a campaign with an identification or a design that cannot succeed on the `rig`.

    Raises
    ------
    AbraceError
        Naming the step, the key and what was expected.
    """
    tests = {step.name: step.task for step in campaign.steps if isinstance(step.task, RigTest)}
    for step in campaign.steps:
        try:
            if isinstance(step.task, Identify):
                _check_identify(step.task, tests, rig)
            elif isinstance(step.task, Design):
                _check_design(step.task, rig)
        except AbraceError as error:
            raise AbraceError(f"step {step.name}: {error}") from error


def _check_identify(task: Identify, tests: dict[str, RigTest], rig: Rig) -> None:
    if not rig.groups:
        raise AbraceError(f"identify: rig {rig.name} has no braces, expected one group at least")
    if rig.groups > 1 and task.fit not in (None, "maximum_likelihood"):
        raise AbraceError(f"identify.fit: {task.fit} of {rig.groups} brace groups, expected maximum_likelihood")
    least = 2 * rig.floors
    if task.command_order and (task.command_order < least or task.command_order % 2):
        raise AbraceError(
            f"identify.command_order: {task.command_order}, expected 0, or an even number from {least} on"
        )
    for key, names in (("table", task.table), ("command", task.command)):
        band = task.band_of(key, [tests[name] for name in names])
        for name in names:
            test = tests[name]
            if test.duration < LEAST_SECONDS:
                raise AbraceError(
                    f"identify.{key}: {name} has {test.duration:g} s, expected {LEAST_SECONDS:g} s at least"
                )
            drive = test.ground_motion if key == "table" else test.excitation
            if isinstance(drive, BandedNoise) and band and not drive.band[0] <= band[0] < band[1] <= drive.band[1]:
                raise AbraceError(
                    f"identify.{key}_band: {band[0]:g} to {band[1]:g} Hz, expected within the {drive.band[0]:g} to "
                    f"{drive.band[1]:g} Hz of {name}"
                )


def _check_design(task: Design, rig: Rig) -> None:
    weights = load_weights(find_file(task.weights, "abrace_lqg", "config", ".yaml", "weights"))
    weights.of(rig.model.outputs, rig.model.inputs[1:])
