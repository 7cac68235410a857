# SPDX-License-Identifier: Apache-2.0
"""The device file: the kind of device that connects a rig's hardware, and its settings.

A laboratory adds kinds of its own as entry points of the group `abrace.devices`: each is a function that takes the path
of the device file and the rig, and returns a `Device`.
"""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points
from ipaddress import IPv4Address
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config
from abrace_core.files.quantity import Quantity
from abrace_core.model import signals
from abrace_plant.devices.calibration import Calibration, read_calibration

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_plant.devices.device import Device
    from abrace_plant.rig.model import Rig

GROUP = "abrace.devices"
"""Entry points of this group are kinds of devices."""
OWN_KINDS = {"udp": "abrace_plant.devices.udp"}
"""Modules of the kinds that abrace has; each has a function `load`."""

Address = IPv4Address
"""Of a device, in digits."""
PortNumber = Annotated[int, pydantic.Field(ge=1, le=65535)]
TimeOut = Annotated[float, pydantic.Field(gt=0, le=1), Quantity("s")]
"""Seconds."""


class DeviceFile(Checked):
    """Keys of every device file; `calibration` is a file, its path relative to the device file's folder."""

    kind: str
    calibration: str | None = None


class _AnyDevice(DeviceFile):
    model_config = pydantic.ConfigDict(extra="allow")


def load_device(path: Path | str, rig: Rig) -> Device:
    """The device that a device file describes; it is not open yet.

    Parameters
    ----------
    path
        Of the device file.
    rig
        The rig that the device moves and measures: its floors, brace groups and sample rate.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    kind = read_config(path, _AnyDevice, "device").kind
    if kind in OWN_KINDS:
        return cast("Device", importlib.import_module(OWN_KINDS[kind]).load(Path(path), rig))
    points = entry_points(group=GROUP)
    if kind not in points.names:
        known = ", ".join([*OWN_KINDS, *sorted(points.names)])
        raise AbraceError(f"device file {path}: kind: {kind!r}, expected one of {known}, or an entry point in {GROUP}")
    try:
        load = cast("Callable[[Path, Rig], Device]", points[kind].load())
    except Exception as error:
        raise AbraceError(
            f"device file {path}: kind: {kind}: {points[kind].value} cannot be loaded: {error}"
        ) from error
    return load(Path(path), rig)


def calibration_of(path: Path | str) -> Path | None:
    """The calibration file that a device file names.

    Raises
    ------
    AbraceError
        If it is no device file.
    """
    named = read_config(path, _AnyDevice, "device").calibration
    return None if named is None else Path(path).parent / named


def commands_of(rig: Rig) -> tuple[str, ...]:
    """Names of the `rig`'s commands: U of each brace group, then the table's acceleration w where abrace drives it."""
    return (*signals.command_names(rig.groups), *([signals.GROUND] if rig.table_driven else []))


def load_calibration(path: Path, file: DeviceFile, rig: Rig) -> Calibration:
    """The calibration of a device.

    Parameters
    ----------
    path
        Of the device file.
    file
        Its content.
    rig
        The rig that it measures.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    if file.calibration is None:
        return Calibration(None, rig.channel_names, commands_of(rig), rig.sample_rate)
    part_path = path.parent / file.calibration
    content = read_calibration(part_path)
    try:
        return Calibration(content, rig.channel_names, commands_of(rig), rig.sample_rate, part_path)
    except AbraceError as error:
        raise AbraceError(f"calibration file {part_path}: {error}") from error
