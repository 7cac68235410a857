"""The ground motions of a campaign, checked against the table before its first test."""

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
