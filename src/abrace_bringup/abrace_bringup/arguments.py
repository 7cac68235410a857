# SPDX-License-Identifier: Apache-2.0
"""Launch arguments: their table, and their check before the first node is started.

Launch files run in the Python of `ros2 launch`, which may lack the packages of abrace's nodes: this module needs only
the standard library and PyYAML, and no ROS.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core.errors import AbraceError
from abrace_core.suggestion import did_you_mean, expected_of
from abrace_core.yaml_text import read_yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

NAMESPACE = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
OWN_NODE = re.compile(r"[A-Za-z_]\w*/[A-Za-z_]\w*")


@dataclass(frozen=True)
class Argument:
    """A launch argument.

    Parameters
    ----------
    name
        As in `name:=value`.
    default
        Text that is used if none is given.
    description
        What it is, with its unit.
    read
        Makes its value of the text; a ValueError names what was expected.
    """

    name: str
    default: str
    description: str
    read: Callable[[str], Any] = str


def number(text: str) -> float:
    """A number of 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise ValueError("a number of 0 or more")
    return value


def duration(text: str) -> float:
    """A number above 0."""
    if not (value := number(text)):
        raise ValueError("a number above 0")
    return value


def exaggeration(text: str) -> float:
    """A number of 1 or more."""
    if (value := number(text)) < 1:
        raise ValueError("a number of 1 or more")
    return value


def forces(text: str) -> list[float]:
    """One number of 0 or more, or several with commas between them; an empty text: none."""
    return [number(each) for each in text.strip("[] ").split(",")] if text else []


def band(text: str) -> list[float]:
    """Two rising frequencies with a comma between them."""
    try:
        low, high = forces(text)
    except ValueError:
        low = high = 0.0
    if not low < high:
        raise ValueError("two frequencies in Hz such as 0.3,10.0, the lower one first")
    return [low, high]


def band_or_none(text: str) -> list[float]:
    """A band, or an empty text."""
    return band(text) if text else []


def flag(text: str) -> bool:
    """`true` or `false`."""
    if text.lower() not in ("true", "false"):
        raise ValueError("true or false")
    return text.lower() == "true"


def one_of(*choices: str) -> Callable[[str], str]:
    """Reads one of these texts."""

    def read(text: str) -> str:
        if text not in choices:
            raise ValueError(" or ".join(choices) + did_you_mean(text, choices))
        return text

    return read


def namespace(text: str) -> str:
    """A ROS namespace, without the slash in front."""
    if not NAMESPACE.fullmatch(text):
        raise ValueError("a ROS namespace such as rig")
    return text.lstrip("/")


def enclave_folder(text: str) -> str:
    """A folder of enclaves, which begins with a slash, or nothing."""
    if text and not (text.startswith("/") and NAMESPACE.fullmatch(text)):
        raise ValueError("a folder of enclaves such as /abrace")
    return text


def new_bag(text: str) -> str:
    """A path where nothing is yet."""
    if not text or Path(text).exists():
        raise ValueError("a new directory for the bag" + (", this one exists already" if text else ""))
    return text


def name_or_file(text: str, *endings: str) -> str:
    """A text; one that looks like a path, by a slash or one of the `endings`, has to name a file or directory."""
    if ("/" in text or text.lower().endswith(endings)) and not Path(text).exists():
        raise ValueError("a file, and there is none of this name")
    return text


def rig(text: str) -> str:
    """A rig's name or file."""
    if not text:
        raise ValueError("the name of a rig or a file")
    return name_or_file(text, ".yaml")


def record(text: str) -> str:
    """A record's name or file."""
    return name_or_file(text, ".at2", ".csv", ".txt", ".mat", ".mcap", ".v2")


def parameter_file(text: str) -> str:
    """A ROS parameter file."""
    if not text:
        raise ValueError("a ROS parameter file")
    try:
        content = read_yaml(text, "ROS parameter")
    except AbraceError as error:
        reason = str(error).removeprefix(f"ROS parameter file {text}: ")
        raise ValueError(f"a ROS parameter file: {reason}") from error
    if not _holds_parameters(content):
        raise ValueError("a ROS parameter file: no ros__parameters in it")
    return text


def controller(text: str) -> str:
    """A controller file, which is a ROS parameter file, or PACKAGE/EXECUTABLE of a node of one's own."""
    if OWN_NODE.fullmatch(text) and not Path(text).exists():
        return text
    try:
        return parameter_file(text)
    except ValueError as error:
        raise ValueError(f"{error}; or PACKAGE/EXECUTABLE of a node of your own") from error


def parameter_file_or_none(text: str) -> str:
    """A ROS parameter file, or an empty text."""
    return parameter_file(text) if text else text


def _holds_parameters(content: object) -> bool:
    if not isinstance(content, dict):
        return False
    return isinstance(content.get("ros__parameters"), dict) or any(map(_holds_parameters, content.values()))


def read_arguments(table: Sequence[Argument], texts: Mapping[str, str], given: Collection[str] = ()) -> dict[str, Any]:
    """The values of the arguments.

    Parameters
    ----------
    table
        The arguments that there are.
    texts
        Text of each of them.
    given
        Names on the command line, all of which have to be in the table.

    Returns
    -------
    dict
        Value by name.

    Raises
    ------
    AbraceError
        With a line for each mistake.
    """
    names = [argument.name for argument in table]
    mistakes, values = [], {}
    for name in given:
        if name not in names:
            mistakes.append(f"{name}: unknown, {expected_of(name, names)}")
    for argument in table:
        text = texts[argument.name]
        try:
            values[argument.name] = argument.read(text)
        except ValueError as error:
            mistakes.append(f"{argument.name}:={text}, expected {error}")
    if mistakes:
        raise AbraceError("\n".join(["wrong launch arguments, nothing was started", *mistakes]))
    return values
