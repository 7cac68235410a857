# SPDX-License-Identifier: Apache-2.0
"""Types of names, files and numbers in the campaign file. Its paths are relative to the file's own folder."""

from __future__ import annotations

import os
import re
from typing import Annotated

import pydantic

CONTROLLER_FILE = ".yaml"
MODEL_FILE = ".json"
LAW_FILE = ".py"
FOLDER = "folder"
"""Key of the validation context: the campaign file's folder."""
_NAMESPACE = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def is_step_name(name: str) -> bool:
    """Whether a step may have this `name`, which is also used for its files."""
    return _FILE_NAME.fullmatch(name) is not None


def _file_name(name: str) -> str:
    if not is_step_name(name):
        raise ValueError("up to 64 letters, digits, _ and -, a letter or digit first")
    return name


def _campaign_name(name: str) -> str:
    if not _NAMESPACE.fullmatch(name) or len(name) > 64 or "__" in name:
        raise ValueError("up to 64 letters, digits and single _, a letter first: it is the ROS namespace of the nodes")
    return name


def _rising(band: tuple[float, float]) -> tuple[float, float]:
    if not band[0] < band[1]:
        raise ValueError("two frequencies in Hz, the lower one first")
    return band


def from_folder(path: str, info: pydantic.ValidationInfo) -> str:
    """A `path` in the campaign file, joined to the file's folder from the validation context `info`."""
    return os.path.join((info.context or {}).get(FOLDER, "."), path)  # noqa: PTH118 - "./model" keeps its slash


def _name_or_file(text: str, info: pydantic.ValidationInfo) -> str:
    is_file = "/" in text or text.endswith((CONTROLLER_FILE, MODEL_FILE))
    return from_folder(text, info) if is_file else text


def is_path(name: str) -> bool:
    """Whether `name` is a path rather than the name of a step."""
    return "/" in name or name.endswith((CONTROLLER_FILE, MODEL_FILE))


def _for_all(value: object) -> object:
    return (value,) if isinstance(value, int | float) else value


def _one_above_zero(values: tuple[float, ...]) -> tuple[float, ...]:
    if not values or min(values) < 0 or max(values) == 0:
        raise ValueError("one number for all brace groups or one for each, 0 or more, above 0 for one group at least")
    return values


def _listed(value: object) -> object:
    return [value] if isinstance(value, str) else value


Positive = Annotated[float, pydantic.Field(gt=0, strict=True)]
NonNegative = Annotated[float, pydantic.Field(ge=0, strict=True)]
Real = Annotated[float, pydantic.Field(strict=True)]
Whole = Annotated[int, pydantic.Field(ge=0, strict=True)]
Flag = Annotated[bool, pydantic.Field(strict=True)]
Text = Annotated[str, pydantic.Field(min_length=1)]
Name = Annotated[str, pydantic.AfterValidator(_file_name)]
CampaignName = Annotated[str, pydantic.AfterValidator(_campaign_name)]
NameOrFile = Annotated[Text, pydantic.AfterValidator(_name_or_file)]
"""Name of a step or of a package's file; or a path, which contains "/" or ends in .yaml or .json."""
OfGroups = Annotated[tuple[Real, ...], pydantic.BeforeValidator(_for_all), pydantic.AfterValidator(_one_above_zero)]
"""One number for all brace groups, or one for each."""
Band = Annotated[tuple[NonNegative, NonNegative], pydantic.AfterValidator(_rising)]
Tests = Annotated[tuple[NameOrFile, ...], pydantic.Field(min_length=1), pydantic.BeforeValidator(_listed)]
