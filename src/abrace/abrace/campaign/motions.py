"""What the tests of a campaign ask of the rig, checked before the first one: of its table, and of its braces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from abrace.campaign.file import RigTest
from abrace_core.errors import AbraceError
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given

if TYPE_CHECKING:
    import pydantic

    from abrace.campaign.file import Campaign
    from abrace_plant.rig.model import Rig


def as_given(drive: pydantic.BaseModel) -> dict[str, Any]:
    """What drives a test, a signal or record of the campaign file, as parameters of its node: `drive`'s own keys."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in drive.model_dump().items()}


def check_motions(campaign: Campaign, rig: Rig) -> None:
    """Refuse a campaign with a ground motion that the table of the `rig` cannot play.

    Raises
    ------
    AbraceError
        Naming the step and what it asks for.
    """
    checked: list[tuple[object, float]] = []
    for step in campaign.steps:
        test = step.task
        if not isinstance(test, RigTest) or test.ground_motion is None:
            continue
        if (test.ground_motion, test.duration) in checked:
            continue
        given = {row.name: row.default for row in MOTION_PARAMETERS} | as_given(test.ground_motion)
        values = SimpleNamespace(**given | {"sample_rate": rig.sample_rate})
        try:
            motion_as_given(values, rig.table, values.record, values.peak_acceleration, test.duration)
        except AbraceError as error:
            raise AbraceError(f"step {step.name}: {error}") from error
        checked.append((test.ground_motion, test.duration))


def check_braces(campaign: Campaign, rig: Rig) -> None:
    """Refuse a campaign with a test that disconnects braces which the `rig` has not, or drives none.

    Raises
    ------
    AbraceError
        Naming the step and what was expected.
    """
    for step in campaign.steps:
        test = step.task
        if not isinstance(test, RigTest):
            continue
        try:
            left = rig.disconnect(test.disconnected_braces)
        except AbraceError as error:
            raise AbraceError(f"step {step.name}: test.disconnected_braces: {error}") from error
        if (test.excitation or test.controller) and not any(group.connected for group in left.braces):
            raise AbraceError(f"step {step.name}: commands to braces of which none is connected, expected one at least")
