# SPDX-License-Identifier: Apache-2.0
"""The limits that a controller has to keep before it is written, and the names of the objections if it does not."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, get_args

import pydantic

from abrace_core.config_file import Checked

Objection = Literal[
    "untrusted_model",
    "unstable_with_check_model",
    "small_gain_margin",
    "small_phase_margin",
    "short_delay_margin",
    "small_disk_margin",
    "damping_lost",
]
"""Name of a reason for which a design is refused; each can be accepted by name."""

OBJECTIONS: tuple[Objection, ...] = get_args(Objection)

Least = Annotated[float, pydantic.Field(ge=0)]


class Limits(Checked):
    """The limits for a controller with every model with which its loop is stable; 0: no limit.

    Parameters
    ----------
    gain_margin, phase_margin, delay_margin
        [dB], [degrees], [s], of the loop broken at each command. 4 ms are two samples at 500 Hz.
    disk_margin
        Radius of the disk of all commands and all measured quantities at once (`DiskMargin.alpha`).
    damping_kept
        Share of its damping without control that each mode keeps.
    """

    gain_margin: Least = 6.0
    phase_margin: Least = 30.0
    delay_margin: Least = 0.004
    disk_margin: Least = 0.3
    damping_kept: Least = 0.8


class Wording(NamedTuple):
    """The wording of a limit: name of the objection, the quantity, factor and unit of the numbers, decimals."""

    objection: Objection
    quantity: str
    factor: float = 1.0
    unit: str = ""
    decimals: int = 2


WORDING = {
    "gain_margin": Wording("small_gain_margin", "gain margin", unit=" dB"),
    "phase_margin": Wording("small_phase_margin", "phase margin", unit=" degrees", decimals=1),
    "delay_margin": Wording("short_delay_margin", "delay margin", factor=1e3, unit=" ms"),
    "disk_margin": Wording("small_disk_margin", "disk margin"),
    "damping_kept": Wording("damping_lost", "damping kept", factor=100.0, unit=" %", decimals=1),
}
"""By the fields of `Limits`."""


def shortfall(limit: str, value: float, where: str, least: float) -> str:
    """The words for a `value` under its `limit`, a field of `Limits`, found at `where`; `least` was asked for."""
    wording = WORDING[limit]
    found, asked = (wording.factor * number for number in (value, least))
    size = f"{found:.{wording.decimals}f}{wording.unit}"
    return f"{wording.quantity} {size} {where}, expected at least {asked:g}{wording.unit}"
