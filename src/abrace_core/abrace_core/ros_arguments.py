# SPDX-License-Identifier: Apache-2.0
"""Readable errors in a node's arguments and environment; rcl prints the state of its parser, or aborts."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core.errors import AbraceError
from abrace_core.suggestion import did_you_mean, expected_of
from abrace_core.yaml_text import parse_yaml, read_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

GREATEST_DOMAIN = 232
LEVELS = ("debug", "info", "warn", "error", "fatal", "unset")
RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_WITH_VALUE = {
    "-p": "name:=value",
    "--param": "name:=value",
    "-r": "from:=to",
    "--remap": "from:=to",
    "--params-file": "a file",
    "--log-level": "a level",
    "-e": "an enclave",
    "--enclave": "an enclave",
    "--log-config-file": "a file",
    "--log-file-name": "a name",
}
_SWITCHES = re.compile(r"--(enable|disable)-(rosout|stdout|external-lib)-logs")
_NAME = re.compile(r"[A-Za-z_]\w*")
_NAMESPACE = re.compile(r"/|(/[A-Za-z_]\w*)+")


def check_environment(environment: Mapping[str, str] = os.environ) -> None:
    """Check the variables of an `environment` that ROS reads before a program can say anything.

    Raises
    ------
    AbraceError
        `<variable>=<value>, expected ...`.
    """
    prefixes = [Path(text) for text in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if text]
    if not prefixes:
        raise AbraceError("AMENT_PREFIX_PATH is not set: expected ros2_ws/setup.bash to be sourced first")
    _expect(environment, "ROS_DOMAIN_ID", lambda text: text.isdecimal() and int(text) <= GREATEST_DOMAIN, "0 to 232")
    made = {
        path.name
        for each in prefixes
        for path in (each / "share/ament_index/resource_index/rmw_typesupport").glob("rmw_fastrtps_*")
    }
    # others number the messages of a stop button differently, or not at all: `StopListener` would not hear it
    _expect(environment, "RMW_IMPLEMENTATION", made.__contains__, f"Fast DDS: {', '.join(sorted(made))}")
    discovery = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    _expect(environment, discovery, RANGES.__contains__, " or ".join(RANGES))
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        _expect(environment, name, lambda text: Path(text).is_file(), "a file")


def _expect(environment: Mapping[str, str], name: str, fits: Any, expected: str) -> None:
    text = environment.get(name)
    if text and not fits(text):
        near = did_you_mean(text, re.findall(r"\w{4,}", expected))
        raise AbraceError(f"{name}={text}, expected {expected}{near}")


def mistake_in(arguments: Sequence[str]) -> str:
    """The error in a node's `arguments`, those after `--ros-args`, in one line; empty: none is known."""
    words = list(arguments)
    if "--ros-args" not in words:
        return ""
    rest = iter(words[words.index("--ros-args") + 1 :])
    for flag in rest:
        if flag == "--":
            return ""
        if _SWITCHES.fullmatch(flag):
            continue
        if flag not in _WITH_VALUE:
            hint = ", did you leave out -p?" if ":=" in flag else did_you_mean(flag, _WITH_VALUE)
            return f"argument {flag}: unknown after --ros-args, expected -p name:=value or --params-file FILE{hint}"
        value = next(rest, None)
        if value is None:
            return f"argument {flag}: no value after it, expected {_WITH_VALUE[flag]}"
        if mistake := _mistake(flag, value):
            return mistake
    return ""


def _mistake(flag: str, value: str) -> str:
    try:
        if flag in ("-p", "--param"):
            _check_parameter(value)
        elif flag in ("-r", "--remap"):
            _check_remapping(value)
        elif flag == "--params-file":
            _check_file(value)
        elif flag == "--log-level" and value.rpartition(":=")[2].lower() not in LEVELS:
            return f"argument {flag} {value}: {expected_of(value, LEVELS)}"
    except AbraceError as error:
        return str(error)
    return ""


def _check_parameter(given: str) -> None:
    name, assigned, text = given.partition(":=")
    if not assigned:
        name, _, text = given.replace(":", "=", 1).partition("=")
        raise AbraceError(
            f"argument -p {given}: expected name:=value, as {name or 'name'}:={text.lstrip('=') or 'value'}"
        )
    if not text:
        raise AbraceError(f"argument -p {given}: nothing after :=, expected a value; an empty text is ''")
    _check_value(parse_yaml(text, f"argument -p {given}"), f"argument -p {given}")


def _check_value(value: Any, where: str) -> None:
    if isinstance(value, list):
        kinds = {type(entry) for entry in value}
        if kinds == {int, float}:
            raise AbraceError(f"{where}: expected numbers of one kind, as [{', '.join(repr(float(v)) for v in value)}]")
        if len(kinds) > 1 or kinds & {list, dict, type(None)}:
            raise AbraceError(f"{where}: expected a list of numbers, of texts, or of true and false")
    elif value is None or isinstance(value, dict):
        raise AbraceError(f"{where}: expected a number, a text, true or false, or a list of them")


def _check_remapping(given: str) -> None:
    source, assigned, target = given.partition(":=")
    if not assigned or not target:
        raise AbraceError(f"argument -r {given}: expected from:=to, as response:=measured")
    if source == "__ns" and not _NAMESPACE.fullmatch(target):
        valid = "/" + re.sub(r"[^\w/]", "_", target.strip("/ "))
        raise AbraceError(f"argument -r {given}: expected a namespace of letters, digits and _, as {valid}")
    if source in ("__node", "__name") and not _NAME.fullmatch(target):
        valid = re.sub(r"\W", "_", target)
        raise AbraceError(f"argument -r {given}: expected a name of letters, digits and _, as {valid}")


def _check_file(path: str) -> None:
    content = read_yaml(path, "parameter")
    if content is not None and not (isinstance(content, dict) and _parameters_of(content, f"parameter file {path}")):
        raise AbraceError(
            f"parameter file {path}: no ros__parameters in it, expected /**: {{ros__parameters: {{...}}}}"
        )


def _parameters_of(content: Mapping[str, Any], where: str) -> bool:
    """Whether there are `ros__parameters` in a mapping or below it; their values are checked."""
    found = False
    for name, inner in content.items():
        if name == "ros__parameters" and isinstance(inner, dict):
            _check_values(inner, where)
            found = True
        elif isinstance(inner, dict):
            found = _parameters_of(inner, where) or found
    return found


def _check_values(content: Mapping[str, Any], where: str) -> None:
    for name, value in content.items():
        if isinstance(value, dict):
            _check_values(value, where)
        else:
            _check_value(value, f"{where}: {name}: {value!r}")
