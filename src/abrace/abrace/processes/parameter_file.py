# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files for the nodes of a test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from abrace_core import AbraceError
from abrace_core.files.config_file import yaml_number
from abrace_core.files.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping


def parameter_file(path: Path | str, parameters: Mapping[str, Any]) -> Path:
    """Write parameters for one node to a ROS parameter file, with the types of their Python values.

    Parameters
    ----------
    path
        YAML file to write.
    parameters
        Names and values: bool, int, float, str, or a list of one of these (whole numbers among floats become floats).

    Raises
    ------
    AbraceError
        If a value has another type, is not finite, or is an empty list (which has no type in ROS).
    """
    lines = [f"    {_quoted(name)}: {written(name, value)}\n" for name, value in parameters.items()]
    write_text(path, "/**:\n  ros__parameters:" + ("\n" + "".join(lines) if lines else " {}\n"))
    return Path(path)


def written(name: str, value: Any) -> str:
    """The `value` of the parameter `name` as YAML; errors as in `parameter_file`."""
    match value:
        case bool():
            return "true" if value else "false"
        case int() if -(2**63) <= value < 2**63:
            return str(value)
        case float() if math.isfinite(value):
            return yaml_number(value)
        case str():
            return _quoted(value)
        case list() | tuple() if value:
            kinds = {next((kind for kind in (bool, int, float, str) if isinstance(item, kind)), None) for item in value}
            if kinds == {int, float}:
                value, kinds = [float(item) for item in value], {float}
            if len(kinds) == 1 and None not in kinds:
                return "[" + ", ".join(written(name, item) for item in value) + "]"
    raise AbraceError(
        f"parameter {name}: {value!r}, expected a bool, a 64-bit int, a finite float, a string, or a list of one kind"
    )


def _quoted(text: str) -> str:
    return yaml.safe_dump(text, default_style='"', width=math.inf).strip()
