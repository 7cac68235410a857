# SPDX-License-Identifier: Apache-2.0
"""The C99 target of `targets/c99`, loaded: what guards outputs here is the code that a laboratory takes."""

from __future__ import annotations

import ctypes
import functools
import os
import shlex
import subprocess
import tempfile
import time
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.devices.device import Wanted
    from abrace_plant.rig.model import Rig

MOST_GROUPS = 8
"""Of braces, as in the header."""
DISARMED, ARMED, STOPPING = range(3)
"""States of the target."""
CAUSES = (
    "its program was started",
    "it was asked to",
    "no new command for its life time",
    "a command with another arm number",
    "a command that is not finite, or wants a state that there is not",
    "it missed its own ticks",
    "a limit of its own",
    "the emergency stop",
)
"""Why it does not follow, from bit 0 on; bits 16 to 31 are the laboratory's own."""
NO_COMMANDS, BAD_COMMAND, OWN_LIMIT = 4, 16, 64
"""Some of these bits."""
OUTCOMES = ("", "refused", "repeated", "old", "not_finite", "wrong_length", "wrong_crc", "wrong_constant")
"""What has become of a command, in the header's order; empty: it was obeyed."""

_Forces = ctypes.c_double * MOST_GROUPS
_Outputs = ctypes.c_double * (MOST_GROUPS + 1)


class Settings(ctypes.Structure):
    """`abrace_target_settings`."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("period", "life_time", "ramp_time")),
        ("capacity", _Forces),
        ("rate_limit", _Forces),
        *((name, ctypes.c_double) for name in ("table_acceleration", "table_jerk")),
        *((name, ctypes.c_uint32) for name in ("groups", "channels", "table_driven", "table_measured", "last_arm")),
    )


class TargetStruct(ctypes.Structure):
    """`abrace_target`."""

    _fields_ = (
        ("settings", Settings),
        ("applied", _Outputs),
        *((name, ctypes.c_double) for name in ("velocity", "displacement")),
        *((name, ctypes.c_uint32) for name in ("power", "state", "causes", "last_arm", "ticks", "applied_counter")),
        *((name, ctypes.c_uint32) for name in ("counter", "heard", "obeyed", "wanted", "silent", "stopping", "still")),
        ("blocked", ctypes.c_uint32),
        ("command", _Outputs),
        ("ramp_from", _Forces),
        ("local_force", _Forces),
        ("local", ctypes.c_uint32),
    )


class CTarget:
    """The outputs of a rig, guarded: followed while armed, limited, and brought to rest by themselves.

    Parameters
    ----------
    rig
        The rig.
    life_time
        Seconds without a new command after which it stops.
    ramp_time
        Seconds in which it then brings the force to zero, along half a cosine.

    Raises
    ------
    AbraceError
        If it refuses the rig, or cannot be compiled.
    """

    def __init__(self, rig: Rig, life_time: float, ramp_time: float) -> None:
        if rig.groups > MOST_GROUPS:
            raise AbraceError(f"rig {rig.name}: {rig.groups} brace groups, expected at most {MOST_GROUPS} for a target")
        self._count = rig.groups + 1
        settings = Settings(
            period=1 / rig.sample_rate,
            life_time=life_time,
            ramp_time=ramp_time,
            table_acceleration=rig.table.peak_acceleration,
            table_jerk=rig.table.peak_jerk,
            groups=rig.groups,
            table_driven=rig.table_driven,
            # another number at each start, so that a command of before arms nothing
            last_arm=time.time_ns() // 10**9 % 2**31,
        )
        settings.capacity[: rig.groups] = rig.capacity.tolist()
        settings.rate_limit[: rig.groups] = rig.rate_limit.tolist()
        self._c, self._library = TargetStruct(), library()
        self._self = ctypes.byref(self._c)
        self._applied = np.ctypeslib.as_array(self._c.applied)[: self._count]
        self._obeyed = np.ctypeslib.as_array(self._c.command)[: self._count]
        if self._library.abrace_target_init(self._self, ctypes.byref(settings)):
            raise AbraceError(
                f"rig {rig.name}: the target takes no life time of {life_time:g} s and ramp of {ramp_time:g} s at "
                f"{rig.sample_rate:g} Hz, expected two periods to 1 s, and at least 50 Hz"
            )

    @property
    def state(self) -> int:
        """Disarmed, armed or stopping."""
        return int(self._c.state)

    @property
    def causes(self) -> int:
        """Why it has stopped, a bit for each cause."""
        return int(self._c.causes)

    @property
    def last_arm(self) -> int:
        """The arm number that it has accepted last."""
        return int(self._c.last_arm)

    @property
    def applied_counter(self) -> int:
        """Counter of the last command that was obeyed, up to the last tick."""
        return int(self._c.applied_counter)

    @property
    def applied(self) -> NDArray[np.float64]:
        """(groups + 1,) force of one brace of each group [N], acceleration of the table [m/s^2]."""
        return self._applied.copy()

    @property
    def obeyed(self) -> NDArray[np.float64]:
        """(groups + 1,) of the last command that was obeyed."""
        return self._obeyed.copy()

    def command(self, counter: int, outputs: Sequence[float], arm: int, wanted: Wanted | int) -> str:
        """Take a command; returns why it is not obeyed, or nothing.

        Parameters
        ----------
        counter
            Of the command.
        outputs
            As of `applied`; without the last where the table is not driven.
        arm, wanted
            Arm number, and what shall be done.
        """
        values = (ctypes.c_double * self._count)(*outputs)
        return OUTCOMES[self._library.abrace_target_command(self._self, counter % 2**32, arm, wanted, values)]

    def stop(self, cause: int) -> None:
        """Bring force and table to rest for a cause of its own, a bit; it stays until the next tick."""
        self._library.abrace_target_stop(self._self, cause)

    def bring_to_rest(self, standing: Sequence[float]) -> None:
        """Ramp from outputs, as of `command`, that are `standing`, because somebody else has left them."""
        self._applied[: len(standing)] = standing
        self._c.ramp_from[: self._count - 1] = standing[: self._count - 1]
        self._c.state, self._c.stopping = STOPPING, 0

    def tick(self, ticks: int = 1) -> None:
        """Make the outputs of the next tick; `ticks` counts it and those before it that were missed."""
        self._library.abrace_target_tick(self._self, ticks)


@functools.cache
def library() -> ctypes.CDLL:
    """The target, compiled now by `CC` (cc).

    Raises
    ------
    AbraceError
        If there is no C compiler, or it fails.
    """
    compiler = shlex.split(os.environ.get("CC", "cc"))
    with tempfile.TemporaryDirectory() as folder, as_file(files(__package__) / "c99") as source:
        compiled = Path(folder) / "abrace_target.so"
        options = ["-std=c99", "-O2", "-fPIC", "-shared", "-o", str(compiled)]
        command = [*compiler, *options, str(source / "abrace_target.c"), "-lm"]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True)
        except OSError as error:
            raise AbraceError(f"{command[0]}: {error.strerror}, expected a C compiler for the target") from error
        except subprocess.CalledProcessError as error:
            raise AbraceError(f"{shlex.join(command)} failed: {error.stderr.strip()[-400:]}") from error
        found = ctypes.CDLL(str(compiled))
    pointer = ctypes.POINTER(TargetStruct)
    found.abrace_target_command.argtypes = [pointer, *[ctypes.c_uint32] * 3, ctypes.POINTER(ctypes.c_double)]
    found.abrace_target_stop.argtypes = found.abrace_target_tick.argtypes = [pointer, ctypes.c_uint32]
    found.abrace_target_stop.restype = found.abrace_target_tick.restype = None
    return found


def causes_in_words(causes: int) -> str:
    """Why a target does not follow, of the bits `causes`."""
    bits = [i for i in range(32) if causes >> i & 1]
    return ", ".join(CAUSES[i] if i < len(CAUSES) else f"its own cause {i}" for i in bits) or "it names no cause"
