# SPDX-License-Identifier: Apache-2.0
"""Checks, before the first test, of what tests demand from rig, table, braces, sensors and controllers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from abrace.campaign.laboratory import program_of
from abrace.campaign.names import CONTROLLER_FILE
from abrace.campaign.tasks import OwnController
from abrace_core import AbraceError
from abrace_core.model.controller_file import load_controller
from abrace_core.model.signals import command_names
from abrace_plant.devices.simulated import check_faults
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given
from abrace_plant.rig.table_file import NOT_DRIVEN
from abrace_sysid.excitation_signal import excitation_signal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from abrace.campaign.drives import Excitation, GroundMotion
    from abrace.campaign.laboratory import Laboratory
    from abrace.campaign.tasks import RigTest
    from abrace_core.model.controller_file import Controller
    from abrace_plant.rig.model import Rig

LEAST_EXCITATION = 2.0
"""Least duration of an excitation by noise [s]: it fades in and out within 1 s each."""


class Signals:
    """The ground motions and excitations of a campaign's tests, each computed once."""

    def __init__(self) -> None:
        self._made: dict[tuple[Path, str, float], NDArray[np.float64]] = {}

    def motion(self, motion: GroundMotion, duration: float, laboratory: Laboratory) -> NDArray[np.float64]:
        """The table's acceleration (samples,) [m/s^2] in a `motion` for a `duration` [s] in a `laboratory`.

        Raises
        ------
        AbraceError
            If there is no such motion, or the table cannot play it.
        """

        def make() -> NDArray[np.float64]:
            rig = laboratory.rig
            if not rig.table_driven:
                raise AbraceError(f"rig {rig.name}: {NOT_DRIVEN}")
            given = SimpleNamespace(**{row.name: row.default for row in MOTION_PARAMETERS} | motion.parameters)
            asked = (given.record, given.peak_acceleration, duration)
            return motion_as_given(given, rig.table, rig.sample_rate, *asked)

        return self._once(motion, duration, laboratory, make)

    def excitation(self, excitation: Excitation, duration: float, laboratory: Laboratory) -> NDArray[np.float64]:
        """The commands (samples, groups) [N] of one brace of each group; arguments as in `motion`."""

        def make() -> NDArray[np.float64]:
            given = excitation.parameters | {"duration": duration, "sample_rate": laboratory.rig.sample_rate}
            return excitation_signal(SimpleNamespace(**given), laboratory.rig.groups)

        return self._once(excitation, duration, laboratory, make)

    def _once(
        self, drive: object, duration: float, laboratory: Laboratory, make: Callable[[], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        key = laboratory.rig_file, repr(drive), duration
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


def wrong_test(test: RigTest, laboratory: Laboratory, lockstep: bool, signals: Signals) -> Iterator[str]:
    """What a `test` requires of its `laboratory` that does not exist or is not possible, in `lockstep` or real time.

    `signals` that are computed are kept.
    """
    if lockstep and not (test.ground_motion or test.excitation or test.controller):
        yield "a lockstep test without any input, expected ground motion or commands"
    for key, attempt in (
        ("test.ground_motion", lambda: _make_motion(test, laboratory, signals)),
        ("test.excitation", lambda: _make_excitation(test, laboratory, signals)),
        ("test.disconnected_braces", lambda: _disconnect(test, laboratory)),
        ("test.sensor_faults", lambda: check_faults(test.sensor_faults, laboratory.rig)),
        ("test.controller", lambda: _find_controller(test, laboratory)),
        ("test.force_limit", lambda: _check_limits(test, laboratory)),
    ):
        try:
            attempt()
        except AbraceError as error:
            yield f"{key}: {error}"


def _make_motion(test: RigTest, laboratory: Laboratory, signals: Signals) -> None:
    if test.ground_motion:
        signals.motion(test.ground_motion, test.duration, laboratory)


def _make_excitation(test: RigTest, laboratory: Laboratory, signals: Signals) -> None:
    if test.excitation is None:
        return
    if test.duration < LEAST_EXCITATION:
        raise AbraceError(f"{test.duration:g} s, expected {LEAST_EXCITATION:g} s at least")
    signals.excitation(test.excitation, test.duration, laboratory)


def _disconnect(test: RigTest, laboratory: Laboratory) -> None:
    left = laboratory.rig.disconnect(test.disconnected_braces)
    if (test.excitation or test.controller) and not any(group.connected for group in left.braces):
        raise AbraceError("commands to braces that are all disconnected, expected at least one connected")


def _find_controller(test: RigTest, laboratory: Laboratory) -> None:
    if isinstance(test.controller, OwnController):
        program_of(test.controller)
    elif test.controller and test.controller.endswith(CONTROLLER_FILE):
        check_controller(load_controller(test.controller), laboratory.rig, test.controller)


def check_controller(controller: Controller, rig: Rig, source: str) -> None:
    """Refuse a `controller` that does not fit the `rig`; `source`: its file, for the message.

    Raises
    ------
    AbraceError
        If the controller's measurements, commands or sample rate are not the rig's.
    """
    law = controller.law
    unknown = [name for name in law.inputs if name not in rig.recorded_names]
    if unknown:
        raise AbraceError(f"{source} measures {', '.join(unknown)}, expected some of {', '.join(rig.recorded_names)}")
    if law.outputs != command_names(rig.groups):
        expected = ", ".join(command_names(rig.groups))
        raise AbraceError(f"{source} commands {', '.join(law.outputs)}, expected {expected} as rig {rig.name} takes")
    try:
        controller.of_rig(1 / rig.sample_rate)
    except AbraceError as error:
        raise AbraceError(f"{source}: {error}") from error


def _check_limits(test: RigTest, laboratory: Laboratory) -> None:
    limits, capacity = test.force_limit, laboratory.rig.capacity.tolist()
    if limits is None:
        return
    if len(limits) != len(capacity):
        raise AbraceError(f"{list(limits)}, expected one force [N] for each of {len(capacity)} brace groups")
    if any(limit > most for limit, most in zip(limits, capacity, strict=True)):
        has: Any = ", ".join(f"{most:g}" for most in capacity)
        raise AbraceError(f"{list(limits)} N, expected at most the capacity, {has} N")
