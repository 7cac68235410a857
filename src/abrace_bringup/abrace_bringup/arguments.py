# SPDX-License-Identifier: Apache-2.0
"""Launch arguments: what each takes, and their check before the first node is started.

Launch files run in the Python of `ros2 launch`, which may lack the packages of abrace's nodes: this module needs only
the standard library and PyYAML, and no ROS.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError
from abrace_core.files.reading import read_yaml
from abrace_core.files.suggestion import did_you_mean, expected_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    Reader = Callable[[str], Any]
    """Makes an argument's value of its text; a ValueError says what was expected."""

NAMESPACE = r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*"
OWN_NODE = re.compile(r"[A-Za-z_]\w*/[A-Za-z_]\w*")
RECORD_FILES = (".at2", ".csv", ".txt", ".mat", ".mcap", ".v2")


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
        Makes its value of the text.
    """

    name: str
    default: str
    description: str
    read: Reader = str


def number(text: str) -> float:
    """A number of 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise ValueError("a number of 0 or more")
    return value


def positive(text: str) -> float:
    """A number above 0."""
    if not (value := number(text)):
        raise ValueError("a number above 0")
    return value


def numbers(text: str) -> list[float]:
    """Numbers of 0 or more with commas between them; none in an empty text."""
    return [number(each) for each in text.strip("[] ").split(",")] if text else []


def band(text: str) -> list[float]:
    """Two rising frequencies with a comma between them, or none."""
    try:
        found = numbers(text)
    except ValueError:
        found = [0.0]
    if found and (len(found) != 2 or found[0] >= found[1]):
        raise ValueError("two frequencies in Hz such as 0.3,10.0, the lower one first")
    return found


def flag(text: str) -> bool:
    """`true` or `false`."""
    if text.lower() not in ("true", "false"):
        raise ValueError("true or false")
    return text.lower() == "true"


def one_of(*choices: str) -> Reader:
    """One of these texts."""

    def read(text: str) -> str:
        if text not in choices:
            raise ValueError(" or ".join(choices) + did_you_mean(text, choices))
        return text

    return read


def matching(pattern: str, expected: str) -> Reader:
    """A text of a form, which `expected` says in words."""

    def read(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(expected)
        return text

    return read


def new_bag(text: str) -> str:
    """A path where nothing is yet."""
    if not text or Path(text).exists():
        raise ValueError("a new directory for the bag" + (", this one exists already" if text else ""))
    return text


def name_or_file(what: str, *endings: str) -> Reader:
    """A text; one that looks like a path, by a slash or one of the `endings`, has to name a file or directory.

    `what` is expected where it is empty; without it the text may be empty.
    """

    def read(text: str) -> str:
        if what and not text:
            raise ValueError(what)
        if ("/" in text or text.lower().endswith(endings)) and not Path(text).exists():
            raise ValueError("a file, and there is none of this name")
        return text

    return read


def parameter_file(text: str) -> str:
    """A ROS parameter file, or an empty text."""
    if not text:
        return text
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
        if text:
            return parameter_file(text)
        raise ValueError("a ROS parameter file")
    except ValueError as error:
        raise ValueError(f"{error}; or PACKAGE/EXECUTABLE of a node of your own") from error


def _holds_parameters(content: object) -> bool:
    if not isinstance(content, dict):
        return False
    return isinstance(content.get("ros__parameters"), dict) or any(map(_holds_parameters, content.values()))


def read_arguments(table: Sequence[Argument], texts: Mapping[str, str], given: Collection[str] = ()) -> dict[str, Any]:
    """The values of the arguments in a `table`, by name.

    Parameters
    ----------
    table
        The arguments that there are.
    texts
        Text of each that is not left at its default.
    given
        Names on the command line, all of which have to be in the table.

    Raises
    ------
    AbraceError
        With a line for each mistake.
    """
    names = [argument.name for argument in table]
    mistakes = [f"{name}: unknown, {expected_of(name, names)}" for name in given if name not in names]
    values = {}
    for argument in table:
        text = texts.get(argument.name, argument.default)
        try:
            values[argument.name] = argument.read(text)
        except ValueError as error:
            mistakes.append(f"{argument.name}:={text}, expected {error}")
    if mistakes:
        raise AbraceError("\n".join(["wrong launch arguments, nothing was started", *mistakes]))
    return values
