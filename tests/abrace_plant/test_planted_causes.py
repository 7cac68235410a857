# SPDX-License-Identifier: Apache-2.0
"""Every interlock stops a rig in lockstep by a planted cause, before any other one does."""

from pathlib import Path

import numpy as np
import pytest
from planted_causes import PLANTED, names, run_planted

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RAMP_TIME, State
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import NUMBER
from abrace_plant.rig.limits import INTERLOCKS

SECONDS_AFTER = 3.0
"""Longer than any stop of braces and table."""


@pytest.fixture(scope="module")
def rig():
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")


def test_every_interlock_has_a_planted_cause():
    assert set(PLANTED) == {*INTERLOCKS, NUMBER}


@pytest.mark.parametrize("interlock", PLANTED)
def test_it_stops_braces_and_table_by_its_cause_alone_and_is_latched(rig, interlock):
    planted = PLANTED[interlock]
    assert run_planted(rig, planted.without_cause()).trip < 0, "it trips without the cause"

    ran = run_planted(rig, planted, SECONDS_AFTER)
    assert ran.trip > 0
    cause = ran.samples[ran.trip].cause
    assert cause.startswith(planted.says)
    assert names(cause, interlock), cause

    states = [sample.head.state for sample in ran.samples]
    assert states[: ran.trip] == [State.RUNNING] * ran.trip
    assert states[ran.trip :] == sorted(states[ran.trip :])
    assert set(states[ran.trip :]) == {State.RAMPING_DOWN, State.LATCHED}
    assert {sample.cause for sample in ran.samples[ran.trip :]} == {cause}, "the first cause is kept"

    ramp = round(RAMP_TIME * rig.sample_rate)
    # a sample's command was in force until it: the one of the trip itself acts until the next one
    command = np.abs([sample.command[0] for sample in ran.samples[ran.trip + 1 :]])
    assert command[0] > 0
    assert np.diff(command).max() <= 0, "the command only falls"
    assert -np.diff(command).min() <= 1.01 * command[0] * np.pi / 2 / ramp, "along a half cosine"
    assert not command[ramp + 1 :].any(), "zero within the ramp, whatever is commanded"
    still = np.array(ran.table[-500:])
    assert np.abs(still).max() < 1e-9, "the table is at rest"
    assert abs(ran.safety.outputs[1].state.displacement) < rig.table.peak_displacement

    with pytest.raises(AbraceError, match="still requests"):
        ran.safety.clear(ran.loop.moving())
    assert ran.safety.state is State.LATCHED
